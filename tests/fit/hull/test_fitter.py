"""The least-squares fit: known people's poses recovered from hulls, failures as statuses, hypotheses independent."""

import math
from dataclasses import replace
from typing import Any

import torch

from torchhand.fit import GaussianPrior, SolveStatus, Stage
from torchhand.fit.hull.fitter import HullEvidence, HullFitter
from torchhand.fit.hull.joint_priors import JointPriors
from torchhand.fit.hull.settings import TRACKING, HullSettings, JointPriorWeights
from torchhand.fit.hull.target import HullTarget
from torchhand.hand import DOFS, HandPose, named_pose_space, pose_space

SPACE = named_pose_space("dof36")
STAGES = tuple(Stage(gross_m=gross_m, rounds=1, iterations=2) for gross_m in (0.010, 0.004, 0.002))
FEW: dict[str, Any] = {
    "schedule": (Stage(gross_m=0.01, rounds=1, iterations=2),),
    "settings": HullSettings(vertices=100),
}


def fitter(rig: Any, **more: Any) -> HullFitter:
    return HullFitter(**({"hand": rig.hand, "space": SPACE, "joints": rig.joints} | more))


def test_recovers_people_of_known_shape(rig: Any) -> None:
    """Hulls of 4 mm octants from four views; the mean over people."""
    errors, turns = [], []
    for seed in range(2, 9):
        pose, shape = rig.person(seed)
        start = rig.moved(pose, seed, deg=2, mm=5)
        found = fitter(rig, shape=shape)(rig.target(pose, shape), start)
        errors.append(rig.error_mm(found.pose, pose, shape))
        turns.append(float((rig.flexion_deg(found.pose, shape) - rig.flexion_deg(pose, shape)).abs().mean()))
        assert rig.error_mm(start, pose, shape) > 3
        assert found.status in (SolveStatus.CONVERGED, SolveStatus.STALLED)
        assert float(found.pose.dofs[3:6].abs().max()) == 0
        assert 0.6 < float(HullEvidence.of(found).inside) <= 1
        assert 0 < float(found.explained_by("edges").distance) < 0.002
        assert float(torch.linalg.eigvalsh(found.covariance).min()) > 0
        joints = found.pose.dofs[6:]
        assert torch.equal(joints, rig.model.skeleton.within_limits(joints))
    assert sum(errors) / len(errors) <= 3
    assert sum(turns) / len(turns) <= 3


def test_without_coverage_a_folded_hand_fits(rig: Any) -> None:
    """The degeneracy of Ueda et al.'s criterion: fingers folded within the hull of an open hand cost nothing."""
    pose, shape = rig.person(9)
    target = rig.target(pose, shape)
    start = pose.dofs.clone()
    flexions = [i for i, name in enumerate(SPACE.free_names) if name.endswith(("pip_fe", "dip_fe"))]
    start[flexions] = rig.model.skeleton.within_limits(start[6:] + 0.25)[torch.tensor(flexions) - 6]
    errors, joints = [], JointPriors(weights=JointPriorWeights(penetration=0.0))
    for weight in (0.0, 100.0):
        settings = HullSettings(surface_weight=weight)
        own = HullFitter(hand=rig.hand, space=SPACE, shape=shape, settings=settings, schedule=STAGES, joints=joints)
        found = own(target, HandPose(dofs=start, reference=pose.reference))
        errors.append(rig.error_mm(found.pose, pose, shape))
    assert errors[1] < 0.6 * errors[0]


def test_hypotheses_are_independent(rig: Any) -> None:
    pose, _ = rig.person(4)
    target = rig.target(pose, points=120)
    starts = HandPose.stack([rig.moved(pose, seed, deg=6, mm=8) for seed in range(4)]).reshape(2, 2)
    starts.dofs[1, 0, 7] = torch.nan
    fit = fitter(rig, **FEW)
    together = fit(target, starts)
    assert together.status.shape == (2, 2)
    for row, column in ((0, 0), (0, 1), (1, 1)):
        alone = fit(target, starts[row][column])
        assert torch.allclose(together.pose.dofs[row, column], alone.pose.dofs, atol=1e-9)
        assert torch.allclose(together.cost[row, column], alone.cost)
    failed = together.select(2)
    assert failed.status == SolveStatus.FAILED
    assert bool(failed.cost.isinf())
    assert float(HullEvidence.of(failed).covered) == 0
    assert not bool(HullEvidence.of(together).is_good[1, 0])
    assert bool(failed.covariance.isnan().all())
    assert torch.equal(failed.pose.dofs.isnan(), starts.dofs[1, 0].isnan())
    assert together.best != 2


