"""Joint limits and couplings: equations (1) to (5) of Ouhaddi and Horain (1998), the projection's laws, the penalties'
derivatives."""

import math
from itertools import product

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.hand.kinematics import DOFS, JOINT_DOFS, POSTURES, posture
from torchhand.hand.limits.constraints import ConstraintSettings, PoseConstraints
from torchhand.hand.limits.couplings import ABDUCTIONS, FLEXIONS, TIES

DEG = math.pi / 180
KINDS = [
    ConstraintSettings(bands=bands, ties=ties, abduction_vanishes_at_deg=vanishes)
    for bands, ties, vanishes in product(("paper", "neighbours", "none"), ("soft", "hard"), (110.0, 70.0))
]


def _constraints(**settings: object) -> PoseConstraints:
    return PoseConstraints(load_hand_model().skeleton, ConstraintSettings(**settings))  # pyright: ignore


def _pose(**angles_deg: float) -> Tensor:
    pose = torch.zeros(len(DOFS), dtype=torch.float64)
    for dof, angle in angles_deg.items():
        pose[DOFS.index(dof)] = angle * DEG
    return pose


def _wild(count: int, generator: torch.Generator, dtype: torch.dtype = torch.float64) -> Tensor:
    """Poses from well inside to ±10 rad outside."""
    scale = 10 ** (2 * torch.rand(count, 1, generator=generator, dtype=torch.float64) - 1)
    return (scale * (2 * torch.rand(count, 36, generator=generator, dtype=torch.float64) - 1)).to(dtype)


@pytest.mark.parametrize("settings", KINDS, ids=str)
def test_projection_is_feasible_idempotent_and_keeps_the_root(
    settings: ConstraintSettings, generator: torch.Generator
) -> None:
    constraints = PoseConstraints(load_hand_model().skeleton, settings)
    poses = _wild(3000, generator)
    near = constraints.project(poses)
    assert float(constraints.violation(near).worst.max()) < 1e-12
    assert bool(constraints.is_feasible(near).all())
    torch.testing.assert_close(constraints.project(near), near, atol=1e-14, rtol=0)
    assert torch.equal(near[:, :6], poses[:, :6])
    assert float(constraints.violation(poses).worst.min()) > 0.01 or settings.ties == "soft"


def test_a_hundred_thousand_poses(generator: torch.Generator) -> None:
    constraints = _constraints()
    near = constraints.project(_wild(100_000, generator, torch.float32))
    assert float(constraints.violation(near).worst.max()) <= 1e-6
    assert torch.equal(constraints.project(near), near)
    assert not bool(near.isnan().any())


def test_feasible_poses_come_back_bit_for_bit(generator: torch.Generator) -> None:
    constraints = _constraints()
    poses = 0.2 * _wild(3000, generator)
    inside = poses[constraints.violation(poses).worst == 0]
    assert len(inside) > 20
    assert torch.equal(constraints.project(inside), inside)


@pytest.mark.parametrize("bands", ["paper", "neighbours"])
def test_flexions_go_to_the_nearest_point(bands: str, generator: torch.Generator) -> None:
    """Dykstra's alternating projections, written from the equations."""
    constraints = _constraints(bands=bands)
    wild = _wild(200, generator)
    point = wild[:, [6 + i for i in FLEXIONS]]
    sides = []
    for i in range(4):
        sides += [({i: 1.0}, 100.0), ({i: -1.0}, 15.0)]
    sides += [({0: 1.0, 1: -1.0}, 25.0), ({2: 1.0, 1: -1.0}, 45.0)]
    if bands == "neighbours":
        sides += [({1: 1.0, 0: -1.0}, 54.0), ({1: 1.0, 2: -1.0}, 20.0)]
        sides += [({2: 1.0, 3: -1.0}, 48.0), ({3: 1.0, 2: -1.0}, 44.0)]
    taken = [torch.zeros_like(point) for _ in sides]
    for _ in range(2000):
        for row, (terms, bound_deg) in enumerate(sides):
            start = point + taken[row]
            normal = torch.zeros(4, dtype=torch.float64)
            for index, factor in terms.items():
                normal[index] = factor
            point = start - ((start @ normal - bound_deg * DEG).clamp_min(0) / (normal @ normal))[:, None] * normal
            taken[row] = start - point
    torch.testing.assert_close(constraints.project(wild)[:, [6 + i for i in FLEXIONS]], point, atol=1e-8, rtol=0)


def test_other_angles_go_to_their_nearest_limit(generator: torch.Generator) -> None:
    skeleton, constraints = load_hand_model().skeleton, _constraints()
    poses = _wild(100, generator)
    near = constraints.project(poses)
    others = [i for i in range(30) if i not in FLEXIONS and i not in ABDUCTIONS]
    assert torch.equal(near[:, 6:][:, others], skeleton.within_limits(poses[:, 6:])[:, others])


