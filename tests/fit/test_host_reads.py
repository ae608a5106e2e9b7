"""No iteration of `solve` waits for its device: every kind of observation and prior, on a processor that is treated as
an accelerator, and on a device that no other one's tensors come near."""

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import pytest
import torch
from torch import Tensor

import torchhand.fit
from tests import pretend_device
from tests.device_guard import HostRead, no_host_reads, on_device
from tests.fit.hull.conftest import Rig, make_rig
from tests.studio import Studio
from torchhand import devices
from torchhand.files import load_hand_model
from torchhand.fit import (
    ConstraintPrior,
    FrameObservations,
    GaussianPrior,
    Observation,
    OwnFactor,
    PosturePrior,
    PostureResiduals,
    Problem,
    Schedule,
    Solutions,
    Stage,
    mask_plane,
    solve,
)
from torchhand.fit.contour import ContourObservation, ContourSettings, EdgeObservation, picture_contours
from torchhand.fit.hull import HullSettings, SkinPoints, with_rays
from torchhand.fit.hull.coverage import CoverageObservation
from torchhand.fit.hull.inside import InsideObservation
from torchhand.fit.hull.penetration import PenetrationPrior
from torchhand.fit.hull.vertices import SkinVertices
from torchhand.fit.keypoints import KeypointSettings, PictureKeypoints, PostureKeypoints, WorldKeypoints
from torchhand.fit.keypoints.prior import NaturalPrior, natural_posture
from torchhand.fit.keypoints.relative import RelativeKeypoints
from torchhand.fit.open_hand.digits import DigitObservation
from torchhand.hand import HandPose, PoseConstraints, named_pose_space
from torchhand.image import HandRegions, divide_hand
from torchhand.numerics import RobustLoss
from torchhand.view import MeshContours, PrimitiveContours, outline_table

HANDS = 3
SPACE = named_pose_space("dof26")
MODEL = load_hand_model()
Method = Literal["levenberg_marquardt", "gauss_newton", "gradient_descent"]


def schedule(method: Method = "levenberg_marquardt", iterations: int = 3) -> Schedule:
    return (Stage(gross_m=0.01, rounds=1, iterations=iterations, method=method),)


