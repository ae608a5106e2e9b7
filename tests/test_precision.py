"""One story of dtypes: float32 unless asked, in what comes in out it goes, mixing is refused, autocast has no part."""

import inspect
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._pytree import tree_structure

import torchhand
import torchhand.geometry as g
import torchhand.hand as h
from torchhand import SeenKeypoints, assumed_camera, fit_keypoints, load_hand_model, settings_of
from torchhand.fit import Problem, Stage, solve
from torchhand.numerics import (
    Gaussian,
    Measurement,
    gradient_descent,
    levenberg_marquardt,
    mode_in_box,
    predict,
    predict_linear,
    robust_cholesky,
    update,
    update_extended,
    update_iterated,
    update_quadratic,
)
from torchhand.precision import EXACT, own_precision, record, require_exact
from torchhand.track import HandKeypoints, Tracker, View
from torchhand.view import mesh_silhouette, outline, outline_table, raycast

MODEL = load_hand_model()
CAMERA = assumed_camera(64, 48)
HALF = (torch.float16, torch.bfloat16)
_GENERATOR = torch.Generator().manual_seed(0)
POSE = 0.2 * torch.randn(3, 36, generator=_GENERATOR, dtype=torch.float64)
POSE[:, 2] += 0.5
SHAPE = MODEL.shape_space.default
VECTOR = torch.randn(4, 3, generator=_GENERATOR, dtype=torch.float64)
ROTATION = g.rotation_from_vector(VECTOR)
PIXELS = 40 * torch.rand(3, 21, 2, generator=_GENERATOR, dtype=torch.float64)
FIXED = torch.eye(4, dtype=torch.float64) + 0.1


@cache
def hand(dtype: torch.dtype) -> h.Hand:
    return torchhand.Hand(dtype=dtype)


@cache
def posed(dtype: torch.dtype) -> h.HandState:
    return hand(dtype)(POSE.to(dtype))


@cache
def prior(dtype: torch.dtype) -> h.HandPrior:
    return MODEL.prior(dtype=dtype)