def test_equation_2() -> None:
    """At 55° of 110° half the abduction is left, on each side half of its own; in extension all of it."""
    constraints = _constraints()
    out = constraints.project(
        _pose(index_mcp_fe=55, middle_mcp_fe=55, index_mcp_aa=40, little_mcp_fe=55, little_mcp_aa=-40)
    )
    assert float(out[DOFS.index("index_mcp_aa")]) == pytest.approx(15 * DEG)
    assert float(out[DOFS.index("little_mcp_aa")]) == pytest.approx(-10 * DEG)
    straight = constraints.project(_pose(index_mcp_fe=-10, index_mcp_aa=40))
    assert float(straight[DOFS.index("index_mcp_aa")]) == pytest.approx(30 * DEG)
    none_left = _constraints(abduction_vanishes_at_deg=70.0).project(
        _pose(index_mcp_fe=80, middle_mcp_fe=80, index_mcp_aa=20)
    )
    assert float(none_left[DOFS.index("index_mcp_aa")]) == 0


def test_equation_3() -> None:
    violation = _constraints().violation(_pose(index_mcp_fe=60, ring_mcp_fe=50))
    amounts = dict(zip(violation.names, (violation.amount / DEG).tolist(), strict=True))
    assert amounts["eq. 3: index_mcp_fe <= middle_mcp_fe + 25°"] == pytest.approx(35)
    assert amounts["eq. 3: ring_mcp_fe <= middle_mcp_fe + 45°"] == pytest.approx(5)
    assert sum(amount > 1e-9 for amount in amounts.values()) == 2
    assert violation.describe().startswith("eq. 3: index_mcp_fe <= middle_mcp_fe + 25° by 35.0°; eq. 3: ring")


def test_equations_1_4_and_5() -> None:
    pose = _pose(
        **{"index_pip_fe": 60, "index_dip_fe": 50, "thumb_cmc_fe": 50, "thumb_mcp_fe": 45},
        **{"thumb_cmc_aa": 10, "thumb_mcp_aa": 12},
    )
    residual = dict(zip([tie.target for tie in TIES], (_constraints().tie_residuals(pose) / DEG).tolist(), strict=True))
    expected = {"index_dip_fe": 10, "middle_dip_fe": 0, "thumb_mcp_fe": 5, "thumb_mcp_aa": -2}
    for dof, missed in expected.items():
        assert residual[JOINT_DOFS.index(dof)] == pytest.approx(missed, abs=1e-9), dof
    far = _pose(thumb_cmc_fe=-20, thumb_mcp_fe=-10, thumb_cmc_aa=40, thumb_mcp_aa=15)  # clamped to the limits
    assert float(_constraints().tie_residuals(far).abs().max()) == pytest.approx(0, abs=1e-12)


def test_hard_ties_go_to_the_nearest_pair(generator: torch.Generator) -> None:
    """Against the best of a fine sampling of each tie's curve."""
    constraints, skeleton = _constraints(ties="hard", bands="none"), load_hand_model().skeleton
    poses = _wild(50, generator)
    near = constraints.project(poses)
    for tie in TIES:
        low, high = float(skeleton.lower[tie.source]), float(skeleton.upper[tie.source])
        source = torch.linspace(low, high, 20001, dtype=torch.float64)
        limits = float(skeleton.lower[tie.target]), float(skeleton.upper[tie.target])
        target = (tie.factor * source + tie.offset).clamp(*limits)

        def distance(x: Tensor, y: Tensor, pair: tuple[int, int] = (tie.source, tie.target)) -> Tensor:
            return torch.hypot(x - poses[:, None, 6 + pair[0]], y - poses[:, None, 6 + pair[1]])

        found = distance(near[:, None, 6 + tie.source], near[:, None, 6 + tie.target])[:, 0]
        best = distance(source, target).amin(1)
        assert bool((found <= best + 1e-9).all()), tie.name
        assert bool((found >= best - 1e-3).all()), tie.name


def test_which_postures_the_constraints_forbid() -> None:
    def forbidden(bands: str) -> set[str]:
        constraints = _constraints(bands=bands)
        return {name for name in POSTURES if not bool(constraints.is_feasible(posture(name, dtype=torch.float64)))}

    assert forbidden("none") == set()
    assert forbidden("paper") == {"victory"}
    assert forbidden("neighbours") == {"victory", "point", "three", "l", "shaka"}
    worst = _constraints().violation(posture("victory", dtype=torch.float64))
    assert worst.describe() == "eq. 3: ring_mcp_fe <= middle_mcp_fe + 45° by 40.0°"
    assert _constraints().violation(posture("fist", dtype=torch.float64)).describe() == "none"


