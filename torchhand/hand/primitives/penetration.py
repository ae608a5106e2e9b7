"""How deep the digits of a hand reach into each other and into the palm, from its primitives; differentiable."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import kept
from torchhand.geometry import tapered_capsule_depth
from torchhand.hand.kinematics import FINGERS
from torchhand.hand.primitives.primitives import CONE_NAMES, ELLIPSOID_NAMES, Primitives
from torchhand.precision import own_precision

_SEGMENTS = CONE_NAMES[1:]
_PALM = CONE_NAMES.index("palm")
_NOTHING = 1e-12  # keeps the slope finite in the very middle of the palm
_THENAR = ELLIPSOID_NAMES.index("thumb_thenar")
_CAPS = tuple(ELLIPSOID_NAMES.index(name) for name in ("palm_fingers", "palm_wrist"))


@dataclass(frozen=True, kw_only=True)
class PenetrationSettings:
    """How much overlap of the primitives is natural, and what more of it costs."""

    slack: float = 0.003
    """Depth at which two digits touch, metres; skin and pads give. 0 or more."""
    neighbour_slack: float = 0.005
    """Overlap that is allowed between neighbouring fingers beyond the webs, metres; 0 or more."""
    palm_slack: float = 0.004
    """Overlap that is allowed between a digit and the palm or the thenar, metres; 0 or more."""
    softness: float = 0.002
    """Depth beyond the slack that costs ½, metres; above 0."""

    def __post_init__(self) -> None:
        for name in ("slack", "neighbour_slack", "palm_slack", "softness"):
            value = getattr(self, name)
            if not 0 <= value < math.inf or (name == "softness" and value == 0):
                raise ValueError(f"{name}: expected {'above 0' if name == 'softness' else '0 or more'}, got {value!r}")


@dataclass(frozen=True, kw_only=True)
class Penetration:
    """How deep each pair of parts is in each other."""

    names: tuple[str, ...]
    """index_distal – thumb_distal and so on, then each outer segment with the palm and with the thenar."""
    depth: Float[Tensor, "*batch pairs"]
    """Depth of every pair's overlap, metres; positive where they overlap, minus the gap where they do not."""
    excess: Float[Tensor, "*batch pairs"]
    """Depth beyond what counts as touching, metres; 0 or more."""

    @property
    def worst(self) -> Float[Tensor, "*batch"]:
        """The largest excess, metres."""
        return self.excess.amax(-1)

    def describe(self) -> str:
        """The pairs of one hand (no batch dimension) that are too deep, worst first; "none" if there are none."""
        ranked = sorted(zip(self.excess.tolist(), self.names, strict=True), key=lambda pair: -pair[0])
        return "; ".join(f"{name} by {1e3 * amount:.1f} mm" for amount, name in ranked if not amount <= 0) or "none"


@own_precision
def penetration(primitives: Primitives, settings: PenetrationSettings | None = None) -> Penetration:
    """Depths of all pairs of segments of different digits, and of the outer segments in the palm and the thenar.

    A segment is the tapered capsule of its cone and the balls at the cone's ends: exact. The palm is its elliptic cone
    with its two caps, the thenar an ellipsoid; balls along the outer segments are held against them with the usual
    first-order distance k (k − 1) / |∇k²/2|, k² = (x/a)² + (y/b)² + (z/c)²: right in sign and exact on the surface.
    Proximal segments of neighbouring fingers meet in the webs and are left out, and so are proximal segments against
    the palm, which they grow from. Any batch shape; differentiable once (see `tapered_capsule_depth`).
    """
    settings = settings or PenetrationSettings()
    names, first, second, slack = digit_pairs(settings, primitives.position.device)
    start, end, radii = _capsules(primitives)
    pick = (start[..., first, :], end[..., first, :], radii[..., first, :])
    against = (start[..., second, :], end[..., second, :], radii[..., second, :])
    depth = tapered_capsule_depth(*pick, *against)
    palm_names, in_palm = _palm_depth(primitives, start, end, radii)
    depth = torch.cat((depth, in_palm), -1)
    slack = torch.cat((slack, slack.new_full((len(palm_names),), settings.palm_slack))).to(depth)
    return Penetration(names=names + palm_names, depth=depth, excess=(depth - slack).clamp_min(0))


@own_precision
def penetration_penalty(primitives: Primitives, settings: PenetrationSettings | None = None) -> Float[Tensor, "*batch"]:
    """½ Σ (excess / softness)² over the pairs; continuously differentiable where the deepest places are unique."""
    settings = settings or PenetrationSettings()
    return energy_of(penetration(primitives, settings), settings)


def energy_of(depths: Penetration, settings: PenetrationSettings) -> Float[Tensor, "*batch"]:
    """The penalty of depths that are at hand."""
    return 0.5 * (depths.excess / settings.softness).square().sum(-1)


