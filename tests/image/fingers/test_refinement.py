"""Graph cut about a guess, and the choice among guesses, on painted scenes."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from torchhand.image.fingers import FingerSettings, find_fingers, refinement
from torchhand.image.fingers.refinement import (
    RefinementSettings,
    edge_fraction,
    find_open_hand,
    fingers_apart,
    odd_digits,
    refine_silhouette,
)

SKIN = (205, 150, 125)
SIDE = 300


# Where each digit leaves the palm, and the middle of its round end, in palm radii about the palm's centre.
BASES = ((-1.36, 0.58), (-0.71, -1.28), (0.0, -1.30), (0.57, -1.11), (1.14, -0.86))
ENDS = ((-2.55, -0.22), (-1.08, -2.75), (0.0, -3.1), (0.86, -2.76), (1.62, -1.95))


def put(point: tuple[float, float]) -> tuple[int, int]:
    return round(150 + 30 * point[0]), round(165 + 30 * point[1])


def hand_mask() -> torch.Tensor:
    canvas = np.zeros((SIDE, SIDE), np.uint8)
    corners = [put(point) for point in (*BASES, (0.75, 1.2), (-0.75, 1.2))]
    cv2.fillPoly(canvas, [cv2.convexHull(np.array(corners, np.int32))], 1)
    cv2.line(canvas, (150, 160), (150, 299), 1, 42)
    for base, end in zip(BASES, ENDS, strict=True):
        cv2.line(canvas, put((0.8 * base[0], 0.8 * base[1])), put(end), 1, 13)
    return torch.from_numpy(canvas > 0)


def scene(background: tuple[int, int, int], generator: torch.Generator, noise: float = 4.0) -> torch.Tensor:
    picture = torch.tensor(background, dtype=torch.float64).expand(SIDE, SIDE, 3).clone()
    picture[hand_mask()] = torch.tensor(SKIN, dtype=torch.float64)
    picture = torch.from_numpy(cv2.GaussianBlur(picture.numpy(), (0, 0), 0.8))
    picture = picture + noise * torch.randn(picture.shape, generator=generator, dtype=torch.float64)
    return picture.round().clamp(0, 255).to(torch.uint8)


def overlap(a: torch.Tensor, b: torch.Tensor) -> float:
    return float((a & b).sum() / (a | b).sum())


def test_cut_puts_a_rough_outline_onto_the_edge(generator: torch.Generator) -> None:
    image, truth = scene((70, 90, 120), generator), hand_mask()
    rough = torch.from_numpy(cv2.dilate(truth.numpy().astype(np.uint8), np.ones((9, 9), np.uint8)) > 0)
    refined = refine_silhouette(image, rough)
    assert overlap(rough, truth) < 0.8
    assert overlap(refined, truth) > 0.92


def test_empty_and_full_guesses_stay(generator: torch.Generator) -> None:
    image = scene((70, 90, 120), generator)
    for guess in (torch.zeros(SIDE, SIDE, dtype=torch.bool), torch.ones(SIDE, SIDE, dtype=torch.bool)):
        assert bool((refine_silhouette(image, guess) == guess).all())


@pytest.mark.parametrize("background", [(40, 60, 90), (235, 235, 230), (230, 190, 120), (150, 95, 70)])
def test_hand_before_plain_and_skin_coloured_walls(
    background: tuple[int, int, int], generator: torch.Generator
) -> None:
    found = find_open_hand(scene(background, generator))
    assert found.search is not None
    assert found.search.order is not None
    assert len(found.search.order.fingers) == 5
    assert found.odd_digits == ()
    assert found.edge_fraction > 0.9
    assert overlap(found.mask, hand_mask()) > 0.93


def test_fingers_that_stand_out_are_counted(generator: torch.Generator) -> None:
    background = (40, 60, 90)
    whole = scene(background, generator)
    assert fingers_apart(whole) == 5
    larger = cv2.resize(whole.numpy(), None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    assert fingers_apart(torch.from_numpy(larger)) == 5
    folded = whole.numpy().copy()
    cv2.line(folded, put((1.3 * BASES[2][0], 1.3 * BASES[2][1])), put(ENDS[2]), background, 17)
    assert fingers_apart(torch.from_numpy(folded)) == 4
    folded[:] = background
    cv2.circle(folded, put((0.0, 0.0)), 45, SKIN, -1)
    cv2.line(folded, (150, 160), (150, 299), SKIN, 42)
    assert fingers_apart(torch.from_numpy(folded)) == 0  # a fist
    assert fingers_apart(torch.full_like(whole, 90)) is None


def test_guesses_alike_are_cut_once(generator: torch.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    cuts: list[torch.Tensor] = []

    def counted(image: torch.Tensor, guess: torch.Tensor, settings: RefinementSettings) -> torch.Tensor:
        cuts.append(guess)
        return refine_silhouette(image, guess, settings)

    monkeypatch.setattr(refinement, "refine_silhouette", counted)
    found = find_open_hand(scene((40, 60, 120), generator))
    assert found.search is not None
    assert found.search.order is not None
    assert len(found.search.order.fingers) == 5
    assert len(cuts) == 1  # skin, redness and blueness all show the same hand on blue


def test_shadow_of_a_finger_is_an_odd_digit(generator: torch.Generator) -> None:
    image = scene((235, 235, 230), generator)
    digit = np.zeros((SIDE, SIDE), np.uint8)
    cv2.line(digit, put(BASES[4]), put(ENDS[4]), 1, 15)
    image[torch.from_numpy(digit > 0)] = torch.tensor((60, 45, 40), dtype=torch.uint8)
    found = find_open_hand(image)
    named = None if found.search is None or found.search.order is None else tuple(found.search.order.fingers)
    assert named is None or len(named) < 5 or "little" in found.odd_digits


def test_a_hand_that_light_falls_off_over_has_no_odd_digit(generator: torch.Generator) -> None:
    channels = cv2.cvtColor(scene((40, 60, 90), generator).numpy(), cv2.COLOR_RGB2YCrCb).astype(np.float64)
    light = np.exp(-np.maximum(np.arange(SIDE) - 150, 0) / 45)  # from the palm's middle on
    dimmed = (channels * np.stack((light, np.ones(SIDE), np.ones(SIDE)), -1)).round().astype(np.uint8)
    image = torch.from_numpy(cv2.cvtColor(dimmed, cv2.COLOR_YCrCb2RGB))
    search = find_fingers(hand_mask(), FingerSettings())
    assert search.order is not None
    assert len(search.order.fingers) == 5
    x, y = put(ENDS[4])
    assert dimmed[y, x, 0] < 0.5 * dimmed[165, 150, 0]  # of the little finger's tip, and of the palm's middle
    assert odd_digits(image, search) == ()


def test_pieces_of_skin_are_looked_at_where_other_guesses_lack_a_finger(
    generator: torch.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, truth = scene((40, 60, 90), generator), hand_mask()
    half = truth.clone()
    half[:, : SIDE // 2] = False
    monkeypatch.setattr(refinement, "_guesses", lambda image, side: [("half", half)])
    monkeypatch.setattr(refinement, "refine_silhouette", lambda image, guess, settings: guess)
    found = find_open_hand(image)
    assert found.source.startswith("piece of skin")
    assert overlap(found.mask, truth) > 0.9
    monkeypatch.setattr(refinement, "_OPEN_MISFIT", 0.0)  # of another posture than an open hand's
    assert find_open_hand(image).source == "half"
    monkeypatch.setattr(refinement, "_guesses", lambda image, side: [])
    assert find_open_hand(image).source == "none"


def test_blank_wall_shows_no_five_fingers(generator: torch.Generator) -> None:
    wall = (128 + 3 * torch.randn(SIDE, SIDE, 3, generator=generator)).clamp(0, 255).to(torch.uint8)
    found = find_open_hand(wall)
    assert found.search is None or found.search.order is None or len(found.search.order.fingers) < 5


def test_edge_share_tells_edges_from_nothing(generator: torch.Generator) -> None:
    image, truth = scene((40, 60, 90), generator), hand_mask()
    assert edge_fraction(image, truth) > 0.95
    assert edge_fraction(torch.full_like(image, 100), truth) == 0.0
    assert edge_fraction(image, torch.zeros_like(truth)) == 0.0


@pytest.mark.parametrize(
    ("field", "value"), [("max_side_px", 8), ("core_fraction", 1.0), ("band_fraction", 0.0), ("iterations", 0)]
)
def test_settings_name_what_is_wrong(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        replace(RefinementSettings(), **{field: value})
