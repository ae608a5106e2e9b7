"""Distance fields: signed distances of shapes that are known, exact gradients, directions kept apart, edges."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.image.contours.boundaries import boundary_points
from torchhand.image.contours.distance_fields import boundary_field, channel_of, point_field

WIDTH, HEIGHT = 120, 90
CENTRE = torch.tensor((61.3, 44.8), dtype=torch.float64)


def grid() -> tuple[Tensor, Tensor]:
    y, x = torch.meshgrid(torch.arange(HEIGHT).double(), torch.arange(WIDTH).double(), indexing="ij")
    return x, y


def disc(radius: float) -> Tensor:
    x, y = grid()
    return (x - CENTRE[0]).square() + (y - CENTRE[1]).square() <= radius**2


@pytest.mark.parametrize(("pitch", "channels", "bound"), [(1, 1, 0.75), (1, 8, 0.75), (2, 8, 1.3), (3, 1, 2.0)])
def test_signed_distance_of_a_disc(pitch: int, channels: int, bound: float, generator: torch.Generator) -> None:
    """Inside negative, outside positive, through zero on the circle, wherever the nearest boundary is that way."""
    field = boundary_field(disc(25.0), pitch_px=pitch, channels=channels)
    angle = 2 * math.pi * torch.rand(400, generator=generator, dtype=torch.float64)
    radius = 18 + 16 * torch.rand(400, generator=generator, dtype=torch.float64)
    outward = torch.stack((angle.cos(), angle.sin()), -1)
    channel = channel_of(outward, channels)
    distance, gradient = field.sample(CENTRE + radius[:, None] * outward, channel)
    error = distance - (radius - 25)
    assert float(error.abs().max()) < bound
    assert abs(float(error.mean())) < 0.15 * pitch
    assert float((gradient * outward).sum(-1).median()) > 0.95


def test_a_straight_boundary_is_found_exactly_between_the_pixels() -> None:
    x, _ = grid()
    field = boundary_field(x <= 40)  # the boundary is at 40.5
    places = torch.linspace(20, 60, 81, dtype=torch.float64)
    points = torch.stack((places, torch.full_like(places, 45.2)), -1)
    distance, gradient = field.sample(points)
    torch.testing.assert_close(distance, places - 40.5, atol=1e-5, rtol=0)
    torch.testing.assert_close(gradient, torch.tensor((1.0, 0.0)).double().expand(81, 2), atol=1e-5, rtol=0)


def test_two_sides_of_a_finger_are_not_confused() -> None:
    """A point with the right side's normal is drawn to the right side even from the left one."""
    x, y = grid()
    field = boundary_field((x > 50) & (x <= 60) & (y > 10), channels=8)
    right = torch.tensor((1.0, 0.0), dtype=torch.float64)
    point = torch.tensor((50.0, 60.0), dtype=torch.float64)
    distance, gradient = field.sample(point, channel_of(right, 8))
    assert float(distance) == pytest.approx(-10.5, abs=1e-5)
    assert float(gradient[0]) == pytest.approx(1.0, abs=1e-5)
    undirected, _ = boundary_field((x > 50) & (x <= 60) & (y > 10)).sample(point)
    assert abs(float(undirected)) < 1


@pytest.mark.parametrize("signed", [True, False])
def test_gradient_is_that_of_the_value(signed: bool, generator: torch.Generator) -> None:
    """Closed form against autograd, inside the picture and far outside of it."""
    marked = torch.rand(30, 2, generator=generator) * torch.tensor((WIDTH - 1.0, HEIGHT - 1.0))
    field = boundary_field(disc(20.0), channels=4) if signed else point_field(marked, WIDTH, HEIGHT)
    points = (torch.rand(300, 2, generator=generator, dtype=torch.float64) - 0.25) * 2 * WIDTH
    channel = torch.randint(field.channels, (300,), generator=generator)
    points.requires_grad_()
    value, gradient = field.sample(points, channel)
    expected = torch.autograd.grad(value.sum(), points)[0]
    torch.testing.assert_close(gradient, expected, atol=1e-9, rtol=0)


def test_beyond_the_map_the_distance_grows() -> None:
    field = boundary_field(disc(20.0))
    out = torch.tensor([[500.0, 44.8], [900.0, 44.8], [61.3, -700.0]], dtype=torch.float64)
    distance, gradient = field.sample(out)
    assert float(distance[1] - distance[0]) == pytest.approx(400, abs=1e-6)
    torch.testing.assert_close(gradient[0], torch.tensor((1.0, 0.0)).double(), atol=1e-6, rtol=0)
    assert float(gradient[2, 1]) == pytest.approx(-1.0)


