"""The hand of detected points and of what else tells its joint angles: each counts by its precision."""

from dataclasses import replace
from typing import Any

import torch

from torchhand.fit.keypoints import KeypointSettings, PostureKeypoints
from torchhand.hand import DOFS, HandPose
from torchhand.track.scene import HandKeypoints, Scene, View, detected_hand, scene_keypoints, with_further_postures

ROWS = [DOFS.index(f"index_{joint}_fe") for joint in ("mcp", "pip", "dip")]


def _scene(placed: Any, points: torch.Tensor) -> Scene:
    seen = HandKeypoints(points_px=placed.keypoints_px, points=points, score=1.0)
    return Scene(views=(View(keypoints=seen),), masks=(None,), probabilities=(None,), time_s=0.0)


def test_a_finger_that_a_detector_sees_bent_is_as_straight_as_a_surer_posture_says(studio: Any) -> None:
    placed = studio.placed(size=0.8, camera=studio.camera(320, 240))
    bent = placed.pose.clone()
    bent[ROWS] += torch.tensor((0.7, 0.9, 0.6), dtype=bent.dtype)
    points = placed.projector.frames(bent, placed.root_reference).keypoints
    scene, settings = _scene(placed, points), KeypointSettings()
    where = ((placed.camera,), placed.kinematics, settings)
    straight = PostureKeypoints(
        pose=HandPose(dofs=placed.pose[None], reference=placed.root_reference[None]),
        precision=torch.full((1, 30), 0.1**-2, dtype=torch.float64),
    )
    told = replace(scene, observations=(straight,))
    seen = scene_keypoints(scene, *where)
    assert len(seen.postures) == 1
    assert len(with_further_postures(seen, told).postures) == 2
    alone, both = (detected_hand(one, *where, placed.shape) for one in (scene, told))
    assert alone is not None
    assert both is not None
    missed = [float((one.dofs - placed.pose)[ROWS].abs().mean()) for one in (alone, both)]
    assert missed[0] > 0.4
    assert missed[1] < 0.3 * missed[0]


def test_postures_without_a_detector_place_no_hand(studio: Any) -> None:
    placed = studio.placed(size=0.8, camera=studio.camera(320, 240))
    posture = PostureKeypoints(
        pose=HandPose(dofs=placed.pose[None], reference=placed.root_reference[None]),
        precision=torch.ones(1, 30, dtype=torch.float64),
    )
    scene = Scene(views=(View(),), masks=(None,), probabilities=(None,), time_s=0.0, observations=(posture,))
    assert detected_hand(scene, (placed.camera,), placed.kinematics, KeypointSettings(), placed.shape) is None
