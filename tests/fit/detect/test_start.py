"""A hand found in a single picture, or the reason why not."""

import itertools
import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from torchhand.fit import Appearance, learn_appearance
from torchhand.fit.detect.edge_fit import Fit
from torchhand.fit.detect.start import (
    ContourFitter,
    NoStart,
    Start,
    find_hand,
    fit_overlap,
    segment_hand,
    start_at_points,
)
from torchhand.hand import posture
from torchhand.image import SilhouetteSettings, learn_background
from torchhand.simulate import SceneSettings, background_picture, sample_shape
from torchhand.simulate.scene import BackgroundKind

CLUTTER = SceneSettings(supersampling=2, background="clutter", noise=3.0)


def _fitter(placed: Any, studio: Any, *, fit_shape: bool = True) -> ContourFitter:
    own = placed.kinematics
    return ContourFitter(
        kinematics=own, camera=placed.camera, table=studio.table, shape=own.default_shape, fit_shape=fit_shape
    )


def _find(
    image: torch.Tensor, placed: Any, studio: Any, posed: str = "open", fit_shape: bool = True, **options: Any
) -> Start | NoStart:
    with torch.no_grad():
        fitter = _fitter(placed, studio, fit_shape=fit_shape)
        return find_hand(image, posture(posed, dtype=torch.float64), fitter, **options)


def _error(start: Start | NoStart, placed: Any) -> float:
    """Mean distance of the keypoints from the truth, share of the hand's length."""
    assert isinstance(start, Start), start
    frames = placed.kinematics(start.fit.pose, start.fit.shape, root_reference=start.fit.root_reference)
    off = placed.camera.project(frames.keypoints) - placed.keypoints_px
    return float(off.norm(dim=-1).mean()) / placed.length_px


@pytest.mark.parametrize(
    ("side", "view", "background"),
    [
        (*which, background)
        for which, background in zip(
            itertools.product(("right", "left"), ("palm", "back")), ("plain", "wall", "dark", "wall"), strict=True
        )
    ],
)
def test_an_open_hand_of_another_person_is_found(side: str, view: Any, background: BackgroundKind, studio: Any) -> None:
    generator = torch.Generator().manual_seed(11)
    shape = sample_shape(studio.kinematics(side).shape_space, generator, spread=0.6)
    placed = studio.placed(side=side, view=view, shape=shape, angle_deg=-25.0, at=(0.1, 0.0), size=0.55)
    scene = SceneSettings(supersampling=2, background=background, skin="brown", forearm=side == "left")
    start = _find(placed.picture(scene), placed, studio)
    assert _error(start, placed) < 0.05
    assert isinstance(start, Start)
    assert start.overlap > 0.9
    assert start.quality <= start.overlap
    # the side is right: a hand turned over would have its palm's normal reversed
    assert float((start.fit.root_reference @ placed.root_reference.T).trace()) > 2.7
    assert isinstance(start.appearance, Appearance)
    assert float(start.appearance.probability(placed.picture(scene))[placed.mask].mean()) > 0.9


@pytest.mark.parametrize("background", ["plain", "dark", "wall"])
def test_a_bare_background_holds_no_hand(background: BackgroundKind, studio: Any) -> None:
    placed = studio.placed()
    image = background_picture(background, 200, 160, torch.Generator().manual_seed(1))
    noise = 2 * torch.randn(image.shape, generator=torch.Generator().manual_seed(2))
    image = (image + noise).round().clamp(0, 255).to(torch.uint8)
    start = _find(image, placed, studio)
    assert isinstance(start, NoStart)
    assert not start.has_foreground
    assert start.reason


def test_a_fist_is_no_open_hand(studio: Any) -> None:
    fist = studio.placed(posed="fist", view="palm", size=0.9)
    start = _find(fist.picture(), fist, studio)
    assert isinstance(start, NoStart)
    assert start.has_foreground
    assert "posture of the start" in start.reason


def test_a_hand_mostly_out_of_the_picture_is_not_found(studio: Any) -> None:
    placed = studio.placed(at=(0.62, 0.0))
    start = _find(placed.picture(), placed, studio)
    assert isinstance(start, NoStart)