@kept(8)
def digit_pairs(settings: PenetrationSettings, device: torch.device) -> tuple[tuple[str, ...], Tensor, Tensor, Tensor]:
    """The pairs of digits' segments: names, both places among the cones after the palm's, overlap allowed in metres."""
    names, first, second, slack = [], [], [], []
    for i, one in enumerate(_SEGMENTS):
        for j in range(i + 1, len(_SEGMENTS)):
            other = _SEGMENTS[j]
            (finger, bone), (other_finger, other_bone) = one.split("_"), other.split("_")
            gap = abs(FINGERS.index(finger) - FINGERS.index(other_finger))
            are_neighbours = gap == 1 and "thumb" not in (finger, other_finger)
            if gap == 0 or (are_neighbours and bone == other_bone == "proximal"):
                continue
            names.append(f"{one} – {other}")
            first.append(i)
            second.append(j)
            slack.append(settings.neighbour_slack if are_neighbours else settings.slack)
    one, other = (torch.tensor(x, device=device) for x in (first, second))
    return tuple(names), one, other, torch.tensor(slack, dtype=torch.float64, device=device)


_OUTER_SEGMENTS = ("thumb_distal", *(f"{finger}_{bone}" for finger in FINGERS[1:] for bone in ("middle", "distal")))
_SAMPLES = (0.4, 0.7, 1.0)
"""Places of the balls along a segment that are held against the palm and the thenar."""


def _capsules(primitives: Primitives) -> tuple[Tensor, Tensor, Tensor]:
    """Ends and end radii of the segments."""
    sizes = primitives.sizes
    start = primitives.cone_position[..., 1:, :]
    end = start + primitives.cone_rotation[..., 1:, :, 1] * sizes.cone_length[..., 1:, None]
    radius = sizes.cone_start[..., 1:, 0]
    return start, end, torch.stack((radius, radius * sizes.cone_end_scale[..., 1:]), -1)


def _palm_depth(primitives: Primitives, start: Tensor, end: Tensor, radii: Tensor) -> tuple[tuple[str, ...], Tensor]:
    """Depth of the deepest ball of each of _OUTER_SEGMENTS in the palm, then of those of the fingers in the thenar."""
    index = [_SEGMENTS.index(name) for name in _OUTER_SEGMENTS]
    places = torch.tensor(_SAMPLES, dtype=start.dtype, device=start.device)[:, None]
    start, end, radii = start[..., index, None, :], end[..., index, None, :], radii[..., index, None, :]
    centres = start + places * (end - start)  # (*batch, segments, samples, 3)
    ball = radii[..., 0] + places[:, 0] * (radii[..., 1] - radii[..., 0])
    sizes = primitives.sizes
    local = _seen_from(centres, primitives.cone_rotation[..., _PALM, :, :], primitives.cone_position[..., _PALM, :])
    height, length = local[..., 1], sizes.cone_length[..., _PALM, None, None]
    caps = sizes.ellipsoid_axes[..., list(_CAPS), 1]
    cap = torch.where(height > 0, caps[..., 0, None, None], caps[..., 1, None, None])
    beyond = (height - length).clamp_min(0) + height.clamp_max(0)
    scale = 1 + (height / length).clamp(0, 1) * (sizes.cone_end_scale[..., _PALM, None, None] - 1)
    half = sizes.cone_start[..., _PALM, None, None, :] * scale[..., None]
    across = torch.stack((local[..., 0], beyond, local[..., 2]), -1)
    in_palm = ball - _ellipsoid_distance(across, torch.stack((half[..., 0], cap, half[..., 1]), -1))
    thenar = primitives.ellipsoid_rotation[..., _THENAR, :, :], primitives.ellipsoid_position[..., _THENAR, :]
    axes = sizes.ellipsoid_axes[..., _THENAR, None, None, :]
    in_thenar = ball[..., 1:, :] - _ellipsoid_distance(_seen_from(centres[..., 1:, :, :], *thenar), axes)
    names = (
        *(f"{name} – palm" for name in _OUTER_SEGMENTS),
        *(f"{name} – thenar" for name in _OUTER_SEGMENTS[1:]),
    )
    return names, torch.cat((in_palm.amax(-1), in_thenar.amax(-1)), -1)


def _seen_from(points: Tensor, rotation: Tensor, position: Tensor) -> Tensor:
    """Points (*batch, segments, samples, 3) in the frame of one part (*batch, 3, 3), (*batch, 3)."""
    return (points - position[..., None, None, :]) @ rotation[..., None, :, :]


def _ellipsoid_distance(point: Tensor, axes: Tensor) -> Tensor:
    """First-order signed distance to an ellipsoid with these semi-axes; finite, with finite slope, at its centre."""
    squares = (point / axes).square() + _NOTHING
    level, steepness = squares.sum(-1).sqrt(), (squares / axes.square()).sum(-1).sqrt()
    return level * (level - 1) / steepness
