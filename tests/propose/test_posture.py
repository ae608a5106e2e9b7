"""The posture that the network sees of a hand whose place is known: fingers that are bent, mirrors, places, cameras."""

from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.files import load_proposal_network
from torchhand.geometry import rotation_from_vector
from torchhand.hand import JOINT_DOFS, HandPose
from torchhand.propose import LearnedPosture, Silhouette, learned_posture


def _seen(placed: Any, pose: HandPose | None = None) -> LearnedPosture:
    here = HandPose(dofs=placed.pose, reference=placed.root_reference) if pose is None else pose
    silhouette = Silhouette(mask=placed.mask, camera=placed.camera, image=placed.picture(seed=1))
    return learned_posture(load_proposal_network(), silhouette, placed.kinematics, here, placed.shape)


def _flexion_deg(found: LearnedPosture, finger: str) -> float:
    rows = [JOINT_DOFS.index(f"{finger}_{joint}_fe") for joint in ("mcp", "pip", "dip")]
    return float(torch.rad2deg(found.joints[rows].sum()))


def test_bent_fingers_are_told_from_straight_ones(studio: Any) -> None:
    """Flexion of fists is 250° or more, that of straight fingers next to none."""
    pointing = _seen(studio.placed(size=0.8, view="back", posed="point"))
    assert _flexion_deg(pointing, "index") < 70
    for finger in ("middle", "ring", "little"):
        assert _flexion_deg(pointing, finger) > 130
    for view in ("palm", "back"):
        straight = _seen(studio.placed(size=0.8, view=view))
        assert max(_flexion_deg(straight, finger) for finger in ("index", "middle", "ring", "little")) < 70


def test_the_place_need_be_known_roughly_only(studio: Any) -> None:
    placed = studio.placed(size=0.8)
    here = HandPose(dofs=placed.pose, reference=placed.root_reference)
    step = torch.zeros(36, dtype=torch.float64)
    step[:3], step[5] = torch.tensor((0.008, -0.008, 0.02)), 0.15
    away = (_seen(placed, here.retract(step)).joints - _seen(placed).joints).abs()
    assert float(away.mean()) < 0.06


def test_left_hands_are_right_ones_in_the_mirror(studio: Any) -> None:
    right, left = studio.placed(size=0.8, posed="point"), studio.placed(size=0.8, posed="point", side="left")
    seen = [
        learned_posture(
            load_proposal_network(),
            Silhouette(mask=one.mask, camera=one.camera),
            one.kinematics,
            HandPose(dofs=one.pose, reference=one.root_reference),
            one.shape,
        )
        for one in (right, left)
    ]
    assert float((seen[0].joints - seen[1].joints).abs().mean()) < 0.05


def _turned(rotation: Tensor, about: int, angle: float) -> Tensor:
    """A hand turned about one of its own axes: 0 out of the back or the palm's plane, 1 the fingers, 2 the thumb."""
    axis = torch.zeros(3, dtype=rotation.dtype)
    axis[about] = angle
    return rotation @ rotation_from_vector(axis)


def test_the_direction_is_told(studio: Any) -> None:
    for side in ("right", "left"):
        placed = studio.placed(size=0.8, view="back", side=side)
        true = HandPose(dofs=placed.pose, reference=placed.root_reference).rotation
        found = _seen(placed)
        assert float(found.weight.sum()) == pytest.approx(1, abs=1e-6)
        assert float(found.direction_agreement(true)) > 0.4, side
        assert float(found.direction_agreement(_turned(true, 1, torch.pi))) < 0.12, side


def test_the_direction_near_a_hand_is_that_of_the_hypotheses_about_it() -> None:
    eye = torch.eye(3, dtype=torch.float64)
    near, far = _turned(eye, 2, 0.3), _turned(eye, 1, 3.0)
    nothing = torch.zeros(30, dtype=torch.float64)
    weight = torch.tensor((0.7, 0.3), dtype=torch.float64)
    found = LearnedPosture(
        joints=nothing, variance=nothing + 1, rotation=torch.stack((near, far)), weight=weight, spread=weight.sum()
    )
    direction, precision = found.direction_near(eye)
    torch.testing.assert_close(direction, near, rtol=0, atol=1e-2)
    nowhere, none = found.direction_near(_turned(eye, 0, 2.0))
    assert float(none) < 0.2 * float(precision)
    assert bool(nowhere.isfinite().all())


def test_what_the_network_is_unsure_of_has_the_larger_variance(studio: Any) -> None:
    """No variance is below the network's own error; the sum of both is, where the hypotheses differ."""
    found = _seen(studio.placed(size=0.8, posed="fist", view="back"))
    assert bool((found.variance > torch.deg2rad(torch.tensor(2.0)).square() * 0.99).all())
    assert float(found.variance.max() / found.variance.min()) > 10


def test_other_cameras_are_refused(studio: Any) -> None:
    placed = studio.placed(camera=studio.camera(kind="orthographic"))
    with pytest.raises(ValueError, match="expected a pinhole camera, got orthographic"):
        _seen(placed)