def test_no_hull_keeps_the_start(rig: Any) -> None:
    pose, _ = rig.person(4)
    nothing = torch.zeros(0, 3, dtype=torch.float64)
    field = rig.target(pose, points=1).field
    empty = HullTarget(field=field, points=nothing, normals=nothing, inner=nothing, depth=nothing[:, 0])
    found = fitter(rig, **FEW)(empty, HandPose.stack([pose]))
    assert found.status.tolist() == [SolveStatus.NO_DATA]
    assert torch.allclose(found.pose.dofs[0], pose.dofs)
    assert bool(found.cost.isinf().all())
    assert HullEvidence.of(found).is_good.tolist() == [False]


def test_a_prediction_holds_what_it_is_sure_of(rig: Any) -> None:
    pose, shape = rig.person(4)
    target = rig.target(pose, shape)
    start = rig.moved(pose, 1, deg=5, mm=8)
    sure = torch.full((36,), 1e-5, dtype=torch.float64)
    fit = fitter(rig, shape=shape, **FEW)
    found = fit(target, start, GaussianPrior.of_std(start, sure, SPACE))
    assert rig.error_mm(found.pose, start, shape) < 0.01
    moved = fit(target, start, GaussianPrior.of_std(start, 1e5 * sure, SPACE))
    assert rig.error_mm(moved.pose, start, shape) > 2


def test_a_forearm_of_the_hull_draws_nothing(rig: Any) -> None:
    """Points of the hull beyond the wrist do not count: silhouettes may show what the model has not."""
    pose, shape = rig.person(4)
    target = rig.target(pose, shape)
    along = pose.reference[:, 1]
    reach = 0.1 * torch.rand(200, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    arm = pose.dofs[:3] - (0.03 + reach) * along
    more = replace(
        target,
        points=torch.cat((target.points, arm)),
        normals=torch.cat((target.normals, pose.reference[:, 0].expand(200, 3))),
    )
    fit = fitter(rig, shape=shape, **FEW)
    with_arm, without = fit(more, pose), fit(target, pose)
    assert torch.allclose(with_arm.pose.dofs, without.pose.dofs, atol=1e-9)


def test_the_palm_alone(rig: Any) -> None:
    """In single precision, with a space that moves no joint."""
    pose, shape = rig.person(2)
    hand = rig.model.hand(shape.float())
    space = pose_space("palm", SPACE.free_names[:6], dtype=torch.float64).about(pose.dofs)
    start = pose.dofs.clone()
    start[:3] += 0.005
    turn = torch.linalg.matrix_exp(math.radians(4) * torch.tensor(((0.0, -1, 0), (1, 0, 0), (0, 0, 0)))).double()
    fit = HullFitter(hand=hand, space=space, schedule=(Stage(gross_m=0.008, rounds=1), *TRACKING), joints=rig.joints)
    found = fit(rig.target(pose, shape), HandPose(dofs=start, reference=turn @ pose.reference))
    assert rig.error_mm(found.pose, pose, shape) < 1.5
    assert torch.allclose(found.pose.dofs[6:], pose.dofs[6:], atol=1e-6)


def test_verdict(rig: Any) -> None:
    """What is not as the silhouettes show is no good fit: fingers stretched that are bent, and no hand at all."""
    pose, shape = rig.person(4)
    straight, bent = pose.dofs.clone(), pose.dofs.clone()
    straight[6:], bent[6:] = 0.0, 0.0
    for finger in ("index", "middle"):
        for joint, angle in (("mcp_fe", 75.0), ("pip_fe", 90.0), ("dip_fe", 50.0)):
            bent[DOFS.index(f"{finger}_{joint}")] = math.radians(angle)
    straight, bent = (HandPose(dofs=dofs, reference=pose.reference) for dofs in (straight, bent))
    sure = torch.full((SPACE.size,), 1e-5, dtype=torch.float64)
    fit = fitter(rig, shape=shape, schedule=TRACKING[-1:])

    def evidence(masks: list[torch.Tensor], at: HandPose) -> HullEvidence:
        return HullEvidence.of(fit(rig.with_edges(masks), at, GaussianPrior.of_std(at, sure, SPACE)))

    right, wrong = (evidence(rig.masks(bent, shape), at) for at in (bent, straight))
    assert bool(right.is_good)
    assert not bool(wrong.is_good)
    assert float(wrong.covered) < 0.88 < 0.95 < float(right.covered)
    assert not bool(evidence(rig.balls(), bent).is_good)
