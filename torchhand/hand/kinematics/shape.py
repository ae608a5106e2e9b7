"""The shape vector: named, bounded parameters of a hand's proportions, and the offsets that follow from them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import kept_property
from torchhand.errors import require_kind
from torchhand.hand.kinematics.skeleton import FINGERS
from torchhand.precision import own_precision

_UNITS = ("m", "/HL", "/HB")
_BOUND_SLACK = 1e-5  # relative: bounds are float64, shapes may be float32


@dataclass(frozen=True, kw_only=True)
class ShapeSpace:
    """Names, defaults, bounds and spread over people of the shape parameters.

    `hand_length` and `hand_breadth` are metres; every other parameter is a ratio, of hand length (lengths along the
    fingers) or of hand breadth (positions across the palm, thicknesses, radii), as its unit says.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    """Units of the parameters: m, /HL or /HB."""
    default: Float[Tensor, "shape"]
    lower: Float[Tensor, "shape"]
    upper: Float[Tensor, "shape"]
    std: Float[Tensor, "shape"]
    """Standard deviation over people."""

    def __post_init__(self) -> None:
        if unknown := set(self.units) - set(_UNITS):
            raise ValueError(f"units: expected {', '.join(_UNITS)}, got {', '.join(sorted(unknown))}")
        if missing := {"hand_length", "hand_breadth"} - set(self.names):
            raise ValueError(
                f"names: expected hand_length and hand_breadth among them, lacks {', '.join(sorted(missing))}"
            )

    def to(self, *, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> "ShapeSpace":
        """The same space with its tensors moved."""
        moved = {n: getattr(self, n).to(dtype=dtype, device=device) for n in ("default", "lower", "upper", "std")}
        return replace(self, **moved)

    @own_precision
    def metres(self, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch shape"]:
        """Every parameter in metres, in the order of `names`."""
        length, breadth = self.names.index("hand_length"), self.names.index("hand_breadth")
        factors = torch.stack((torch.ones_like(shape[..., 0]), shape[..., length], shape[..., breadth]), -1)
        return shape * factors.index_select(-1, self._unit_index.to(shape.device))

    def metric(self, shape: Float[Tensor, "*batch shape"]) -> dict[str, Float[Tensor, "*batch"]]:
        """Every parameter in metres, by name."""
        return dict(zip(self.names, self.metres(shape).unbind(-1), strict=True))

    def check_width(self, shape: Float[Tensor, "*batch numbers"]) -> None:
        """Raises ValueError where the last dimension does not hold the parameters, TypeError for what is no tensor."""
        require_kind("shape", shape, Tensor)
        if shape.ndim == 0 or shape.shape[-1] != len(self.names):
            raise ValueError(
                f"shape: expected {len(self.names)} numbers in the last dimension, got shape {tuple(shape.shape)}"
            )

    def check(self, shape: Float[Tensor, "*batch shape"]) -> None:
        """Raises ValueError naming the first parameter that is not finite or outside its bounds, whatever the dtype;
        TypeError for what is no tensor."""
        self.check_width(shape)
        values = shape.detach().double().reshape(-1, len(self.names))
        is_wrong = (~values.isfinite()).nonzero()
        if len(is_wrong):
            row, column = is_wrong[0].tolist()
            raise ValueError(f"shape: {self.names[column]}: expected finite numbers, got {float(values[row, column])}")
        lower, upper = self.lower.to(values), self.upper.to(values)
        slack = _BOUND_SLACK * upper.abs().maximum(lower.abs())
        is_outside = ((values < lower - slack) | (values > upper + slack)).nonzero()
        if len(is_outside):
            row, column = is_outside[0].tolist()
            raise ValueError(
                f"shape: {self.names[column]}: expected {float(lower[column]):g} to {float(upper[column]):g}"
                f" {self.units[column]}, got {float(values[row, column]):g}"
            )

    def check_one(self, shape: Float[Tensor, "shape"]) -> None:
        """Raises as `check` does, and ValueError for the shapes of several hands."""
        self.check(shape)
        if shape.ndim != 1:
            raise ValueError(f"shape: expected that of one hand, ({len(self.names)},), got {tuple(shape.shape)}")

    @kept_property
    def _unit_index(self) -> Tensor:
        with torch.inference_mode(False):  # kept for callers in any mode
            return torch.tensor([_UNITS.index(unit) for unit in self.units], device=self.default.device)


def linear_map(
    names: tuple[str, ...], function: Callable[[Mapping[str, Tensor]], Tensor]
) -> Float[Tensor, "*sizes shape"]:
    """The matrix of a linear function of the parameters in metres, float64, found by feeding it the unit vectors.

    A readable function of named lengths so becomes one product of matrices.
    """
    unit = torch.eye(len(names), dtype=torch.float64)
    return function(dict(zip(names, unit, strict=True))).movedim(0, -1)


TIP_DEPTH = 0.016
"""Depth of the fingertip keypoint below the skin at the fingertip, as a share of hand length (3 mm)."""

# Joint centres that are no shape parameters, as shares of hand length (y) and of hand breadth (x, z), after Buchholz et
# al. 1992.
METACARPAL_BASE_Y = 0.073
METACARPAL_BASE_Z = {"index": 0.126, "middle": 0.0, "ring": -0.129, "little": -0.223}
KNUCKLE_X = {"index": 0.0, "middle": 0.02, "ring": 0.01, "little": -0.04}  # the palmar arch
THUMB_BASE_X = -0.10


@own_precision
def joint_positions(space: ShapeSpace, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch 2 5 3"]:
    """Bases of the metacarpals and the knuckles (MCP joints) in the hand frame of a straight hand, metres.

    [..., 0, :, :] are the CMC joints thumb to little; [..., 1, 1:, :] the MCP joints of the four fingers. The entry of
    the thumb's MCP joint holds the length of its metacarpal on y, in that bone's own frame.
    """
    return _joint_positions(space.metric(shape))


def _joint_positions(metric: Mapping[str, Tensor]) -> Tensor:
    length, breadth = metric["hand_length"], metric["hand_breadth"]
    zero = torch.zeros_like(length)
    bases = [torch.stack((THUMB_BASE_X * breadth, METACARPAL_BASE_Y * length, metric["thumb_cmc_radial"]), -1)]
    knuckles = [torch.stack((zero, metric["thumb_metacarpal"], zero), -1)]
    for finger in FINGERS[1:]:
        height, base_z = KNUCKLE_X[finger] * breadth, METACARPAL_BASE_Z[finger] * breadth
        bases.append(torch.stack((height, METACARPAL_BASE_Y * length, base_z), -1))
        knuckles.append(torch.stack((height, metric[f"{finger}_metacarpal"], metric[f"{finger}_mcp_radial"]), -1))
    return torch.stack((torch.stack(bases, -2), torch.stack(knuckles, -2)), -3)


@own_precision
def bone_offsets(
    space: ShapeSpace, shape: Float[Tensor, "*batch shape"], metacarpal_rotation: Float[Tensor, "5 3 3"]
) -> tuple[Float[Tensor, "*batch 20 3"], Float[Tensor, "*batch 5 3"]]:
    """Origin of every bone in its parent's frame, and the fingertip keypoints in their last bone's frame, metres.

    metacarpal_rotation holds hand_from_metacarpal at rest: the knuckles are known in the hand frame and wanted in the
    metacarpals'. Differentiable in shape.
    """
    offsets = _offsets(space.metric(shape), metacarpal_rotation)
    return offsets[..., :20, :], offsets[..., 20:, :]


def offset_matrix(space: ShapeSpace, metacarpal_rotation: Float[Tensor, "5 3 3"]) -> Float[Tensor, "25 3 shape"]:
    """`bone_offsets` (bones, then tips) as a linear map of the parameters in metres, float64."""
    return linear_map(space.names, lambda metric: _offsets(metric, metacarpal_rotation.double().cpu()))


def _offsets(metric: Mapping[str, Tensor], metacarpal_rotation: Tensor) -> Tensor:
    bases, knuckles = _joint_positions(metric).unbind(-3)
    zero = torch.zeros_like(metric["hand_length"])

    def along(y: Tensor) -> Tensor:
        return torch.stack((zero, y, zero), -1)

    inverse = metacarpal_rotation[1:].transpose(-1, -2)
    levers = (inverse @ (knuckles - bases)[..., 1:, :, None]).squeeze(-1)
    rows = [torch.zeros_like(bases[..., 0, :]), *bases.unbind(-2), knuckles[..., 0, :], *levers.unbind(-2)]
    rows += [along(metric[f"{finger}_proximal"]) for finger in FINGERS]
    rows += [along(metric[f"{finger}_middle"]) for finger in FINGERS[1:]]
    rows += [along(metric[f"{finger}_distal"] - TIP_DEPTH * metric["hand_length"]) for finger in FINGERS]
    return torch.stack(rows, -2)
