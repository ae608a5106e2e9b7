"""Proportions fitted over several frames: derivatives, a known person's hand recovered, errors."""

from typing import Any

import pytest
import torch

from torchhand.fit.hull.fit import HullFitter
from torchhand.fit.hull.settings import HullFitSettings, HullShapeSettings
from torchhand.fit.hull.shape import fit_shape
from torchhand.fit.hull.shape_rows import people_rows, shape_rows
from torchhand.hand import named_pose_space, skin_jacobian

SPACE = named_pose_space("dof36")


def test_derivative_of_the_skin_in_the_shape(rig: Any, generator: torch.Generator) -> None:
    pose, reference, shape = rig.person(2)
    vertices = torch.randint(2010, (12,), generator=generator)
    direction = torch.randn(12, 3, generator=generator, dtype=torch.float64)
    step = rig.model.shape_space.std

    def along(values: torch.Tensor) -> torch.Tensor:
        points, _ = skin_jacobian(rig.hand, pose, vertices[:, None], shape=values, root_reference=reference)
        return (points * direction).sum(-1)

    exact = torch.func.jacrev(along)(shape) * step
    found = shape_rows(rig.hand, pose, reference, shape, vertices, direction, step)
    assert torch.allclose(found, exact, atol=1e-10)
    assert float(exact.abs().max()) > 1e-3


def test_rows_of_people_are_their_density(rig: Any) -> None:
    people = rig.model.prior().people
    shape = rig.person(2)[2]
    std = people.space.std
    residual, _ = people_rows(people, shape)
    default, _ = people_rows(people, people.space.default)
    wanted = people.log_density(people.space.default) - people.log_density(shape)
    assert float(0.5 * (residual.square().sum() - default.square().sum())) == pytest.approx(float(wanted))
    broken = shape.clone()
    broken[people.space.names.index("index_proximal")] *= 1.3
    exact = torch.func.jacrev(lambda x: people_rows(people, x)[0])(broken) * std
    found, slopes = people_rows(people, broken)
    assert torch.allclose(slopes, exact, atol=1e-10)
    assert float(found[52:].max()) > 0


def test_a_known_persons_hand(rig: Any) -> None:
    """From the mean person's hand; silhouettes end at the wrist."""
    _, _, shape = rig.person(5)
    targets, truths, starts = [], [], []
    for seed in (30, 33):
        pose, reference, _ = rig.person(seed)
        vertices = rig.hand(pose, shape, root_reference=reference).vertices
        pose[:3] -= 0.5 * (vertices.amax(0) + vertices.amin(0))
        truths.append((pose, reference))
        targets.append(rig.target(pose, reference, shape, points=250))
        starts.append(rig.moved(pose, reference, seed, deg=2, mm=4))
    fit = HullFitSettings(vertices=250, beyond_wrist_m=0.03)
    fitter = HullFitter(rig.hand, SPACE, fit, constraints=rig.constraints, prior=rig.prior)
    ends = [fitter(target, *start) for target, start in zip(targets, starts, strict=True)]
    pose, reference = (torch.stack([getattr(end, name) for end in ends]) for name in ("pose", "root_reference"))
    people = rig.model.prior().people
    found = fit_shape(
        targets,
        rig.hand,
        SPACE,
        pose,
        reference,
        people,
        HullShapeSettings(rounds=6, iterations=2),
        fit,
        constraints=rig.constraints,
        prior=rig.prior,
    )

    def errors(poses: torch.Tensor, references: torch.Tensor, own: torch.Tensor) -> list[float]:
        apart = [
            rig.keypoints(p, r, own) - rig.keypoints(*truth, shape)
            for p, r, truth in zip(poses, references, truths, strict=True)
        ]
        return [1e3 * float(each.norm(dim=-1).mean()) for each in apart]

    before = sum(errors(pose, reference, rig.hand.shape)) / 2
    after = sum(errors(found.pose, found.root_reference, found.shape)) / 2
    length = people.space.names.index("hand_length")
    assert after < 0.6 * before
    assert abs(float(found.shape[length] - shape[length])) < 0.5 * abs(float(rig.hand.shape[length] - shape[length]))
    assert people.is_feasible(found.shape)
    assert bool(((found.shape_std > 0) & (found.shape_std < 1.2 * people.space.std)).all())


def test_wrong_numbers_of_frames_are_named(rig: Any) -> None:
    pose, reference, shape = rig.person(4)
    target, people = rig.target(pose, reference, shape, points=50), rig.model.prior().people
    with pytest.raises(ValueError, match="targets: expected as many as poses, at least one, got 1 and 2"):
        fit_shape([target], rig.hand, SPACE, pose.expand(2, -1), reference.expand(2, 3, 3), people)
    empty = type(target)(
        field=target.field,
        points=target.points[:0],
        normals=target.normals[:0],
        inner=target.inner[:0],
        depth=target.depth[:0],
    )
    with pytest.raises(ValueError, match="targets: expected a hull in every frame"):
        fit_shape([empty], rig.hand, SPACE, pose[None], reference[None], people)
    with pytest.raises(ValueError, match=r"hull_shape.rounds: expected 1 or more, got 0"):
        HullShapeSettings(rounds=0)
