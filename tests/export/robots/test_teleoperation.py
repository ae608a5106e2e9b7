"""Points in the wrist's frame: the same wherever the hand is, in MANO's axes and in those of retargeting libraries."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from torchhand.export.clip import MotionClip
from torchhand.export.robots.teleoperation import teleoperation_message, wrist_points, write_teleoperation
from torchhand.export.robots.urdf import write_urdf
from torchhand.hand import KEYPOINTS


@pytest.mark.parametrize("axes", ["mano", "wrist", "operator"])
def test_points_and_wrist_give_the_keypoints_back(clip: MotionClip, axes) -> None:
    keypoints = clip.frames.keypoints
    found = wrist_points(clip.poses, keypoints, side=clip.side, axes=axes)
    back = found.points @ found.rotation.mT + found.position[:, None]
    assert float((back - keypoints).abs().max()) < 1e-12
    assert float((torch.linalg.det(found.rotation) - 1).abs().max()) < 1e-12
    elsewhere = clip.poses.clone()
    elsewhere[:, :6] = torch.tensor((1.0, 2.0, 3.0, 0.3, -0.2, 0.1), dtype=torch.float64)
    moved = wrist_points(elsewhere, clip.kinematics(elsewhere, clip.shape).keypoints, side=clip.side, axes=axes)
    assert float((moved.points - found.points).abs().max()) < 1e-12
    one = wrist_points(clip.poses[2], keypoints[2], side=clip.side, axes=axes)
    assert torch.equal(one.points, found.points[2])


def test_axes_are_the_anatomical_ones(clip: MotionClip) -> None:
    """On an open hand: the middle finger, the thumb's side and the back of the hand, by the points alone."""
    poses = torch.zeros(1, 36, dtype=torch.float64)
    keypoints = clip.kinematics(poses, clip.shape).keypoints
    is_right = clip.side == "right"
    mano = wrist_points(poses, keypoints, side=clip.side, axes="mano").points[0]
    operator = wrist_points(poses, keypoints, side=clip.side, axes="operator").points[0]
    middle, across = mano[12], mano[5] - mano[17]
    assert abs(float(middle[0])) > 0.95 * float(middle.norm())
    assert (float(middle[0]) < 0) == is_right
    assert float(across[2]) > 0.9 * float(across.norm())  # from the little finger to the index finger
    assert float(operator[12, 2]) > 0.95 * float(operator[12].norm())
    assert (float((operator[5] - operator[17])[1]) > 0) == is_right
    assert float(operator[4, 0]) > 0  # the thumb lies on the palm's side
    # What dex_retargeting multiplies by from the right (OPERATOR2MANO_RIGHT), transposed.
    to_operator = operator.T @ torch.linalg.pinv(mano.T)
    published = torch.tensor([[0, -1, 0], [0, 0, 1], [-1, 0, 0]], dtype=torch.float64)
    if is_right:
        assert float((to_operator - published).abs().max()) < 1e-9


def test_the_file_is_what_a_stream_says(clip: MotionClip, tmp_path: Path) -> None:
    times = tuple(0.5 + 0.04 * t * t for t in range(7))
    held = replace(clip, held=(13,), frame=tuple(range(10, 17)), time_s=times)
    write_teleoperation(held, tmp_path / "hand.teleop.jsonl")
    lines = [json.loads(line) for line in (tmp_path / "hand.teleop.jsonl").read_text().splitlines()]
    assert [line["frame"] for line in lines] == list(range(10, 17))
    assert [line["held"] for line in lines] == [False, False, False, True, False, False, False]
    assert [line["time_s"] for line in lines] == pytest.approx([0.04 * t * t for t in range(7)], abs=1e-12)
    for t, line in enumerate(lines):
        found = wrist_points(clip.poses[t], clip.frames.keypoints[t], side=clip.side)
        said = teleoperation_message(found, side=clip.side, frame=10 + t, time_s=line["time_s"], held=line["held"])
        turn, own = (Rotation.from_quat(one["wrist"].pop("quaternion")).as_matrix() for one in (line, said))
        assert np.abs(turn - own).max() < 1e-12
        assert line == said
    lost = wrist_points(torch.full((36,), torch.nan), torch.full((21, 3), torch.nan), side="right")
    message = teleoperation_message(lost, side="right", frame=0, time_s=0.0)
    assert (message["points"], message["wrist"]) == (None, None)
    json.dumps(message, allow_nan=False)


def test_retargeting_onto_our_own_robot(clip: MotionClip, tmp_path: Path) -> None:
    """With dex_retargeting: in the frame of the URDF's base link the links come to the points."""
    config = pytest.importorskip(
        "dex_retargeting.retargeting_config", reason="needs dex_retargeting: pip install dex_retargeting"
    )
    write_urdf(clip, tmp_path / "hand.urdf")
    links = [f"{finger}_proximal" for finger in ("index", "middle", "ring", "little")]
    links += [f"{finger}_tip" for finger in ("thumb", "index", "middle", "ring", "little")]
    points = [5, 9, 13, 17, *(KEYPOINTS.index(name) for name in links[4:])]
    robot = config.RetargetingConfig.from_dict(
        {
            "type": "position",
            "urdf_path": str(tmp_path / "hand.urdf"),
            "target_link_names": links,
            "target_link_human_indices": np.array(points),
            "normal_delta": 1e-4,
            "huber_delta": 0.002,
            "low_pass_alpha": 1.0,
        }
    ).build()
    found = wrist_points(clip.poses, clip.frames.keypoints, side=clip.side, axes="wrist").points.numpy()
    body = robot.optimizer.robot
    errors = []
    for wanted in found:
        for _ in range(3):
            joints = robot.retarget(wanted[points].astype(np.float32))
        body.compute_forward_kinematics(joints)
        places = np.stack([body.get_link_pose(body.get_link_index(name))[:3, 3] for name in links])
        errors.append(np.linalg.norm(places - wanted[points], axis=1).mean())
    assert np.median(errors) < 4e-3
