"""Sizes of the 37 primitives from the shape vector."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import constant_tensor, kept
from torchhand.geometry import rotation_from_vector
from torchhand.hand.kinematics import FINGERS, ShapeSpace, linear_map
from torchhand.hand.primitives.primitives import CONE_NAMES, ELLIPSOID_NAMES, PrimitiveSizes
from torchhand.precision import own_precision

_CONES = len(CONE_NAMES)
_HALF, _WHOLE = 0.0, -2.0  # a clipping level below -1 keeps the whole ellipsoid
_LEVELS = tuple(_HALF if name.endswith("tip") or name.startswith("palm") else _WHOLE for name in ELLIPSOID_NAMES)
_SHORTEST = 1e-3  # metres: a thick fingertip can be longer than a short distal phalanx
_PALM_START_Y = 0.03  # the palm's cone begins here, share of hand length
_WRIST_CAP = 0.05  # height of the half-ellipsoid towards the forearm, share of hand length

# The knuckles' ellipsoids follow the proximal phalanges and carry the webs between the fingers: how far they reach
# back into the palm (share of hand length), and their depth and width over the knuckle's radius.
_KNUCKLE_BACK, _KNUCKLE_DEPTH, _KNUCKLE_WIDTH = 0.05, 1.06, 1.22
# The ball of the thumb lies on the palmar and ulnar side of its metacarpal: place (radii along x and z, share of the
# bone along y), half length over the bone's, width over depth.
_THENAR_SHIFT, _THENAR_REACH, _THENAR_WIDTH = (-0.2, 0.46, -0.45), 0.66, 1.4


@own_precision
def primitive_sizes(space: ShapeSpace, shape: Float[Tensor, "*batch shape"]) -> PrimitiveSizes:
    """Sizes of the primitives for a shape; differentiable.

    Joints are whole spheres, which stay closed when a finger bends where a hemisphere would gape; tips and
    palm ends are halves. Everything but the palm is linear in the parameters in metres.
    """
    metres = space.metres(shape)
    matrix = _digit_matrix(space.names, shape.dtype, shape.device)
    digits = (matrix @ metres[..., None]).squeeze(-1)
    radius, end, length = digits[..., : 3 * (_CONES - 1)].unflatten(-1, (3, -1)).unbind(-2)
    balls = digits[..., 3 * (_CONES - 1) :].unflatten(-1, (6, -1)).transpose(-1, -2)
    palm = _palm(dict(zip(space.names, metres.unbind(-1), strict=True)))
    identity = torch.eye(3, dtype=shape.dtype, device=shape.device).expand(*balls.shape[:-1], 3, 3)
    origin = torch.zeros_like(radius)[..., None].expand(*radius.shape, 3)
    level = constant_tensor(_LEVELS, shape.dtype, shape.device).expand(*shape.shape[:-1], -1)
    return PrimitiveSizes(
        cone_origin=torch.cat((palm.start[..., None, :], origin), -2),
        cone_turn=torch.cat((palm.turn[..., None, :, :], identity[..., : _CONES - 1, :, :]), -3),
        cone_start=torch.cat((palm.start_axes[..., None, :], torch.stack((radius, radius), -1)), -2),
        cone_end_scale=torch.cat((palm.end_scale[..., None], end / radius), -1),
        cone_length=torch.cat((palm.length[..., None], length.clamp_min(_SHORTEST)), -1),
        ellipsoid_centre=torch.cat((palm.cap_centres, balls[..., :3]), -2),
        ellipsoid_turn=torch.cat((palm.cap_turns, identity), -3),
        ellipsoid_axes=torch.cat((palm.cap_axes, balls[..., 3:]), -2),
        ellipsoid_level=level,
    )


@dataclass(frozen=True, kw_only=True)
class _Palm:
    """The palm's cone and its two half-ellipsoids, in the hand frame."""

    start: Tensor
    turn: Tensor
    start_axes: Tensor
    end_scale: Tensor
    length: Tensor
    cap_centres: Tensor
    cap_turns: Tensor
    cap_axes: Tensor


