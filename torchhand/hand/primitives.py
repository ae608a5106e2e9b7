"""The hand of paper 003, section 4.1: 37 truncated quadrics that follow the bones and the shape vector."""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import cone, ellipsoid, half_space, moved, rotation_from_vector, slab
from torchhand.hand.kinematics import HandFrames
from torchhand.hand.shape import ShapeSpace
from torchhand.hand.skeleton import BONES, FINGERS

_FINGER_CONES = [f"{finger}_{bone}" for finger in FINGERS[1:] for bone in ("proximal", "middle", "distal")]
_FINGER_BALLS = [f"{finger}_{joint}" for finger in FINGERS[1:] for joint in ("mcp", "pip", "dip", "tip")]

CONE_NAMES = ("palm", *_FINGER_CONES, "thumb_proximal", "thumb_distal")
ELLIPSOID_NAMES = ("palm_fingers", "palm_wrist", *_FINGER_BALLS, "thumb_thenar", "thumb_mcp", "thumb_ip", "thumb_tip")
PRIMITIVE_NAMES = CONE_NAMES + ELLIPSOID_NAMES
"""Fifteen cones, then twenty-two ellipsoids (FACTS 4.1)."""

_JOINT_BONES = {"mcp": "proximal", "pip": "middle", "dip": "distal", "ip": "distal", "tip": "distal"}


def _bone(name: str) -> int:
    if name.startswith("palm"):
        return 0
    finger, part = name.split("_")
    return BONES.index(f"{finger}_{'metacarpal' if part == 'thenar' else _JOINT_BONES.get(part, part)}")


CONE_BONES = tuple(_bone(name) for name in CONE_NAMES)
ELLIPSOID_BONES = tuple(_bone(name) for name in ELLIPSOID_NAMES)

_WHOLE = -2.0  # a clipping level below -1 keeps the whole ellipsoid
_PALM_START_Y = 0.03  # the palm's cone begins here, share of hand length
_WRIST_CAP = 0.05  # height of the half-ellipsoid towards the forearm, share of hand length


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


@dataclass(frozen=True, kw_only=True)
class Primitives:
    """The 37 truncated quadrics placed in one frame (world or camera), metres."""

    sizes: PrimitiveSizes
    cone_rotation: Float[Tensor, "*batch 15 3 3"]
    """frame_from_cone"""
    cone_position: Float[Tensor, "*batch 15 3"]
    ellipsoid_rotation: Float[Tensor, "*batch 22 3 3"]
    ellipsoid_position: Float[Tensor, "*batch 22 3"]

    def moved(self, rotation: Float[Tensor, "3 3"], translation: Float[Tensor, "3"]) -> "Primitives":
        """The same primitives after X_new = rotation X + translation."""
        return Primitives(
            sizes=self.sizes,
            cone_rotation=rotation @ self.cone_rotation,
            cone_position=self.cone_position @ rotation.T + translation,
            ellipsoid_rotation=rotation @ self.ellipsoid_rotation,
            ellipsoid_position=self.ellipsoid_position @ rotation.T + translation,
        )

    def select(self, index: int) -> "Primitives":
        """One hand of a flat batch."""
        batched = self.sizes.cone_length.ndim > 1
        sizes = {f.name: getattr(self.sizes, f.name)[index] for f in fields(self.sizes)} if batched else None
        return Primitives(
            sizes=PrimitiveSizes(**sizes) if sizes else self.sizes,
            cone_rotation=self.cone_rotation[index],
            cone_position=self.cone_position[index],
            ellipsoid_rotation=self.ellipsoid_rotation[index],
            ellipsoid_position=self.ellipsoid_position[index],
        )

    def quadrics(self) -> tuple[Float[Tensor, "*batch 37 4 4"], Float[Tensor, "*batch 37 4 4"]]:
        """Matrices Q and Π of every primitive in PRIMITIVE_NAMES order (paper 003, equations 1 and 2)."""
        s = self.sizes
        cones = moved(cone(s.cone_start, s.cone_end_scale, s.cone_length), self.cone_rotation, self.cone_position)
        zero = torch.zeros_like(s.cone_length)
        cone_clips = moved(slab(zero, s.cone_length), self.cone_rotation, self.cone_position)
        balls = moved(ellipsoid(s.ellipsoid_axes), self.ellipsoid_rotation, self.ellipsoid_position)
        level = s.ellipsoid_level * s.ellipsoid_axes[..., 1]
        ball_clips = moved(half_space(level), self.ellipsoid_rotation, self.ellipsoid_position)
        return torch.cat((cones, balls), -3), torch.cat((cone_clips, ball_clips), -3)


