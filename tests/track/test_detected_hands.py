"""Detected keypoints in the tracker: they start it, bring it back, and tell it which finger is where."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.steps import FRAME_S, right_hand
from tests.studio import StagedHand
from torchhand.fit.detect import CutAtKeypoints
from torchhand.fit.keypoints import place_hand
from torchhand.hand import DOFS, posture
from torchhand.image import dilate, disc_kernel
from torchhand.track import (
    DEFAULTS,
    Estimate,
    HandKeypoints,
    Tracker,
    TrackerSettings,
    View,
    restored_state,
    saved_state,
)

CONTOUR = replace(DEFAULTS["contour"], pose_space="dof26")
DISTANCE = replace(DEFAULTS["distance"], pose_space="dof26")
FLEXIONS = [i for i, n in enumerate(DOFS) if n.endswith(("mcp_fe", "pip_fe")) and not n.startswith("thumb")]
BY_NAME = pytest.mark.parametrize("settings", [CONTOUR, DISTANCE], ids=["contour", "distance"])


def _detected(placed: StagedHand, seed: int = 1, *, away_px: float = 0.0) -> HandKeypoints:
    """As a detector would: two pixels of noise, points in space about their own middle and in a size of their own."""
    generator = torch.Generator().manual_seed(seed)
    noise = 2.0 * torch.randn(21, 2, generator=generator, dtype=torch.float64)
    points = placed.projector.frames(placed.pose, placed.root_reference).keypoints
    return HandKeypoints(
        points_px=placed.keypoints_px + noise + away_px, points=0.9 * (points - points.mean(0)), score=0.9
    )


def _with_posture(placed: StagedHand, name: str) -> StagedHand:
    return replace(placed, pose=torch.cat((placed.pose[:6], posture(name, dtype=torch.float64)[6:].to(placed.pose))))


def _steps(tracker: Tracker, views: list[View]) -> list[Estimate]:
    state, estimates = None, []
    for frame, view in enumerate(views):
        state, estimate = tracker.step(state, (view,), frame * FRAME_S)
        estimates.append(estimate)
    return estimates


def _flexion_error(estimate: Estimate, placed: StagedHand) -> float:
    """Radians, mean over the fingers' flexions."""
    assert estimate.pose is not None
    return float((estimate.pose - placed.pose)[FLEXIONS].abs().mean())


@BY_NAME
def test_a_fist_is_found_by_its_keypoints_and_not_without(studio: Any, settings: TrackerSettings) -> None:
    fist = _with_posture(studio.placed(size=0.8), "fist")
    image, detected = fist.picture(seed=1), _detected(fist)
    tracker = Tracker(right_hand(), fist.camera, settings, shape=fist.shape)
    found = _steps(tracker, [View(image=image, keypoints=detected)] * 3)
    assert [one.status for one in found] == ["tracked"] * 3
    assert _flexion_error(found[-1], fist) < 0.2
    without = _steps(tracker, [View(image=image)])
    assert without[0].status != "tracked" or _flexion_error(without[0], fist) > 0.5


@BY_NAME
def test_fingers_that_closed_within_a_frame_are_followed(studio: Any, settings: TrackerSettings) -> None:
    """The outline of a fist bears out a half open hand as well: it is the points that tell."""
    opened = studio.placed(size=0.8)
    fist = _with_posture(opened, "fist")
    views = [View(image=one.picture(seed=1), keypoints=_detected(one)) for one in (opened, opened, fist, fist, fist)]
    tracker = Tracker(right_hand(), opened.camera, settings, shape=opened.shape)
    estimates = _steps(tracker, views)
    assert [one.status for one in estimates[3:]] == ["tracked"] * 2
    assert _flexion_error(estimates[1], opened) < 0.15
    assert _flexion_error(estimates[-1], fist) < 0.2


@BY_NAME
def test_a_lost_hand_comes_back_where_the_points_are(studio: Any, settings: TrackerSettings) -> None:
    """In another posture than that of the start, which alone is searched without points."""
    opened = studio.placed(size=0.7, at=(-0.15, 0.0))
    back = _with_posture(studio.placed(size=0.7, at=(0.2, 0.05), angle_deg=25.0), "fist")
    empty = torch.zeros_like(opened.picture(seed=1)) + opened.picture(seed=1)[0, 0]
    views = [View(image=opened.picture(seed=1), keypoints=_detected(opened)), *([View(image=empty)] * 4)]
    views += [View(image=back.picture(seed=1), keypoints=_detected(back))] * 2
    tracker = Tracker(right_hand(), opened.camera, settings, shape=opened.shape)
    estimates = _steps(tracker, views)
    assert estimates[4].status in ("lost", "no_hand")
    assert estimates[5].status == "recovered"
    assert _flexion_error(estimates[6], back) < 0.25


