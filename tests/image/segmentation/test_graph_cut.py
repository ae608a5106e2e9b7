"""Graph cuts: what colours alone miss, what cannot be cut, and sameness."""

import torch

from torchhand.image import cut_along_edges, graph_cut

SKIN, WALL = torch.tensor((205.0, 150.0, 125.0)), torch.tensor((90.0, 110.0, 150.0))


def _picture() -> tuple[torch.Tensor, torch.Tensor]:
    """A disc of skin whose right half grows dark, before a wall, and where it is."""
    y, x = torch.meshgrid(torch.arange(80), torch.arange(100), indexing="ij")
    disc = (x - 50) ** 2 + (y - 40) ** 2 < 25**2
    light = 1 - 0.35 * ((x - 40) / 35).clamp(0, 1)
    noise = 4 * torch.randn(80, 100, 3, generator=torch.Generator().manual_seed(0))
    picture = torch.where(disc[..., None], SKIN * light[..., None], WALL) + noise
    return picture.clamp(0, 255).to(torch.uint8), disc


def _overlap(one: torch.Tensor, other: torch.Tensor) -> float:
    return float((one & other).sum() / (one | other).sum())


def test_a_lit_half_is_completed_by_its_shaded_one() -> None:
    picture, disc = _picture()
    lit = disc & (torch.arange(100) < 60)
    assert _overlap(lit, disc) < 0.75
    assert _overlap(cut_along_edges(picture, lit), disc) > 0.95


def test_a_rim_of_wall_is_taken_away() -> None:
    picture, disc = _picture()
    broad = torch.nn.functional.max_pool2d(disc[None, None].float(), 11, 1, 5)[0, 0] > 0
    assert _overlap(broad, disc) < 0.75
    assert _overlap(cut_along_edges(picture, broad), disc) > 0.95


def test_what_is_inside_and_outside_stays() -> None:
    picture, disc = _picture()
    inside, outside = torch.zeros_like(disc), torch.zeros_like(disc)
    inside[:5, :5], outside[38:43, 48:53] = True, True
    found = graph_cut(picture, disc, inside=inside, outside=outside)
    assert bool(found[inside].all())
    assert not bool(found[outside].any())


def test_nothing_is_cut_where_one_side_is_empty() -> None:
    picture, disc = _picture()
    nothing = torch.zeros_like(disc)
    for likely in (nothing, ~nothing):
        assert torch.equal(graph_cut(picture, likely, inside=nothing, outside=nothing), likely)


def test_the_same_picture_gives_the_same_cut() -> None:
    picture, disc = _picture()
    assert torch.equal(cut_along_edges(picture, disc), cut_along_edges(picture, disc))
