"""The module `Hand`: against a plain loop of linear blend skinning, its derivatives, its state, what it refuses."""

import copy
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from torchhand.geometry import rotation_from_vector
from torchhand.hand.hand import Hand, HandState
from torchhand.hand.kinematics import JOINT_DOFS
from torchhand.hand.model import HandModel
from torchhand.hand.primitives import place_primitives, primitive_sizes

SIDES = ("right", "left")
MIRROR = torch.tensor((1.0, 1.0, -1.0), dtype=torch.float64)
TORCH_SCRIPTS = pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")
"""torch itself scripts the decompositions that forward mode under vmap needs."""


def _hand(model: HandModel, side: str = "right", dtype: torch.dtype = torch.float64) -> Hand:
    return model.hand(side="left" if side == "left" else "right", dtype=dtype)


def _pose(generator: torch.Generator, *batch: int) -> Tensor:
    return 0.7 * torch.randn(*batch, 36, generator=generator, dtype=torch.float64)


def _shape(model: HandModel, generator: torch.Generator, *batch: int) -> Tensor:
    default = model.shape_space.default
    return default * (1 + 0.05 * torch.randn(*batch, len(default), generator=generator, dtype=torch.float64))


def plain_vertices(model: HandModel, side: str, pose: Tensor, shape: Tensor, reference: Tensor) -> Tensor:
    """The specification: one hand, one vertex, one bone after the other."""
    mesh, space = model.mesh, model.shape_space
    assert mesh is not None
    flip = torch.eye(3, dtype=pose.dtype) if side == "right" else torch.diag(MIRROR)
    right = model.kinematics("right", dtype=torch.float64)
    # A left hand is the right one before a mirror that turns with the root.
    fixed = torch.cat((torch.zeros(6, dtype=pose.dtype), pose[6:]))
    now, bind = right(fixed, shape), right(mesh.bind_pose, shape)
    metres, default = space.metres(shape), space.metres(space.default)
    breadth = space.names.index("hand_breadth")
    vertices = []
    for v in range(len(mesh.vertices)):
        at_rest = mesh.vertices[v] + mesh.shape_basis[v] @ (metres - default)
        posed = torch.zeros(3, dtype=pose.dtype)
        for bone, weight in zip(mesh.skin_bones[v].tolist(), mesh.skin_weights[v], strict=True):
            in_bone = bind.rotation[bone].T @ (at_rest - bind.position[bone])
            posed = posed + weight * (now.rotation[bone] @ in_bone + now.position[bone])
        for c, dof in enumerate(mesh.corrective_dofs):
            angle = pose[6 + dof] - mesh.bind_pose[6 + dof]
            offset = mesh.corrective_basis[v, :, c, 0] * angle.sin() + mesh.corrective_basis[v, :, c, 1] * (
                1 - angle.cos()
            )
            scale = metres[breadth] / default[breadth]
            posed = posed + now.rotation[model.skeleton.bone[dof]] @ offset * scale
        vertices.append(rotation_from_vector(pose[3:6]) @ reference @ flip @ posed + pose[:3])
    return torch.stack(vertices)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_vertices_equal_the_plain_loop(
    side: str, batch: tuple[int, ...], small_model: HandModel, generator: torch.Generator
) -> None:
    """With a shape for every hand, and with one for all."""
    hand, pose = _hand(small_model, side), _pose(generator, *batch)
    reference = rotation_from_vector(torch.randn(*batch, 3, generator=generator, dtype=torch.float64))
    for shape in (_shape(small_model, generator, *batch), _shape(small_model, generator)):
        vertices = hand(pose, shape, root_reference=reference).vertices
        shapes = shape.expand(*batch, -1).reshape(-1, shape.shape[-1])
        rows = zip(pose.reshape(-1, 36), shapes, reference.reshape(-1, 3, 3), strict=True)
        loop = torch.stack([plain_vertices(small_model, side, *row) for row in rows]).reshape(vertices.shape)
        torch.testing.assert_close(vertices, loop, atol=1e-13, rtol=0)


