"""What outlines hardly tell and the network does: fingers that close or are stuck, and the side that a hand shows."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from tests.steps import right_hand, run
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, HandPose, posture
from torchhand.runs import settings_of
from torchhand.track import Tracker, TrackerState

FRAMES = 15
FLEXIONS = torch.tensor(
    [not name.startswith("thumb") and name.endswith(("mcp_fe", "pip_fe", "dip_fe")) for name in DOFS]
)


def _missed_deg(studio: Any, *, learned: bool) -> float:
    """Mean error of the fingers' flexion in the last frames, when the hand is closed to three quarters."""
    placed = studio.placed(size=0.7, view="back", camera=studio.camera(320, 240))
    images, closed = [], placed.pose
    for frame in range(FRAMES):
        part = 0.75 * min(1.0, frame / (FRAMES - 5))
        closed = placed.pose.clone()
        closed[6:] = (1 - part) * posture("open", dtype=torch.float64)[6:] + part * posture(
            "fist", dtype=torch.float64
        )[6:]
        images.append(replace(placed, pose=closed).picture(seed=frame))
    settings = replace(settings_of("contour_full"), learned_posture=learned)
    _, estimates = run(Tracker(right_hand(), placed.camera, settings, shape=placed.shape), images)
    assert all(one.pose is not None for one in estimates)
    missed = [(one.pose - closed)[FLEXIONS].abs().mean() for one in estimates[-3:] if one.pose is not None]
    return float(torch.rad2deg(torch.stack(missed).mean()))


def test_fingers_that_close_are_followed_with_the_network(studio: Any) -> None:
    with_network, without = (_missed_deg(studio, learned=learned) for learned in (True, False))
    assert with_network < 15
    assert with_network < 0.75 * without


def _begun(placed: Any, pose: HandPose) -> tuple[Tracker, TrackerState]:
    """A tracker and its state after it was put on a picture at a pose, whatever is there."""
    tracker = Tracker(right_hand(), placed.camera, settings_of("contour_full"), shape=placed.shape)
    state, _ = run(tracker, [placed.picture(seed=0)])
    return tracker, replace(state, hand=tracker.parts.motion.started(pose))


@pytest.mark.slow
def test_a_hand_that_is_held_the_wrong_way_round_is_turned(studio: Any) -> None:
    """A fist from its back, followed as one from the palm: half a turn about the fingers' direction."""
    placed = studio.placed(size=0.7, view="back", posed="fist", camera=studio.camera(320, 240))
    true = HandPose(dofs=placed.pose, reference=placed.root_reference)
    about = true.rotation[:, 1]
    wrong = HandPose(dofs=true.normalized().dofs, reference=rotation_from_vector(torch.pi * about) @ true.rotation)
    tracker, state = _begun(placed, wrong)
    state, estimates = run(tracker, [placed.picture(seed=seed) for seed in range(1, 9)], state)
    assert any(one.is_new for one in estimates)
    found = tracker.pose_of(state)
    assert found is not None
    assert float(0.5 * ((found.rotation * true.rotation).sum() - 1)) > 0.7


def test_a_finger_that_is_stuck_is_put_where_the_network_sees_it(studio: Any) -> None:
    """An open hand, followed with its middle finger bent and out of reach of its edges."""
    placed = studio.placed(size=0.7, view="palm", camera=studio.camera(320, 240))
    bent = placed.pose.clone()
    bent[[DOFS.index(f"middle_{joint}_fe") for joint in ("mcp", "pip", "dip")]] = torch.tensor((1.2, 1.6, 1.0)).double()
    wrong = HandPose(dofs=bent, reference=placed.root_reference).normalized()
    tracker, state = _begun(placed, wrong)
    _, estimates = run(tracker, [placed.picture(seed=seed) for seed in range(1, 4)], state)
    pose = estimates[-1].pose
    assert pose is not None
    rows = [DOFS.index(f"middle_{joint}_fe") for joint in ("mcp", "pip", "dip")]
    assert float(torch.rad2deg((pose - placed.pose)[rows].abs().mean())) < 12


def test_orthographic_cameras_and_rigid_hands_do_without(studio: Any) -> None:
    placed = studio.placed(size=0.7, camera=studio.camera(320, 240, kind="orthographic"))
    images = [placed.picture(seed=seed) for seed in range(3)]
    own, other = (
        run(
            Tracker(right_hand(), placed.camera, replace(settings_of("contour_full"), learned_posture=learned)), images
        )[1]
        for learned in (True, False)
    )
    assert [one.status for one in own] == ["tracked"] * 3
    for one, same in zip(own, other, strict=True):
        assert one.pose is not None
        assert same.pose is not None
        torch.testing.assert_close(one.pose, same.pose, rtol=0, atol=0)


@pytest.mark.parametrize("name", ["contour_planar", "contour_planar_scale"])
def test_planar_configurations_do_not_ask_it(name: str, studio: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise AssertionError("the network was asked")

    monkeypatch.setattr("torchhand.track.tracker.seen_posture", refuse)
    placed = studio.placed(size=0.7, camera=studio.camera(320, 240))
    tracker = Tracker(right_hand(), placed.camera, settings_of(name), shape=placed.shape)
    _, estimates = run(tracker, [placed.picture(seed=seed) for seed in range(3)])
    assert [one.status for one in estimates] == ["tracked"] * 3