@dataclass(frozen=True)
class Scene:
    """An open hand before a camera and one in a rig, with some hands that are off by a few degrees."""

    studio: Studio
    rig: Rig

    @property
    def kinds(self) -> dict[str, Callable[[], tuple[Problem, HandPose]]]:
        """A problem and starts of every kind."""
        return {**self._of_pictures(), **self._of_points(), **self._of_priors(), **self._of_hulls()}

    def _of_pictures(self) -> dict[str, Any]:
        placed = self.studio.placed(posed="open", camera=self.studio.camera(160, 128))
        image = torch.full((128, 160, 3), 40, dtype=torch.uint8)
        image[placed.mask] = torch.tensor((200, 150, 120), dtype=torch.uint8)
        points = placed.keypoints_px
        for finger in (5, 9, 13, 17):  # creases: valleys
            x, y = (0.4 * points[0] + 0.6 * points[finger]).round().long().tolist()
            image[y - 6 : y + 6, x] = 60
        picture = picture_contours(placed.mask, schedule(), ContourSettings(), image=image)
        table = outline_table(6, 6, without=("palm_wrist",))
        surfaces = {
            "contour of primitives": PrimitiveContours(placed.projector, table),
            "contour of the mesh": MeshContours(MODEL.hand(dtype=torch.float64), placed.camera, max_points=120),
        }

        def of(name: str) -> Callable[[], tuple[Problem, HandPose]]:
            seen = ContourObservation(picture=picture, contours=surfaces[name], settings=ContourSettings())
            return lambda: (problem(seen), self.hands)

        edges = EdgeObservation(
            plane=mask_plane(placed.mask).double(), contours=surfaces["contour of primitives"], std_px=1.0, std_m=0.001
        )
        regions = divide_hand(placed.mask)
        assert isinstance(regions, HandRegions)
        digits = DigitObservation.of(regions, placed.kinematics, placed.camera)
        return {
            **{name: of(name) for name in surfaces},
            "edges along normals": lambda: (problem(edges), self.hands),
            "digits": lambda: (problem(digits), self.hands),
        }

    def _of_points(self) -> dict[str, Any]:
        placed = self.studio.placed(posed="open", camera=self.studio.camera(160, 128))
        kinematics, settings = MODEL.kinematics(dtype=torch.float64), KeypointSettings()
        points = kinematics(placed.pose, root_reference=placed.root_reference).keypoints[None]
        seen = PictureKeypoints(
            points_px=placed.camera.project(points), kinematics=kinematics, camera=placed.camera, settings=settings
        )
        spread = torch.diag(torch.tensor((9.0, 4.0), dtype=torch.float64)).expand(1, 21, 2, 2)
        frames = FrameObservations(frames=(seen,) * HANDS)
        turn, std = torch.eye(3, dtype=torch.float64)[None], torch.full((3,), 0.01, dtype=torch.float64)
        relative = RelativeKeypoints(
            points=points.expand(HANDS, -1, -1), kinematics=kinematics, cam_from_world=turn, std=std
        )
        bent = PostureKeypoints.of_points(points, kinematics, kinematics.default_shape, settings)
        world = WorldKeypoints(points=points, kinematics=kinematics, settings=settings)
        robust = replace(seen, cov_px=spread, loss=RobustLoss(kind="huber", scale=3.0, group=2))
        kinds = {
            "points of a picture": (seen,),
            "points with covariances": (robust,),
            "points of frames": (frames,),
            "points in the world": (world,),
            "points about their mean": (relative, seen),
            "posture of points": (bent, seen),
        }
        return {name: lambda own=own: (problem(*own), self.hands) for name, own in kinds.items()}

    def _of_priors(self) -> dict[str, Any]:
        postures = PostureResiduals.of(MODEL.prior().postures)
        std = torch.full((SPACE.size,), 0.3, dtype=torch.float64)
        natural = NaturalPrior(posture=natural_posture(), fraction=torch.ones(HANDS, 36, dtype=torch.float64))
        kinds = {
            "constraints": ConstraintPrior(constraints=PoseConstraints(MODEL.skeleton)),
            "postures": PosturePrior(postures=postures, tail=4.0),
            "expected poses": GaussianPrior.of_std(self.hands, std, SPACE),
            "natural posture": natural,
        }
        return {name: lambda own=own: self._with_points(own) for name, own in kinds.items()}

    def _with_points(self, prior: Observation) -> tuple[Problem, HandPose]:
        points, hands = self._of_points()["points in the world"]()
        return replace(points, priors=(prior,)), hands

    def _of_hulls(self) -> dict[str, Any]:
        pose, shape = self.rig.person(3)
        masks = self.rig.masks(pose, shape)
        target = self.rig.target_of_masks(masks, level=6)
        skin = SkinPoints(self.rig.hand, shape)
        vertices = SkinVertices.of(skin, HullSettings())
        edges = CoverageObservation(target=with_rays(target, self.rig.cameras, masks, count=120), vertices=vertices)
        kinds: dict[str, tuple[Observation, ...]] = {
            "inside a hull": (InsideObservation(target=target, vertices=vertices),),
            "surface of a hull": (CoverageObservation(target=target, vertices=vertices),),
            "edges of silhouettes": (edges,),
            "digits apart": (edges, PenetrationPrior(skin=skin)),
        }
        hands = near(pose)
        return {name: lambda own=own: (problem(*own, shape=shape), hands) for name, own in kinds.items()}

    @property
    def hands(self) -> HandPose:
        placed = self.studio.placed(posed="open", camera=self.studio.camera(160, 128))
        return near(HandPose.of(placed.pose, placed.root_reference))


