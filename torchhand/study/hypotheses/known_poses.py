"""The poses that a sequence's truth tells: those of our own simulator as they are, others' from their keypoints."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files import FittedHand, load_hand_model
from torchhand.files.disk import opened_arrays
from torchhand.fit.keypoints import KeypointFit, fit_keypoints
from torchhand.hand import DOFS, ShapeSpace, Side

_KEYPOINTS, _POSE = "keypoints3d", ("pose", "root_reference", "shape", "side", "dof_names", "shape_names")


@dataclass(frozen=True, kw_only=True)
class KnownPoses:
    """A hand through a sequence."""

    pose: Float[Tensor, "frames 36"]
    """Metres and radians; rotation vectors turn the reference. NaN where unknown."""
    root_reference: Float[Tensor, "3 3"]
    shape: Float[Tensor, "shape"]
    side: Side
    source: str
    """How they are known, for the user."""

    def __len__(self) -> int:
        return len(self.pose)


def load_known_poses(path: Path, *, side: Side | None = None, hand: FittedHand | None = None) -> KnownPoses:
    """Read a truth.npz.

    Where it has poses of our hand (as `torchhand simulate` writes them) these are taken, with its shape and side. Else
    our hand is fitted to its keypoints3d in space: one shape for all frames, unless `hand` gives it, and the side that
    fits better, unless one is given.

    Raises InputError naming the file and what it lacks, or where a hand or side is given that is not the truth's.
    """
    wanted = f"expected an npz file with {_KEYPOINTS}, or with {', '.join(_POSE)}; it cannot be read as one"
    with opened_arrays(path, complaint=wanted) as stored:
        arrays = {key: np.asarray(stored[key]) for key in (*_POSE, _KEYPOINTS) if key in stored}
    space = load_hand_model().shape_space
    if all(key in arrays for key in _POSE):
        return _own(path, arrays, space, side, hand)
    if _KEYPOINTS not in arrays:
        got = ", ".join(arrays) or "none of these"
        raise InputError(f"{path}: expected {_KEYPOINTS}, or {', '.join(_POSE)}; got {got}")
    return _fitted(path, arrays[_KEYPOINTS], side, hand)


def _own(
    path: Path, arrays: dict[str, np.ndarray], space: ShapeSpace, side: Side | None, hand: FittedHand | None
) -> KnownPoses:
    pose, reference, shape = (arrays[key] for key in _POSE[:3])
    for key, array, expected in (
        ("pose", pose, (len(pose) if pose.ndim else 0, len(DOFS))),
        ("root_reference", reference, (3, 3)),
        ("shape", shape, (len(space.names),)),
    ):
        if array.shape != expected or not np.issubdtype(array.dtype, np.floating):
            raise InputError(f"{path}: {key}: expected numbers of shape {expected}, got {array.shape}")
    for key, names in (("dof_names", DOFS), ("shape_names", space.names)):
        if tuple(arrays[key].reshape(-1).tolist()) != tuple(names):
            raise InputError(f"{path}: {key}: expected the {len(names)} of this version's hand, got others")
    own = str(arrays["side"])
    if own not in ("left", "right"):
        raise InputError(f"{path}: side: expected left or right, got {own!r}")
    if side is not None and side != own:
        raise InputError(f"--side: expected {own}, that of {path}, got {side}")
    if hand is not None:
        raise InputError(f"--hand: expected none: {path} tells the hand's shape")
    return KnownPoses(
        pose=torch.from_numpy(pose).double(),
        root_reference=torch.from_numpy(reference).double(),
        shape=torch.from_numpy(shape).double(),
        side="left" if own == "left" else "right",
        source="exact, of the truth",
    )


def _fitted(path: Path, keypoints: np.ndarray, side: Side | None, hand: FittedHand | None) -> KnownPoses:
    if keypoints.ndim != 3 or keypoints.shape[1:] != (21, 3) or not np.issubdtype(keypoints.dtype, np.number):
        raise InputError(f"{path}: {_KEYPOINTS}: expected numbers of shape (frames, 21, 3), got {keypoints.shape}")
    shape = None if hand is None else torch.tensor(list(hand.values.values()), dtype=torch.float64)
    named = side or (None if hand is None else "left" if hand.side == "left" else "right")
    sides: tuple[Side, ...] = ("left", "right") if named is None else ("left",) if named == "left" else ("right",)
    points = torch.from_numpy(keypoints.astype(np.float64))
    fits = [
        fit_keypoints(
            load_hand_model().kinematics(one, dtype=torch.float64), points, shape=shape, fit_shape=hand is None
        )
        for one in sides
    ]
    best, fit = min(zip(sides, fits, strict=True), key=lambda pair: _misfit(pair[1]))
    if not bool(fit.is_fitted.any()):
        raise InputError(f"{path}: {_KEYPOINTS}: no frame can be fitted ({', '.join(sorted(set(fit.status_names())))})")
    missed = 1e3 * float(fit.residual.nanmean())
    return KnownPoses(
        pose=fit.pose,
        root_reference=torch.eye(3, dtype=torch.float64),
        shape=fit.shape,
        side=best,
        source=f"our hand fitted to the truth's keypoints ({missed:.1f} mm apart on average, {best} hand)",
    )


def _misfit(fit: KeypointFit) -> float:
    return float(fit.residual.square().nanmean()) if bool(fit.is_fitted.any()) else float("inf")
