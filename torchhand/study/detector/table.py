"""The table of a detector's errors from several recordings, and how well it holds for recordings that are not in it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import JOINT_DOFS, KEYPOINTS
from torchhand.study.detector.errors import DetectorErrors

MIN_RECORDINGS = 3


@dataclass(frozen=True, kw_only=True)
class _Typical:
    """Medians over recordings, so that none of them decides."""

    offset: Float[Tensor, "21"]
    std: Float[Tensor, "21"]
    angle_std: Float[Tensor, "30"]
    angle_correlation: Float[Tensor, ""]

    @classmethod
    def of(cls, recordings: Sequence[DetectorErrors]) -> "_Typical":
        offset = _median(torch.stack([one.offset for one in recordings]))
        std = torch.stack([one.variance(offset) for one in recordings]).sqrt()
        angles = torch.stack([one.angle_variance for one in recordings]).sqrt()
        correlation = offset.new_tensor([one.angle_correlation for one in recordings])
        return cls(offset=offset, std=_median(std), angle_std=_median(angles), angle_correlation=_median(correlation))

    def normalised(self, errors: DetectorErrors) -> tuple[float, float]:
        """Root mean square of a recording's errors in the standard deviations of the table: points, angles."""
        points = (errors.variance(self.offset) / self.std.square()).mean().sqrt()
        return float(points), float((errors.angle_variance / self.angle_std.square()).nanmean().sqrt())


def error_table(recordings: Sequence[DetectorErrors]) -> dict[str, Any]:
    """Standard deviations of points and angles with the recordings that they come from; values that JSON knows.

    points: std_m along each axis of the picture at a hand of our default size, and along_m, how far the point lies
    beyond the true one along the bone that ends there. angles: std_rad; an angle that is never told is left out.
    angle_correlation: of the angles' errors with those of the frame before; 0 where no recording has two frames.
    held_out: each recording against the table of all others, root mean squares in its standard deviations; 1 is what
    the table promises.

    Raises ValueError for fewer than three recordings.
    """
    if len(recordings) < MIN_RECORDINGS:
        raise ValueError(f"expected {MIN_RECORDINGS} or more recordings, got {len(recordings)}")
    table = _Typical.of(recordings)
    held_out = {}
    for place, one in enumerate(recordings):
        points, angles = _Typical.of([*recordings[:place], *recordings[place + 1 :]]).normalised(one)
        held_out[one.name] = {"frames": one.frames, "points": round(points, 2), "angles": round(angles, 2)}
    return {
        "points": {
            name: {"std_m": round(std, 5), "along_m": round(along, 5)}
            for name, std, along in zip(KEYPOINTS, table.std.tolist(), table.offset.tolist(), strict=True)
        },
        "angles": {
            name: {"std_rad": round(float(std), 4)}
            for name, std in zip(JOINT_DOFS, table.angle_std, strict=True)
            if bool(std.isfinite())
        },
        "angle_correlation": round(float(table.angle_correlation.nan_to_num()), 2),
        "held_out": held_out,
    }


def _median(values: Float[Tensor, "recordings *n"]) -> Float[Tensor, "*n"]:
    """Medians over the recordings that tell; the mean of the middle two of an even number."""
    return values.nanquantile(0.5, 0)
