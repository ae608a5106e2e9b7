"""torch.compile without graph breaks, forward and backward: the same as eager mode.

Compilers cannot trace the tests' own type checks: these tests run in a call of their own with JAXTYPING_DISABLE=1.
"""

import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch._dynamo.testing import CompileCounter

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector
from torchhand.hand import Hand, HandState
from torchhand.hand.kinematics import Side, place_chain_plainly
from torchhand.losses import keypoint_loss, penetration_loss, prior_loss

pytestmark = [
    pytest.mark.skipif(
        not os.environ.get("JAXTYPING_DISABLE"), reason="needs JAXTYPING_DISABLE=1: compilers cannot trace type checks"
    ),
    # torch's own, on the way.
    pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf:UserWarning"),
    pytest.mark.filterwarnings("ignore:.*is deprecated:FutureWarning"),
    pytest.mark.filterwarnings("ignore:.*is deprecated:DeprecationWarning"),
]
HAS_COMPILER = any(shutil.which(name) for name in (os.environ.get("CXX") or "g++", "g++", "clang++"))
NEEDS_COMPILER = pytest.mark.skipif(not HAS_COMPILER, reason="needs a C++ compiler (g++), which was not found")


@pytest.fixture(autouse=True)
def _fresh_compiler() -> Iterator[None]:
    torch._dynamo.reset()
    yield
    torch._dynamo.reset()


def _inputs(hand: Hand, generator: torch.Generator, *batch: int) -> tuple[Tensor, Tensor]:
    pose = 0.5 * torch.randn(*batch, 36, generator=generator, dtype=torch.float64)
    noise = torch.randn(*batch, len(hand.shape), generator=generator, dtype=torch.float64)
    return pose, hand.shape * (1 + 0.03 * noise)


def _loss(state: HandState) -> Tensor:
    return state.vertices.square().sum() + state.keypoints[..., 0].sum() + state.frames.rotation[..., 1, :].sum()


def _check(hand: Hand, backend: str, pose: Tensor, shape: Tensor | None, **options: Any) -> None:
    """Outputs and gradients of the compiled hand are those of the eager one."""
    compiled = torch.compile(hand, fullgraph=True, backend=backend)
    leaves = [x.detach().requires_grad_() for x in (pose, shape) if x is not None]
    found, expected = compiled(*leaves, **options), hand(*leaves, **options)
    torch.testing.assert_close(found.vertices, expected.vertices, atol=1e-13, rtol=0)
    torch.testing.assert_close(found.keypoints, expected.keypoints, atol=1e-13, rtol=0)
    torch.testing.assert_close(found.frames.rotation, expected.frames.rotation, atol=1e-13, rtol=0)
    of_found, of_expected = (torch.autograd.grad(_loss(state), leaves) for state in (found, expected))
    for one, other in zip(of_found, of_expected, strict=True):
        torch.testing.assert_close(one, other, atol=1e-10, rtol=1e-10)


@pytest.mark.parametrize(
    ("backend", "has_shapes"),
    [("aot_eager", False), ("aot_eager", True), pytest.param("inductor", False, marks=NEEDS_COMPILER)],
)
def test_compiled_equals_eager(backend: str, has_shapes: bool, generator: torch.Generator) -> None:
    """With one shape for all, and with a shape for every hand; one pose is zero."""
    hand = load_hand_model().hand(dtype=torch.float64)
    pose, shape = _inputs(hand, generator, 3)
    pose[0] = 0
    _check(hand, backend, pose, shape if has_shapes else None)


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_compiled_with_any_batch_and_a_reference(batch: tuple[int, ...], generator: torch.Generator) -> None:
    hand = load_hand_model().hand(side="left", dtype=torch.float64)
    pose, _ = _inputs(hand, generator, *batch)
    reference = rotation_from_vector(torch.randn(*batch, 3, generator=generator, dtype=torch.float64))
    _check(hand, "aot_eager", pose, None, root_reference=reference)


def test_compiled_at_once_for_every_batch_size(generator: torch.Generator) -> None:
    """One graph with a symbolic batch."""
    hand = load_hand_model().hand(dtype=torch.float64)
    counter = CompileCounter()
    compiled = torch.compile(hand, fullgraph=True, dynamic=True, backend=counter)
    for count in (5, 2, 9):
        pose, _ = _inputs(hand, generator, count)
        torch.testing.assert_close(compiled(pose).vertices, hand(pose).vertices, atol=1e-13, rtol=0)
    assert counter.frame_count == 1


def test_transforms_can_be_compiled(generator: torch.Generator) -> None:
    hand = load_hand_model().hand(dtype=torch.float64)
    pose, _ = _inputs(hand, generator, 2)

    def points(pose: Tensor) -> Tensor:
        return hand(pose).keypoints

    for function in (torch.vmap(points), torch.vmap(torch.func.jacrev(points))):
        found = torch.compile(function, fullgraph=True, backend="aot_eager")(pose)
        torch.testing.assert_close(found, function(pose), atol=1e-12, rtol=0)


