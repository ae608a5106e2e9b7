"""Kinematics against pytorch-kinematics, against a plain loop, and against the meaning of its angles."""

import math
from collections.abc import Callable

import pytest
import pytorch_kinematics
import torch
from torch import Tensor

from torchhand.files import load_hand_model, models_dir
from torchhand.geometry import rotation_from_vector
from torchhand.hand.kinematics.kinematics import HandFrames, HandKinematics
from torchhand.hand.kinematics.shape import bone_offsets
from torchhand.hand.kinematics.skeleton import BONES, DOFS, FINGERS, JOINT_DOFS, KEYPOINTS, PARENTS

SIDES = ("right", "left")
MIRROR = torch.tensor((1.0, 1.0, -1.0), dtype=torch.float64)
TIPS = (4, 8, 12, 16, 20)
TORCH_SCRIPTS = pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")
"""torch itself scripts the decompositions that forward mode under vmap needs."""


def _kinematics(side: str = "right", dtype: torch.dtype = torch.float64) -> HandKinematics:
    return load_hand_model().kinematics("left" if side == "left" else "right", dtype=dtype)


def _pose(generator: torch.Generator, *batch: int) -> Tensor:
    return 0.7 * torch.randn(*batch, len(DOFS), generator=generator, dtype=torch.float64)


def _shape(kinematics: HandKinematics, generator: torch.Generator, *batch: int) -> Tensor:
    noise = torch.randn(*batch, len(kinematics.default_shape), generator=generator, dtype=torch.float64)
    return kinematics.default_shape * (1 + 0.05 * noise)


def _flat(frames: HandFrames) -> Tensor:
    parts = (frames.rotation.flatten(-3), frames.position.flatten(-2), frames.keypoints.flatten(-2))
    return torch.cat(parts, -1)


def plain_kinematics(kinematics: HandKinematics, pose: Tensor, shape: Tensor, reference: Tensor) -> HandFrames:
    """The specification: one hand, one bone after the other, one Rodrigues rotation after the other."""
    skeleton = kinematics.skeleton
    offsets, tips = bone_offsets(kinematics.shape_space, shape, skeleton.rest_rotation[1:6])
    flip = torch.eye(3, dtype=pose.dtype) if kinematics.side == "right" else torch.diag(MIRROR)
    rotations, positions = [rotation_from_vector(pose[3:6]) @ reference @ flip], [pose[:3]]
    for bone in range(1, len(BONES)):
        parent = rotations[PARENTS[bone]]
        positions.append(parent @ offsets[bone] + positions[PARENTS[bone]])
        rotation = parent @ skeleton.rest_rotation[bone]
        own = [i for i in range(len(JOINT_DOFS)) if skeleton.bone[i] == bone]
        for i in sorted(own, key=lambda i: skeleton.order[i]):
            rotation = rotation @ rotation_from_vector(pose[6 + i] * skeleton.axis[i] / skeleton.axis[i].norm())
        rotations.append(rotation)
    last = [BONES.index(f"{finger}_distal") for finger in FINGERS]
    points = {
        f"{finger}_tip": rotations[b] @ tips[k] + positions[b]
        for k, (finger, b) in enumerate(zip(FINGERS, last, strict=True))
    }
    bone_of = {"cmc": "metacarpal", "pip": "middle", "dip": "distal", "ip": "distal", "mcp": "proximal"}
    keypoints = [positions[0]]
    for name in KEYPOINTS[1:]:
        finger, point = name.split("_")
        keypoints.append(points[name] if point == "tip" else positions[BONES.index(f"{finger}_{bone_of[point]}")])
    return HandFrames(
        rotation=torch.stack([rotation @ flip for rotation in rotations]),
        position=torch.stack(positions),
        keypoints=torch.stack(keypoints),
    )


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_the_plain_loop(side: str, batch: tuple[int, ...], generator: torch.Generator) -> None:
    kinematics = _kinematics(side)
    pose, shape = _pose(generator, *batch), _shape(kinematics, generator, *batch)
    reference = rotation_from_vector(torch.randn(*batch, 3, generator=generator, dtype=torch.float64))
    frames = kinematics(pose, shape, root_reference=reference)
    rows = zip(pose.reshape(-1, 36), shape.reshape(-1, shape.shape[-1]), reference.reshape(-1, 3, 3), strict=True)
    expected = [plain_kinematics(kinematics, *row) for row in rows]
    for name in ("rotation", "position", "keypoints"):
        actual = getattr(frames, name)
        loop = torch.stack([getattr(frame, name) for frame in expected]).reshape(actual.shape)
        torch.testing.assert_close(actual, loop, atol=1e-13, rtol=0)