def test_a_pointing_hand_is_found_with_its_posture(studio: Any) -> None:
    placed = studio.placed(posed="point", view="back", angle_deg=20.0, size=0.7)
    assert _error(_find(placed.picture(), placed, studio, "point"), placed) < 0.06


def test_known_proportions_are_kept(studio: Any) -> None:
    placed = studio.placed(angle_deg=10.0)
    start = _find(placed.picture(), placed, studio, fit_shape=False)
    assert isinstance(start, Start)
    assert torch.equal(start.fit.shape, placed.kinematics.default_shape)


def test_learned_colours_find_a_hand_that_is_no_skin(studio: Any) -> None:
    """A green glove before a skin-coloured wall."""
    placed = studio.placed(angle_deg=-12.0)
    mask = placed.mask
    image = torch.empty(placed.camera.height, placed.camera.width, 3, dtype=torch.uint8)
    image[:] = torch.tensor((205, 160, 135), dtype=torch.uint8)
    image[mask] = torch.tensor((40, 170, 60), dtype=torch.uint8)
    appearance = learn_appearance(image, mask, ~mask, 2)
    segmented, reason = segment_hand(image, appearance)
    assert (int((segmented ^ mask).sum()) < 0.03 * int(mask.sum()), reason) == (True, "")
    start = _find(image, placed, studio, appearance=appearance)
    assert _error(start, placed) < 0.05
    assert isinstance(start, Start)
    assert start.appearance is appearance
    bare = torch.empty_like(image)
    bare[:] = torch.tensor((205, 160, 135), dtype=torch.uint8)
    gone = _find(bare, placed, studio, appearance=appearance)
    assert isinstance(gone, NoStart)
    assert (gone.reason, gone.has_foreground) == ("nothing has the hand's colours", False)


@pytest.mark.parametrize(("side", "view", "fit_shape"), [("right", "palm", True), ("left", "back", False)])
def test_two_points_start_in_clutter(side: str, view: Any, fit_shape: bool, studio: Any) -> None:
    placed = studio.placed(side=side, view=view, angle_deg=18.0, camera=studio.camera(240, 192))
    image = placed.picture(CLUTTER, seed=4)
    wrist, tip = (tuple(point) for point in placed.keypoints_px[[0, 12]].tolist())
    off = (wrist[0] + 2.0, wrist[1] - 2.0, tip[0] - 1.0, tip[1] + 2.0)  # as well as a person clicks
    fitter = replace(_fitter(placed, studio, fit_shape=fit_shape), shape=placed.shape)
    with torch.no_grad():
        start = start_at_points(image, off, posture("open", dtype=torch.float64), fitter)
    assert _error(start, placed) < 0.04
    assert isinstance(start, Start)
    assert float((start.fit.root_reference @ placed.root_reference.T).trace()) > 2.7
    assert torch.equal(start.fit.shape, placed.shape) is not fit_shape


def test_points_out_of_the_picture_are_no_start(studio: Any) -> None:
    placed = studio.placed()
    image = placed.picture()
    points = (900.0, 900.0, 900.0, 830.0)
    fitter = replace(_fitter(placed, studio), shape=placed.shape)
    start = start_at_points(image, points, posture("open", dtype=torch.float64), fitter)
    assert isinstance(start, NoStart)
    assert "outside the picture" in start.reason


def test_overlap_of_a_fit_leaves_the_forearm_out(studio: Any) -> None:
    placed = studio.placed()
    fit = Fit.of_start(placed.pose, placed.root_reference, placed.shape)
    mask = placed.mask
    alone = fit_overlap(mask, placed.kinematics, placed.camera, fit)
    assert alone == 1.0
    wrist = placed.keypoints_px[0]
    arm = mask.clone()
    arm[math.ceil(float(wrist[1])) :, int(wrist[0]) - 12 : int(wrist[0]) + 12] = True
    assert int(arm.sum()) > 1.1 * int(mask.sum())
    assert fit_overlap(arm, placed.kinematics, placed.camera, fit) == 1.0
    half = mask.clone()
    half[:, int(wrist[0]) :] = False
    assert fit_overlap(half, placed.kinematics, placed.camera, fit) < 0.7