def test_points_that_are_not_finite_stay_so() -> None:
    field = boundary_field(disc(20.0))
    points = torch.tensor([[torch.nan, 4.0], [10.0, 10.0]], dtype=torch.float64)
    distance, _ = field.sample(points)
    assert distance.isnan().tolist() == [True, False]


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_of_points(batch: tuple[int, ...], generator: torch.Generator) -> None:
    field = boundary_field(disc(20.0), channels=4)
    points = 80 * torch.rand(*batch, 2, generator=generator, dtype=torch.float64)
    channel = torch.randint(4, batch, generator=generator)
    value, gradient = field.sample(points, channel)
    for i, (point, own) in enumerate(zip(points.reshape(-1, 2), channel.reshape(-1), strict=True)):
        one, slope = field.sample(point, own)
        torch.testing.assert_close(value.reshape(-1)[i], one)
        torch.testing.assert_close(gradient.reshape(-1, 2)[i], slope)


def test_point_field_keeps_places_within_the_pixel() -> None:
    line = torch.stack((torch.linspace(10, 90, 400).double(), torch.full((400,), 40.25).double()), -1)
    probe = torch.tensor([[50.0, 45.0], [50.0, 35.0]], dtype=torch.float64)
    fine, _ = point_field(line, WIDTH, HEIGHT, pitch_px=0.25).sample(probe)
    torch.testing.assert_close(fine, torch.tensor((4.75, 5.25)).double(), atol=1e-3, rtol=0)


def test_boundary_points_lie_on_the_circle_with_its_normals() -> None:
    found = boundary_points(disc(30.0), 80)
    assert len(found.points_px) == 80
    offset = found.points_px - CENTRE
    assert float((offset.norm(dim=-1) - 30).abs().mean()) < 0.15
    assert float((offset.norm(dim=-1) - 30).abs().max()) < 0.5
    outward = torch.nn.functional.normalize(offset, dim=-1)
    assert float((outward * found.normals).sum(-1).min()) > math.cos(math.radians(10))


def test_the_edge_of_the_picture_is_no_boundary() -> None:
    x, _ = grid()
    found = boundary_points(x < 30, 500)
    assert len(found.points_px) > 50
    torch.testing.assert_close(found.points_px[:, 0], torch.full_like(found.points_px[:, 0], 29.5), atol=0.1, rtol=0)


def test_empty_and_full_masks_have_no_boundary() -> None:
    for mask in (torch.zeros(HEIGHT, WIDTH, dtype=torch.bool), torch.ones(HEIGHT, WIDTH, dtype=torch.bool)):
        assert len(boundary_points(mask, 50).points_px) == 0
        value, gradient = boundary_field(mask, channels=4).sample(torch.rand(5, 2).double(), torch.arange(5) % 4)
        assert bool(value.isfinite().all())
        assert float(gradient.abs().max()) == 0


@pytest.mark.parametrize(("pitch", "channels"), [(1, 1), (1, 8), (2, 8), (3, 4)])
def test_what_lies_around_does_not_matter(pitch: int, channels: int) -> None:
    """The same hand elsewhere in a larger picture: the same field and the same points, moved."""
    mask = disc(21.0) | disc(14.0).roll(12, 0)
    step = (6 * 7, 6 * 9)  # of rows and columns, multiples of every pitch
    larger = torch.zeros(HEIGHT + 130, WIDTH + 150, dtype=torch.bool)
    larger[step[0] : step[0] + HEIGHT, step[1] : step[1] + WIDTH] = mask
    moved = torch.tensor((step[1], step[0]), dtype=torch.float64)
    y, x = torch.meshgrid(torch.arange(4, HEIGHT - 6, 3.7), torch.arange(4, WIDTH - 6, 3.3), indexing="ij")
    probe = torch.stack((x, y), -1).reshape(-1, 2).double()
    channel = torch.arange(len(probe)) % channels
    fields = (boundary_field(one, pitch_px=pitch, channels=channels, reach_px=200.0) for one in (mask, larger))
    (value, slope), (other, other_slope) = (
        field.sample(points, channel) for field, points in zip(fields, (probe, probe + moved), strict=True)
    )
    torch.testing.assert_close(value, other, atol=1e-4, rtol=0)
    torch.testing.assert_close(slope, other_slope, atol=1e-4, rtol=0)
    one, two = (boundary_points(picture, 60) for picture in (mask, larger))
    torch.testing.assert_close(one.points_px + moved, two.points_px)
    torch.testing.assert_close(one.normals, two.normals)


def test_maps_reach_as_far_as_they_are_asked_to() -> None:
    """Within the reach nothing changes; the margin is 8 pixels of the map more."""
    whole, near = boundary_field(disc(12.0)), boundary_field(disc(12.0), reach_px=3.0)
    assert near.maps.shape[-1] == 26 + 2 * (3 + 8)  # 24 columns of the disc, and those beside it
    angle = torch.arange(0.0, 6.2, 0.1, dtype=torch.float64)
    probe = CENTRE + 22 * torch.stack((angle.cos(), angle.sin()), -1)
    torch.testing.assert_close(near.sample(probe)[0], whole.sample(probe)[0], atol=1e-6, rtol=0)


def test_refuses_nonsense() -> None:
    with pytest.raises(ValueError, match="expected 1 or more, got 0 and 1"):
        boundary_field(disc(10.0), pitch_px=0)