def problem(*observations: Observation, shape: Tensor | None = None) -> Problem:
    return Problem(
        space=SPACE,
        skeleton=MODEL.skeleton,
        shape=MODEL.kinematics(dtype=torch.float64).default_shape if shape is None else shape,
        observations=observations,
    )


def near(pose: HandPose) -> HandPose:
    """Hands about a pose, some of them at limits."""
    generator = torch.Generator().manual_seed(1)
    free = SPACE.free(pose.dofs) + 0.12 * torch.randn(HANDS, SPACE.size, generator=generator, dtype=torch.float64)
    free[:, :3] = SPACE.free(pose.dofs)[:3] + 0.002 * torch.randn(HANDS, 3, generator=generator, dtype=torch.float64)
    return HandPose.of(SPACE.dof(free), pose.reference).normalized()


NAMES = (
    *(
        "contour of primitives",
        "contour of the mesh",
        "edges along normals",
        "digits",
        "points of a picture",
        "points with covariances",
    ),
    *("points of frames", "points in the world", "points about their mean", "posture of points", "constraints"),
    *("postures", "expected poses", "natural posture", "inside a hull", "surface of a hull", "edges of silhouettes"),
    "digits apart",
)

SEARCHED = ("edges along normals",)
"""What waits for its device in every association, though in no iteration."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(studio=Studio(), rig=make_rig())


@pytest.fixture(scope="module")
def problems(scene: Scene) -> dict[str, tuple[Problem, HandPose]]:
    return {name: make() for name, make in scene.kinds.items()}


@pytest.fixture
def accelerator(monkeypatch: pytest.MonkeyPatch) -> None:
    """The processor counts as a device that must be waited for."""
    monkeypatch.setattr(devices, "_HOSTS", ())


def close(one: Solutions, other: Solutions) -> None:
    """To what rounding leaves of a few iterations in float64, in whatever order sums are taken."""
    for name in ("cost", "status", "iterations"):
        torch.testing.assert_close(getattr(one, name), getattr(other, name), rtol=1e-8, atol=1e-8)
    torch.testing.assert_close(one.pose.vector, other.pose.vector, rtol=0, atol=1e-8)
    for own, others in zip(one.explained, other.explained, strict=True):
        torch.testing.assert_close(own.distance, others.distance, rtol=1e-8, atol=1e-8)


def test_every_kind_is_among_those_tested(problems: dict[str, tuple[Problem, HandPose]]) -> None:
    used = {type(one) for case, _ in problems.values() for one in (*case.observations, *case.priors)}
    known = set()
    for module in pkgutil.walk_packages(torchhand.fit.__path__, "torchhand.fit."):
        own = vars(importlib.import_module(module.name)).values()
        kinds = [kind for kind in own if isinstance(kind, type)]
        known |= {kind for kind in kinds if hasattr(kind, "associate") and hasattr(kind, "is_empty")}
    assert known - {Observation, OwnFactor} == used
    assert set(problems) == set(NAMES)


@pytest.mark.parametrize(
    ("name", "method"),
    [
        *((name, "levenberg_marquardt") for name in NAMES),
        *((name, "gauss_newton") for name in ("contour of primitives", "inside a hull")),
    ],
)
def test_no_iteration_waits_for_its_device(
    name: str, method: Method, problems: dict[str, tuple[Problem, HandPose]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is read or sent in a second run but in the named places, as often in 3 iterations as in one; and what
    comes out is what a processor finds, which asks itself all the time."""
    case, starts = problems[name]
    expected = solve(case, starts, schedule(method))
    monkeypatch.setattr(devices, "_HOSTS", ())
    solve(case, starts, schedule(method))  # constants are sent once
    with no_host_reads() as permitted:
        found = solve(case, starts, schedule(method))
    few, permitted.count = permitted.count, 0
    with no_host_reads() as permitted:
        solve(case, starts, schedule(method, iterations=1))
    assert few == permitted.count
    assert few <= len(case.observations) or name in SEARCHED
    close(found, expected)


