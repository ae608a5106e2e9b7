"""Pieces and holes against a slow flood fill."""

import pytest
import torch

from torchhand.image.segmentation.components import (
    clean,
    components,
    fill_holes,
    label_pieces,
    largest_component,
    solidity,
    touching,
)


def flood(mask: torch.Tensor, eight: bool) -> list[set[tuple[int, int]]]:
    """Connected pieces by plain breadth-first search."""
    height, width = mask.shape
    steps = [(-1, 0), (1, 0), (0, -1), (0, 1)]
    if eight:
        steps += [(-1, -1), (-1, 1), (1, -1), (1, 1)]
    left = {(int(y), int(x)) for y, x in mask.nonzero()}
    pieces = []
    while left:
        queue = [left.pop()]
        piece = set(queue)
        while queue:
            y, x = queue.pop()
            for dy, dx in steps:
                neighbour = (y + dy, x + dx)
                if neighbour in left:
                    left.remove(neighbour)
                    piece.add(neighbour)
                    queue.append(neighbour)
        pieces.append(piece)
    assert height * width >= sum(map(len, pieces))
    return pieces


@pytest.mark.parametrize("fraction", [0.3, 0.5, 0.65])
def test_pieces_equal_a_flood_fill(generator: torch.Generator, fraction: float) -> None:
    mask = torch.rand(24, 31, generator=generator) < fraction
    slow = sorted((len(piece) for piece in flood(mask, eight=True)), reverse=True)
    found = components(mask)
    assert [piece.area_px for piece in found] == slow
    assert [piece.area_px for piece in components(mask, min_area=3)] == [area for area in slow if area >= 3]
    for piece in found:
        y, x = (label_pieces(mask).labels == piece.label).nonzero(as_tuple=True)
        assert len(y) == piece.area_px
        assert (int(x.min()), int(y.min())) == (piece.left, piece.top)
        assert (int(x.max()) + 1 - piece.left, int(y.max()) + 1 - piece.top) == (piece.width, piece.height)
        assert piece.centroid == pytest.approx((float(x.float().mean()), float(y.float().mean())), abs=1e-3)
    assert int(largest_component(mask).sum()) == slow[0]


def test_holes_equal_a_flood_fill(generator: torch.Generator) -> None:
    mask = torch.rand(24, 31, generator=generator) < 0.6
    for limit in (None, 2):
        expected = mask.clone()
        for hole in flood(~mask, eight=False):
            inner = all(0 < y < 23 and 0 < x < 30 for y, x in hole)
            if inner and (limit is None or len(hole) <= limit):
                for y, x in hole:
                    expected[y, x] = True
        assert torch.equal(fill_holes(mask, max_area=limit), expected)
        assert not torch.equal(expected, mask)


def test_fill_leaves_its_argument_alone() -> None:
    ring = torch.ones(5, 5, dtype=torch.bool)
    ring[2, 2] = False
    assert bool(fill_holes(ring).all())
    assert not bool(ring[2, 2])


def test_empty_and_full_masks() -> None:
    empty, full = torch.zeros(7, 9, dtype=torch.bool), torch.ones(7, 9, dtype=torch.bool)
    assert components(empty) == []
    for function in (largest_component, fill_holes, clean):
        assert not function(empty).any()
        assert function(full).all()


def test_clean_removes_specks_closes_slits_and_follows_the_size() -> None:
    mask = torch.zeros(100, 120, dtype=torch.bool)
    mask[20:80, 20:80] = True
    mask[50, 20:80] = False
    mask[5, 100] = True
    cleaned = clean(mask)
    assert not bool(cleaned[5, 100])
    assert bool(cleaned[50, 25:75].all())
    large = torch.zeros(1000, 1280, dtype=torch.bool)
    large[500:504, 600:604] = True  # a speck in a picture of this size
    assert not clean(large).any()
    assert clean(large, radius_px=0).sum() == 16
    with pytest.raises(ValueError, match="radius_px must be >= 0, got -1"):
        clean(mask, radius_px=-1)


def test_pieces_apart_from_the_model_do_not_count() -> None:
    model, picture = torch.zeros(20, 30, dtype=torch.bool), torch.zeros(20, 30, dtype=torch.bool)
    model[5:15, 5:12] = True
    picture[4:14, 6:13] = True  # the hand
    picture[14, 13] = True  # joined by a corner
    picture[2:6, 20:26] = True  # clutter
    kept = touching(picture, model)
    expected = picture.clone()
    expected[2:6, 20:26] = False
    assert torch.equal(kept, expected)
    assert not bool(touching(picture, torch.zeros_like(model)).any())
    assert not bool(touching(torch.zeros_like(model), model).any())


def test_solidity_of_shapes_whose_hulls_are_known() -> None:
    mask = torch.zeros(60, 60, dtype=torch.bool)
    assert solidity(mask) == 0
    mask[10:40, 10:40] = True
    assert solidity(mask) == 1
    mask[10:25, 25:40] = False  # the hull of what is left cuts the corner off: 900 - 225 of 900 - 112.5
    assert solidity(mask) == pytest.approx(675 / 787.5, abs=0.02)
