"""The contours of a picture as a factor: against its plain specification, as the derivative of its cost in the pose and
in the shape, and a shape that comes back from one picture."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.fit.contour.plain import coverage, outer_contour, robust_equations, summed, valley
from torchhand.files import load_hand_model
from torchhand.fit import (
    Equations,
    GaussianPrior,
    PosedHands,
    Problem,
    SharedUnknowns,
    Stage,
    solve_shared,
)
from torchhand.fit.contour.matching import match_boundary
from torchhand.fit.contour.observation import TURN_M, VALLEY_GROSS_M, ContourObservation
from torchhand.fit.contour.picture import picture_contours
from torchhand.fit.contour.settings import TRACKING, ContourSettings
from torchhand.geometry import rotation_from_vector
from torchhand.hand import Anthropometry, HandPose, named_pose_space
from torchhand.image import Boundary, channel_of
from torchhand.numerics import NormalEquations
from torchhand.view import MeshContours, PrimitiveContours, outline_table

SPACE = named_pose_space("dof26")
_OUTSIDE: Any = {"without": ("palm_wrist",)}
TABLE = outline_table(6, 6, **_OUTSIDE)
_THINNED = {2: (3, 3)}
SETTINGS = ContourSettings()
COUNT = 3
KINKS = 1e-3  # of a finite difference where maps are read between their pixels


def normal(generator: torch.Generator, *size: int) -> Tensor:
    return torch.randn(*size, generator=generator, dtype=torch.float64)


class Scene:
    """Hands near a picture with a crease in its palm."""

    def __init__(
        self, studio: Any, generator: torch.Generator, *, surface: str = "primitives", by_length: bool = False
    ) -> None:
        placed = studio.placed(posed="open", camera=studio.camera(320, 256))
        image, points = torch.full((256, 320, 3), 40, dtype=torch.uint8), placed.keypoints_px
        image[placed.mask] = torch.tensor((200, 150, 120), dtype=torch.uint8)
        for finger in (5, 9, 13, 17):
            x, y = (0.4 * points[0] + 0.6 * points[finger]).round().long().tolist()
            image[y - 12 : y + 12, x] = 60
        self.picture = picture_contours(placed.mask, TRACKING, SETTINGS, image=image)
        self.contours = (
            PrimitiveContours(placed.projector, TABLE)
            if surface == "primitives"
            else MeshContours(load_hand_model().hand(dtype=torch.float64), placed.camera, max_points=120)
        )
        self.projector = placed.projector
        self.settings = replace(SETTINGS, by_length=by_length)
        self.observation = ContourObservation(picture=self.picture, contours=self.contours, settings=self.settings)
        free = SPACE.free(placed.pose) + 0.1 * normal(generator, COUNT, SPACE.size)
        free[:, :3] = SPACE.free(placed.pose)[:3] + 0.004 * normal(generator, COUNT, 3)
        self.hands = self.posed(HandPose.of(SPACE.dof(free), placed.root_reference).normalized())

    def posed(self, pose: HandPose, shape: Tensor | None = None, unknowns: SharedUnknowns | None = None) -> PosedHands:
        shape = self.contours.shape if shape is None else shape
        extra = None if unknowns is None else unknowns.extra
        return PosedHands(pose=pose, shape=shape, unknowns=unknowns, extra=extra)

    def moved(self, step: Tensor) -> PosedHands:
        pose = self.hands.pose
        return self.posed(HandPose(dofs=pose.dofs + step, reference=pose.reference))

    def plainly(self, associated: PosedHands, hands: PosedHands, stage: Stage) -> NormalEquations:
        """The specification, hand by hand sizes included."""
        s, camera, k = self.settings, self.contours.camera, stage.thinning
        every = self.picture.boundary
        boundary = Boundary(points_px=every.points_px[::k], normals=every.normals[::k])
        contours = (
            self.contours if k == 1 else PrimitiveContours(self.projector, outline_table(*_THINNED[k], **_OUTSIDE))
        )
        scale = camera.intrinsics[0, 0] / associated.pose.dofs[:, 2]  # the camera is the world
        gross_px, length_px = stage.gross_m * scale, float(self.contours.shape[0]) * scale
        assert self.contours.kinematics.shape_space.names[0] == "hand_length"
        visible = contours.visible(associated.pose, probe_distance_px=1 + s.probe_distance_m * scale)
        motion = contours.motion(hands.pose, visible)
        precision = torch.maximum(torch.tensor(s.contour_std_px), s.contour_std_fraction * gross_px).square()[:, None]
        size = visible.length_px if s.by_length else 1
        weight = size * (visible.outer + s.valley_weight * visible.inner)
        each = size * s.contour_weight / precision / weight.sum(-1, keepdim=True)
        ahead = ((boundary.points_px - visible.wrist_px[:, None]) * visible.distal_px[:, None]).sum(-1) > 0
        of_each = s.coverage_weight / precision / ahead.double().sum(-1, keepdim=True)
        match = match_boundary(boundary, visible.points_px, visible.normals, visible.outer, turn_px=TURN_M * scale)
        field, valleys = self.picture.field(stage.pitch_px), self.picture.valleys
        assert valleys is not None
        outer = outer_contour(motion, field, channel_of(visible.normals, field.channels))
        covered = coverage(motion, boundary, match, visible.normals, unmatched_px=length_px)
        return summed(
            robust_equations(outer, each * visible.outer, gross_px),
            robust_equations(covered, of_each * ahead, gross_px),
            robust_equations(valley(motion, valleys), s.valley_weight * each * visible.inner, VALLEY_GROSS_M * scale),
        )


def agree(found: Equations, expected: NormalEquations) -> None:
    scale = float(expected.matrix.abs().max())
    torch.testing.assert_close(found.cost, expected.cost, atol=0, rtol=1e-11)
    torch.testing.assert_close(found.matrix, expected.matrix, atol=1e-11 * scale, rtol=0)
    torch.testing.assert_close(found.gradient, expected.gradient, atol=1e-11 * scale, rtol=0)


@pytest.mark.parametrize("stage", [*TRACKING, replace(TRACKING[0], thinning=2)])
@pytest.mark.parametrize("by_length", [False, True])
def test_equations_are_those_of_all_residuals(
    stage: Stage, by_length: bool, studio: Any, generator: torch.Generator
) -> None:
    """At the hands of the association, where their motion is known, and away from them; of some of the hands."""
    scene = Scene(studio, generator, by_length=by_length)
    factor = scene.observation.associate(scene.hands, stage)
    agree(factor.equations(scene.hands), scene.plainly(scene.hands, scene.hands, stage))
    moved = scene.moved(0.1 * normal(generator, COUNT, 36) * (torch.arange(36) > 2))
    found = factor.equations(moved)
    agree(found, scene.plainly(scene.hands, moved, stage))
    some = torch.tensor([2])
    part = factor.rows(some).equations(scene.posed(moved.pose[some]))
    torch.testing.assert_close(part.cost, found.cost[some])
    torch.testing.assert_close(part.gradient, found.gradient[some])


@pytest.mark.parametrize("surface", ["primitives", "mesh"])
@pytest.mark.parametrize("by_length", [False, True])
def test_an_outline_is_worth_as_much_however_much_of_it_is_inner(
    surface: str, by_length: bool, studio: Any, generator: torch.Generator
) -> None:
    scene = Scene(studio, generator, surface=surface, by_length=by_length)
    bent = scene.hands.pose.dofs + torch.linspace(0, 1.4, COUNT)[:, None] * SPACE.basis[:, 6:].sum(1).clamp(0, 1)
    hands = scene.posed(HandPose(dofs=bent, reference=scene.hands.pose.reference))
    factor = scene.observation.associate(hands, TRACKING[-1])
    inner, count = factor.visible.inner.double().mean(-1), factor.visible.inner.shape[1]
    assert float(inner.max()) > 1.3 * float(inner.min())
    std = (SETTINGS.contour_std_fraction * factor.gross_px).clamp_min(SETTINGS.contour_std_px)
    worth = factor.pairs.weight[:, :count].sum(-1) * std.square()
    torch.testing.assert_close(worth, torch.full_like(worth, SETTINGS.contour_weight))


@pytest.mark.parametrize("surface", ["primitives", "mesh"])
def test_the_gradient_is_that_of_the_cost(surface: str, studio: Any, generator: torch.Generator) -> None:
    """Across the outlines it is exact; along them the slide of the points is left out, so a few per cent remain."""
    scene, step = Scene(studio, generator, surface=surface), 1e-6
    factor = scene.observation.associate(scene.hands, TRACKING[-1])
    gradient = factor.equations(scene.hands).gradient
    slopes = []
    for direction in torch.eye(36, dtype=torch.float64):
        ends = [factor.equations(scene.moved(sign * step * direction)).cost for sign in (1, -1)]
        slopes.append((ends[0] - ends[1]) / (2 * step))
    expected = torch.stack(slopes, -1)
    if surface == "mesh":  # edges are carried by the skin; some cross from one pixel of the map to the next
        torch.testing.assert_close(gradient, expected, atol=KINKS * float(expected.abs().max()), rtol=0)
    cosine = torch.nn.functional.cosine_similarity(gradient, expected, dim=-1)
    assert float(cosine.min()) > 0.99


def unknowns(*names: str, extra: int = 0) -> SharedUnknowns:
    """Of the named parameters, and numbers that the contours know nothing of."""
    space = load_hand_model().shape_space
    found = SharedUnknowns.of_shape(Anthropometry(space), tuple(space.names.index(name) for name in names))
    return replace(found, extra=torch.zeros(extra).double(), extra_std=torch.ones(extra).double())


@pytest.mark.parametrize("surface", ["primitives", "mesh"])
@pytest.mark.parametrize("change", [1.0, 1.04])
def test_the_gradient_in_the_shape_is_that_of_the_cost(
    change: float, surface: str, studio: Any, generator: torch.Generator
) -> None:
    """With the correspondences frozen, also where the shape is not the contours' own; what comes after the shape counts
    for nothing."""
    scene = Scene(studio, generator, surface=surface)
    free = unknowns("hand_length", "hand_breadth", "palm_thickness", extra=2)
    pose, shape = scene.hands.pose, change * scene.contours.shape
    hands = scene.posed(pose, shape, free)
    factor = scene.observation.associate(hands, TRACKING[-1])
    found = factor.equations(hands)
    assert found.mixed is not None
    assert found.shared_gradient is not None
    assert found.shared_matrix is not None
    slopes = []
    for column in free.columns:
        step = torch.zeros_like(shape)
        step[column] = 1e-6
        ends = [factor.equations(scene.posed(pose, shape + sign * step)).cost for sign in (1, -1)]
        slopes.append((ends[0] - ends[1]) / 2e-6)
    expected = torch.stack(slopes, -1)
    columns = len(free.columns)
    if surface == "mesh":
        tolerance = KINKS * float(expected.abs().max())
        torch.testing.assert_close(found.shared_gradient[:, :columns], expected, atol=tolerance, rtol=0)
    cosine = torch.nn.functional.cosine_similarity(found.shared_gradient[:, :columns], expected, dim=-1)
    assert float(cosine.min()) > 0.99
    assert not bool(found.shared_gradient[:, columns:].any())
    assert not bool(found.mixed[..., columns:].any())
    assert not bool(found.shared_matrix[:, columns:].any())
    whole = torch.cat(
        (
            torch.cat((found.matrix, found.mixed), -1),
            torch.cat((found.mixed.mT, found.shared_matrix), -1),
        ),
        -2,
    )
    lowest = torch.linalg.eigvalsh(whole).amin(-1) / whole.abs().amax((-2, -1))
    assert float(lowest.min()) > -1e-9  # one positive semi-definite matrix in pose and shape


def test_a_changed_breadth_comes_back_from_one_picture(studio: Any) -> None:
    """With the pose unknown too, known as well as a tracker knows it."""
    model, camera = load_hand_model(), studio.camera(320, 256)
    space, shape = model.shape_space, model.shape_space.default.double()
    breadth = space.names.index("hand_breadth")
    broad = shape.clone()
    broad[breadth] *= 1.08
    placed = studio.placed(posed="open", camera=camera, shape=broad)
    picture = picture_contours(placed.mask, TRACKING)
    contours = PrimitiveContours(studio.placed(posed="open", camera=camera).projector, outline_table(8, 8))
    truth = HandPose.of(SPACE.dof(SPACE.free(placed.pose)), placed.root_reference)
    step = torch.zeros(36, dtype=torch.float64)
    step[:3], step[5] = torch.tensor((0.003, -0.002, 0.004), dtype=torch.float64), 0.03
    starts = truth.retract(step).reshape(1)
    std = torch.full((SPACE.size,), 0.05, dtype=torch.float64)
    std[:3] = 0.01
    problem = Problem(
        space=SPACE,
        skeleton=model.skeleton,
        shape=shape,
        observations=(ContourObservation(picture=picture, contours=contours, settings=SETTINGS),),
        priors=(GaussianPrior.of_std(starts, std, SPACE),),
        shared=unknowns("hand_breadth"),
    )
    schedule = (Stage(gross_m=0.00935, rounds=3, iterations=6), Stage(gross_m=0.00374, rounds=4, iterations=6))
    found = solve_shared(problem, starts, schedule)
    assert abs(float(found.shape[breadth] / broad[breadth]) - 1) < 0.015
    fixed = [i for i in range(len(shape)) if i != breadth]
    assert torch.equal(found.shape[fixed], shape[fixed])
    assert float(found.shape_std[breadth]) < 0.5 * float(space.std[breadth])
    assert float(found.explained[0].distance) < 0.6


def test_hands_that_are_seen_explain_the_picture(studio: Any, generator: torch.Generator) -> None:
    scene = Scene(studio, generator)
    placed, pose = studio.placed(posed="open", camera=studio.camera(320, 256)), scene.hands.pose
    truth = HandPose.of(placed.pose[None], placed.root_reference)
    gone = HandPose.of(pose.dofs * torch.where(torch.arange(36) == 2, -1.0, 1.0), pose.reference)  # behind the camera
    hands = scene.posed(HandPose.cat((truth, pose, gone)))
    [found] = scene.observation.associate(hands, TRACKING[0]).explained()
    assert (found.name, found.view) == ("contour", 0)
    assert float(found.fraction[0]) > 0.95
    assert float(found.distance[0]) < 0.6
    assert bool((found.fraction[1 : 1 + COUNT] < found.fraction[0]).all())
    assert bool((found.distance[1 : 1 + COUNT] > found.distance[0]).all())
    assert bool(found.distance[1 : 1 + COUNT].isfinite().all())
    assert bool((found.fraction[1 + COUNT :] == 0).all())
    assert bool(found.distance[1 + COUNT :].isinf().all())


def test_rotation_vectors_are_about_their_references(studio: Any, generator: torch.Generator) -> None:
    """The same hands about other references cost the same."""
    scene = Scene(studio, generator)
    turned = rotation_from_vector(0.2 * normal(generator, COUNT, 3)) @ scene.hands.pose.reference
    other = scene.posed(scene.hands.pose.about(turned))
    costs = [scene.observation.associate(one, TRACKING[-1]).equations(one).cost for one in (scene.hands, other)]
    torch.testing.assert_close(costs[1], costs[0], atol=0, rtol=1e-9)
