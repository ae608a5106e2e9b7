"""Proportions fitted over several frames: derivatives, a known person's hand recovered, errors."""

from typing import Any

import pytest
import torch

from torchhand.fit import PosedHands, SharedUnknowns
from torchhand.fit.hull.fitter import HullFitter
from torchhand.fit.hull.settings import HullSettings
from torchhand.fit.hull.shape import fit_shape
from torchhand.fit.hull.shape_rows import shape_rows
from torchhand.fit.hull.skin import SkinPoints
from torchhand.fit.hull.target import HullTarget
from torchhand.hand import HandPose, named_pose_space, skin_jacobian

SPACE = named_pose_space("dof36")


@pytest.mark.parametrize("columns", [None, (1, 0, 20)])
def test_derivative_of_the_skin_in_the_shape(
    rig: Any, columns: tuple[int, ...] | None, generator: torch.Generator
) -> None:
    shape = rig.person(2)[1]
    pose = HandPose.stack([rig.person(seed)[0] for seed in (2, 3)])
    pose = HandPose(dofs=pose.dofs + 0.1, reference=pose.reference)
    vertices = torch.randint(2010, (2, 12), generator=generator)
    direction = torch.randn(2, 12, 3, generator=generator, dtype=torch.float64)

    def along(values: torch.Tensor) -> torch.Tensor:
        points, _ = skin_jacobian(rig.hand, pose.dofs, vertices[..., None], shape=values, root_reference=pose.reference)
        return (points * direction).sum(-1)

    exact = torch.func.jacrev(along)(shape)
    unknowns = SharedUnknowns.of_shape(rig.model.prior().population, columns)
    hands = PosedHands(pose=pose, shape=shape, unknowns=unknowns)
    found = shape_rows(SkinPoints(rig.hand, shape), hands, vertices, direction)
    assert torch.allclose(found, exact[..., list(unknowns.columns)], atol=1e-10)
    assert float(exact.abs().max()) > 0.1


def test_a_known_persons_hand(rig: Any) -> None:
    """From the mean person's hand; silhouettes end at the wrist."""
    _, shape = rig.person(5)
    targets, truths, ends = [], [], []
    fitter = HullFitter(
        hand=rig.hand, space=SPACE, settings=HullSettings(vertices=250, beyond_wrist_m=0.03), joints=rig.joints
    )
    for seed in (30, 33):
        pose = rig.in_the_middle(rig.person(seed)[0], shape)
        truths.append(pose)
        targets.append(rig.target(pose, shape, points=250))
        ends.append(fitter(targets[-1], rig.moved(pose, seed, deg=2, mm=4)).pose)
    population = rig.model.prior().population
    found = fit_shape(fitter, targets, HandPose.stack(ends), population)

    def error(poses: Any, own: torch.Tensor) -> float:
        distances = [
            (rig.keypoints(pose, own) - rig.keypoints(truth, shape)).norm(dim=-1).mean()
            for pose, truth in zip(poses, truths, strict=True)
        ]
        return 1e3 * float(sum(distances)) / len(distances)

    length = population.space.names.index("hand_length")
    assert error([found.pose[0], found.pose[1]], found.shape) < 0.6 * error(ends, rig.hand.shape)
    assert abs(float(found.shape[length] - shape[length])) < 0.5 * abs(float(rig.hand.shape[length] - shape[length]))
    assert population.is_feasible(found.shape)
    assert bool(((found.shape_std > 0) & (found.shape_std < 1.2 * population.space.std)).all())


def test_wrong_numbers_of_frames_are_named(rig: Any) -> None:
    pose, _ = rig.person(4)
    target, population = rig.target(pose, points=50), rig.model.prior().population
    fitter = HullFitter(hand=rig.hand, space=SPACE)
    with pytest.raises(ValueError, match="targets: expected as many as poses, at least one, got 1 and 2"):
        fit_shape(fitter, [target], HandPose.stack([pose, pose]), population)
    none = torch.zeros(0, 3, dtype=torch.float64)
    empty = HullTarget(field=target.field, points=none, normals=none, inner=none, depth=none[:, 0])
    with pytest.raises(ValueError, match="targets: expected a hull in every frame"):
        fit_shape(fitter, [empty], HandPose.stack([pose]), population)