@pytest.mark.parametrize("method", ["chroma", "background"])
def test_a_gloved_hand_is_found_before_a_screen_or_a_known_scene(method: Any, studio: Any) -> None:
    """A green glove teaches no skin, so only what is known of the surroundings can tell it."""
    placed = studio.placed(angle_deg=20.0)
    noise = torch.randint(-3, 4, (*placed.mask.shape, 3), generator=torch.Generator().manual_seed(0))
    empty = (torch.tensor((40, 60, 200)) + noise).to(torch.uint8)
    image = torch.where(placed.mask[..., None], torch.tensor((60, 170, 90), dtype=torch.uint8), empty)
    assert isinstance(_find(image, placed, studio), NoStart)
    plate = learn_background(empty[None]) if method == "background" else None
    known = {"silhouette": SilhouetteSettings(method=method), "plate": plate}
    start = _find(image, placed, studio, **known)
    assert _error(start, placed) < 0.03
    hidden = _find(empty, placed, studio, **known)
    assert isinstance(hidden, NoStart)
    assert not hidden.has_foreground


def _beside_a_face(placed: Any, *, of_other_colour: bool = False) -> torch.Tensor:
    """The placed hand, and an oval of its colours that is larger."""
    picture = placed.picture(SceneSettings(supersampling=2, background="wall"), seed=1)
    y, x = torch.meshgrid(torch.arange(240.0), torch.arange(320.0), indexing="ij")
    face = ((x - 255) / 60).square() + ((y - 120) / 100).square() < 1
    skin = picture[placed.mask].float().mean(0) + (torch.tensor((12.0, 8.0, 4.0)) if of_other_colour else 0.0)
    noise = 3 * torch.randn(240, 320, 3, generator=torch.Generator().manual_seed(0))
    return torch.where(face[..., None], (skin + noise).round().clamp(0, 255).to(torch.uint8), picture)


@pytest.mark.parametrize("of_other_colour", [False, True])
def test_a_hand_beside_a_larger_face_is_found(of_other_colour: bool, studio: Any) -> None:
    placed = studio.placed(at=(-0.22, 0.0), size=0.5, camera=studio.camera(320, 240))
    image = _beside_a_face(placed, of_other_colour=of_other_colour)
    segmented, _ = segment_hand(image, None)
    assert not bool((segmented & placed.mask).any())  # the face is the likeliest piece
    assert isinstance(_find(image, placed, studio, looks_elsewhere=False), NoStart)
    start = _find(image, placed, studio)
    assert _error(start, placed) < 0.05
    assert isinstance(start, Start)
    assert start.overlap > 0.9


def test_a_face_alone_is_no_hand(studio: Any) -> None:
    placed = studio.placed(at=(-0.22, 0.0), size=0.5, camera=studio.camera(320, 240))
    image = _beside_a_face(placed)
    image[:, :190] = image[0, 0]
    assert isinstance(_find(image, placed, studio), NoStart)


def test_a_hand_of_known_colours_is_found_again_beside_a_larger_face(studio: Any) -> None:
    placed = studio.placed(at=(-0.22, 0.0), size=0.5, camera=studio.camera(320, 240))
    image = _beside_a_face(placed)
    face = torch.zeros_like(placed.mask)
    face[:, 190:] = True
    appearance = learn_appearance(image, placed.mask, ~(placed.mask | face), 2)
    assert appearance is not None
    options: dict[str, Any] = {"appearance": appearance, "fit_shape": False}
    assert isinstance(_find(image, placed, studio, looks_elsewhere=False, **options), NoStart)
    start = _find(image, placed, studio, **options)
    assert _error(start, placed) < 0.05
    assert isinstance(start, Start)
    assert start.appearance is appearance


def test_two_fingers_beside_a_face_are_no_open_hand(studio: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    placed = studio.placed(at=(-0.22, 0.0), size=0.5, posed="victory", camera=studio.camera(320, 240))
    image = _beside_a_face(placed)
    assert isinstance(_find(image, placed, studio), NoStart)
    monkeypatch.setattr("torchhand.fit.detect.start._APART", 0.0)
    assert isinstance(_find(image, placed, studio), Start)  # its outline is that of an open hand with fingers on others