def test_shared_shape_and_reference_equal_repeated_ones(generator: torch.Generator) -> None:
    kinematics = _kinematics()
    pose, shape = _pose(generator, 5), _shape(kinematics, generator)
    reference = rotation_from_vector(torch.randn(3, generator=generator, dtype=torch.float64))
    shared = kinematics(pose, shape, root_reference=reference)
    repeated = kinematics(pose, shape.expand(5, -1), root_reference=reference.expand(5, 3, 3))
    torch.testing.assert_close(_flat(shared), _flat(repeated), atol=1e-14, rtol=0)
    torch.testing.assert_close(
        _flat(kinematics(pose)), _flat(kinematics(pose, kinematics.default_shape)), atol=1e-14, rtol=0
    )


def test_agrees_with_pytorch_kinematics(generator: torch.Generator) -> None:
    """The library keeps constants in float32, so 1e-6 is all that can agree."""
    chain = pytorch_kinematics.build_chain_from_urdf((models_dir() / "generic_hand" / "hand.urdf").read_bytes())
    chain = chain.to(dtype=torch.float64)
    pose = _pose(generator, 20)
    pose[:, :6] = 0
    names = chain.get_joint_parameter_names()
    assert sorted(names) == sorted(JOINT_DOFS)
    places = chain.forward_kinematics(pose[:, [DOFS.index(name) for name in names]])
    frames = _kinematics()(pose)
    for bone, name in enumerate(BONES):
        matrix = places[name].get_matrix().expand(20, 4, 4)
        torch.testing.assert_close(frames.rotation[:, bone], matrix[:, :3, :3], atol=1e-6, rtol=0)
        torch.testing.assert_close(frames.position[:, bone], matrix[:, :3, 3], atol=1e-6, rtol=0)
    for finger, tip in zip(FINGERS, TIPS, strict=True):
        torch.testing.assert_close(
            frames.keypoints[:, tip], places[f"{finger}_tip"].get_matrix()[:, :3, 3], atol=1e-6, rtol=0
        )


def test_a_left_hand_is_the_exact_mirror(generator: torch.Generator) -> None:
    """z of the hand frame reversed: world_left = root · S · root⁻¹ world_right for the same pose numbers."""
    pose = _pose(generator, 4)
    pose[:, :6] = 0
    right, left = _kinematics("right")(pose), _kinematics("left")(pose)
    torch.testing.assert_close(left.keypoints, right.keypoints * MIRROR, atol=1e-15, rtol=0)
    torch.testing.assert_close(left.rotation, right.rotation * MIRROR[:, None] * MIRROR, atol=1e-15, rtol=0)


def test_root_pose_moves_the_whole_hand(generator: torch.Generator) -> None:
    for side in SIDES:
        kinematics, pose = _kinematics(side), _pose(generator)
        still = pose.clone()
        still[:6] = 0
        rotation = rotation_from_vector(pose[3:6])
        expected = kinematics(still).keypoints @ rotation.T + pose[:3]
        torch.testing.assert_close(kinematics(pose).keypoints, expected, atol=1e-14, rtol=0)


@pytest.mark.parametrize("side", SIDES)
def test_flexion_brings_fingertips_to_the_palm(side: str) -> None:
    """x points out of the back of the hand of either side: a flexing finger goes to -x."""
    kinematics = _kinematics(side)
    for finger, tip in list(zip(FINGERS, TIPS, strict=True))[1:]:
        for joint in ("cmc_fe", "mcp_fe", "pip_fe", "dip_fe"):
            pose = torch.zeros(2, 36, dtype=torch.float64)
            pose[1, DOFS.index(f"{finger}_{joint}")] = 0.3
            still, moved = kinematics(pose).keypoints[:, tip]
            assert float(moved[0] - still[0]) < -2e-3, (finger, joint)
            assert float(moved[1] - still[1]) < 0, (finger, joint)


@pytest.mark.parametrize("side", SIDES)
def test_thumb_flexion_crosses_the_palm(side: str) -> None:
    kinematics = _kinematics(side)
    towards_little = -1.0 if side == "right" else 1.0
    for dof in ("thumb_cmc_fe", "thumb_mcp_fe", "thumb_ip_fe"):
        pose = torch.zeros(2, 36, dtype=torch.float64)
        pose[1, DOFS.index(dof)] = 0.3
        still, moved = kinematics(pose).keypoints[:, 4]
        assert towards_little * float(moved[2] - still[2]) > 2e-3, dof


