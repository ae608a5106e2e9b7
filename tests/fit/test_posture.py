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


def test_hard_ties_have_no_density() -> None:
    constraints = PoseConstraints(load_hand_model().skeleton, ConstraintSettings(ties="hard"))
    with pytest.raises(ValueError, match="mixture: expected soft ties"):
        PostureResiduals.of(PostureMixture(constraints, COMPONENTS))
