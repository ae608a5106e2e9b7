"""Constraints between joint angles as residuals: derivatives, values, batches."""

import math
from typing import Any, cast

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit.limits import DynamicConstraints
from torchhand.hand import DOFS, ConstraintSettings, PoseConstraints


def poses(generator: torch.Generator, *batch: int) -> Tensor:
    """Anywhere within and a good way beyond the limits."""
    skeleton = load_hand_model().skeleton
    fraction = 1.6 * torch.rand(*batch, 30, generator=generator, dtype=torch.float64) - 0.3
    pose = torch.zeros(*batch, 36, dtype=torch.float64)
    pose[..., 6:] = skeleton.lower + fraction * (skeleton.upper - skeleton.lower)
    return pose


@pytest.mark.parametrize("has_ties", [True, False])
@pytest.mark.parametrize("bands", ["paper", "neighbours"])
def test_derivatives_in_the_joint_angles(bands: Any, has_ties: bool, generator: torch.Generator) -> None:
    constraints = PoseConstraints(load_hand_model().skeleton, ConstraintSettings(bands=bands))
    residuals = DynamicConstraints(constraints=constraints)
    for pose in poses(generator, 20):

        def value(dofs: Tensor) -> Tensor:
            return residuals.of_joints(dofs, has_ties=has_ties)[0]

        expected = cast(Tensor, torch.autograd.functional.jacobian(value, pose))
        found = residuals.of_joints(pose, has_ties=has_ties)[1]
        torch.testing.assert_close(found, expected[:, 6:], atol=1e-9, rtol=0)
        assert not bool(expected[:, :6].any())


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...], bench: Any, generator: torch.Generator) -> None:
    pose, residuals = poses(generator, *batch), DynamicConstraints(constraints=bench.constraints)
    whole = residuals.of_joints(pose)
    for i, one in enumerate(pose.reshape(-1, 36)):
        for many, part in zip(whole, residuals.of_joints(one), strict=True):
            torch.testing.assert_close(many.reshape(-1, *part.shape)[i], part)


def test_what_holds_costs_nothing(bench: Any, generator: torch.Generator) -> None:
    pose = bench.constraints.project(poses(generator, 50))
    value, _ = DynamicConstraints(constraints=bench.constraints).of_joints(pose, has_ties=False)
    assert float(value.abs().max()) < 1e-9


def test_violations_are_counted_in_units_of_the_softness(bench: Any) -> None:
    softness = math.radians(bench.constraints.settings.softness_deg)
    bent = torch.zeros(36, dtype=torch.float64)
    bent[DOFS.index("index_mcp_fe")] = math.radians(25) + 3 * softness  # eq. 3: the middle finger must follow
    value, _ = DynamicConstraints(constraints=bench.constraints).of_joints(bent)
    assert float(value[:2].max()) == pytest.approx(3)