@pytest.mark.parametrize("side", SIDES)
def test_abduction_spreads_away_from_the_middle_finger(side: str) -> None:
    """Towards the thumb's side (+z, right hand) for thumb, index and the middle finger itself, else away from it."""
    kinematics = _kinematics(side)
    for finger, tip in zip(FINGERS, TIPS, strict=True):
        radial = -1.0 if finger in ("ring", "little") else 1.0
        handed = 1.0 if side == "right" else -1.0
        pose = torch.zeros(2, 36, dtype=torch.float64)
        pose[1, DOFS.index("thumb_cmc_aa" if finger == "thumb" else f"{finger}_mcp_aa")] = 0.2
        still, moved = kinematics(pose).keypoints[:, tip]
        assert radial * handed * float(moved[2] - still[2]) > 5e-3, finger


def test_twist_leaves_a_straight_finger_in_place() -> None:
    pose = torch.zeros(2, 36, dtype=torch.float64)
    pose[1, [DOFS.index(f"{finger}_mcp_tw") for finger in FINGERS[1:]]] = 0.5
    still, moved = _kinematics()(pose).keypoints
    torch.testing.assert_close(moved, still, atol=1e-9, rtol=0)


@pytest.mark.parametrize("angle", [0.0, 10.0, 35.0, 90.0])
def test_angles_are_angles_between_bones(angle: float) -> None:
    """A hinge's angle is the angle between the bones that meet in it."""
    for finger in FINGERS[1:]:
        pose = torch.zeros(36, dtype=torch.float64)
        pose[DOFS.index(f"{finger}_pip_fe")] = math.radians(angle)
        points = _kinematics()(pose).keypoints
        first = 1 + 4 * FINGERS.index(finger)
        before, after = points[first + 1] - points[first], points[first + 2] - points[first + 1]
        cosine = float((before @ after) / (before.norm() * after.norm()))
        assert math.degrees(math.acos(min(1.0, cosine))) == pytest.approx(angle, abs=1e-4)


def _near_zero(generator: torch.Generator) -> Tensor:
    return 1e-6 * _pose(generator)


@pytest.mark.parametrize(
    ("side", "start"),
    [
        ("right", _pose),
        ("left", _pose),
        ("right", lambda _: torch.zeros(36, dtype=torch.float64)),
        ("left", _near_zero),
    ],
)
def test_derivatives(side: str, start: Callable[[torch.Generator], Tensor], generator: torch.Generator) -> None:
    """To pose, shape and (through a rotation vector) the root's reference; of random sums of all outputs, as many as
    there are pose parameters."""
    kinematics = _kinematics(side)
    pose, shape = start(generator).requires_grad_(), _shape(kinematics, generator).requires_grad_()
    vector = torch.randn(3, generator=generator, dtype=torch.float64).requires_grad_()

    def everything(pose: Tensor, shape: Tensor, vector: Tensor) -> Tensor:
        outputs = _flat(kinematics(pose, shape, root_reference=rotation_from_vector(vector)))
        seeded = torch.Generator().manual_seed(1)
        return torch.randn(36, len(outputs), generator=seeded, dtype=torch.float64) @ outputs

    assert torch.autograd.gradcheck(everything, (pose, shape, vector))


def test_derivatives_of_batches(generator: torch.Generator) -> None:
    """A shape per hand, and one for all."""
    kinematics = _kinematics()
    pose = _pose(generator, 2).requires_grad_()
    for shape in (_shape(kinematics, generator), _shape(kinematics, generator, 2)):
        leaf = shape.detach().requires_grad_()
        assert torch.autograd.gradcheck(
            lambda pose, shape: kinematics(pose, shape).keypoints, (pose, leaf), fast_mode=True
        )


def test_derivatives_of_single_outputs(generator: torch.Generator) -> None:
    """What is not used must not be needed."""
    kinematics, pose = _kinematics(), _pose(generator).requires_grad_()
    for name in ("rotation", "position", "keypoints"):
        assert torch.autograd.gradcheck(lambda pose, name=name: getattr(kinematics(pose), name), (pose,))