def _palm(m: Mapping[str, Tensor]) -> _Palm:
    """Sizes of the palm, whose axis runs from the middle of the wrist to the middle of the knuckles, beside the middle
    finger's line."""
    zero = torch.zeros_like(m["hand_length"])
    start = torch.stack((zero, _PALM_START_Y * m["hand_length"], zero), -1)
    run = 0.25 * sum(m[f"{finger}_metacarpal"] for finger in FINGERS[1:]) - start[..., 1]
    rise = m["palm_radial"]
    length = (run * run + rise * rise).sqrt()
    turned = rotation_from_vector(torch.stack((torch.atan2(rise, run), zero, zero), -1))
    half_wrist, half_palm, half_depth = 0.5 * m["wrist_breadth"], 0.5 * m["palm_breadth"], 0.5 * m["palm_thickness"]
    scale = half_palm / half_wrist
    top = start + torch.stack((zero, run, rise), -1)
    fingers = torch.stack((half_depth, m["palm_cap"], half_palm), -1)
    wrist = torch.stack((half_depth / scale, _WRIST_CAP * m["hand_length"], half_wrist), -1)
    flip = constant_tensor((1.0, -1.0, -1.0), zero.dtype, zero.device)
    return _Palm(
        start=start,
        turn=turned,
        start_axes=torch.stack((half_depth / scale, half_wrist), -1),
        end_scale=scale,
        length=length,
        cap_centres=torch.stack((top, start), -2),
        cap_turns=torch.stack((turned, turned * flip), -3),
        cap_axes=torch.stack((fingers, wrist), -2),
    )


@kept(16)
def _digit_matrix(names: tuple[str, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    return linear_map(names, _digit_sizes).to(dtype=dtype, device=device)


def _digit_sizes(m: Mapping[str, Tensor]) -> Tensor:
    """Start radii, end radii and lengths of the digits' cones, then centres and semi-axes of their balls."""
    cones, balls = {}, {}
    for finger in FINGERS:
        joints = ("mcp", "ip", "tip") if finger == "thumb" else ("mcp", "pip", "dip", "tip")
        bones = ("proximal", "distal") if finger == "thumb" else ("proximal", "middle", "distal")
        radii = [m[f"{finger}_{joint}_radius"] for joint in joints]
        for bone, start, end in zip(bones, radii[:-1], radii[1:], strict=True):
            cones[f"{finger}_{bone}"] = (start, end, m[f"{finger}_{bone}"] - (end if bone == "distal" else 0))
        for joint, radius in zip(joints, radii, strict=True):
            zero = torch.zeros_like(radius)
            along = m[f"{finger}_distal"] - radius if joint == "tip" else zero
            balls[f"{finger}_{joint}"] = (zero, along, zero, radius, radius, radius)
            if joint == "mcp" and finger != "thumb":
                back = _KNUCKLE_BACK * m["hand_length"]
                centre, reach = 0.5 * (m["web_length"] - back), 0.5 * (m["web_length"] + back)
                balls[f"{finger}_mcp"] = (zero, centre, zero, _KNUCKLE_DEPTH * radius, reach, _KNUCKLE_WIDTH * radius)
    thenar, metacarpal = m["thumb_thenar_radius"], m["thumb_metacarpal"]
    shift = (_THENAR_SHIFT[0] * thenar, _THENAR_SHIFT[1] * metacarpal, _THENAR_SHIFT[2] * thenar)
    balls["thumb_thenar"] = (*shift, thenar, _THENAR_REACH * metacarpal, _THENAR_WIDTH * thenar)
    rows = [cones[name][i] for i in range(3) for name in CONE_NAMES[1:]]
    rows += [balls[name][i] for i in range(6) for name in ELLIPSOID_NAMES[2:]]
    return torch.stack(rows, -1)
