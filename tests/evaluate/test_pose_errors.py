"""Errors of poses: changes of known size, batches against loops."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.evaluate.pose_errors import PoseErrors, pose_errors
from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, posture

KINEMATICS = load_hand_model().kinematics(dtype=torch.float64)
TRUTH = posture("point", dtype=torch.float64)
REFERENCE = rotation_from_vector(torch.tensor([0.3, -0.2, 2.0]).double())
JOINTS = torch.arange(30) % 2 == 0


def errors(pose: Tensor, reference: Tensor = REFERENCE, joints: Tensor = JOINTS) -> PoseErrors:
    return pose_errors(
        KINEMATICS,
        KINEMATICS.default_shape,
        pose,
        reference.expand(*pose.shape[:-1], 3, 3),
        TRUTH,
        REFERENCE,
        joints,
    )


def test_the_truth_has_none() -> None:
    found = errors(TRUTH)
    assert [float(found.angle_deg), float(found.keypoint_mm), float(found.rotation_deg)] == [0, 0, 0]


def test_translation_moves_every_keypoint_alike() -> None:
    moved = TRUTH.clone()
    moved[:3] += torch.tensor([0.003, 0.0, -0.004], dtype=torch.float64)
    found = errors(moved)
    assert float(found.keypoint_mm) == pytest.approx(5.0, rel=1e-9)
    assert float(found.angle_deg) == float(found.rotation_deg) == 0


@pytest.mark.parametrize("angle_deg", [1e-7, 0.5, 40.0, 179.9])
def test_orientation_by_vector_or_by_reference(angle_deg: float) -> None:
    axis = torch.tensor([1.0, 2.0, -2.0]).double() / 3
    turned = TRUTH.clone()
    turned[3:6] = math.radians(angle_deg) * axis
    by_reference = errors(TRUTH, rotation_from_vector(turned[3:6]) @ REFERENCE)
    assert float(errors(turned).rotation_deg) == pytest.approx(angle_deg, rel=1e-6)
    assert float(by_reference.rotation_deg) == pytest.approx(angle_deg, rel=1e-6)
    assert float(errors(turned).keypoint_mm) == pytest.approx(float(by_reference.keypoint_mm), abs=1e-9)


def test_only_the_joints_that_count() -> None:
    bent = TRUTH.clone()
    bent[6 + 2] -= math.radians(30)  # counts
    bent[6 + 3] += math.radians(90)  # does not
    assert float(errors(bent).angle_deg) == pytest.approx(30 / 15, rel=1e-12)
    assert float(errors(bent).rotation_deg) == 0


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_are_loops(batch: tuple[int, ...], generator: torch.Generator) -> None:
    pose = TRUTH + 0.2 * torch.randn(*batch, len(DOFS), generator=generator, dtype=torch.float64)
    reference = rotation_from_vector(torch.randn(*batch, 3, generator=generator, dtype=torch.float64))
    whole = errors(pose, reference)
    for name in ("angle_deg", "keypoint_mm", "rotation_deg"):
        got = getattr(whole, name)
        assert got.shape == batch
        single = [
            float(getattr(errors(one, turn), name))
            for one, turn in zip(pose.reshape(-1, len(DOFS)), reference.reshape(-1, 3, 3), strict=True)
        ]
        assert got.reshape(-1).tolist() == pytest.approx(single, rel=1e-9)
