"""The least-squares fit: known people's poses recovered from hulls, failures as statuses, hypotheses independent."""

import math
from typing import Any

import torch

from torchhand.fit import Expectation
from torchhand.fit.hull.fit import HullFitter, HullStatus
from torchhand.fit.hull.points import hull_target
from torchhand.fit.hull.settings import HULL_TRACKING_LEVELS, HullFitSettings, HullLevel
from torchhand.hand import named_pose_space, pose_space

SPACE = named_pose_space("dof36")
LEVELS = (
    HullLevel(robust_m=0.010, rounds=1, iterations=2),
    HullLevel(robust_m=0.004, rounds=1, iterations=2),
    HullLevel(robust_m=0.002, rounds=1, iterations=2),
)
FEW = HullFitSettings(levels=(HullLevel(robust_m=0.01, rounds=1, iterations=2),), vertices=100)


class Nothing:
    def sample(self, points: torch.Tensor, /) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.ones_like(points[..., 0]), torch.zeros_like(points)


def fitter(rig: Any, settings: HullFitSettings | None = None, **more: Any) -> HullFitter:
    return HullFitter(rig.hand, SPACE, settings, constraints=rig.constraints, prior=rig.prior, **more)


def test_recovers_people_of_known_shape(rig: Any) -> None:
    """Hulls of 4 mm octants from four views; the mean over people."""
    errors, turns = [], []
    for seed in range(2, 9):
        pose, reference, shape = rig.person(seed)
        start = rig.moved(pose, reference, seed, deg=2, mm=5)
        found = fitter(rig, shape=shape)(rig.target(pose, reference, shape), *start)
        ends = (found.pose, found.root_reference)
        errors.append(rig.error_mm(ends, (pose, reference), shape))
        turns.append(float((rig.flexion_deg(*ends, shape) - rig.flexion_deg(pose, reference, shape)).abs().mean()))
        assert rig.error_mm(start, (pose, reference), shape) > 3
        assert found.status in (HullStatus.CONVERGED, HullStatus.STALLED)
        assert float(found.pose[3:6].abs().max()) == 0
        assert 0.6 < float(found.inside_share) <= 1
        assert 0 < float(found.apart_m) < 0.002
        assert float(torch.linalg.eigvalsh(found.covariance).min()) > 0
        assert torch.equal(found.pose[6:], rig.model.skeleton.within_limits(found.pose[6:]))
    assert sum(errors) / len(errors) <= 3
    assert sum(turns) / len(turns) <= 3


def test_without_the_covered_side_a_folded_hand_fits(rig: Any) -> None:
    """The degeneracy that paper 002's criterion has: fingers folded within the hull of an open hand cost nothing."""
    pose, reference, shape = rig.person(9)
    target = rig.target(pose, reference, shape)
    start = pose.clone()
    flexions = [i for i, name in enumerate(SPACE.free_names) if name.endswith(("pip_fe", "dip_fe"))]
    start[flexions] = rig.model.skeleton.within_limits(start[6:] + 0.25)[torch.tensor(flexions) - 6]
    errors = []
    for weight in (0.0, 100.0):
        settings = HullFitSettings(surface_weight=weight, levels=LEVELS)
        found = HullFitter(rig.hand, SPACE, settings, shape=shape)(target, start, reference)
        errors.append(rig.error_mm((found.pose, found.root_reference), (pose, reference), shape))
    assert errors[1] < 0.6 * errors[0]


def test_hypotheses_are_independent(rig: Any) -> None:
    pose, reference, _ = rig.person(4)
    target = rig.target(pose, reference, points=120)
    starts = [rig.moved(pose, reference, seed, deg=6, mm=8) for seed in range(4)]
    poses, references = (torch.stack(x).unflatten(0, (2, 2)) for x in zip(*starts, strict=True))
    poses[1, 0, 7] = torch.nan
    fit = fitter(rig, FEW)
    together = fit(target, poses, references)
    assert together.status.shape == (2, 2)
    for row, column in ((0, 0), (0, 1), (1, 1)):
        alone = fit(target, poses[row, column], references[row, column])
        assert torch.allclose(together.pose[row, column], alone.pose, atol=1e-9)
        assert torch.allclose(together.cost[row, column], alone.cost)
    failed = together.select(2)
    assert failed.status == HullStatus.FAILED
    assert bool(failed.cost.isinf())
    assert bool(failed.inside_share.isnan())
    assert bool(failed.covariance.isnan().all())
    assert torch.equal(failed.pose.isnan(), poses[1, 0].isnan())
    assert together.best != 2