def test_gradient_descent_asks_at_its_stride(problems: dict[str, tuple[Problem, HandPose]], accelerator: None) -> None:
    case, starts = problems["points in the world"]
    solve(case, starts, schedule("gradient_descent"))
    with no_host_reads() as permitted:
        solve(case, starts, schedule("gradient_descent"))
    assert 0 < permitted.count <= 30 // devices.TURNS  # ten iterations for one of Levenberg-Marquardt


@pytest.mark.parametrize("name", NAMES)
def test_the_guard_finds_a_read_of_any_kind(
    name: str, problems: dict[str, tuple[Problem, HandPose]], accelerator: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    case, starts = problems[name]
    factors = case.associated(case.values_of(starts), starts.reference, schedule()[0])
    factors.here()  # constants are sent once
    kind = type(factors.factors[-1 if case.priors else 0])
    equations = kind.equations

    def reading(self: Any, hands: Any) -> Any:
        found = equations(self, hands)
        assert float(found.cost.sum()) < torch.inf
        return found

    with no_host_reads():
        factors.here()
    monkeypatch.setattr(kind, "equations", reading)
    with no_host_reads(), pytest.raises(HostRead, match="float"):
        factors.here()


FLAGS, MATRIX = torch.tensor((True, False, True)), torch.eye(3)
WAITS: dict[str, Callable[[], Any]] = {
    "item": lambda: MATRIX[0, 0].item(),
    "float": lambda: float(MATRIX[0, 0]),
    "int": lambda: int(MATRIX[0, 0]),
    "bool": lambda: bool(FLAGS.any()),
    "tolist": MATRIX.tolist,
    "cpu": MATRIX.cpu,
    "numpy": MATRIX.numpy,
    "asarray": lambda: np.asarray(MATRIX),
    "nonzero": FLAGS.nonzero,
    "mask": lambda: MATRIX[FLAGS],
    "to a mask": lambda: MATRIX.clone().__setitem__(FLAGS, MATRIX[:2]),
    "where": lambda: torch.where(FLAGS),
    "masked_select": lambda: MATRIX.masked_select(FLAGS),
    "unique": lambda: MATRIX.unique(),
    "equal": lambda: torch.equal(MATRIX, MATRIX),
    "repeat_interleave": lambda: torch.repeat_interleave(FLAGS.long()),
    "inverse": lambda: torch.linalg.inv(MATRIX),
    "cholesky": lambda: torch.linalg.cholesky(MATRIX),
    "solve": lambda: torch.linalg.solve(MATRIX, MATRIX),
    "tensor": lambda: torch.tensor((1.0, 2.0)),
    "new_tensor": lambda: MATRIX.new_tensor((1.0, 2.0)),
    "as_tensor": lambda: torch.as_tensor((1.0, 2.0)),
    "list": lambda: MATRIX[[0, 2]],
    "index": lambda: [0, 1, 2][MATRIX[0, 0].long()],
}


@pytest.mark.parametrize("name", WAITS)
def test_the_guard_knows_what_waits(name: str) -> None:
    for is_inference in (False, True):
        with torch.inference_mode(is_inference), no_host_reads(), pytest.raises(HostRead):
            WAITS[name]()


@pytest.mark.parametrize("of", NAMES)
def test_hands_on_a_device_are_those_of_the_processor(
    of: str, device: torch.device, problems: dict[str, tuple[Problem, HandPose]]
) -> None:
    """All is on the device before the first iteration: a second run sends nothing to the pretended one."""
    stages = schedule(iterations=1)
    expected = solve(*problems[of], stages)
    case, starts = on_device(problems[of], device)
    assert solve(case, starts, stages).pose.dofs.device.type == device.type
    before = pretend_device.sent()
    found = solve(case, starts, stages)
    assert pretend_device.sent() == before
    close(on_device(found, torch.device("cpu")), expected)
