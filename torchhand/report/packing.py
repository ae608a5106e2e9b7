"""Arrays as text that a page unpacks: quantised, differences along the first axis, deflated, base64.

`page/data.js` is the reader. A value is start + step · q; a column's q are the running sums of what is stored, modulo
the type's range; the smallest signed and the largest unsigned q stand for NaN.
"""

import base64
import math
import zlib
from typing import Any, Literal

import numpy as np

Kind = Literal["i1", "i2", "i4", "u1"]
_MISSING: dict[Kind, int] = {"i1": -(2**7), "i2": -(2**15), "i4": -(2**31), "u1": 2**8 - 1}
_LARGEST: dict[Kind, int] = {"i1": 2**7 - 1, "i2": 2**15 - 1, "i4": 2**31 - 1, "u1": 2**8 - 2}


def packed(values: np.ndarray, kind: Kind, *, step: float = 1.0, start: float = 0.0) -> dict[str, Any]:
    """An array with frames along its first axis. step: distance of neighbouring values; NaN stays NaN.

    Raises ValueError where a value lies outside what the type holds at this step.
    """
    flat = values.reshape(len(values), math.prod(values.shape[1:])).astype(np.float64)
    steps = np.rint((flat - start) / step)
    if (np.abs(steps[np.isfinite(steps)]) > _LARGEST[kind]).any() or (kind == "u1" and (steps < 0).any()):
        raise ValueError(f"values: expected them within the range of {kind} at steps of {step:g}, got others")
    whole = np.where(np.isfinite(steps), steps, _MISSING[kind]).astype(np.int64)
    stored = np.diff(whole.T, axis=1, prepend=0).astype(f"<{kind}")  # wraps around
    text = base64.b64encode(zlib.compress(stored.tobytes(), 9)).decode("ascii")
    return {"kind": kind, "shape": list(values.shape), "step": step, "start": start, "data": text}


def packed_range(values: np.ndarray, *, step: float) -> dict[str, Any]:
    """The same in 16 bits at that step, or at a coarser one where the values' range asks for it."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    return packed(values, "i2", step=max(step, (high - low) / (2.0 * _LARGEST["i2"])), start=0.5 * (low + high))
