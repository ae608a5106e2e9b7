"""The hand of Stenger et al. (2001, section 4.1): 37 truncated quadrics that follow the bones and the shape vector."""

from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import kept, kept_property
from torchhand.geometry import batch_first, batch_last, compose, cone, ellipsoid, half_space, moved, slab, turn
from torchhand.hand.kinematics import BONES, FINGERS, HandFrames
from torchhand.precision import own_precision, record

_FINGER_CONES = [f"{finger}_{bone}" for finger in FINGERS[1:] for bone in ("proximal", "middle", "distal")]
_FINGER_BALLS = [f"{finger}_{joint}" for finger in FINGERS[1:] for joint in ("mcp", "pip", "dip", "tip")]

CONE_NAMES = ("palm", *_FINGER_CONES, "thumb_proximal", "thumb_distal")
ELLIPSOID_NAMES = ("palm_fingers", "palm_wrist", *_FINGER_BALLS, "thumb_thenar", "thumb_mcp", "thumb_ip", "thumb_tip")
PRIMITIVE_NAMES = CONE_NAMES + ELLIPSOID_NAMES
"""Names of all primitives: fifteen cones, then twenty-two ellipsoids."""

_JOINT_BONES = {"mcp": "proximal", "pip": "middle", "dip": "distal", "ip": "distal", "tip": "distal"}


def _bone(name: str) -> int:
    if name.startswith("palm"):
        return 0
    finger, part = name.split("_")
    return BONES.index(f"{finger}_{'metacarpal' if part == 'thenar' else _JOINT_BONES.get(part, part)}")


CONE_BONES = tuple(_bone(name) for name in CONE_NAMES)
ELLIPSOID_BONES = tuple(_bone(name) for name in ELLIPSOID_NAMES)
_CONES = len(CONE_NAMES)