def test_wall_is_zero_inside_and_grows_outside(generator: torch.Generator) -> None:
    for settings in KINDS:
        constraints = PoseConstraints(load_hand_model().skeleton, settings)
        near = constraints.project(_wild(300, generator))
        assert float(constraints.wall(near).max()) < 1e-20
    constraints = _constraints()
    assert float(constraints.wall(_pose(index_pip_fe=112.0))) == pytest.approx(0.5)
    assert float(constraints.wall(_pose(index_pip_fe=114.0))) == pytest.approx(2.0)
    spread = _pose(index_mcp_fe=55.0, middle_mcp_fe=55.0, index_mcp_aa=17.0)
    assert float(constraints.wall(spread)) == pytest.approx(0.5)
    off_the_tie = _pose(index_pip_fe=60.0, index_dip_fe=48.0, thumb_mcp_fe=-10.0)
    assert float(constraints.tie_energy(off_the_tie)) == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("vanishes", [110.0, 70.0])
def test_penalty_is_smooth(generator: torch.Generator, vanishes: float) -> None:
    """Derivatives, and no jump of the slope along lines through the corners."""
    constraints = _constraints(abduction_vanishes_at_deg=vanishes)
    poses = _wild(10, generator).requires_grad_()
    assert torch.autograd.gradcheck(constraints.penalty, poses, fast_mode=True)
    for direction in torch.randn(5, 36, generator=generator, dtype=torch.float64):
        steps = torch.linspace(-2, 2, 10001, dtype=torch.float64)
        line = (steps[:, None] * direction).requires_grad_()
        (slope,) = torch.autograd.grad(constraints.penalty(line).sum(), line)
        along = (slope * direction).sum(-1)
        assert float(along.diff().abs().max()) < 0.02 * float(along.abs().max())


def test_projection_is_differentiable(generator: torch.Generator) -> None:
    poses = _wild(10, generator).requires_grad_()
    for ties in ("soft", "hard"):
        project = _constraints(ties=ties).project
        assert torch.autograd.gradcheck(project, poses, fast_mode=True)
        by_row = torch.func.vmap(torch.func.jacrev(project))(poses.detach())
        whole = torch.func.jacrev(project)(poses.detach())
        torch.testing.assert_close(by_row, torch.stack([whole[i, :, i] for i in range(10)]), atol=1e-12, rtol=0)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches(generator: torch.Generator, batch: tuple[int, ...]) -> None:
    constraints = _constraints(ties="hard")
    poses = _wild(max(1, math.prod(batch)), generator).reshape(*batch, 36)
    for function in (
        constraints.project,
        constraints.penalty,
        constraints.is_feasible,
        lambda pose: constraints.violation(pose).amount,
    ):
        loop = torch.stack([function(pose) for pose in poses.reshape(-1, 36)])
        together = function(poses)
        torch.testing.assert_close(together, loop.reshape(together.shape), atol=1e-12, rtol=1e-12)


def test_nan_is_nobodys_nearest() -> None:
    constraints = _constraints()
    pose = _pose(index_pip_fe=200.0, ring_pip_fe=math.nan, middle_mcp_fe=math.nan)
    near = constraints.project(pose)
    names = {DOFS[i] for i in near.isnan().nonzero().flatten().tolist()}
    coupled = {f"{finger}_mcp_{role}" for finger in ("index", "middle", "ring", "little") for role in ("fe", "aa")}
    assert names == {"ring_pip_fe"} | coupled
    assert float(near[DOFS.index("index_pip_fe")]) == pytest.approx(110 * DEG)
    assert not bool(constraints.is_feasible(pose))
    assert "ring_pip_fe by nan" in constraints.violation(pose).describe()
    infinite = _pose() + torch.where(torch.arange(36) % 2 == 0, math.inf, -math.inf)
    assert bool(constraints.is_feasible(constraints.project(infinite)))


def test_what_settings_refuse() -> None:
    for bad, message in (
        ({"bands": "all"}, "bands: expected one of paper, neighbours, none, got 'all'"),
        ({"ties": "some"}, "ties: expected 'soft' or 'hard', got 'some'"),
        ({"softness_deg": 0.0}, "softness_deg: expected above 0 and finite, got 0.0"),
        ({"dip_spread_deg": math.nan}, "dip_spread_deg: expected above 0"),
    ):
        with pytest.raises(ValueError, match=message):
            ConstraintSettings(**bad)  # pyright: ignore
    with pytest.raises(ValueError, match="pose: expected 36 numbers"):
        PoseConstraints.project.__wrapped__.__wrapped__(_constraints(), torch.zeros(30))  # pyright: ignore
