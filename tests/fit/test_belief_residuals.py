"""Residuals of limits, dynamic constraints, prior and expectation: derivatives, values, batches, messages."""

import math
from typing import Any, cast

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit.limits import DynamicConstraints, limit_residual
from torchhand.fit.posture import PostureResiduals
from torchhand.fit.smoothness import Expectation, smoothness_residual
from torchhand.geometry import rotation_from_vector
from torchhand.hand import COMPONENTS, DOFS, ConstraintSettings, PoseConstraints, PostureMixture, named_pose_space

SPACE = named_pose_space("dof26")


def poses(generator: torch.Generator, *batch: int) -> Tensor:
    """Anywhere within and a good way beyond the limits."""
    skeleton = load_hand_model().skeleton
    share = 1.6 * torch.rand(*batch, 30, generator=generator, dtype=torch.float64) - 0.3
    pose = torch.zeros(*batch, 36, dtype=torch.float64)
    pose[..., 6:] = skeleton.lower + share * (skeleton.upper - skeleton.lower)
    return pose


def slope(residual: Any, free: Tensor) -> Tensor:
    return cast(Tensor, torch.autograd.functional.jacobian(lambda x: residual(SPACE.dof(x))[0], free))


@pytest.mark.parametrize("kind", ["limits", "dynamic", "neighbours", "prior"])
def test_derivatives_in_the_pose_space(kind: str, bench: Any, generator: torch.Generator) -> None:
    if kind == "limits":

        def residual(pose: Tensor) -> Any:
            return limit_residual(pose, SPACE.basis, bench.constraints)
    elif kind == "prior":
        postures = PostureResiduals.of(PostureMixture(bench.constraints, COMPONENTS))

        def residual(pose: Tensor) -> Any:
            return postures.residual(pose, torch.tensor(2), SPACE.basis)
    else:
        settings = ConstraintSettings(bands="paper" if kind == "dynamic" else "neighbours")
        dynamic = DynamicConstraints(
            constraints=PoseConstraints(load_hand_model().skeleton, settings), basis=SPACE.basis
        )
        residual = dynamic.residual
    for pose in poses(generator, 20):
        free = SPACE.free(pose)
        expected = slope(residual, free)
        torch.testing.assert_close(residual(SPACE.dof(free))[1], expected, atol=1e-9, rtol=0)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...], bench: Any, generator: torch.Generator) -> None:
    pose = poses(generator, *batch)
    dynamic = DynamicConstraints(constraints=bench.constraints, basis=SPACE.basis)
    postures = PostureResiduals.of(PostureMixture(bench.constraints, COMPONENTS))
    kinds = postures.likeliest(pose)
    whole = [*limit_residual(pose, SPACE.basis, bench.constraints), *dynamic.residual(pose)]
    whole += postures.residual(pose, kinds, SPACE.basis)
    for i, (one, kind) in enumerate(zip(pose.reshape(-1, 36), kinds.reshape(-1), strict=True)):
        parts = [*limit_residual(one, SPACE.basis, bench.constraints), *dynamic.residual(one)]
        parts += postures.residual(one, kind, SPACE.basis)
        for many, part in zip(whole, parts, strict=True):
            torch.testing.assert_close(many.reshape(-1, *part.shape)[i], part)


def test_limits_and_constraints_cost_nothing_within(bench: Any, generator: torch.Generator) -> None:
    pose = bench.constraints.project(poses(generator, 50))
    assert float(limit_residual(pose, SPACE.basis, bench.constraints)[0].abs().max()) < 1e-9
    dynamic = DynamicConstraints(constraints=bench.constraints, basis=SPACE.basis)
    assert float(dynamic.residual(pose)[0][:, :-6].abs().max()) < 1e-9


def test_violations_are_counted_in_units_of_the_softness(bench: Any) -> None:
    softness = math.radians(bench.constraints.settings.softness_deg)
    pose = torch.zeros(36, dtype=torch.float64)
    pose[DOFS.index("index_pip_fe")] = bench.constraints.skeleton.upper[DOFS.index("index_pip_fe") - 6] + 2 * softness
    residual, _ = limit_residual(pose, SPACE.basis, bench.constraints)
    assert float(residual[DOFS.index("index_pip_fe") - 6]) == pytest.approx(2)
    assert float(residual.abs().sum()) == pytest.approx(2)
    bent = torch.zeros(36, dtype=torch.float64)
    bent[DOFS.index("index_mcp_fe")] = math.radians(25) + 3 * softness  # equation 3: the middle finger must follow
    over = DynamicConstraints(constraints=bench.constraints, basis=SPACE.basis).residual(bent)[0]
    assert float(over[:2].max()) == pytest.approx(3)


def test_prior_is_the_component_s_density_without_cut_offs(bench: Any, generator: torch.Generator) -> None:
    """Differences of half the sum of squares are those of minus the log density, where nothing is cut off."""
    mixture = PostureMixture(bench.constraints, COMPONENTS)
    postures = PostureResiduals.of(mixture)
    sample, kind = mixture.sample(40, generator)
    residual, _ = postures.residual(sample, kind, SPACE.basis)
    # Standardised residuals of samples of truncated normals: no larger than standard normal ones.
    assert 0.3 < float(residual.square().mean()) < 1.3
    assert float((postures.likeliest(sample) == kind).double().mean()) > 0.6
    hard = PostureMixture(PoseConstraints(load_hand_model().skeleton, ConstraintSettings(ties="hard")), COMPONENTS)
    with pytest.raises(ValueError, match="soft ties"):
        PostureResiduals.of(hard)


def test_expectation_is_whitened_and_turned_with_its_reference(generator: torch.Generator) -> None:
    size = SPACE.size
    spread = torch.randn(size, size, generator=generator, dtype=torch.float64)
    covariance = spread @ spread.T + torch.eye(size)
    free = torch.randn(2, size, generator=generator, dtype=torch.float64) * 0.1
    reference = rotation_from_vector(torch.randn(2, 3, generator=generator).double())
    expected = Expectation.from_covariance(free, reference, covariance.expand(2, size, size))
    other = free + 0.1 * torch.randn(2, size, generator=generator, dtype=torch.float64)
    residual, jacobian = smoothness_residual(other, expected)
    apart = other - free
    mahalanobis = (apart @ torch.linalg.inv(covariance) * apart).sum(-1)
    torch.testing.assert_close(residual.square().sum(-1), mahalanobis)
    torch.testing.assert_close((jacobian @ apart[..., None]).squeeze(-1), residual)
    # About another reference the expected hand is the same hand.
    turned = rotation_from_vector(torch.tensor((0.2, -0.1, 0.3)).double()) @ reference
    again = expected.about(turned, (3, 4, 5))
    before = rotation_from_vector(free[:, 3:6]) @ reference
    torch.testing.assert_close(rotation_from_vector(again.free[:, 3:6]) @ turned, before)
    torch.testing.assert_close(again.free[:, 6:], free[:, 6:])
    loose = Expectation.from_std(free, reference, torch.full((size,), torch.inf, dtype=torch.float64))
    assert not bool(smoothness_residual(other, loose)[0].any())
