"""The posture prior as least squares: derivatives, the density that it stands for, batches, messages."""

from typing import cast

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit.posture import PostureResiduals
from torchhand.hand import COMPONENTS, ConstraintSettings, PoseConstraints, PostureMixture

CONSTRAINTS = PoseConstraints(load_hand_model().skeleton)


@pytest.fixture(scope="module")
def mixture() -> PostureMixture:
    return PostureMixture(CONSTRAINTS, COMPONENTS)


def test_derivatives_in_the_joint_angles(mixture: PostureMixture, generator: torch.Generator) -> None:
    postures, pose = PostureResiduals.of(mixture), torch.randn(36, generator=generator, dtype=torch.float64)
    for kind in torch.arange(3):

        def value(dofs: Tensor, kind: Tensor = kind) -> Tensor:
            return postures.of_joints(dofs, kind)[0]

        expected = cast(Tensor, torch.autograd.functional.jacobian(value, pose))
        torch.testing.assert_close(postures.of_joints(pose, kind)[1], expected[:, 6:], atol=1e-9, rtol=0)


def test_it_is_the_component_s_density_without_cut_offs(mixture: PostureMixture, generator: torch.Generator) -> None:
    """Standardised residuals of samples of truncated normals: no larger than standard normal ones."""
    postures = PostureResiduals.of(mixture)
    sample, kind = mixture.sample(40, generator)
    residual, _ = postures.of_joints(sample, kind)
    assert 0.3 < float(residual.square().mean()) < 1.3
    assert float((postures.likeliest(sample) == kind).double().mean()) > 0.6


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...], mixture: PostureMixture, generator: torch.Generator) -> None:
    postures, pose = PostureResiduals.of(mixture), torch.randn(*batch, 36, generator=generator, dtype=torch.float64)
    kinds = postures.likeliest(pose)
    whole = postures.of_joints(pose, kinds)
    for i, (one, kind) in enumerate(zip(pose.reshape(-1, 36), kinds.reshape(-1), strict=True)):
        assert int(postures.likeliest(one)) == int(kind)
        for many, part in zip(whole, postures.of_joints(one, kind), strict=True):
            torch.testing.assert_close(many.reshape(-1, *part.shape)[i], part)


def test_the_nearest_postures_are_those_of_highest_density_under_errors(
    mixture: PostureMixture, generator: torch.Generator
) -> None:
    """Against dense normal distributions; with hardly any errors, the angles given in the likeliest posture."""
    postures, spread = PostureResiduals.of(mixture), 0.2
    pose = mixture.sample(5, generator)[0].double() + 0.1 * torch.randn(5, 36, generator=generator, dtype=torch.float64)
    inverse = torch.linalg.inv(postures.matrix)
    mean, own = (inverse @ postures.offset[..., None]).squeeze(-1), inverse @ inverse.mT
    blurred = own + spread**2 * torch.eye(30, dtype=torch.float64)
    weight = -postures.level - torch.logdet(postures.matrix)  # logarithms, up to one constant
    density = torch.distributions.MultivariateNormal(mean, blurred).log_prob(pose[:, None, 6:]) + weight
    chosen = density.topk(3).indices
    gain = own @ torch.linalg.inv(blurred)
    expected = mean + (gain @ (pose[:, None, 6:] - mean)[..., None]).squeeze(-1)
    expected = expected.gather(1, chosen[..., None].expand(-1, -1, 30))
    torch.testing.assert_close(postures.nearest(pose, spread, 3), expected, atol=1e-9, rtol=0)
    torch.testing.assert_close(postures.nearest(pose, 1e-6, 1)[:, 0], pose[:, 6:], atol=1e-6, rtol=0)


def test_hard_ties_have_no_density() -> None:
    constraints = PoseConstraints(load_hand_model().skeleton, ConstraintSettings(ties="hard"))
    with pytest.raises(ValueError, match="mixture: expected soft ties"):
        PostureResiduals.of(PostureMixture(constraints, COMPONENTS))
