"""The hand's surface as the zero of one function of space: a smooth union that follows bones and shape vector."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.hand import BONES, ELLIPSOID_NAMES, FINGERS, HandFrames, ShapeSpace, primitive_sizes
from torchhand.modelling.distances import blended, ellipsoid, round_cone

# Widths of the fillets where two parts meet, shares of hand breadth.
_FILLETS = {"knuckle": 0.06, "thumb": 0.09, "thenar": 0.055, "digits": 0.02, "joints": 0.01, "pads": 0.03, "palm": 0.07}
# Height of the knuckles' ridges over the joint centres, shares of palm thickness: lower at the edges of the palm.
_KNUCKLE_TOP = {"index": 0.325, "middle": 0.46, "ring": 0.45, "little": 0.325}
_INSET = 0.0025  # taken off everywhere, share of hand breadth: what the fillets add on average
_SECTION_POWER = 2.05  # the palm's section is a little fuller than an ellipse
_PALM_SHRINK = (0.93, 0.975)
_PALM_SINK = 0.015  # by so much of its thickness it lies deeper: the ridges stand out on the back


class HandField:
    """Signed distance, to first order, from points in the hand's frame to the skin of one hand."""

    def __init__(self, space: ShapeSpace, frames: HandFrames, shape: Float[Tensor, "shape"]) -> None:
        self._metric = space.metric(shape)
        self._sizes = primitive_sizes(space, shape)
        self._rotation, self._position = frames.rotation, frames.position
        self._fillet = {name: fraction * self._metric["hand_breadth"] for name, fraction in _FILLETS.items()}

    def __call__(self, points: Float[Tensor, "points 3"]) -> Float[Tensor, "points"]:
        palm = self._palm(points) + _INSET * self._metric["hand_breadth"]
        whole = palm
        for finger in FINGERS[1:]:
            with_digit = blended(palm, self._digit(points, finger), self._fillet["knuckle"])
            whole = blended(whole, with_digit, self._fillet["digits"])
        thumb = blended(self._digit(points, "thumb"), self._thenar(points), self._fillet["thenar"])
        return blended(whole, thumb, self._fillet["thumb"])

    def digit_distance(self, points: Float[Tensor, "points 3"], finger: str) -> Float[Tensor, "points"]:
        """Distance to one digit alone, the thumb without the ball at its base."""
        return self._digit(points, finger)

    def thumb_base(self, points: Float[Tensor, "points 3"]) -> Bool[Tensor, "points"]:
        """Whether points of the skin belong to the thumb's metacarpal rather than to the palm."""
        return torch.minimum(self._digit(points, "thumb"), self._thenar(points)) < self._palm(points)

    def _bone(self, name: str) -> tuple[Tensor, Tensor]:
        index = BONES.index(name)
        return self._rotation[index], self._position[index]

    def _at(self, bone: str, *local: Tensor | float) -> Tensor:
        rotation, position = self._bone(bone)
        return position + rotation @ torch.stack([torch.as_tensor(x, dtype=position.dtype) for x in local])

    def _digit(self, points: Tensor, finger: str) -> Tensor:
        m = self._metric
        thumb = finger == "thumb"
        joints = ("mcp", "ip", "tip") if thumb else ("mcp", "pip", "dip", "tip")
        bones = ("proximal", "distal") if thumb else ("proximal", "middle", "distal")
        radii = [m[f"{finger}_{joint}_radius"] for joint in joints]
        parts: list[tuple[Tensor, Tensor]] = []  # and the fillet with what stands before
        for i, bone in enumerate(bones):
            name = f"{finger}_{bone}"
            length = m[name] - (radii[-1] if bone == "distal" else 0.0)
            start, end = self._at(name, 0.0, 0.0, 0.0), self._at(name, 0.0, length, 0.0)
            parts.append((round_cone(points, start, end, radii[i], radii[i + 1]), self._fillet["joints"]))
            pad_radius = 0.5 * (radii[i] + radii[i + 1])
            centre = self._at(name, -0.16 * pad_radius, (0.5 if bone == "distal" else 0.52) * m[name], 0.0)
            axes = torch.stack((0.84 * pad_radius, 0.40 * m[name], 0.80 * pad_radius))
            parts.append((ellipsoid(points, centre, self._bone(name)[0], axes), self._fillet["pads"]))
        if thumb:
            start = self._at("thumb_metacarpal", 0.0, 0.25 * m["thumb_metacarpal"], 0.0)
            end = self._at("thumb_proximal", 0.0, 0.0, 0.0)
            base = round_cone(points, start, end, 0.55 * m["thumb_thenar_radius"], radii[0])
        else:
            base = self._ball(points, f"{finger}_mcp", f"{finger}_proximal")
        parts.append((base, self._fillet["pads"]))
        whole = parts[0][0]
        for part, fillet in parts[1:]:
            whole = blended(whole, part, fillet)
        return whole

    def _ball(self, points: Tensor, name: str, bone: str) -> Tensor:
        i, s = ELLIPSOID_NAMES.index(name), self._sizes
        rotation, position = self._bone(bone)
        centre, turn = position + rotation @ s.ellipsoid_centre[i], rotation @ s.ellipsoid_turn[i]
        return ellipsoid(points, centre, turn, s.ellipsoid_axes[i])

    def _thenar(self, points: Tensor) -> Tensor:
        return self._ball(points, "thumb_thenar", "thumb_metacarpal")

    def _knuckle(self, finger: str, rise: Tensor) -> tuple[Tensor, ...]:
        """The knuckle in the frame of its metacarpal, raised by so much to the back of the hand."""
        rotation, position = self._bone(f"{finger}_metacarpal")
        local = rotation.T @ (self._bone(f"{finger}_proximal")[1] - position)
        return local[0] + rise, local[1], local[2]

    def _palm(self, points: Tensor) -> Tensor:
        m = self._metric
        breadth, length, depth = m["hand_breadth"], m["hand_length"], m["palm_thickness"]
        whole = self._palm_body(points)
        for finger in FINGERS[1:]:
            # Ridges of the metacarpals, flush with the back of the palm at the knuckles.
            bone, radius = f"{finger}_metacarpal", 0.97 * m[f"{finger}_mcp_radius"]
            start = self._at(bone, 0.0, 0.06 * length, 0.0)
            end = self._at(bone, *self._knuckle(finger, _KNUCKLE_TOP[finger] * depth - radius))
            whole = blended(whole, round_cone(points, start, end, 0.24 * depth, radius), self._fillet["pads"])
        # The heel of the hand, towards the little finger, and the hollow of the palm.
        edge = 0.42 * m["palm_radial"] - 0.29 * m["wrist_breadth"] - 0.21 * m["palm_breadth"]
        heel = self._at("wrist", -0.15 * depth, 0.195 * length, edge + 0.17 * breadth)
        axes = torch.stack((0.315 * depth, 0.14 * length, 0.122 * breadth))
        whole = blended(whole, ellipsoid(points, heel, self._bone("wrist")[0], axes), self._fillet["palm"])
        hollow = self._at("wrist", -0.88 * depth, 0.32 * length, m["palm_radial"] + 0.05 * breadth)
        axes = torch.stack((0.45 * depth, 0.15 * length, 0.15 * breadth))
        return -blended(-whole, ellipsoid(points, hollow, self._bone("wrist")[0], axes), self._fillet["palm"])

    def _palm_body(self, points: Tensor) -> Tensor:
        s = self._sizes
        rotation, position = self._bone("wrist")
        turn, origin = rotation @ s.cone_turn[0], position + rotation @ s.cone_origin[0]
        origin = origin - _PALM_SINK * self._metric["palm_thickness"] * rotation[:, 0]
        length, scale = s.cone_length[0], s.cone_end_scale[0]
        before, after = s.ellipsoid_axes[1, 1], s.ellipsoid_axes[0, 1]

        local = (points - origin) @ turn
        y = local[:, 1]
        axes = s.cone_start[0] * (1 + (scale - 1) * (y / length).clamp(0, 1))[:, None] * points.new_tensor(_PALM_SHRINK)
        across = (local[:, ::2] / axes).abs().clamp_min(1e-9)
        ring = across.pow(_SECTION_POWER).sum(-1).pow(1 / _SECTION_POWER)
        beyond = (y - length).clamp_min(0) / after + (-y).clamp_min(0) / before
        value = (ring.square() + beyond.square()).sqrt()
        # Slope of the value, but for the taper: distance to first order is value over slope.
        sideways = (across / ring[:, None]).pow(_SECTION_POWER - 1) / axes * (ring / value)[:, None]
        cap = torch.where(y > length, 1 / after, 1 / before) * beyond / value
        return (value - 1) / (sideways.square().sum(-1) + cap.square()).sqrt()
