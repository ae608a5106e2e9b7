"""What becomes of every start of a hypothesis study, as arrays."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int

from torchhand.fit import SolveStatus

STATUS_NAMES = tuple(status.name.lower() for status in SolveStatus)
"""By the numbers in `Hypotheses.status`."""


@dataclass(frozen=True, kw_only=True)
class Hypotheses:
    """One row per start. What failed has NaN errors and pose, and infinite cost and misfit."""

    frame: Int[np.ndarray, "starts"]
    batch: Int[np.ndarray, "starts"]
    seed: Int[np.ndarray, "starts"]
    """Seed of the batch's generator."""
    level: Int[np.ndarray, "starts"]
    """Size of the perturbation: 1 to the number of levels."""
    perturbation: Float[np.ndarray, "starts free"]
    """Perturbation of the pose space's free parameters, metres and radians, within the limits; the rotation is a left
    one."""
    start_angle_deg: Float[np.ndarray, "starts"]
    start_keypoint_mm: Float[np.ndarray, "starts"]
    start_rotation_deg: Float[np.ndarray, "starts"]
    angle_deg: Float[np.ndarray, "starts"]
    """Mean absolute error of the joint angles that the pose space moves."""
    keypoint_mm: Float[np.ndarray, "starts"]
    rotation_deg: Float[np.ndarray, "starts"]
    contour_px: Float[np.ndarray, "starts"]
    """Mean distance of the picture's contour from the model's outline."""
    cost: Float[np.ndarray, "starts"]
    """Nats that were minimised, the priors among them: that about the start is another for every start."""
    misfit: Float[np.ndarray, "starts"]
    """Nats of the picture alone: comparable within a frame."""
    status: Int[np.ndarray, "starts"]
    """Index into STATUS_NAMES."""
    iterations: Int[np.ndarray, "starts"]
    pose: Float[np.ndarray, "starts 36"]
    """Metres and radians; the rotation vector is that of world_from_hand."""

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def is_registered(self) -> Bool[np.ndarray, "starts"]:
        """Neither failed nor without data to register on."""
        return self.status <= SolveStatus.STALLED.value

    def is_success(self, success_deg: float) -> Bool[np.ndarray, "starts"]:
        """Whether the mean joint error is small enough; NaN is not."""
        return self.angle_deg <= success_deg

    def select(self, chosen: Bool[np.ndarray, "starts"]) -> "Hypotheses":
        """Some of them."""
        return Hypotheses(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays by name, as `from_arrays` takes them."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> "Hypotheses":
        """The hypotheses of a file. Raises KeyError for what is missing, ValueError for arrays of differing lengths."""
        chosen = {f.name: arrays[f.name] for f in fields(cls)}
        lengths = {len(array) for array in chosen.values()}
        if len(lengths) != 1:
            raise ValueError(f"expected arrays of one length, got {sorted(lengths)}")
        return cls(**chosen)

    @classmethod
    def joined(cls, parts: Iterable["Hypotheses"], count: int) -> "Hypotheses":
        """One after the other, `count` in all; no more than one of the parts is held at a time."""
        arrays: dict[str, np.ndarray] = {}
        end = 0
        for part in parts:
            begin, end = end, end + len(part)
            own = part.arrays()
            arrays = arrays or {name: np.empty((count, *one.shape[1:]), one.dtype) for name, one in own.items()}
            for name, values in own.items():
                arrays[name][begin:end] = values
        if end != count:
            raise ValueError(f"expected {count} hypotheses, got {end}")
        return cls(**arrays)