def test_shapes_and_poses_broadcast(small_model: HandModel, generator: torch.Generator) -> None:
    hand = _hand(small_model)
    poses, shapes = _pose(generator, 3), _shape(small_model, generator, 2, 1)
    both = hand(poses, shapes)
    assert both.vertices.shape == (2, 3, 24, 3)
    for i in range(2):
        alone = hand(poses, shapes[i, 0])
        for name in ("vertices", "keypoints"):
            torch.testing.assert_close(getattr(both, name)[i], getattr(alone, name), atol=1e-14, rtol=0)
        torch.testing.assert_close(both.primitives.position[i], alone.primitives.position, atol=1e-14, rtol=0)
    one_pose = hand(poses[0], shapes[:, 0])
    torch.testing.assert_close(one_pose.vertices, both.vertices[:, 0], atol=1e-14, rtol=0)
    one_shape = hand(poses, shapes[:1, 0])
    torch.testing.assert_close(one_shape.vertices, both.vertices[0], atol=1e-14, rtol=0)


def test_at_the_bind_pose_the_mesh_is_itself(small_model: HandModel, generator: torch.Generator) -> None:
    mesh, space = small_model.mesh, small_model.shape_space
    assert mesh is not None
    shape = _shape(small_model, generator)
    change = space.metres(shape) - space.metres(space.default)
    vertices = _hand(small_model)(mesh.bind_pose, shape).vertices
    torch.testing.assert_close(vertices, mesh.vertices + mesh.shape_basis @ change, atol=1e-14, rtol=0)


def test_a_left_hand_is_the_exact_mirror(small_model: HandModel, generator: torch.Generator) -> None:
    pose, shape = _pose(generator, 4), _shape(small_model, generator, 4)
    pose[:, :6] = 0
    for given in (shape, shape[0]):
        right, left = (_hand(small_model, side)(pose, given) for side in SIDES)
        torch.testing.assert_close(left.vertices, right.vertices * MIRROR, atol=1e-15, rtol=0)
        torch.testing.assert_close(left.keypoints, right.keypoints * MIRROR, atol=1e-15, rtol=0)
        torch.testing.assert_close(left.primitives.position, right.primitives.position * MIRROR, atol=1e-15, rtol=0)
    # A mirror turns surfaces inside out, and the faces turn them back.
    assert torch.equal(left.faces, right.faces[:, [0, 2, 1]])


def test_frames_and_primitives_are_those_of_the_kinematics(small_model: HandModel, generator: torch.Generator) -> None:
    for side in SIDES:
        hand, pose, shape = _hand(small_model, side), _pose(generator, 2), _shape(small_model, generator)
        state, frames = hand(pose, shape), small_model.kinematics(hand.side, dtype=torch.float64)(pose, shape)
        assert torch.equal(state.frames.rotation, frames.rotation)
        assert torch.equal(state.keypoints, frames.keypoints)
        expected = place_primitives(frames, primitive_sizes(hand.shape_space, shape), is_left=side == "left")
        assert torch.equal(state.primitives.position, expected.position)
        assert torch.equal(state.primitives.rotation, expected.rotation)


# ------------------------------------------------------------------ the shape as state


def test_the_shape_is_the_default_one_or_the_given_one(small_model: HandModel, generator: torch.Generator) -> None:
    pose, shape = _pose(generator), _shape(small_model, generator)
    own, given = small_model.hand(shape, dtype=shape.dtype), _hand(small_model)
    torch.testing.assert_close(own(pose).vertices, given(pose, shape).vertices, atol=0, rtol=0)
    default = given(pose, small_model.shape_space.default)
    torch.testing.assert_close(given(pose).vertices, default.vertices, atol=0, rtol=0)