Walk = Callable[[Callable[[Tensor], Tensor], torch.dtype], Any]
"""A use of a public name: `a` gives a tensor its dtype, `d` is the dtype of modules."""
WALKED: dict[str, Walk] = {
    "Hand": lambda a, d: hand(d)(a(POSE), a(SHAPE)),
    "HandState": lambda a, d: posed(d).primitives,
    "HandKinematics": lambda a, d: hand(d).kinematics(a(POSE), a(SHAPE), root_reference=a(ROTATION[:3])),
    "HandPrior": lambda a, d: [prior(d).energy(a(POSE), a(SHAPE)), prior(d).log_prob(a(POSE))],
    "PostureMixture": lambda a, d: prior(d).postures.log_density(a(POSE)),
    "PoseConstraints": lambda a, d: [getattr(prior(d).constraints, n)(a(POSE)) for n in ("project", "penalty")],
    "Anthropometry": lambda a, d: [getattr(prior(d).population, n)(a(SHAPE)) for n in ("project", "log_density")],
    "ShapeSpace": lambda a, d: MODEL.shape_space.metres(a(SHAPE)),
    "PoseSpace": lambda a, d: (s := h.named_pose_space("dof26")).dof(s.free(a(POSE))),
    "Skeleton": lambda a, d: MODEL.skeleton.within_limits(a(POSE)[:, 6:]),
    "HandPose": lambda a, d: h.HandPose.of(a(POSE)).retract(a(POSE)).step_to(h.HandPose.of(a(POSE))),
    "rebased": lambda a, d: h.rebased(a(POSE), a(ROTATION[:3])),
    "bone_offsets": lambda a, d: h.bone_offsets(MODEL.shape_space, a(SHAPE), a(MODEL.skeleton.rest_rotation[1:6])),
    "keypoint_jacobian": lambda a, d: h.keypoint_jacobian(hand(d).kinematics, a(POSE), posed(d).frames),
    "ShapeJacobian": lambda a, d: h.ShapeJacobian(hand(d).kinematics)(posed(d).frames, a(SHAPE)),
    "skin_jacobian": lambda a, d: h.skin_jacobian(hand(d), a(POSE), torch.tensor([[0, 1, 2]])),
    "posed_mesh": lambda a, d: h.posed_mesh(hand(d), posed(d)).moved(a(ROTATION[0]), a(VECTOR[0])),
    "PosedMesh": lambda a, d: h.posed_mesh(hand(d), posed(d)).vertex_normals(),
    "primitive_sizes": lambda a, d: h.primitive_sizes(MODEL.shape_space, a(SHAPE)),
    "place_primitives": lambda a, d: h.place_primitives(
        posed(d).frames, h.primitive_sizes(MODEL.shape_space, a(SHAPE))
    ),
    "Primitives": lambda a, d: posed(d).primitives.moved(a(ROTATION[0]), a(VECTOR[0])).quadrics(),
    "Implicit": lambda a, d: posed(d).primitives.implicit(),
    "penetration_penalty": lambda a, d: h.penetration_penalty(posed(d).primitives),
    "Camera": lambda a, d: [
        CAMERA.project(a(POSE)[:, :3]),
        *CAMERA.rays(a(PIXELS)),
        CAMERA.pixel_jacobian(a(PIXELS)),
        CAMERA.pixels_from_plane(CAMERA.plane_from_pixels(a(PIXELS))),
    ],
    "outline": lambda a, d: outline(posed(d).primitives, outline_table(4, 4)),
    "raycast": lambda a, d: raycast(posed(d).primitives.select(0), CAMERA).depth,
    "mesh_silhouette": lambda a, d: a(mesh_silhouette(posed(d).vertices, hand(d).faces, CAMERA).double()),
    "rotation_from_vector": lambda a, d: g.rotation_from_vector(a(VECTOR)),
    "vector_from_rotation": lambda a, d: g.vector_from_rotation(a(ROTATION)),
    "left_jacobian": lambda a, d: g.left_jacobian(a(VECTOR)),
    "quaternion_of_rotation": lambda a, d: g.rotation_of_quaternion(g.quaternion_of_rotation(a(ROTATION))),
    "moved": lambda a, d: g.moved(a(FIXED), a(ROTATION), a(VECTOR)),
    "conic_of_quadric": lambda a, d: g.conic_of_quadric(a(FIXED)),
    "evaluate": lambda a, d: g.evaluate(a(FIXED), a(VECTOR)),
    "distort": lambda a, d: g.undistort(g.distort(a(PIXELS / 100), a(VECTOR[:, 0] / 9)), a(VECTOR[:, 0] / 9)),
    "fit_keypoints": lambda a, d: fit_keypoints(hand(d).kinematics, posed(d).keypoints).pose,
    "update": lambda a, d: update(_belief(a), lambda x: x @ a(FIXED), Measurement(a(FIXED[0]), a(FIXED[0]))).state,
    "update_extended": lambda a, d: update_extended(_belief(a), a(FIXED[0]), a(FIXED), a(FIXED[0])).state,
    "update_quadratic": lambda a, d: update_quadratic(_belief(a), a(FIXED[0]), a(FIXED)),
    "update_iterated": lambda a, d: (
        update_iterated(
            _belief(a), lambda x: (x @ a(FIXED), a(FIXED)), Measurement(a(FIXED[0]), a(FIXED[0]))
        ).update.state
    ),
    "predict": lambda a, d: predict(_belief(a), lambda x: x @ a(FIXED), a(FIXED)),
    "predict_linear": lambda a, d: predict_linear(_belief(a), a(FIXED), a(FIXED)),
    "robust_cholesky": lambda a, d: robust_cholesky(a(FIXED)),
    "levenberg_marquardt": lambda a, d: levenberg_marquardt(lambda x: (x @ a(FIXED), a(FIXED)), a(FIXED[0])).values,
    "gradient_descent": lambda a, d: gradient_descent(lambda x: (x @ a(FIXED), a(FIXED)), a(FIXED[0])).values,
    "mode_in_box": lambda a, d: mode_in_box(_belief(a), a(FIXED[1] - 9), a(FIXED[1] + 9)),
}
TAKES_TWO = (
    *("Hand", "HandKinematics", "HandPrior", "HandPose", "rebased", "bone_offsets", "place_primitives", "Primitives"),
    *("keypoint_jacobian", "ShapeJacobian", "skin_jacobian", "posed_mesh", "moved", "evaluate", "distort"),
    *("update", "update_extended", "update_iterated", "update_quadratic", "predict_linear", "mode_in_box"),
)
EXACT_ALONE = (
    *("HandPrior", "update", "update_extended", "update_iterated", "predict", "predict_linear", "robust_cholesky"),
    *("update_quadratic", "levenberg_marquardt", "gradient_descent", "mode_in_box"),
)
"""Filters, solvers and the prior."""
BESIDE_MODULES = ("place_primitives", "keypoint_jacobian", "ShapeJacobian", "skin_jacobian")
"""Uses of TAKES_TWO whose second tensors come from modules."""