@BY_NAME
def test_frames_without_detection_points_missing_and_hands_that_are_not_believed(
    studio: Any, settings: TrackerSettings
) -> None:
    """Nothing, half of the points, no points in space, and a hand elsewhere with a low score: all are followed."""
    placed = studio.placed(size=0.8)
    image, whole = placed.picture(seed=1), _detected(placed)
    half: Tensor = whole.points_px.clone()
    half[::2] = torch.nan
    elsewhere = replace(_detected(placed, away_px=60.0), score=0.1)
    seen = [whole, None, replace(whole, points_px=half), replace(whole, points=None), elsewhere]
    tracker = Tracker(right_hand(), placed.camera, settings, shape=placed.shape)
    for estimate in _steps(tracker, [View(image=image, keypoints=one) for one in seen]):
        assert estimate.status == "tracked"
        assert estimate.keypoints_px is not None
        assert float((estimate.keypoints_px[0] - placed.keypoints_px).norm(dim=-1).mean()) < 3.0
        assert _flexion_error(estimate, placed) < 0.15


@BY_NAME
def test_one_wild_point_moves_nothing(studio: Any, settings: TrackerSettings) -> None:
    placed = studio.placed(size=0.8)
    image, detected = placed.picture(seed=1), _detected(placed)
    wild = detected.points_px.clone()
    wild[8] += torch.tensor((40.0, 25.0), dtype=wild.dtype)
    views = [View(image=image, keypoints=one) for one in (detected, replace(detected, points_px=wild))]
    first, second = _steps(Tracker(right_hand(), placed.camera, settings, shape=placed.shape), views)
    assert first.keypoints_px is not None
    assert second.keypoints_px is not None
    assert float((second.keypoints_px - first.keypoints_px)[0].norm(dim=-1).max()) < 3.0


