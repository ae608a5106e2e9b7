"""Several cameras whose pictures do not wait: another process finds the hand and fits its proportions."""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
import torch

from tests.steps import FRAME_S
from torchhand.fit.hull import HullShapeSettings
from torchhand.geometry import Camera
from torchhand.hand import Hand
from torchhand.track import DEFAULTS, Estimate, SearchBeside, Tracker, TrackerState, View
from torchhand.track.multiview import FrameFitter
from torchhand.view import mesh_silhouette

PATIENCE_S = 180.0  # for another process on a machine with other work
_RIG = DEFAULTS["hull"].rig
_START = replace(_RIG.start, places=1, rolls=4, postures=("open",), coarse=6, fine=2, finger_rounds=0)
SETTINGS = replace(
    DEFAULTS["hull"],
    rig=replace(_RIG, shape_frames=2, shape=HullShapeSettings(rounds=4), start=_START),
)


@pytest.fixture(scope="module")
def large(rig_hand: Hand) -> torch.Tensor:
    """A hand a tenth larger than the generic one."""
    space = rig_hand.kinematics.shape_space
    metric = torch.tensor([unit == "m" for unit in space.units])
    shape = rig_hand.kinematics.default_shape
    return torch.where(metric, 1.1 * shape, shape).clamp(space.lower.to(shape), space.upper.to(shape))


@pytest.fixture(scope="module")
def scenes(large: torch.Tensor, rig_hand: Hand, rig: list[Camera], pose_at: Callable[..., Any]) -> list[list[View]]:
    """Two postures of it before all cameras."""
    found = []
    for name in ("open", "point"):
        pose, reference = pose_at(name)
        state = rig_hand(pose, large, root_reference=reference)
        found.append([View(mask=mask) for mask in (mesh_silhouette(state.vertices, rig_hand.faces, c) for c in rig)])
    return found


def _elsewhere(work: Callable[..., Any]) -> Callable[..., Any]:
    """The same in another process, which may be a copy of this one; fails here."""
    here = os.getpid()

    def checked(*args: Any, **given: Any) -> Any:
        assert os.getpid() != here, "the step searches, or fits proportions, itself"
        return work(*args, **given)

    return checked


def _stepped(
    beside: SearchBeside, views: Sequence[View], state: TrackerState | None, ends: Callable[[TrackerState], bool]
) -> tuple[TrackerState, list[Estimate]]:
    """The same views again and again, at the times at which they are looked at, until a state ends that."""
    before_s = 0.0 if state is None or state.time_s is None else state.time_s + FRAME_S
    begun_s, estimates = time.monotonic(), list[Estimate]()
    while state is None or not ends(state) or not estimates:
        now_s = time.monotonic() - begun_s
        assert now_s < PATIENCE_S
        state, estimate = beside.step(state, views, before_s + now_s)
        estimates.append(estimate)
        time.sleep(FRAME_S)
    return state, estimates


def test_hand_and_proportions_are_found_while_steps_go_on(
    large: torch.Tensor,
    scenes: list[list[View]],
    rig_hand: Hand,
    rig: list[Camera],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("search", "fit_shape", "refine", "vary_fingers", "vary_orientation", "fit_proposed"):
        monkeypatch.setattr(FrameFitter, name, _elsewhere(getattr(FrameFitter, name)))
    shown, other = scenes
    with SearchBeside(partial(Tracker, rig_hand, rig, SETTINGS)) as beside:
        state, waited = _stepped(beside, shown, None, lambda state: state.hand is not None)
        assert {one.status for one in waited[:-1]} == {"no_hand"}
        assert waited[-1].status == "tracked"
        assert state.shape_frames is not None  # one frame does not settle the proportions
        rough = state.shape
        state, followed = _stepped(beside, other, state, lambda state: state.shape_frames is None)
    assert followed[-1].status == "tracked"
    assert state.shape is not None
    assert rough is not None
    true, generic = _length(rig_hand, large), _length(rig_hand, rig_hand.kinematics.default_shape)
    assert not torch.equal(state.shape, rough)
    assert abs(_length(rig_hand, state.shape) - true) < 0.2 * abs(generic - true)


def _length(hand: Hand, shape: torch.Tensor) -> float:
    return float(hand.kinematics.shape_space.metric(shape)["hand_length"])
