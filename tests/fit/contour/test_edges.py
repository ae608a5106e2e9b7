"""Edges along the normals of a contour as a factor: its cost and the change of it in pose and shape, what it tells of a
silhouette, and many hypotheses at once."""

from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import PosedHands, Problem, SharedUnknowns, Stage, mask_plane, solve
from torchhand.fit.contour import EDGE_REACH, EdgeFactor, EdgeObservation
from torchhand.hand import Anthropometry, HandPose, named_pose_space
from torchhand.image import EdgeSettings, search_edges
from torchhand.view import MeshContours, PrimitiveContours, outline_table

STAGE = Stage(gross_m=0.005, rounds=3, iterations=3)
SPACE = named_pose_space("dof27")
TABLE = outline_table(6, 6, without=("palm_wrist",))


class Scene:
    """An open hand before a camera, and some hands that are a little off."""

    def __init__(
        self, studio: Any, generator: torch.Generator, *, surface: str = "primitives", std_m: float = 0.0
    ) -> None:
        self.placed = placed = studio.placed(posed="open", camera=studio.camera(320, 256))
        self.contours = (
            PrimitiveContours(placed.projector, TABLE)
            if surface == "primitives"
            else MeshContours(load_hand_model().hand(dtype=torch.float64), placed.camera, max_points=200)
        )
        self.true = HandPose.of(placed.pose[None], placed.root_reference)
        self.edges = EdgeObservation(
            plane=mask_plane(placed.mask).double(), contours=self.contours, std_px=0.7, std_m=std_m
        )
        free = SPACE.free(self.true.dofs) + 0.05 * torch.randn(3, SPACE.size, generator=generator, dtype=torch.float64)
        free[:, :3] = SPACE.free(self.true.dofs)[:, :3] + 0.003 * torch.randn(
            3, 3, generator=generator, dtype=torch.float64
        )
        self.pose = HandPose.of(SPACE.dof(free), placed.root_reference).normalized()

    def hands(self, pose: HandPose, shape: Tensor | None = None, unknowns: SharedUnknowns | None = None) -> PosedHands:
        shape = self.contours.shape if shape is None else shape
        return PosedHands(pose=pose, shape=shape, unknowns=unknowns, extra=None if unknowns is None else unknowns.extra)


def test_the_cost_is_that_of_every_edge_along_its_normal(studio: Any, generator: torch.Generator) -> None:
    """Hand by hand and point by point; points without an edge cost as much as the farthest."""
    scene = Scene(studio, generator, std_m=0.001)
    stage = Stage(gross_m=0.001)
    factor = scene.edges.associate(scene.hands(scene.pose), stage)
    moved = scene.pose.retract(0.01 * torch.randn(36, generator=generator, dtype=torch.float64))
    found = factor.equations(scene.hands(moved))
    for i in range(3):
        pose = scene.pose[i]
        px_per_m = float(scene.placed.camera.intrinsics[0, 0] / pose.dofs[2])
        reach = max(4.0, EDGE_REACH * stage.gross_m * px_per_m)
        seen = scene.contours.visible(scene.pose, probe_distance_px=1 + 0.00374 * px_per_m)
        outer = factor.outer[i]
        edges = search_edges(
            scene.edges.plane,
            seen.points_px[i][outer],
            seen.normals[i][outer],
            EdgeSettings(polarity="inside_bright", min_strength=0.15, choose="nearest"),
            half_length_px=reach,
        )
        assert bool(edges.found.any())
        assert not bool(edges.found.all())
        at = moved[i]
        now = scene.placed.projector.outline_px(at.dofs, at.reference, TABLE)[outer]
        along = ((now - seen.points_px[i][outer]) * seen.normals[i][outer]).sum(-1) - edges.offset_px
        gross = max(2.0, reach / EDGE_REACH)
        squared = along.square() / (1 + along.square() / gross**2)
        cost = torch.where(edges.found, squared, gross**2)
        weight = 1 / (0.7**2 + (0.001 * px_per_m) ** 2) / edges.candidates.clamp_min(1)
        torch.testing.assert_close(found.cost[i], 0.5 * (weight * cost).sum(), rtol=1e-7, atol=0)