def test_the_shape_is_all_that_is_saved(small_model: HandModel, generator: torch.Generator) -> None:
    pose, shape = _pose(generator), _shape(small_model, generator)
    for saved in (small_model.hand(given, dtype=shape.dtype) for given in (shape, nn.Parameter(shape))):
        state = copy.deepcopy(saved.state_dict())
        assert list(state) == ["shape"]
        loaded = _hand(small_model)
        loaded.load_state_dict(state)
        assert torch.equal(loaded(pose).vertices, saved(pose).vertices)
        assert not torch.equal(loaded(pose).vertices, _hand(small_model)(pose).vertices)
    [parameter] = small_model.hand(nn.Parameter(shape), dtype=shape.dtype).parameters()
    assert parameter.shape == shape.shape
    assert not list(small_model.hand(shape).parameters())


def test_loading_does_not_change_the_model(small_model: HandModel) -> None:
    before = small_model.shape_space.default.clone()
    hand = _hand(small_model)
    hand.load_state_dict({"shape": 1.01 * before})
    assert torch.equal(small_model.shape_space.default, before)
    assert torch.equal(_hand(small_model).shape, before)


def test_a_parameter_is_fitted_by_an_optimiser(small_model: HandModel, generator: torch.Generator) -> None:
    """Nothing of an earlier call may be kept: every step makes its own graph."""
    pose, truth = _pose(generator, 6), _shape(small_model, generator)
    target = _hand(small_model)(pose, truth).vertices
    hand = small_model.hand(nn.Parameter(small_model.shape_space.default.clone()), dtype=torch.float64)
    optimiser = torch.optim.LBFGS(hand.parameters(), max_iter=60, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        value = 1e4 * (hand(pose).vertices - target).square().sum()
        value.backward()
        return value.detach()

    first = float(loss())
    optimiser.step(loss)
    assert float(loss()) < 1e-6 * first


def test_gradients_flow_to_a_tensor_given_as_shape(small_model: HandModel, generator: torch.Generator) -> None:
    shape = _shape(small_model, generator).requires_grad_()
    pose = _pose(generator)
    small_model.hand(shape, dtype=torch.float64)(pose).vertices.sum().backward()
    assert shape.grad is not None
    assert bool((shape.grad != 0).all())
    exact, shape.grad = shape.grad, None
    small_model.hand(shape)(pose.float()).vertices.sum().backward()  # float32 unless asked
    torch.testing.assert_close(shape.grad, exact, atol=1e-4, rtol=1e-4)


# ------------------------------------------------------------------ derivatives


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("start", [_pose, lambda *_: torch.zeros(36, dtype=torch.float64)])
def test_derivatives(
    side: str, start: Callable[[torch.Generator], Tensor], small_model: HandModel, generator: torch.Generator
) -> None:
    """To pose, shape and (through a rotation vector) the root's reference, of all that a state holds."""
    hand = _hand(small_model, side)
    vector = torch.randn(3, generator=generator, dtype=torch.float64).requires_grad_()

    def everything(pose: Tensor, shape: Tensor, vector: Tensor) -> Tensor:
        state = hand(pose, shape, root_reference=rotation_from_vector(vector))
        parts = (state.vertices, state.keypoints, state.frames.rotation, state.primitives.position)
        return torch.cat([part.flatten() for part in parts])

    pose, shape = start(generator).requires_grad_(), _shape(small_model, generator).requires_grad_()
    assert torch.autograd.gradcheck(everything, (pose, shape, vector), fast_mode=True)
    slow = (pose, shape)
    assert torch.autograd.gradcheck(lambda pose, shape: hand(pose, shape).vertices[3:6], slow)


def test_derivatives_of_batches(small_model: HandModel, generator: torch.Generator) -> None:
    hand, pose = _hand(small_model), _pose(generator, 2).requires_grad_()
    for shape in (_shape(small_model, generator), _shape(small_model, generator, 2)):
        leaf = shape.requires_grad_()
        assert torch.autograd.gradcheck(lambda pose, shape: hand(pose, shape).vertices, (pose, leaf), fast_mode=True)


@TORCH_SCRIPTS
@pytest.mark.parametrize("batch", [(), (2,)])
def test_second_derivatives(batch: tuple[int, ...], small_model: HandModel, generator: torch.Generator) -> None:
    hand = _hand(small_model)

    def loss(pose: Tensor, shape: Tensor) -> Tensor:
        return (10 * hand(pose, shape).vertices[..., :3, :]).pow(3).sum()

    pose, shape = _pose(generator, *batch), _shape(small_model, generator, *batch)
    leaves = (pose.requires_grad_(), shape.requires_grad_())
    assert torch.autograd.gradgradcheck(loss, leaves, fast_mode=True)
    forward_over_reverse = torch.func.hessian(loss)(pose.detach(), shape.detach())
    reverse_twice = torch.autograd.functional.hessian(lambda pose: loss(pose, shape.detach()), pose.detach())
    torch.testing.assert_close(forward_over_reverse, reverse_twice, atol=1e-9, rtol=1e-9)


@TORCH_SCRIPTS
def test_transforms_of_torch_func(small_model: HandModel, generator: torch.Generator) -> None:
    """vmap, forward mode and reverse mode agree with plain autograd."""
    hand = _hand(small_model)
    poses, shapes = _pose(generator, 3), _shape(small_model, generator, 3)

    def points(pose: Tensor, shape: Tensor) -> Tensor:
        return hand(pose, shape).vertices

    for dims, arguments in (
        ((0, 0), (poses, shapes)),
        ((0, None), (poses, shapes[0])),
        ((None, 0), (poses[0], shapes)),
    ):
        expected = torch.stack([points(arguments[0].expand(3, 36)[i], arguments[1].expand(3, -1)[i]) for i in range(3)])
        torch.testing.assert_close(torch.vmap(points, dims)(*arguments), expected, atol=1e-14, rtol=0)
    of_pose, of_shape = torch.vmap(torch.func.jacfwd(points, (0, 1)))(poses, shapes)
    back_pose, back_shape = torch.vmap(torch.func.jacrev(points, (0, 1)))(poses, shapes)
    for i in range(3):
        expected = torch.autograd.functional.jacobian(points, (poses[i], shapes[i]))
        torch.testing.assert_close(of_pose[i], expected[0], atol=1e-14, rtol=0)
        torch.testing.assert_close(of_shape[i], expected[1], atol=1e-14, rtol=0)
    torch.testing.assert_close(back_pose, of_pose, atol=1e-14, rtol=0)
    torch.testing.assert_close(back_shape, of_shape, atol=1e-14, rtol=0)


@TORCH_SCRIPTS
def test_second_derivatives_of_any_two_modes(small_model: HandModel, generator: torch.Generator) -> None:
    """Forward over forward, too, which torch gets wrong without a word where a Function has a `jvp` of its own."""
    hand, pose, shape = _hand(small_model), _pose(generator), _shape(small_model, generator)

    def measured(pose: Tensor, shape: Tensor) -> Tensor:
        return hand(pose, shape).vertices[::50].square().sum()

    modes = (torch.func.jacfwd, torch.func.jacrev)
    expected = torch.autograd.functional.hessian(measured, (pose, shape))
    for outer in modes:
        for inner in modes:
            found = outer(inner(measured, (0, 1)), (0, 1))(pose, shape)
            for i in range(2):
                for j in range(2):
                    torch.testing.assert_close(found[i][j], expected[i][j], atol=1e-11, rtol=0)


# ------------------------------------------------------------------ precision


def test_float32_stays_close(small_model: HandModel, generator: torch.Generator) -> None:
    pose, shape = _pose(generator, 50), _shape(small_model, generator, 50)
    exact = _hand(small_model)
    for given in (shape, shape[0]):
        single = _hand(small_model, dtype=torch.float32)(pose.float(), given.float())
        assert single.vertices.dtype == torch.float32
        torch.testing.assert_close(single.vertices.double(), exact(pose, given).vertices, atol=5e-6, rtol=0)


def test_bfloat16_is_finite(small_model: HandModel, generator: torch.Generator) -> None:
    """At zero and elsewhere, forward and backward; within bfloat16's three digits of the exact hand."""
    hand = _hand(small_model, dtype=torch.bfloat16)
    pose = _pose(generator, 20)
    pose[0], pose[1, 3:6], pose[2, 3:6] = 0, 1e-4, 1e-6
    for shape in (_shape(small_model, generator), _shape(small_model, generator, 20)):
        leaves = [x.bfloat16().requires_grad_() for x in (pose, shape)]
        state: HandState = hand(*leaves)
        assert state.vertices.dtype == torch.bfloat16
        state.vertices.sum().backward()
        for found in (state.vertices, state.keypoints, state.frames.rotation, *(leaf.grad for leaf in leaves)):
            assert found is not None
            assert bool(found.isfinite().all())
        exact = _hand(small_model)(leaves[0].double(), leaves[1].double())
        torch.testing.assert_close(state.vertices.double(), exact.vertices, atol=0.03, rtol=0.03)


# ------------------------------------------------------------------ what it refuses


def test_wrong_dimensions_and_dtypes(small_model: HandModel) -> None:
    hand = _hand(small_model)
    # past the tests' own type checks
    forward = Hand.forward.__wrapped__.__wrapped__  # pyright: ignore[reportFunctionMemberAccess]
    pose = torch.zeros(36, dtype=torch.float64)
    with pytest.raises(ValueError, match=r"pose: expected 36 numbers in the last dimension, got shape \(2, 35\)"):
        forward(hand, torch.zeros(2, 35, dtype=torch.float64))
    with pytest.raises(ValueError, match=r"shape: expected \d+ numbers in the last dimension, got shape \(3,\)"):
        forward(hand, pose, torch.zeros(3, dtype=torch.float64))
    with pytest.raises(
        ValueError, match=r"pose: expected torch.float64, in which the hand computes, got torch.float32"
    ):
        hand(pose.float())
    with pytest.raises(ValueError, match=r"shape: expected \d+ numbers in the last dimension, got shape \(4,\)"):
        small_model.hand(torch.zeros(4))
    with pytest.raises(ValueError, match=r"dtype: expected torch.float32, that of the parameter"):
        small_model.hand(nn.Parameter(small_model.shape_space.default.float()), dtype=torch.float64)


def test_a_model_without_mesh_is_refused(small_model: HandModel) -> None:
    with pytest.raises(ValueError, match=r"model: expected one with a mesh, 'generic_hand' has none"):
        replace(small_model, mesh=None).hand()


def test_a_shape_outside_its_bounds_is_named(small_model: HandModel) -> None:
    space = small_model.shape_space
    shape = space.default.repeat(2, 1)
    shape[1, space.names.index("hand_length")] = 0.5
    with pytest.raises(ValueError, match=r"shape: hand_length: expected 0\.\d+ to 0\.\d+ m, got 0.5"):
        small_model.hand(shape)
    hand = _hand(small_model)
    with pytest.raises(ValueError, match="shape: hand_length"):
        hand.check(shape=shape)
    shape[1, 3] = torch.nan
    with pytest.raises(ValueError, match=f"shape: {space.names[3]}: expected finite numbers, got nan"):
        small_model.hand(shape)
    for bound in (space.lower, space.upper):
        small_model.hand(bound.float())  # rounding is no violation


def test_a_pose_that_is_not_finite_is_named_by_check_and_goes_through_forward(small_model: HandModel) -> None:
    hand, pose = _hand(small_model), torch.zeros(3, 36, dtype=torch.float64)
    pose[1, 6 + JOINT_DOFS.index("index_pip_fe")] = torch.inf
    with pytest.raises(ValueError, match="pose: index_pip_fe: expected finite numbers, got inf"):
        hand.check(pose)
    hand.check(pose[::2], hand.shape)
    vertices = hand(pose).vertices
    assert bool(vertices[::2].isfinite().all())
    assert bool(vertices[1].isnan().any())


def test_a_dtype_of_whole_numbers_is_refused(small_model: HandModel) -> None:
    with pytest.raises(ValueError, match="dtype: expected one of floating-point numbers"):
        small_model.hand(dtype=torch.int64)
