"""Derivatives of the 21 keypoints in closed form: in the pose, in a pose space, in the shape.

Pose: an angle moves every keypoint beyond its joint by axis × lever, all others not at all; the root's rotation vector
turns about the columns of its left Jacobian. Shape: keypoints are linear in the parameters in metres. Only the entries
that can differ from zero are computed.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import batch_last, cross, left_jacobian, turn
from torchhand.hand.kinematics.constants import LEVER_ENDS
from torchhand.hand.kinematics.joint_rotations import world_axes
from torchhand.hand.kinematics.kinematics import HandFrames, HandKinematics
from torchhand.hand.kinematics.skeleton import BONES, DOFS, KEYPOINTS, PARENTS, ROOT_DOFS
from torchhand.precision import own_precision

_POINTS = len(KEYPOINTS)
_ROOT = len(ROOT_DOFS)
_JOINTS = {"cmc": "metacarpal", "mcp": "proximal", "pip": "middle", "dip": "distal", "ip": "distal", "tip": "distal"}


def _bone_of(keypoint: str) -> int:
    """The bone that carries a keypoint: at its origin, or at its end for a fingertip."""
    if keypoint == "wrist":
        return 0
    finger, point = keypoint.split("_")
    return BONES.index(f"{finger}_{_JOINTS[point]}")


def _chain_to(bone: int) -> tuple[int, ...]:
    """The bone and its ancestors, the wrist last."""
    return (bone,) if bone == 0 else (bone, *_chain_to(PARENTS[bone]))


def _moved_by(bone: int) -> tuple[int, ...]:
    """Keypoints that turn with a bone about its origin; the one at the origin stays."""
    turning = [i for i, name in enumerate(KEYPOINTS) if bone in _chain_to(_bone_of(name))]
    return tuple(i for i in turning if _bone_of(KEYPOINTS[i]) != bone or KEYPOINTS[i].endswith("tip"))


KEYPOINT_BONES = tuple(
    _bone_of(name) if name == "wrist" or name.endswith("tip") else PARENTS[_bone_of(name)] for name in KEYPOINTS
)
"""The bone that each keypoint is the end of: all that moves the keypoint moves that bone."""


class PoseJacobian:
    """d keypoints / d free for pose = basis · free + constant, with all that does not change multiplied out once.

    basis: (36, free), such as that of a PoseSpace; the 36 DOFs themselves where it is None. Not differentiable in it.
    """

    def __init__(self, kinematics: HandKinematics, basis: Float[Tensor, "36 free"] | None = None) -> None:
        like = kinematics.default_levers
        known = torch.eye(len(DOFS), dtype=like.dtype) if basis is None else basis.detach().to(like).cpu()
        basis = known.to(like)
        self.free = basis.shape[1]
        self._constants = kinematics.chain.constants
        skeleton = kinematics.skeleton
        pairs: list[tuple[int, int]] = []  # keypoint, joint angle
        places: list[int] = []
        entries: list[tuple[int, float]] = []  # pair, factor
        for angle, bone in enumerate(skeleton.bone):
            columns = [(j, factor) for j, factor in enumerate(known[_ROOT + angle].tolist()) if factor]
            for point in _moved_by(bone) if columns else ():
                for column, factor in columns:
                    places += [(3 * point + i) * self.free + column for i in range(3)]
                    entries.append((len(pairs), factor))
                pairs.append((point, angle))

        def index(values: list[int]) -> Tensor:
            return torch.tensor(values, dtype=torch.int64, device=like.device)

        self._points = index([point for point, _ in pairs])
        self._angles = index([angle for _, angle in pairs])
        self._bones = index([skeleton.bone[angle] for _, angle in pairs])
        self._places = index(places)
        self._entries = index([pair for pair, _ in entries])
        self._factors = like.new_tensor([factor for _, factor in entries])[:, None, None]
        self._is_selection = len(entries) == len(pairs) and len(set(places)) == len(places)
        self._is_unscaled = all(factor == 1 for _, factor in entries)
        self._root = basis[:_ROOT]
        self._root_columns = known[:_ROOT].any(0).nonzero()[:, 0].to(like.device)

    @own_precision
    def __call__(self, pose: Float[Tensor, "*batch 36"], frames: HandFrames) -> Float[Tensor, "*batch 21 3 free"]:
        """pose: the one that `frames` belong to. Metres per radian (root translations: per metre)."""
        batch = pose.shape[:-1]
        flat = pose.reshape(-1, len(DOFS))
        rotation, position, keypoints = (
            batch_last(x, own, batch) for x, own in ((frames.rotation, 3), (frames.position, 2), (frames.keypoints, 2))
        )
        columns = self.batch_last(flat.T, rotation, position, keypoints)
        return columns.permute(3, 0, 1, 2).reshape(*batch, _POINTS, 3, self.free)

    @own_precision
    def batch_last(
        self,
        pose: Float[Tensor, "36 n"],
        rotation: Float[Tensor, "20 3 3 n"],
        position: Float[Tensor, "20 3 n"],
        keypoints: Float[Tensor, "21 3 n"],
    ) -> Float[Tensor, "21 3 free n"]:
        """The derivative with the batch last, as the memory of HandFrames has it."""
        count = pose.shape[-1]
        axes = world_axes(pose, rotation, self._constants).index_select(0, self._angles)
        levers = keypoints.index_select(0, self._points) - position.index_select(0, self._bones)
        moved = cross(axes, levers)
        if not self._is_selection:
            moved = moved.index_select(0, self._entries)
        if not self._is_unscaled:
            moved = moved * self._factors
        out = pose.new_zeros(3 * _POINTS * self.free, count)
        out = (out.index_copy if self._is_selection else out.index_add)(0, self._places, moved.flatten(0, 1))
        out = out.unflatten(0, (_POINTS, 3, self.free))
        if not len(self._root_columns):
            return out
        return out.index_add(2, self._root_columns, self._root_part(pose, position, keypoints))

    def _root_part(self, pose: Tensor, position: Tensor, keypoints: Tensor) -> Float[Tensor, "21 3 columns n"]:
        spin = left_jacobian(pose[3:6].T).permute(1, 2, 0)  # angular velocity per rotation vector: 3 3 n
        root = self._root.index_select(1, self._root_columns)
        shift = (root[:3]).expand(_POINTS, 3, -1)[..., None]
        about = torch.einsum("ikn,kc->icn", spin, root[3:])
        lever = keypoints - position[:1]
        return shift + cross(about[None], lever[:, :, None])


def keypoint_jacobian(
    kinematics: HandKinematics,
    pose: Float[Tensor, "*batch 36"],
    frames: HandFrames,
    *,
    basis: Float[Tensor, "36 free"] | None = None,
) -> Float[Tensor, "*batch 21 3 free"]:
    """Derivative of the keypoints in the pose, or in the parameters of the pose space with that basis.

    frames: `kinematics(pose, ...)`, of any shape and root reference (the rotation vector is its left perturbation).
    Where it is wanted often, keep a `PoseJacobian`.
    """
    return PoseJacobian(kinematics, basis)(pose, frames)


class ShapeJacobian:
    """d keypoints / d shape: sums, over the bones that lead to a keypoint, of rotation · offset per unit.

    columns: the parameters wanted, by index; all of them where it is None.
    """

    def __init__(self, kinematics: HandKinematics, columns: Sequence[int] | None = None) -> None:
        space, like = kinematics.shape_space, kinematics.default_levers
        wanted = range(len(space.names)) if columns is None else columns
        self.columns = tuple(wanted)
        matrix = kinematics.lever_matrix.unflatten(0, (len(LEVER_ENDS), 3))
        sizes = [space.names.index(name) for name in ("hand_length", "hand_breadth")]
        units = [[i for i, unit in enumerate(space.units) if unit == name] for name in ("/HL", "/HB")]
        lever_bones = (*[0] * 5, *range(1, len(BONES)))  # the bone that carries each lever
        bones, levers, parameters, places, sources = [], [], [], [], []
        for lever, end in enumerate(LEVER_ENDS):
            touched = set(matrix[lever].any(0).nonzero()[:, 0].tolist())
            touched |= {size for size, fractions in zip(sizes, units, strict=True) if touched & set(fractions)}
            for parameter in sorted(touched & set(self.columns)):
                column = self.columns.index(parameter)
                for point in _beyond(end):
                    places += [(3 * point + i) * len(self.columns) + column for i in range(3)]
                    sources.append(len(bones))
                bones.append(lever_bones[lever])
                levers.append(lever)
                parameters.append(parameter)

        def index(values: list[int]) -> Tensor:
            return torch.tensor(values, dtype=torch.int64, device=like.device)

        self._bones, self._levers, self._parameters = index(bones), index(levers), index(parameters)
        self._places, self._sources = index(places), index(sources)
        self._per_metre = matrix[self._levers, :, self._parameters][..., None]
        self._sizes = index(sizes)
        self._size_of = index([("m", "/HL", "/HB").index(unit) for unit in space.units])[self._parameters]
        # Of every size: the offsets that grow with it, as a map of the shares; and the entries that stand for the size.
        self._fractions = torch.zeros(2, 3 * len(LEVER_ENDS), len(space.names), dtype=like.dtype, device=like.device)
        for i, fractions in enumerate(units):
            self._fractions[i][:, fractions] = kinematics.lever_matrix[:, fractions]
        self._is_size = (self._parameters == self._sizes[:, None]).to(like.dtype)[..., None, None]

    @own_precision
    def __call__(
        self, frames: HandFrames, shape: Float[Tensor, "*#batch shape"]
    ) -> Float[Tensor, "*batch 21 3 columns"]:
        """Derivative per unit of each parameter: metres, or fractions of hand length or breadth. frames: of that
        shape."""
        batch = frames.rotation.shape[:-3]
        rotation = batch_last(frames.rotation, 3, batch)
        out = self.batch_last(rotation, batch_last(shape, 1, batch))
        return out.permute(3, 0, 1, 2).reshape(*batch, _POINTS, 3, len(self.columns))

    @own_precision
    def batch_last(
        self, rotation: Float[Tensor, "20 3 3 n"], shape: Float[Tensor, "shape #n"]
    ) -> Float[Tensor, "21 3 columns n"]:
        """The derivative with the batch last; a shape for all may have n = 1."""
        factors = torch.cat((torch.ones_like(shape[:1]), shape.index_select(0, self._sizes)))
        per_unit = self._per_metre * factors.index_select(0, self._size_of)[:, None]
        for grown, is_size in zip(self._fractions @ shape, self._is_size, strict=True):
            per_unit = per_unit + is_size * grown.unflatten(0, (-1, 3)).index_select(0, self._levers)
        turned = turn(rotation.index_select(0, self._bones), per_unit)
        out = rotation.new_zeros(3 * _POINTS * len(self.columns), rotation.shape[-1])
        out = out.index_add(0, self._places, turned.index_select(0, self._sources).flatten(0, 1))
        return out.unflatten(0, (_POINTS, 3, len(self.columns)))


def _beyond(point: int) -> tuple[int, ...]:
    """Keypoints that a change of the lever ending at this point moves: points count bones' origins, then fingertips."""
    if point >= len(BONES):
        return (4 * (point - len(BONES)) + 4,)
    return tuple(i for i, name in enumerate(KEYPOINTS) if point in _chain_to(_bone_of(name)))


def moving_parameters(kinematics: HandKinematics) -> tuple[int, ...]:
    """Shape parameters that move keypoints, index into the shape space's names."""
    frames = kinematics(torch.zeros(len(DOFS)).to(kinematics.default_levers))
    moved = ShapeJacobian(kinematics)(frames, kinematics.default_shape).abs().amax((0, 1))
    return tuple(moved.nonzero()[:, 0].tolist())
