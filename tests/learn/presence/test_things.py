"""Things that are no hands: repeatable, in sight, of all kinds."""

import torch

from torchhand.learn.presence import thing_pool


def _generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_the_same_seed_gives_the_same_things() -> None:
    ready: list[int] = []
    one, same, other = (
        thing_pool(6, _generator(4), ready.append),
        thing_pool(6, _generator(4)),
        thing_pool(6, _generator(5)),
    )
    assert sum(ready) == len(one) == 6
    assert torch.equal(one.depth, same.depth)
    assert torch.equal(one.albedo, same.albedo)
    assert not torch.equal(one.label, other.label)


def test_things_are_in_sight_with_relief_and_brightness() -> None:
    things = thing_pool(32, _generator(1))
    share = things.label.float().mean((1, 2))
    assert float(share.median()) > 0.08
    assert int((share == 0).sum()) <= 2  # what another thing hides altogether
    is_thing = things.label > 0
    assert float((things.depth[is_thing] < 255).float().mean()) > 0.95
    assert bool((things.brightness[is_thing] > 0.1).all())
    dark = [
        float(one[mask].min() / one[mask].max())
        for one, mask in zip(things.brightness, is_thing, strict=True)
        if mask.any()
    ]
    assert min(dark) < 0.6  # eyes, stripes
    assert torch.equal(things.rows(slice(3, 5)).normal, things.normal[3:5])
