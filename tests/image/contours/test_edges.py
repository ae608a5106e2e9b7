"""Edge search along normals against steps whose place is known."""

import math
from typing import Any

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter1d

from torchhand.image.contours.edges import EdgeSettings, derivative_of_gaussian, search_edges

CENTRE = torch.tensor([80.3, 60.7])


def step_image(angle: float, blur: float, low: float = 0.2, high: float = 0.8) -> torch.Tensor:
    """120 x 160 picture, `high` behind the line through CENTRE with outward normal at `angle`, `low` before it."""
    y, x = torch.meshgrid(
        torch.arange(120.0, dtype=torch.float64), torch.arange(160.0, dtype=torch.float64), indexing="ij"
    )
    distance = (x - CENTRE[0]) * math.cos(angle) + (y - CENTRE[1]) * math.sin(angle)
    return (low + (high - low) * 0.5 * torch.erfc(distance / (blur * math.sqrt(2.0)))).float()


def line_points(angle: float, offsets: torch.Tensor, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Points `offsets` beyond the line, at random places along it, and their normals."""
    normal = torch.tensor([math.cos(angle), math.sin(angle)])
    tangent = torch.stack([-normal[1], normal[0]])
    along = (torch.rand(len(offsets), 1, generator=generator) * 2.0 - 1.0) * 15.0
    return CENTRE + offsets[:, None] * normal + along * tangent, normal.expand(len(offsets), 2)


@pytest.mark.parametrize("blur", [0.7, 1.5, 2.5])
def test_blurred_step_is_found_to_a_twentieth_of_a_pixel(generator: torch.Generator, blur: float) -> None:
    for angle in torch.linspace(0.0, 2.0 * math.pi, 17).tolist():
        offsets = torch.rand(30, generator=generator) * 20.0 - 10.0
        points, normals = line_points(angle, offsets, generator)
        result = search_edges(step_image(angle, blur), points, normals)
        assert result.found.all()
        assert (result.offset_px + offsets).abs().max() < 0.05
        assert (result.polarity == 1).all()
        assert (result.candidates == 1).all()
        expected = 0.6 * 1.5 / math.hypot(1.5, blur)
        assert (result.strength - expected).abs().max() < 0.03


def test_noise_moves_the_edge_by_little(generator: torch.Generator) -> None:
    image = step_image(0.4, 1.0) + 0.03 * torch.randn(120, 160, generator=generator)
    offsets = torch.rand(200, generator=generator) * 12.0 - 6.0
    points, normals = line_points(0.4, offsets, generator)
    result = search_edges(image, points, normals)
    assert result.found.all()
    assert (result.offset_px + offsets).square().mean().sqrt() < 0.25


def test_ideal_step_answers_its_height() -> None:
    image = torch.zeros(40, 60)
    image[:, 30:] = 0.5
    image[:, 29] = 0.25  # the step lies in the middle of pixel 29
    points, normals = torch.tensor([[27.0, 20.0]]), torch.tensor([[1.0, 0.0]])
    result = search_edges(image, points, normals, EdgeSettings(sigma_px=3.0))
    assert float(result.offset_px) == pytest.approx(2.0, abs=1e-3)
    assert float(result.strength) == pytest.approx(0.5, abs=0.01)
    assert int(result.polarity) == -1


def test_kernel_is_the_derivative_of_a_gaussian() -> None:
    sigma, step = 1.5, 0.5  # px, between samples
    impulse = np.zeros(201)
    impulse[100] = 1.0
    scipy_kernel = gaussian_filter1d(impulse, sigma / step, order=1, truncate=3.0)
    ours = derivative_of_gaussian(sigma).numpy()
    # Correlation against convolution turns the sign, and both are compared at their peak's height.
    theirs = -scipy_kernel[100 - 9 : 100 + 10]
    assert np.allclose(ours / ours.max(), theirs / theirs.max(), atol=1e-9)
    assert derivative_of_gaussian(sigma)[10:].sum() == pytest.approx(1.0)


def two_edges() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Bright bar: columns 50..65 against 0, and a fainter step up at 40; the point at 48 looks along +x."""
    x = torch.arange(120, dtype=torch.float64)

    def rise(place: float) -> torch.Tensor:
        return 0.5 * torch.erfc(-(x - place) / math.sqrt(2.0))

    row = 0.35 * rise(43.0) + 0.45 * rise(58.0) - 0.8 * rise(75.0)
    return row.float().expand(30, 120), torch.tensor([[46.0, 15.0]]), torch.tensor([[1.0, 0.0]])


def test_strongest_and_nearest_choose_differently_and_count_rivals() -> None:
    image, points, normals = two_edges()
    strongest = search_edges(image, points, normals)
    nearest = search_edges(image, points, normals, EdgeSettings(choose="nearest"))
    assert float(strongest.offset_px) == pytest.approx(12.0, abs=0.02)
    assert float(nearest.offset_px) == pytest.approx(-3.0, abs=0.02)
    assert int(strongest.candidates) == int(nearest.candidates) == 2
    alone = search_edges(image, points, normals, EdgeSettings(choose="nearest", rival_fraction=0.95))
    assert float(alone.offset_px) == pytest.approx(12.0, abs=0.02)
    assert int(alone.candidates) == 1


def test_polarity_selects_the_side() -> None:
    image, points, normals = two_edges()
    wide: Any = {"half_length_px": 35.0}
    assert float(search_edges(image, points, normals, **wide).offset_px) == pytest.approx(29.0, abs=0.02)
    bright = search_edges(image, points, normals, EdgeSettings(polarity="inside_bright"), **wide)
    assert float(bright.offset_px) == pytest.approx(29.0, abs=0.02)
    assert int(bright.polarity) == 1
    dark = search_edges(image, points, normals, EdgeSettings(polarity="inside_dark"), **wide)
    assert float(dark.offset_px) == pytest.approx(12.0, abs=0.02)
    assert int(dark.polarity) == -1


def test_flank_of_an_edge_beyond_the_end_is_none() -> None:
    image, points, normals = two_edges()
    result = search_edges(image, points, normals, EdgeSettings(polarity="inside_dark"), half_length_px=11.0)
    assert float(result.offset_px) == pytest.approx(-3.0, abs=0.02)
    nothing = search_edges(image, points, normals, half_length_px=torch.tensor([2.0]))
    assert not bool(nothing.found)
    assert float(nothing.offset_px) == float(nothing.strength) == 0.0
    assert int(nothing.candidates) == int(nothing.polarity) == 0


def test_half_length_per_point_shortens_and_lengthens() -> None:
    image, points, normals = two_edges()
    three, lengths = points.expand(3, 2), torch.tensor([1.0, 5.0, 40.0])
    result = search_edges(image, three, normals.expand(3, 2), half_length_px=lengths)
    assert result.found.tolist() == [False, True, True]
    assert result.offset_px[1:].tolist() == pytest.approx([-3.0, 29.0], abs=0.02)


def test_a_search_of_any_length_ends_with_the_picture(generator: torch.Generator) -> None:
    """A hand that lies at the camera's lens is searched for its edges without bound: 15 GB were asked for once."""
    picture = step_image(0.4, 1.0)
    points, normals = line_points(0.4, torch.tensor([3.0, -4.0]), generator)
    narrow = search_edges(picture, points, normals, half_length_px=15.0)
    wide = search_edges(picture, points, normals, half_length_px=torch.tensor([15.0, 1e9]))
    assert wide.found.all()
    torch.testing.assert_close(wide.offset_px, narrow.offset_px, rtol=0, atol=1e-5)


def test_long_and_short_searches_are_correlated_alike(
    generator: torch.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = torch.rand(3, 120, 160, generator=generator)
    points, normals = line_points(1.1, torch.rand(9, generator=generator) * 8 - 4, generator)
    by_band = search_edges(picture, points.reshape(3, 3, 2), normals.reshape(3, 3, 2))
    monkeypatch.setattr("torchhand.image.contours.edges._MOST_IN_BAND", 0)
    by_convolution = search_edges(picture, points.reshape(3, 3, 2), normals.reshape(3, 3, 2))
    torch.testing.assert_close(by_convolution.offset_px, by_band.offset_px, rtol=0, atol=1e-4)
    torch.testing.assert_close(by_convolution.strength, by_band.strength)


def test_border_of_the_picture_is_no_edge() -> None:
    image = torch.full((40, 60), 0.9)
    points = torch.tensor([[1.0, 20.0], [58.0, 20.0], [30.0, 1.0], [30.0, 39.0], [-5.0, 20.0], [300.0, 300.0]])
    normals = torch.tensor([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0], [1.0, 0.0], [1.0, 0.0]])
    assert not search_edges(image, points, normals).found.any()


def test_edge_inside_is_found_from_a_point_near_the_border() -> None:
    image = step_image(0.0, 1.0)
    points, normals = torch.tensor([[86.0, 60.0]]), torch.tensor([[1.0, 0.0]])
    cropped = search_edges(image[:, :94], points, normals)  # the search runs out of the picture at 93
    assert bool(cropped.found)
    assert float(cropped.offset_px) == pytest.approx(80.3 - 86.0, abs=0.05)


def test_points_that_are_not_finite_find_nothing() -> None:
    points = torch.tensor([[float("nan"), 20.0], [float("inf"), 3.0]])
    result = search_edges(step_image(0.0, 1.0), points, torch.tensor([[1.0, 0.0], [1.0, 0.0]]))
    assert not result.found.any()
    assert (result.offset_px == 0.0).all()


def test_several_planes_take_the_loudest() -> None:
    image, points, normals = two_edges()
    flat = torch.zeros_like(image)
    planes = torch.stack([flat, image, 0.3 * image.flip(-1)])
    single = search_edges(image, points, normals)
    several = search_edges(planes, points, normals)
    assert float(several.offset_px) == pytest.approx(float(single.offset_px), abs=1e-5)
    muted = search_edges(planes, points, normals, channel_weights=torch.tensor([1.0, 0.1, 0.1]))
    assert float(muted.strength) == pytest.approx(0.1 * float(single.strength), abs=1e-5)


def test_batch_shapes_equal_a_loop(generator: torch.Generator) -> None:
    image = torch.rand(60, 80, generator=generator)
    points = torch.rand(2, 3, 5, 2, generator=generator) * torch.tensor([79.0, 59.0])
    normals = torch.nn.functional.normalize(torch.randn(2, 3, 5, 2, generator=generator), dim=-1)
    settings = EdgeSettings(choose="nearest")
    whole = search_edges(image, points, normals, settings, half_length_px=6.0)
    assert whole.offset_px.shape == (2, 3, 5)
    assert whole.found.any()
    for i in range(2):
        for j in range(3):
            part = search_edges(image, points[i, j], normals[i, j], settings, half_length_px=6.0)
            assert torch.equal(part.found, whole.found[i, j])
            assert torch.equal(part.candidates, whole.candidates[i, j])
            assert torch.allclose(part.offset_px, whole.offset_px[i, j], atol=1e-5)
    empty = search_edges(image, points[0, 0, :0], normals[0, 0, :0], settings)
    assert empty.offset_px.shape == (0,)


def test_slow_loop_agrees(generator: torch.Generator) -> None:
    """One profile at a time, in numpy, from the formula."""
    image = torch.nn.functional.avg_pool2d(torch.rand(1, 64, 84, generator=generator), 5, stride=1)[0]
    points = torch.rand(40, 2, generator=generator) * torch.tensor([30.0, 20.0]) + torch.tensor([25.0, 20.0])
    normals = torch.nn.functional.normalize(torch.randn(40, 2, generator=generator), dim=-1)
    settings = EdgeSettings(sigma_px=1.0, min_strength=0.01)
    result = search_edges(image, points, normals, settings, half_length_px=5.0)
    pixels = image.double().numpy()

    def read(x: float, y: float) -> float:
        column, row = int(x), int(y)
        u, v = x - column, y - row
        top = (1 - u) * pixels[row, column] + u * pixels[row, column + 1]
        return (1 - v) * top + v * ((1 - u) * pixels[row + 1, column] + u * pixels[row + 1, column + 1])

    taps = [0.5 * i for i in range(-6, 7)]
    scale = sum(t * math.exp(-0.5 * t * t) for t in taps if t > 0)
    for k in range(40):
        (x, y), (nx, ny) = points[k].tolist(), normals[k].tolist()
        places = [0.5 * i for i in range(-11, 12)]
        answers = [
            abs(sum(t * math.exp(-0.5 * t * t) * read(x + nx * (s + t), y + ny * (s + t)) for t in taps) / scale)
            for s in places
        ]
        peaks = [i for i in range(1, 22) if answers[i - 1] < answers[i] >= answers[i + 1] and answers[i] >= 0.01]
        assert bool(result.found[k]) == bool(peaks)
        if peaks:
            best = max(peaks, key=lambda i: answers[i])
            assert float(result.strength[k]) == pytest.approx(answers[best], abs=1e-4)
            assert float(result.offset_px[k]) == pytest.approx(places[best], abs=0.25 + 1e-6)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("sigma_px", 0.4, "sigma_px must be >= 0.5 px"),
        ("min_strength", -0.1, "min_strength must be >= 0"),
        ("rival_fraction", 1.5, "rival_fraction must lie in 0..1"),
        ("polarity", "up", "polarity must be one of any, inside_bright, inside_dark"),
        ("choose", "best", "choose must be one of strongest, nearest"),
    ],
)
def test_settings_name_what_is_wrong(field: str, value: object, message: str) -> None:
    settings = EdgeSettings()
    # Set behind the type checker's back: it would refuse the wrong words before they are looked at.
    object.__setattr__(settings, field, value)
    with pytest.raises(ValueError, match=message):
        settings.__post_init__()