def test_a_hand_is_placed_anew_only_where_its_points_say_so(studio: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Placing costs as much as all else of a frame; a followed hand that its points bear out goes without."""
    opened = studio.placed(size=0.8)
    fist, placings = _with_posture(opened, "fist"), []

    def counted(*arguments: Any) -> Any:
        placings.append(arguments)
        return place_hand(*arguments)

    tracker = Tracker(right_hand(), opened.camera, CONTOUR, shape=opened.shape)
    seen = View(image=opened.picture(seed=1), keypoints=_detected(opened))
    state, _ = tracker.step(None, (seen,), 0.0)
    monkeypatch.setattr("torchhand.track.scene.keypoints.place_hand", counted)
    state, estimate = tracker.step(state, (seen,), FRAME_S)
    assert estimate.status == "tracked"
    assert not placings
    tracker.step(state, (View(image=fist.picture(seed=1), keypoints=_detected(fist)),), 2 * FRAME_S)
    assert placings


def _grey(placed: StagedHand) -> Tensor:
    """A picture whose wall has patches as bright and as dark as both halves of the hand."""
    mask = placed.mask
    y, x = torch.meshgrid(torch.arange(mask.shape[0]), torch.arange(mask.shape[1]), indexing="ij")
    patches = torch.where((x // 9 + y // 9) % 2 == 0, 70, 180)
    halo = dilate(mask, disc_kernel(3))
    middle = float(placed.keypoints_px[9, 0])
    level = torch.where(mask, torch.where(x < middle, 70, 180), torch.where(halo, 125, patches))
    return level.to(torch.uint8)[..., None].expand(-1, -1, 3).contiguous()


@BY_NAME
def test_a_hand_that_colours_do_not_tell_is_followed_where_its_points_are(
    studio: Any, settings: TrackerSettings
) -> None:
    """Through a checkpoint as well; without points nothing is found."""
    placed = [studio.placed(size=0.8, at=(0.01 * i, 0.0)) for i in range(3)]
    views = [View(image=_grey(one), keypoints=_detected(one, seed=i)) for i, one in enumerate(placed)]
    tracker = Tracker(right_hand(), placed[0].camera, settings, shape=placed[0].shape)
    state, estimate = tracker.step(None, views[:1], 0.0)
    state = restored_state(saved_state(state))
    for frame, (view, one) in enumerate(zip(views[1:], placed[1:], strict=True), 1):
        state, estimate = tracker.step(state, (view,), frame * FRAME_S)
        assert estimate.status == "tracked"
        assert estimate.overlap is not None
        assert estimate.overlap > 0.75
        assert estimate.keypoints_px is not None
        assert float((estimate.keypoints_px[0] - one.keypoints_px).norm(dim=-1).mean()) < 4.0
    assert _steps(tracker, [replace(views[0], keypoints=None)])[0].status == "no_hand"


def _before_bars(placed: StagedHand) -> Tensor:
    """A picture of a hand before bars of its own colours, which reach beyond it."""
    image, mask = placed.picture(seed=1), placed.mask
    bars = torch.zeros_like(mask)
    for row in placed.keypoints_px[[6, 2], 1].int().tolist():
        bars[row - 8 : row + 8] = True
    image[bars & ~mask] = image[mask].float().mean(0).to(torch.uint8)
    return image


@BY_NAME
def test_a_hand_before_things_of_its_colours_is_cut_out_about_its_points(
    studio: Any, settings: TrackerSettings
) -> None:
    """From the first picture on; in one without detection about where it is expected."""
    placed = [studio.placed(size=0.6, at=(0.01 * i, 0.0)) for i in range(4)]
    views = [View(image=_before_bars(one), keypoints=_detected(one, seed=i)) for i, one in enumerate(placed)]
    views[2] = replace(views[2], keypoints=None)
    tracker, state = Tracker(right_hand(), placed[0].camera, settings, shape=placed[0].shape), None
    for frame, (view, one) in enumerate(zip(views, placed, strict=True)):
        state, estimate = tracker.step(state, (view,), frame * FRAME_S)
        assert estimate.status == "tracked"
        assert isinstance(state.appearance[0], CutAtKeypoints)
        assert estimate.overlap is not None
        assert estimate.overlap > 0.8
        assert estimate.keypoints_px is not None
        assert float((estimate.keypoints_px[0] - one.keypoints_px).norm(dim=-1).mean()) < 6.0


@BY_NAME
def test_a_followed_hand_that_comes_before_things_of_its_colours_is_cut_out_from_then_on(
    studio: Any, settings: TrackerSettings
) -> None:
    placed = studio.placed(size=0.6)
    tracker, state, known = Tracker(right_hand(), placed.camera, settings, shape=placed.shape), None, []
    images = [placed.picture(seed=1)] * 2 + [_before_bars(placed)] * 7
    for frame, image in enumerate(images):
        view = View(image=image, keypoints=_detected(placed, seed=frame))
        state, estimate = tracker.step(state, (view,), frame * FRAME_S)
        known.append(isinstance(state.appearance[0], CutAtKeypoints))
    assert not any(known[:2])
    assert known[-1]
    assert estimate.status == "tracked"
    assert estimate.keypoints_px is not None
    assert float((estimate.keypoints_px[0] - placed.keypoints_px).norm(dim=-1).mean()) < 4.0


@BY_NAME
def test_a_hand_whose_light_changes_is_followed_where_its_points_are(studio: Any, settings: TrackerSettings) -> None:
    """Darker and bluer from one picture to the next."""
    placed = studio.placed(size=0.8)
    bright = placed.picture(seed=1)
    dark = (bright * torch.tensor((0.36, 0.43, 0.56))).to(torch.uint8)
    views = [View(image=one, keypoints=_detected(placed, seed=i)) for i, one in enumerate([bright] * 2 + [dark] * 3)]
    estimates = _steps(Tracker(right_hand(), placed.camera, settings, shape=placed.shape), views)
    assert estimates[-1].status == "tracked"
    assert estimates[-1].keypoints_px is not None
    assert float((estimates[-1].keypoints_px[0] - placed.keypoints_px).norm(dim=-1).mean()) < 4.0


@BY_NAME
def test_no_hand_is_looked_for_where_a_detector_finds_none(studio: Any, settings: TrackerSettings) -> None:
    """One that is followed is followed on, and one whose place is given is believed."""
    placed = studio.placed(size=0.8)
    silent = View(image=placed.picture(seed=1), is_detector_silent=True)
    tracker = Tracker(right_hand(), placed.camera, settings, shape=placed.shape)
    found = _steps(tracker, [silent, replace(silent, is_detector_silent=False), silent, silent])
    assert [one.status for one in found] == ["no_hand", "tracked", "tracked", "tracked"]
    assert found[0].reason.startswith("the detector finds no hand")
    wrist, tip = (tuple(point) for point in placed.keypoints_px[[0, 12]].tolist())
    told = Tracker(right_hand(), placed.camera, settings, shape=placed.shape, start_points=(*wrist, *tip))
    assert _steps(told, [silent])[0].status == "tracked"