@pytest.mark.parametrize("surface", ["primitives", "mesh"])
def test_the_gradient_is_that_of_the_cost_in_pose_and_shape(
    surface: str, studio: Any, generator: torch.Generator
) -> None:
    scene, step = Scene(studio, generator, surface=surface), 1e-5
    space = load_hand_model().shape_space
    names = ("hand_breadth", "index_proximal", "thumb_mcp_radius")
    unknowns = SharedUnknowns.of_shape(Anthropometry(space), tuple(space.names.index(name) for name in names))
    hands = scene.hands(scene.pose, unknowns=unknowns)
    factor = scene.edges.associate(hands, STAGE)
    found = factor.equations(hands)

    def cost(dofs: Tensor, shape: Tensor) -> Tensor:
        pose = HandPose(dofs=scene.pose.dofs + dofs, reference=scene.pose.reference)
        return factor.equations(scene.hands(pose, scene.contours.shape + shape)).cost

    nothing, still = torch.zeros(36).double(), torch.zeros_like(scene.contours.shape)
    in_pose = [(cost(step * d, still) - cost(-step * d, still)) / (2 * step) for d in torch.eye(36).double()]
    in_shape = []
    for column in unknowns.columns:
        change = still.index_fill(0, torch.tensor([column]), step)
        in_shape.append((cost(nothing, change) - cost(nothing, -change)) / (2 * step))
    assert found.shared_gradient is not None
    for own, expected in ((found.gradient, in_pose), (found.shared_gradient, in_shape)):
        wanted = torch.stack(expected, -1)
        assert float(wanted.abs().max()) > 1
        torch.testing.assert_close(own, wanted, rtol=0, atol=1e-3 * float(wanted.abs().max()))


def test_edges_of_the_hands_own_silhouette_lie_on_its_contour(studio: Any, generator: torch.Generator) -> None:
    scene = Scene(studio, generator)
    (told,) = scene.edges.associate(scene.hands(scene.true), STAGE).explained()
    assert float(told.fraction) > 0.97
    assert float(told.distance) < 0.3
    behind = HandPose(dofs=scene.true.dofs * torch.tensor([1, 1, -1] + [1] * 33), reference=scene.true.reference)
    factor = scene.edges.associate(scene.hands(behind), STAGE)
    (told,) = factor.explained()
    assert (float(told.fraction), float(told.distance)) == (0.0, float("inf"))
    found = factor.equations(scene.hands(behind))
    assert not bool(found.gradient.any())
    assert not bool(found.matrix.any())


def test_many_hypotheses_come_to_the_hand_each_by_itself(studio: Any, generator: torch.Generator) -> None:
    """One posture at many places in one batch: as many searches as hands, and the same as one by one."""
    scene = Scene(studio, generator)
    problem = Problem(
        space=named_pose_space("planar_scale").about(scene.placed.pose),
        skeleton=load_hand_model().skeleton,
        shape=scene.contours.shape,
        observations=(scene.edges,),
    )
    away = torch.tensor(((0.01, 0.0), (-0.008, 0.006), (0.0, -0.01))).double()
    starts = HandPose(
        dofs=scene.true.dofs + torch.nn.functional.pad(away, (0, 34)),
        reference=scene.true.reference.expand(3, 3, 3),
    )
    found = solve(problem, starts, (STAGE,))
    alone = solve(problem, starts[1:2], (STAGE,))
    torch.testing.assert_close(found.pose[1:2].dofs, alone.pose.dofs, rtol=0, atol=1e-9)
    assert float((found.pose.dofs[:, :2] - scene.true.dofs[:, :2]).norm(dim=-1).max()) < 3e-4
    part = scene.edges.associate(problem.hands(starts), STAGE)
    assert isinstance(part, EdgeFactor)
    torch.testing.assert_close(
        part.rows(torch.tensor([2])).equations(problem.hands(starts[2:])).cost,
        part.equations(problem.hands(starts)).cost[2:],
    )
    assert not EdgeObservation(plane=torch.zeros(4, 4), contours=scene.contours, std_px=1.0).rows(slice(1)).plane.any()
    assert EdgeObservation(plane=torch.zeros(4, 4), contours=scene.contours, std_px=1.0).is_empty