@pytest.mark.parametrize(("side", "distortion"), [("right", ()), ("left", (0.1, -0.05, 0.001, 0.002))])
def test_losses_can_be_compiled(side: Side, distortion: tuple[float, ...], generator: torch.Generator) -> None:
    """What a network learns from, of hands seen by one camera with a lens or without, on pixels and on rays."""
    model = load_hand_model()
    hand, prior = model.hand(side=side, dtype=torch.float64), model.prior(dtype=torch.float64)
    camera = replace(assumed_camera(64, 48), distortion=torch.tensor(distortion, dtype=torch.float64))
    pose, shape = _inputs(hand, generator, 3)
    pose[:, :3] = torch.tensor((0.0, 0.0, 0.5))
    target = camera.project(hand(pose + 0.05).keypoints)

    def loss(pose: Tensor, shape: Tensor) -> Tensor:
        state = hand(pose)
        pixels = camera.project(state.keypoints)
        misfit = keypoint_loss(pixels, target, std=2.0) + camera.plane_from_pixels(pixels).square().sum()
        return misfit + penetration_loss(state.primitives) + prior_loss(prior, pose, shape)

    compiled = torch.compile(loss, fullgraph=True, backend="eager")
    leaves = [x.detach().requires_grad_() for x in (pose, shape)]
    found, expected = compiled(*leaves), loss(*leaves)
    torch.testing.assert_close(found, expected, atol=0, rtol=1e-12)
    assert float(penetration_loss(hand(pose).primitives)) > 0
    of_found, of_expected = (torch.autograd.grad(x, leaves) for x in (found, expected))
    for one, other in zip(of_found, of_expected, strict=True):
        torch.testing.assert_close(one, other, atol=1e-9, rtol=1e-9)


def test_log_probabilities_can_be_compiled(generator: torch.Generator) -> None:
    """Also of hands that cannot be."""
    prior = load_hand_model().prior(dtype=torch.float64)
    poses, shapes = prior.sample(2, generator)
    poses = torch.cat((poses, poses + 0.5))
    compiled = torch.compile(prior.log_prob, fullgraph=True, backend="eager")
    expected = prior.log_prob(poses, shapes.repeat(2, 1))
    torch.testing.assert_close(compiled(poses, shapes.repeat(2, 1)), expected, atol=0, rtol=1e-12)
    assert expected.isfinite().tolist() == [True, True, False, False]


def test_one_graph_serves_cameras_with_a_lens_and_without(generator: torch.Generator) -> None:
    """The compiler is told no value of a coefficient: none may be taken for the next camera's."""
    counter = CompileCounter()
    compiled = torch.compile(Camera.project, fullgraph=True, backend=counter)
    points = torch.randn(5, 3, generator=generator, dtype=torch.float64) + torch.tensor((0.0, 0.0, 5.0))
    for factor in (0.0, 0.1):
        coefficients = torch.full((4,), factor, dtype=torch.float64)
        camera = replace(assumed_camera(64, 48), distortion=coefficients)
        torch.testing.assert_close(compiled(camera, points), camera.project(points), atol=1e-10, rtol=0)
    assert counter.frame_count == 1


@pytest.mark.parametrize("start", [lambda pose: pose, torch.zeros_like])
def test_plain_chain_has_right_derivatives(start: Callable[[Tensor], Tensor], generator: torch.Generator) -> None:
    """What exporters get, at zero too: against the chain with the derivative in closed form."""
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    pose = start(torch.randn(36, 2, generator=generator, dtype=torch.float64)).requires_grad_()
    levers = kinematics.default_levers.clone().requires_grad_()
    placed = place_chain_plainly(pose, None, levers, kinematics.chain.constants)
    frames = kinematics(pose.T)
    names = ("rotation", "position", "keypoints")
    for name, part in zip(names, placed, strict=True):
        torch.testing.assert_close(part.movedim(-1, 0), getattr(frames, name), atol=1e-14, rtol=0)
        [of_plain] = torch.autograd.grad(part.pow(3).sum(), pose, retain_graph=True)
        [expected] = torch.autograd.grad(getattr(frames, name).pow(3).sum(), pose, retain_graph=True)
        torch.testing.assert_close(of_plain, expected, atol=1e-12, rtol=0)


def test_compiled_within_autocast_is_in_float32(generator: torch.Generator) -> None:
    hand = load_hand_model().hand()
    pose = _inputs(hand, generator, 2)[0].float()
    compiled = torch.compile(hand, fullgraph=True, backend="aot_eager")
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = compiled(pose)
    torch.testing.assert_close(found.vertices, hand(pose).vertices, atol=1e-6, rtol=0)