@TORCH_SCRIPTS
def test_second_derivatives(generator: torch.Generator) -> None:
    kinematics = _kinematics("left")
    for pose in (_pose(generator), torch.zeros(36, dtype=torch.float64)):
        leaf = pose.requires_grad_()
        assert torch.autograd.gradgradcheck(lambda pose: kinematics(pose).keypoints[[4, 16]], (leaf,))
    shape = _shape(kinematics, generator)

    def loss(pose: Tensor, shape: Tensor) -> Tensor:
        return (_flat(kinematics(pose, shape)) ** 3).sum()

    pose = _pose(generator)
    forward_over_reverse = torch.func.hessian(loss, argnums=(0, 1))(pose, shape)
    reverse_twice = torch.autograd.functional.hessian(loss, (pose, shape))
    for row, other in zip(forward_over_reverse, reverse_twice, strict=True):
        for block, expected in zip(row, other, strict=True):
            torch.testing.assert_close(block, expected, atol=1e-11, rtol=0)


@TORCH_SCRIPTS
def test_transforms_of_torch_func(generator: torch.Generator) -> None:
    """vmap, forward mode and reverse mode agree with plain autograd, nested either way."""
    kinematics = _kinematics()
    poses, shape = _pose(generator, 3), _shape(kinematics, generator)
    shapes = _shape(kinematics, generator, 3)

    def points(pose: Tensor, shape: Tensor) -> Tensor:
        return kinematics(pose, shape).keypoints

    torch.testing.assert_close(torch.vmap(points)(poses, shapes), kinematics(poses, shapes).keypoints)
    torch.testing.assert_close(torch.vmap(points, (0, None))(poses, shape), kinematics(poses, shape).keypoints)
    torch.testing.assert_close(torch.vmap(points, (None, 0))(poses[0], shapes), points(poses[:1].expand(3, 36), shapes))
    of_pose, of_shape = torch.vmap(torch.func.jacfwd(points, (0, 1)))(poses, shapes)
    back_pose, back_shape = torch.vmap(torch.func.jacrev(points, (0, 1)))(poses, shapes)
    for i in range(3):
        expected = torch.autograd.functional.jacobian(points, (poses[i], shapes[i]))
        torch.testing.assert_close(of_pose[i], expected[0], atol=1e-14, rtol=0)
        torch.testing.assert_close(of_shape[i], expected[1], atol=1e-14, rtol=0)
    torch.testing.assert_close(back_pose, of_pose, atol=1e-14, rtol=0)
    torch.testing.assert_close(back_shape, of_shape, atol=1e-14, rtol=0)


def test_float32_stays_close(generator: torch.Generator) -> None:
    pose = _pose(generator, 50)
    single = _kinematics(dtype=torch.float32)(pose.float())
    assert single.keypoints.dtype == torch.float32
    torch.testing.assert_close(single.keypoints.double(), _kinematics()(pose).keypoints, atol=2e-6, rtol=0)


def test_what_it_refuses() -> None:
    model = load_hand_model()
    kinematics = _kinematics()
    with pytest.raises(ValueError, match=r"pose: expected 36 numbers in the last dimension, got shape \(35,\)"):
        HandKinematics.forward.__wrapped__.__wrapped__(kinematics, torch.zeros(35, dtype=torch.float64))  # pyright: ignore
    with pytest.raises(ValueError, match=r"shape: expected \d+ numbers in the last dimension, got shape \(3,\)"):
        kinematics(torch.zeros(36, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))
    with pytest.raises(ValueError, match="side: expected 'left' or 'right', got 'up'"):
        HandKinematics.__init__.__wrapped__(kinematics, model.skeleton, model.shape_space, "up")  # pyright: ignore


@pytest.mark.parametrize("side", SIDES)
def test_one_hand_without_derivatives_is_what_it_is_among_others(side: str, generator: torch.Generator) -> None:
    kinematics = _kinematics(side)
    pose, shape = _pose(generator, 3), _shape(kinematics, generator)
    reference = rotation_from_vector(torch.randn(3, 3, generator=generator, dtype=torch.float64))
    with torch.inference_mode():
        together = _flat(kinematics(pose, shape, root_reference=reference))
        for row, own, turned in zip(together, pose, reference, strict=True):
            for one in (
                kinematics(own, shape, root_reference=turned),
                kinematics(own[None], shape, root_reference=turned),
            ):
                torch.testing.assert_close(_flat(one).reshape(-1), row, rtol=0, atol=1e-14)