def test_small_chunks_change_nothing(rig: Any) -> None:
    pose, reference, _ = rig.person(4)
    target = rig.target(pose, reference, points=120)
    starts = [rig.moved(pose, reference, seed, deg=6, mm=8) for seed in range(3)]
    poses, references = (torch.stack(x) for x in zip(*starts, strict=True))
    settings = HullFitSettings(levels=FEW.levels, vertices=100, hypotheses_at_once=2)
    one, other = fitter(rig, FEW)(target, poses, references), fitter(rig, settings)(target, poses, references)
    assert torch.allclose(one.pose, other.pose, atol=1e-9)


def test_equations_at_a_look_are_those_about_it(rig: Any) -> None:
    """With the bones that are known there; and its distances from the hull are those of the vertices."""
    pose, reference, shape = rig.person(5)
    target = rig.target(pose, reference, shape)
    own = fitter(rig, shape=shape)
    starts = [rig.moved(pose, reference, seed, deg=3, mm=4) for seed in (1, 2)]
    pose, reference = (torch.stack(parts) for parts in zip(*starts, strict=True))
    values = SPACE.free(pose)
    level = HullLevel(robust_m=0.004, rounds=1, iterations=1, is_judged=False)
    look = own.look(target, SPACE.dof(values), reference, None, level)
    rows = torch.arange(2)
    plain, quick = look.cost.equations(values, rows), look.cost.equations(values, rows, look.bones)
    for name in ("matrix", "gradient", "cost"):
        torch.testing.assert_close(getattr(quick, name), getattr(plain, name), rtol=1e-12, atol=1e-12)
    skin = own.skin.vertices(SPACE.dof(values), reference)
    assert look.beyond is not None
    torch.testing.assert_close(look.beyond, target.field.sample(skin[:, own.vertices])[0], rtol=0, atol=1e-12)


def test_no_hull_keeps_the_start(rig: Any) -> None:
    pose, reference, _ = rig.person(4)
    ends = torch.full((3,), -0.1, dtype=torch.float64), torch.full((3,), 0.1, dtype=torch.float64)
    found = fitter(rig, FEW)(hull_target(Nothing(), *ends, pitch=0.02), pose[None], reference)
    assert found.status.tolist() == [HullStatus.NO_HULL]
    assert torch.allclose(found.pose[0], pose)
    assert bool(found.cost.isinf().all())


def test_an_expectation_holds_what_it_is_sure_of(rig: Any) -> None:
    pose, reference, shape = rig.person(4)
    target = rig.target(pose, reference, shape)
    start, turned = rig.moved(pose, reference, 1, deg=5, mm=8)
    sure = torch.full((36,), 1e-5, dtype=torch.float64)
    expected = Expectation.from_std(SPACE.free(start), turned, sure)
    found = fitter(rig, FEW, shape=shape)(target, start, turned, expected=expected)
    assert rig.error_mm((found.pose, found.root_reference), (start, turned), shape) < 0.01
    loose = Expectation.from_std(SPACE.free(start), turned, 1e5 * sure)
    moved = fitter(rig, FEW, shape=shape)(target, start, turned, expected=loose)
    assert rig.error_mm((moved.pose, moved.root_reference), (start, turned), shape) > 2


def test_a_forearm_of_the_hull_draws_nothing(rig: Any) -> None:
    """Points of the hull beyond the wrist do not count: silhouettes may show what the model has not."""
    pose, reference, shape = rig.person(4)
    target = rig.target(pose, reference, shape)
    wrist = pose[:3] - 0.03 * reference[:, 1]
    arm = (
        wrist
        - torch.rand(200, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 0.1 * reference[:, 1]
    )
    more = type(target)(
        field=target.field,
        points=torch.cat((target.points, arm)),
        normals=torch.cat((target.normals, reference[:, 0].expand(200, 3))),
        inner=target.inner,
        depth=target.depth,
    )
    fit = fitter(rig, FEW, shape=shape)
    with_arm, without = fit(more, pose, reference), fit(target, pose, reference)
    assert torch.allclose(with_arm.pose, without.pose, atol=1e-9)


def test_the_palm_alone(rig: Any) -> None:
    """A space without joint angles has no beliefs, and single precision does."""
    pose, reference, shape = rig.person(2)
    hand = rig.model.hand(shape.float())
    space = pose_space("palm", SPACE.free_names[:6], dtype=torch.float64).about(pose)
    settings = HullFitSettings(levels=HULL_TRACKING_LEVELS)
    start = pose.clone()
    start[:3] += 0.005
    fit = HullFitter(hand, space, settings, constraints=rig.constraints, prior=rig.prior)
    turned = torch.linalg.matrix_exp(math.radians(4) * torch.tensor(((0.0, -1, 0), (1, 0, 0), (0, 0, 0)))).double()
    found = fit(rig.target(pose, reference, shape), start, turned @ reference)
    assert rig.error_mm((found.pose, found.root_reference), (pose, reference), shape) < 1.5
    assert torch.allclose(found.pose[6:], pose[6:], atol=1e-6)
