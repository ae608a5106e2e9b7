"""The hand's surface as the zero of one function of space: a smooth union that follows bones and shape vector."""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.hand import BONES, ELLIPSOID_NAMES, FINGERS, HandFrames, ShapeSpace, primitive_sizes
from torchhand.modelling.distances import blended, ellipsoid, round_cone

# Widths of the fillets where two parts meet, shares of hand breadth.
_FILLETS = {"knuckle": 0.06, "thumb": 0.12, "digits": 0.02, "joints": 0.01, "pads": 0.03, "palm": 0.08}
_SECTION_POWER = 2.1  # the palm's section is a little fuller than an ellipse
_PALM_SHRINK = (0.86, 0.975)


class HandField:
    """Signed distance, to first order, from points in the hand's frame to the skin of one hand."""

    def __init__(self, space: ShapeSpace, frames: HandFrames, shape: Float[Tensor, "shape"]) -> None:
        self._metric = space.metric(shape)
        self._sizes = primitive_sizes(space, shape)
        self._rotation, self._position = frames.rotation, frames.position
        self._fillet = {name: share * self._metric["hand_breadth"] for name, share in _FILLETS.items()}

    def __call__(self, points: Float[Tensor, "points 3"]) -> Float[Tensor, "points"]:
        palm = self._palm(points)
        whole = palm
        for finger in FINGERS:
            fillet = self._fillet["thumb" if finger == "thumb" else "knuckle"]
            with_digit = blended(palm, self._digit(points, finger), fillet)
            whole = blended(whole, with_digit, self._fillet["digits"]) if finger != "thumb" else with_digit
        return whole

    def digit_distance(self, points: Float[Tensor, "points 3"], finger: str) -> Float[Tensor, "points"]:
        """Distance to one digit alone, the thumb without the ball at its base."""
        return self._digit(points, finger)

    def thumb_base(self, points: Float[Tensor, "points 3"]) -> Bool[Tensor, "points"]:
        """Whether points of the skin belong to the thumb's metacarpal rather than to the palm."""
        base = torch.minimum(self._digit(points, "thumb"), self._ball(points, "thumb_thenar", "thumb_metacarpal"))
        return base < self._palm_without_thumb(points)

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
        whole = None
        for i, bone in enumerate(bones):
            name = f"{finger}_{bone}"
            length = m[name] - (radii[-1] if bone == "distal" else 0.0)
            start, end = self._at(name, 0.0, 0.0, 0.0), self._at(name, 0.0, length, 0.0)
            part = round_cone(points, start, end, radii[i], radii[i + 1])
            whole = part if whole is None else blended(whole, part, self._fillet["joints"])
            pad_radius = 0.5 * (radii[i] + radii[i + 1])
            centre = self._at(name, -0.16 * pad_radius, (0.5 if bone == "distal" else 0.52) * m[name], 0.0)
            axes = torch.stack((0.86 * pad_radius, 0.40 * m[name], 0.84 * pad_radius))
            whole = blended(whole, ellipsoid(points, centre, self._bone(name)[0], axes), self._fillet["pads"])
        if thumb:
            start = self._at("thumb_metacarpal", 0.0, 0.25 * m["thumb_metacarpal"], 0.0)
            end = self._at("thumb_proximal", 0.0, 0.0, 0.0)
            base = round_cone(points, start, end, 0.62 * m["thumb_thenar_radius"], radii[0])
            return blended(whole, base, self._fillet["pads"])
        return blended(whole, self._ball(points, f"{finger}_mcp", f"{finger}_proximal"), self._fillet["pads"])

    def _ball(self, points: Tensor, name: str, bone: str) -> Tensor:
        i, s = ELLIPSOID_NAMES.index(name), self._sizes
        rotation, position = self._bone(bone)
        centre, turn = position + rotation @ s.ellipsoid_centre[i], rotation @ s.ellipsoid_turn[i]
        return ellipsoid(points, centre, turn, s.ellipsoid_axes[i])

    def _palm(self, points: Tensor) -> Tensor:
        thenar = self._ball(points, "thumb_thenar", "thumb_metacarpal")
        return blended(self._palm_without_thumb(points), thenar, self._fillet["palm"])

    def _knuckle(self, finger: str, rise: Tensor) -> tuple[Tensor, ...]:
        """The knuckle in the frame of its metacarpal, raised by so much to the back of the hand."""
        rotation, position = self._bone(f"{finger}_metacarpal")
        local = rotation.T @ (self._bone(f"{finger}_proximal")[1] - position)
        return local[0] + rise, local[1], local[2]

    def _palm_without_thumb(self, points: Tensor) -> Tensor:
        m, breadth, length = self._metric, self._metric["hand_breadth"], self._metric["hand_length"]
        whole = self._palm_body(points)
        for finger in FINGERS[1:]:
            bone, radius = f"{finger}_metacarpal", m[f"{finger}_mcp_radius"]
            start, end = self._at(bone, 0.01 * breadth, 0.03 * length, 0.0), self._at(f"{finger}_metacarpal", *self._knuckle(finger, 0.036 * breadth))
            whole = blended(whole, round_cone(points, start, end, 0.085 * breadth, 1.05 * radius), self._fillet["pads"])
        little = "little_metacarpal"
        axes = torch.stack((0.125 * breadth, 0.15 * length, 0.14 * breadth))
        heel = ellipsoid(points, self._at(little, -0.055 * breadth, 0.12 * length, 0.06 * breadth), self._bone(little)[0], axes)
        whole = blended(whole, heel, self._fillet["palm"])
        # the hollow of the palm
        axes = torch.stack((0.16 * breadth, 0.15 * length, 0.15 * breadth))
        hollow = ellipsoid(points, self._at("middle_metacarpal", -0.31 * breadth, 0.25 * length, -0.02 * breadth), self._bone("middle_metacarpal")[0], axes)
        return -blended(-whole, hollow, self._fillet["palm"])

    def _palm_body(self, points: Tensor) -> Tensor:
        s = self._sizes
        rotation, position = self._bone("wrist")
        turn, origin = rotation @ s.cone_turn[0], position + rotation @ s.cone_origin[0]
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