def _belief(a: Callable[[Tensor], Tensor]) -> Gaussian:
    return Gaussian(a(FIXED[0]), a(FIXED))


def numbers(value: Any) -> list[Tensor]:
    """All floating-point tensors that a result holds, but those of its constants."""
    if isinstance(value, Tensor):
        return [value] if value.is_floating_point() else []
    if isinstance(value, (list, tuple)):
        return [number for one in value for number in numbers(one)]
    if is_dataclass(value) and not isinstance(value, h.ShapeSpace):
        return [number for field in fields(value) for number in numbers(getattr(value, field.name))]
    return []


@pytest.mark.parametrize("dtype", EXACT)
@pytest.mark.parametrize("name", WALKED)
def test_what_comes_in_is_what_goes_out(name: str, dtype: torch.dtype) -> None:
    found = numbers(WALKED[name](lambda x: x.to(dtype), dtype))
    assert found
    assert {one.dtype for one in found} == {dtype}


@pytest.mark.parametrize("name", WALKED)
def test_autocast_changes_nothing(name: str) -> None:
    """Not a bit of any result, in float32."""
    walk = WALKED[name]
    expected = numbers(walk(Tensor.float, torch.float32))
    posed.cache_clear()  # what is made of a state is made within as well
    try:
        with torch.autocast("cpu", dtype=torch.bfloat16):
            assert (FIXED.float() @ FIXED.float()).dtype == torch.bfloat16
            found = numbers(walk(Tensor.float, torch.float32))
    finally:
        posed.cache_clear()
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == torch.float32
        assert torch.equal(one.nan_to_num(-1.0), other.nan_to_num(-1.0))


@pytest.mark.parametrize("name", TAKES_TWO)
def test_mixing_is_refused_with_one_line(name: str) -> None:
    """The modules are float32 and so is the first tensor that is given besides; every other tensor is float64."""
    given = iter([] if name in BESIDE_MODULES else [torch.float32])
    with pytest.raises(ValueError, match=r"expected torch\.float(32|64),.* got torch\.float(32|64)$") as caught:
        WALKED[name](lambda x: x.to(next(given, torch.float64)), torch.float32)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("dtype", HALF)
@pytest.mark.parametrize("name", EXACT_ALONE)
def test_filters_and_solvers_refuse_half_precision(name: str, dtype: torch.dtype) -> None:
    with pytest.raises(ValueError, match=rf"expected torch\.float32.*, got {dtype}$") as caught:
        WALKED[name](lambda x: x.to(dtype), torch.float32)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("dtype", HALF)
def test_solvers_refuse_measurements_of_half_precision(dtype: torch.dtype) -> None:
    half = PIXELS[0].to(dtype)
    space = h.named_pose_space("dof26")
    kinematics = MODEL.kinematics(dtype=torch.float64)
    problem = Problem(space=space, skeleton=MODEL.skeleton, shape=SHAPE, observations=())
    refused: dict[str, Callable[[], object]] = {
        "points_px": lambda: HandKeypoints(points_px=half),
        "points": lambda: HandKeypoints(points_px=PIXELS[0], points=torch.zeros(21, 3, dtype=dtype)),
        "confidence": lambda: SeenKeypoints(camera=CAMERA, points_px=PIXELS[0], confidence=half[:, 0]),
        "keypoints": lambda: fit_keypoints(kinematics, torch.zeros(21, 3, dtype=dtype)),
        "kinematics": lambda: fit_keypoints(MODEL.kinematics(dtype=dtype), torch.zeros(21, 3)),
        "starts": lambda: solve(problem, h.HandPose.of(POSE.to(dtype)), (Stage(),)),
        "dtype": lambda: MODEL.prior(dtype=dtype),
    }
    for name, call in refused.items():
        with pytest.raises(ValueError, match=rf"{name}: expected torch\.float32 or torch\.float64, got {dtype}$"):
            call()