def primitive_sizes(space: ShapeSpace, shape: Float[Tensor, "*batch shape"]) -> PrimitiveSizes:
    """Sizes of the primitives for a shape; differentiable.

    Joints are whole spheres, which stay closed when a finger bends where a hemisphere would gape (FACTS 4.1); tips and palm
    ends are halves.
    """
    m = space.metric(shape)
    length, breadth = m["hand_length"], m["hand_breadth"]
    zero = torch.zeros_like(length)
    origin = torch.stack((zero, zero, zero), -1)

    def on_axis(y: Tensor) -> Tensor:
        return torch.stack((zero, y, zero), -1)

    # Palm: its axis runs from the middle of the wrist to the middle of the knuckles, which lies off the middle finger's line.
    wrist = torch.stack((zero, _PALM_START_Y * length, zero), -1)
    top_y = 0.25 * (m["index_metacarpal"] + m["middle_metacarpal"] + m["ring_metacarpal"] + m["little_metacarpal"])
    run, rise = top_y - wrist[..., 1], m["palm_radial"]
    palm_length = (run * run + rise * rise).sqrt()
    palm_turn = rotation_from_vector(torch.stack((torch.atan2(rise, run), zero, zero), -1))
    half_wrist, half_palm = 0.5 * m["wrist_breadth"], 0.5 * m["palm_breadth"]
    half_depth = 0.5 * m["palm_thickness"]
    palm_scale = half_palm / half_wrist
    identity = torch.eye(3, dtype=shape.dtype, device=shape.device).expand(palm_turn.shape)
    flip = torch.diag(torch.tensor((1.0, -1.0, -1.0), dtype=shape.dtype, device=shape.device))

    def ball(radius: Tensor) -> Tensor:
        return torch.stack((radius, radius, radius), -1)

    cones: dict[str, tuple[Tensor, Tensor, Tensor, Tensor]] = {
        "palm": (wrist, torch.stack((half_depth / palm_scale, half_wrist), -1), palm_scale, palm_length)
    }
    top = wrist + (palm_turn @ on_axis(palm_length)[..., None]).squeeze(-1)
    balls: dict[str, tuple[Tensor, Tensor, float]] = {
        "palm_fingers": (top, torch.stack((half_depth, m["palm_cap"], half_palm), -1), 0.0),
        "palm_wrist": (wrist, torch.stack((half_depth / palm_scale, _WRIST_CAP * length, half_wrist), -1), 0.0),
    }
    for finger in FINGERS:
        joints = ("mcp", "ip", "tip") if finger == "thumb" else ("mcp", "pip", "dip", "tip")
        bones = ("proximal", "distal") if finger == "thumb" else ("proximal", "middle", "distal")
        radii = [m[f"{finger}_{joint}_radius"] for joint in joints]
        for bone, start, end in zip(bones, radii[:-1], radii[1:], strict=True):
            reach = m[f"{finger}_{bone}"] - (end if bone == "distal" else 0)
            cones[f"{finger}_{bone}"] = (origin, torch.stack((start, start), -1), end / start, reach)
        for joint, radius in zip(joints, radii, strict=True):
            is_tip = joint == "tip"
            centre = on_axis(m[f"{finger}_distal"] - radius) if is_tip else origin
            balls[f"{finger}_{joint}"] = (centre, ball(radius), 0.0 if is_tip else _WHOLE)
    thenar, metacarpal = m["thumb_thenar_radius"], m["thumb_metacarpal"]
    balls["thumb_thenar"] = (on_axis(0.5 * metacarpal), torch.stack((thenar, 0.68 * metacarpal, thenar), -1), _WHOLE)

    turns = {"palm": palm_turn, "palm_fingers": palm_turn, "palm_wrist": palm_turn @ flip}
    return PrimitiveSizes(
        cone_origin=torch.stack([cones[n][0] for n in CONE_NAMES], -2),
        cone_turn=torch.stack([turns.get(n, identity) for n in CONE_NAMES], -3),
        cone_start=torch.stack([cones[n][1] for n in CONE_NAMES], -2),
        cone_end_scale=torch.stack([cones[n][2] for n in CONE_NAMES], -1),
        cone_length=torch.stack([cones[n][3] for n in CONE_NAMES], -1),
        ellipsoid_centre=torch.stack([balls[n][0] for n in ELLIPSOID_NAMES], -2),
        ellipsoid_turn=torch.stack([turns.get(n, identity) for n in ELLIPSOID_NAMES], -3),
        ellipsoid_axes=torch.stack([balls[n][1] for n in ELLIPSOID_NAMES], -2),
        ellipsoid_level=torch.stack([zero + balls[n][2] for n in ELLIPSOID_NAMES], -1),
    )


def place_primitives(frames: HandFrames, sizes: PrimitiveSizes, *, is_left: bool = False) -> Primitives:
    """The primitives in the world. For a left hand their offsets are mirrored; the surfaces themselves are symmetric."""
    device = frames.position.device
    cone_bones, ball_bones = torch.tensor(CONE_BONES, device=device), torch.tensor(ELLIPSOID_BONES, device=device)
    origin, turn = sizes.cone_origin, sizes.cone_turn
    centre, ball_turn = sizes.ellipsoid_centre, sizes.ellipsoid_turn
    if is_left:
        mirror = torch.tensor((1.0, 1.0, -1.0), dtype=origin.dtype, device=device)
        both = mirror[:, None] * mirror
        origin, turn, centre, ball_turn = origin * mirror, turn * both, centre * mirror, ball_turn * both
    cone_frames = frames.rotation.index_select(-3, cone_bones)
    ball_frames = frames.rotation.index_select(-3, ball_bones)
    return Primitives(
        sizes=sizes,
        cone_rotation=cone_frames @ turn,
        cone_position=(cone_frames @ origin[..., None]).squeeze(-1) + frames.position.index_select(-2, cone_bones),
        ellipsoid_rotation=ball_frames @ ball_turn,
        ellipsoid_position=(ball_frames @ centre[..., None]).squeeze(-1) + frames.position.index_select(-2, ball_bones),
    )