@record()
@dataclass(frozen=True, kw_only=True)
class PrimitiveSizes:
    """The primitives in the frames of their bones, metres; from a shape vector, independent of the pose."""

    cone_origin: Float[Tensor, "*batch 15 3"]
    cone_turn: Float[Tensor, "*batch 15 3 3"]
    """bone_from_cone; the cone's axis is its y."""
    cone_start: Float[Tensor, "*batch 15 2"]
    """Semi-axes along x and z at the beginning."""
    cone_end_scale: Float[Tensor, "*batch 15"]
    """Section at the end relative to that at the beginning."""
    cone_length: Float[Tensor, "*batch 15"]
    ellipsoid_centre: Float[Tensor, "*batch 22 3"]
    ellipsoid_turn: Float[Tensor, "*batch 22 3 3"]
    ellipsoid_axes: Float[Tensor, "*batch 22 3"]
    ellipsoid_level: Float[Tensor, "*batch 22"]
    """The part with y >= level · (semi-axis along y) is kept; below -1 all of it."""

    @kept_property
    def placement(self) -> tuple[Float[Tensor, "*batch 37 3 3"], Float[Tensor, "*batch 37 3"]]:
        """bone_from_primitive of a right hand, in PRIMITIVE_NAMES order."""
        return torch.cat((self.cone_turn, self.ellipsoid_turn), -3), torch.cat(
            (self.cone_origin, self.ellipsoid_centre), -2
        )

    @kept_property
    def mirrored_placement(self) -> tuple[Float[Tensor, "*batch 37 3 3"], Float[Tensor, "*batch 37 3"]]:
        """`placement` of a left hand: mirrored in z = 0. The surfaces themselves are symmetric."""
        turned, origin = self.placement
        mirror = torch.tensor((1.0, 1.0, -1.0), dtype=origin.dtype, device=origin.device)
        return turned * (mirror[:, None] * mirror), origin * mirror

    @kept_property
    def form(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Q and the clip of every primitive in its own frame: diagonal (37, 3), slope, low, high (each 37).

        Inside where Σ diagonal · X² + 2 slope · y < 1; kept where low <= y <= high.
        """
        slope = (1 - self.cone_end_scale) / self.cone_length
        wide = self.cone_start.square().reciprocal()
        cones = torch.stack((wide[..., 0], -slope * slope, wide[..., 1]), -1)
        diagonal = torch.cat((cones, self.ellipsoid_axes.square().reciprocal()), -2)
        level = self.ellipsoid_level * self.ellipsoid_axes[..., 1]
        low = torch.cat((torch.zeros_like(slope), level), -1)
        high = torch.cat((self.cone_length, torch.full_like(level, torch.inf)), -1)
        return diagonal, torch.cat((slope, torch.zeros_like(level)), -1), low, high


@record()
@dataclass(frozen=True, kw_only=True)
class Implicit:
    """Q = [[A, b], [bᵀ, c]] and the clips of placed primitives, in parts; the batch stands last."""

    upper: Float[Tensor, "37 3 3 n"]
    """A of the quadric [[A, b], [bᵀ, c]]."""
    edge: Float[Tensor, "37 3 n"]
    """b of the quadric [[A, b], [bᵀ, c]]."""
    corner: Float[Tensor, "37 n"]
    """c of the quadric [[A, b], [bᵀ, c]]."""
    axis: Float[Tensor, "37 3 n"]
    """A point X is kept where low <= axis·X <= high."""
    low: Float[Tensor, "37 n"]
    high: Float[Tensor, "37 n"]


@record()
@dataclass(frozen=True, kw_only=True)
class Primitives:
    """The 37 truncated quadrics placed in one frame (world or camera), metres."""

    sizes: PrimitiveSizes
    rotation: Float[Tensor, "*batch 37 3 3"]
    """frame_from_primitive, in PRIMITIVE_NAMES order"""
    position: Float[Tensor, "*batch 37 3"]

    @property
    def cone_rotation(self) -> Float[Tensor, "*batch 15 3 3"]:
        return self.rotation[..., :_CONES, :, :]

    @property
    def cone_position(self) -> Float[Tensor, "*batch 15 3"]:
        return self.position[..., :_CONES, :]

    @property
    def ellipsoid_rotation(self) -> Float[Tensor, "*batch 22 3 3"]:
        return self.rotation[..., _CONES:, :, :]

    @property
    def ellipsoid_position(self) -> Float[Tensor, "*batch 22 3"]:
        return self.position[..., _CONES:, :]

    @own_precision
    def moved(self, rotation: Float[Tensor, "3 3"], translation: Float[Tensor, "3"]) -> "Primitives":
        """The same primitives after X_new = rotation X + translation."""
        batch = self.position.shape[:-2]
        matrix, point = rotation[None, ..., None], batch_last(self.position, 2, batch)
        return Primitives(
            sizes=self.sizes,
            rotation=batch_first(compose(matrix, batch_last(self.rotation, 3, batch)), batch),
            position=batch_first(turn(matrix, point) + translation[:, None], batch),
        )

    def select(self, index: int) -> "Primitives":
        """One hand of a flat batch."""
        sizes = self.sizes
        if sizes.cone_length.ndim > 1:
            sizes = replace(sizes, **{f.name: getattr(sizes, f.name)[index] for f in fields(sizes)})
        return Primitives(sizes=sizes, rotation=self.rotation[index], position=self.position[index])

    @own_precision
    def quadrics(self) -> tuple[Float[Tensor, "*batch 37 4 4"], Float[Tensor, "*batch 37 4 4"]]:
        """Matrices Q and Π of every primitive in PRIMITIVE_NAMES order (Stenger et al. 2001, equations 1 and 2)."""
        s = self.sizes
        cones = moved(cone(s.cone_start, s.cone_end_scale, s.cone_length), self.cone_rotation, self.cone_position)
        zero = torch.zeros_like(s.cone_length)
        cone_clips = moved(slab(zero, s.cone_length), self.cone_rotation, self.cone_position)
        balls = moved(ellipsoid(s.ellipsoid_axes), self.ellipsoid_rotation, self.ellipsoid_position)
        level = s.ellipsoid_level * s.ellipsoid_axes[..., 1]
        ball_clips = moved(half_space(level), self.ellipsoid_rotation, self.ellipsoid_position)
        return torch.cat((cones, balls), -3), torch.cat((cone_clips, ball_clips), -3)

    @own_precision
    def implicit(self) -> Implicit:
        """`quadrics` in parts, in a tenth of the time."""
        batch = self.position.shape[:-2]
        rotation, position = batch_last(self.rotation, 3, batch), batch_last(self.position, 2, batch)
        diagonal, slope, low, high = self.sizes.form
        slope, low, high = (batch_last(x, 1, batch) for x in (slope, low, high))
        upper = compose(rotation * batch_last(diagonal, 2, batch)[:, None], rotation.transpose(1, 2))
        axis = rotation[:, :, 1]
        tilt = axis * slope[:, None]
        pulled = turn(upper, position)
        height = (axis * position).sum(1)
        return Implicit(
            upper=upper,
            edge=tilt - pulled,
            corner=((pulled - 2 * tilt) * position).sum(1) - 1,
            axis=axis,
            low=low + height,
            high=high + height,
        )


@own_precision
def place_primitives(frames: HandFrames, sizes: PrimitiveSizes, *, is_left: bool = False) -> Primitives:
    """The primitives in the world; of a left hand where `is_left`."""
    batch = frames.position.shape[:-2]
    turned, origin = sizes.mirrored_placement if is_left else sizes.placement
    bones = _bone_index(frames.position.device)
    bone_rotation = batch_last(frames.rotation, 3, batch).index_select(0, bones)
    position = batch_last(frames.position, 2, batch).index_select(0, bones) + turn(
        bone_rotation, batch_last(origin, 2, batch)
    )
    rotation = compose(bone_rotation, batch_last(turned, 3, batch))
    return Primitives(sizes=sizes, rotation=batch_first(rotation, batch), position=batch_first(position, batch))


@kept(16)
def _bone_index(device: torch.device) -> Tensor:
    return torch.tensor(CONE_BONES + ELLIPSOID_BONES, device=device)