def test_unless_asked_it_is_float32() -> None:
    """What a learning pipeline makes first."""
    generator = torch.Generator().manual_seed(0)
    asked = torch.float64
    made: dict[str, tuple[Any, Any]] = {
        "posture": (h.posture("fist"), h.posture("fist", dtype=asked)),
        "sample": (prior(torch.float32).sample(2, generator), prior(torch.float32).sample(2, generator, dtype=asked)),
        "shapes": (
            MODEL.prior().population.sample(2, generator),
            MODEL.prior().population.sample(2, generator, dtype=asked),
        ),
        "Hand": (torchhand.Hand().shape, torchhand.Hand(dtype=asked).shape),
        "Hand of a shape": (torchhand.Hand(SHAPE).shape, torchhand.Hand(SHAPE, dtype=asked).shape),
        "HandModel.hand": (MODEL.hand().shape, MODEL.hand(dtype=asked).shape),
        "HandModel.kinematics": (MODEL.kinematics().default_shape, MODEL.kinematics(dtype=asked).default_shape),
        "HandModel.prior": (
            MODEL.prior().energy(POSE.float()),
            MODEL.prior(dtype=asked).energy(POSE),
        ),
    }
    for name, (plain, wanted) in made.items():
        assert {one.dtype for one in numbers(plain)} == {torch.float32}, name
        assert {one.dtype for one in numbers(wanted)} == {asked}, name


def test_filters_of_a_tracker_are_float64() -> None:
    """Whatever the hand is that it is given, and within autocast."""
    tracker = Tracker(MODEL.hand(), CAMERA, settings_of("contour_full"))
    view = View(image=torch.zeros(48, 64, 3, dtype=torch.uint8))
    with torch.autocast("cpu", dtype=torch.bfloat16):
        state, _ = tracker.step(None, [view], 0.0)
    assert tracker.parts.kinematics.default_levers.dtype == torch.float64
    assert {one.dtype for one in numbers(state) if one.numel() > 1} <= {torch.float64}


def test_what_a_network_gives_under_autocast_is_promoted() -> None:
    network = torch.nn.Linear(4, 36)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        pose = network(torch.zeros(2, 4))
        assert pose.dtype == torch.bfloat16
        state = hand(torch.float32)(pose)
        energy = prior(torch.float32).energy(pose)
    assert torch.equal(state.vertices, hand(torch.float32)(pose.float()).vertices)
    energy.sum().backward()
    assert network.bias.grad is not None
    assert bool(network.bias.grad.isfinite().all())
    with pytest.raises(ValueError, match=r"pose: expected torch.float32, in which the hand computes, got torch.bfl"):
        hand(torch.float32)(pose)


@pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")  # of torch itself
def test_a_record_is_mapped_over() -> None:
    """Leaves have the mapped dimension, constants do not; derivatives come in the same record."""
    exact = hand(torch.float64)
    mapped, expected = torch.vmap(exact)(POSE), exact(POSE)
    assert isinstance(mapped, h.HandState)
    for one, other in zip(numbers(mapped.primitives), numbers(expected.primitives), strict=True):
        torch.testing.assert_close(one, other.expand_as(one), atol=1e-14, rtol=0)
    torch.testing.assert_close(mapped.vertices, expected.vertices, atol=1e-14, rtol=0)
    assert mapped.faces is expected.faces
    both = torch.vmap(lambda pose, state: pose[0] * state.keypoints, in_dims=(0, 0))(POSE, mapped)
    torch.testing.assert_close(both, POSE[:, :1, None] * expected.keypoints, atol=1e-14, rtol=0)
    slopes = torch.func.jacrev(lambda pose: exact(pose).frames)(POSE[0])
    rates: Any = torch.func.jvp(exact, (POSE[0],), (POSE[1],))[1]
    assert isinstance(slopes, h.HandFrames)
    assert isinstance(rates, h.HandState)
    torch.testing.assert_close(rates.frames.rotation, slopes.rotation @ POSE[1], atol=1e-12, rtol=0)


def test_records_of_other_constants_are_not_alike() -> None:
    specs = [tree_structure(hand(torch.float64)(POSE)) for _ in range(2)]
    assert specs[0] == specs[1]
    other = tree_structure(torchhand.Hand(side="left", dtype=torch.float64)(POSE))
    assert specs[0] != other


def test_the_line_names_what_was_given() -> None:
    @own_precision
    def combined(one: Tensor, other: Tensor, *, third: Tensor | None = None) -> Tensor:
        return one + other

    one, other = torch.zeros(2), torch.zeros(2, dtype=torch.float64)
    with pytest.raises(ValueError, match=r"^other: expected torch.float32, that of one, got torch.float64$"):
        combined(one, other)
    with pytest.raises(ValueError, match=r"^third: expected torch.float32, that of one, got torch.float64$"):
        combined(one, one, third=other)
    assert combined(one, torch.ones(2, dtype=torch.int64)).dtype == torch.float32
    with pytest.raises(ValueError, match=r"^dtype: expected torch.float32 or torch.float64, got torch.int64$"):
        require_exact("dtype", torch.int64)
    assert list(inspect.signature(combined).parameters) == ["one", "other", "third"]
    assert callable(record())
