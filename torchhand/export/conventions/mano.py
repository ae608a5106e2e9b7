"""MANO's rotations as .npz: the arrays that smplx's layers and motion data sets use, written and read.

global_orient (frames, 3), hand_pose (frames, 45), wrist (frames, 3) metres, joint_names (16,), is_rhand, fps, frame,
time_s, held, flat_hand_mean True (zero is the flat hand), residual (frames, 21) metres. Frame: that of the poses (a
camera's: OpenCV) unless other axes are asked for.
"""

import math
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip, Up
from torchhand.files.disk import opened_arrays, replacing
from torchhand.hand import DOFS, FINGERS, HandModel, Side
from torchhand.hand.conventions import MANO_JOINTS, BoneFit, ManoPose, mano_of_pose, pose_of_mano

_RATES = ("fps", "mocap_framerate", "mocap_frame_rate")
_READ = (
    *("hand_pose", "global_orient", "wrist", "poses", "trans", "joint_names", "is_rhand", "flat_hand_mean"),
    *(*_RATES, "frame", "up", "time_s", "held", "hands_mean", "hands_components"),
)
_RELAXED_DEG = {"mcp": 20.0, "pip": 35.0, "dip": 20.0}
"""Flexion of the fingers of a relaxed hand, which MANO's mean posture shows."""
_SHAPES = {"global_orient": 3, "hand_pose": 45, "wrist": 3}


def write_mano(clip: MotionClip, path: str | Path) -> ManoPose:
    """Write the file; returns what it holds with what MANO's skeleton leaves out."""
    placed = clip.placed("camera")
    mano = mano_of_pose(clip.kinematics, placed.poses, clip.shape)
    rotations = mano.axis_angle.numpy()
    with replacing(Path(path)) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            global_orient=rotations[:, 0],
            hand_pose=rotations[:, 1:].reshape(len(clip), 45),
            wrist=mano.wrist.numpy(),
            residual=mano.residual.numpy(),
            joint_names=np.array(MANO_JOINTS),
            is_rhand=np.array(clip.side == "right"),
            flat_hand_mean=np.array(True),
            fps=np.array(clip.fps),
            frame=np.array(clip.frame),
            time_s=clip.seconds.numpy(),
            held=~np.array(clip.is_own),
            up=np.array(placed.up),
        )
    return mano


def clip_of_mano(
    path: str | Path, model: HandModel, shape: Float64[Tensor, "shape"] | None = None, *, side: Side | None = None
) -> tuple[MotionClip, BoneFit]:
    """The motion of a file, and what our joints cannot do of it.

    Takes our files and those of others with hand_pose (frames, 45) or poses (frames, 48). Principal components
    (fewer than 45 numbers) need the file's own hands_components. Rotations about MANO's mean posture (flat_hand_mean
    False) are added to the file's hands_mean, or to a relaxed hand of ours that is like it to some 10 degrees: the
    clip's notes say so. side: where the file has no is_rhand.

    Raises InputError naming the array and what is wrong with it.
    """
    path = Path(path)
    with opened_arrays(path, complaint="expected MANO's rotations in an .npz that can be read") as stored:
        arrays = stored.chosen(_READ)
        names = list(stored)
    if "poses" in arrays and "hand_pose" not in arrays:
        width = arrays["poses"].shape[-1] if arrays["poses"].ndim == 2 else 48
        poses = _checked(path, "poses", arrays["poses"], width if 3 < width < 48 else 48, None)
        arrays |= {"global_orient": poses[:, :3], "hand_pose": poses[:, 3:]}
    if "hand_pose" not in arrays:
        got = ", ".join(names[:5]) or "none"
        raise InputError(f"{path}: expected an array hand_pose (frames, 45) or poses (frames, 48), got {got}")
    if "joint_names" in arrays and tuple(map(str, arrays["joint_names"].reshape(-1))) != MANO_JOINTS:
        raise InputError(f"{path}: joint_names: expected MANO's {len(MANO_JOINTS)} in its order, got others")
    hand = _without_components(path, arrays)
    given = {name: arrays.get(name, np.zeros((len(hand), 3))) for name in ("global_orient", "wrist")}
    if "wrist" not in arrays and "trans" in arrays:
        given["wrist"] = arrays["trans"]
    root, wrist = (_checked(path, name, array, _SHAPES[name], len(hand)) for name, array in given.items())
    own = _side(path, arrays)
    if own is None and side is None:
        raise InputError(f"{path}: expected is_rhand, the file has none; say which side the hand is")
    if own is not None and side is not None and own != side:
        raise InputError(f"{path}: expected a {side} hand, got a {own} one (is_rhand)")
    side = own or side or "right"
    mean, notes = _zero_posture(path, arrays, model, side)
    rotations = torch.from_numpy(np.concatenate((root, hand + mean), 1)).reshape(-1, len(MANO_JOINTS), 3)
    kinematics = model.kinematics(side, dtype=torch.float64)
    fit = pose_of_mano(kinematics, rotations, torch.from_numpy(wrist))
    frame, time_s, held = _frames(arrays, len(hand))
    clip = MotionClip(
        model=model,
        side=side,
        shape=model.shape_space.default.double() if shape is None else shape,
        poses=fit.pose,
        fps=_scalar(path, arrays, _RATES, 30.0),
        name=path.stem.removesuffix(".mano"),
        up=_up(path, arrays),
        notes=notes,
        frame=frame,
        time_s=time_s,
        held=held,
    )
    return clip, fit


def is_mano_file(path: Path) -> bool:
    """Whether a file holds MANO's rotations: hand_pose, or poses without the fields of a track."""
    try:
        with opened_arrays(path, complaint="expected arrays") as stored:
            names = set(stored)
    except InputError:
        return False
    return "hand_pose" in names or ("poses" in names and "pose_std" not in names)


def _without_components(path: Path, arrays: dict[str, np.ndarray]) -> np.ndarray:
    """hand_pose (frames, 45), of principal components if need be."""
    given = arrays["hand_pose"]
    width = given.shape[-1] if given.ndim == 2 else 45
    if not 0 < width < 45 or given.dtype.kind not in "fiu":
        return _checked(path, "hand_pose", given, 45, None)
    components = arrays.get("hands_components")
    if components is None or components.ndim != 2 or components.shape[1] != 45 or len(components) < width:
        raise InputError(
            f"{path}: hand_pose: expected 45 rotations a frame, got {width} principal components, which need an array"
            f" hands_components ({width} or more, 45) in the file"
        )
    return _checked(path, "hand_pose", given, width, None) @ components[:width].astype(np.float64)


def _zero_posture(
    path: Path, arrays: dict[str, np.ndarray], model: HandModel, side: Side
) -> tuple[np.ndarray, tuple[str, ...]]:
    """What is added to the hand's rotations, (45,), and what a user should know of it."""
    if "flat_hand_mean" not in arrays or bool(arrays["flat_hand_mean"]):
        return np.zeros(45), ()
    if "hands_mean" in arrays:
        return _checked(path, "hands_mean", arrays["hands_mean"].reshape(1, -1), 45, 1)[0], ()
    relaxed = torch.zeros(len(DOFS), dtype=torch.float64)
    for joint, angle in _RELAXED_DEG.items():
        for finger in FINGERS[1:]:
            relaxed[DOFS.index(f"{finger}_{joint}_fe")] = math.radians(angle)
    mano = mano_of_pose(model.kinematics(side, dtype=torch.float64), relaxed)
    note = "flat_hand_mean is False and the file has no hands_mean: a relaxed hand of ours stands for MANO's mean"
    return mano.axis_angle[1:].reshape(-1).numpy(), (note,)


def _frames(arrays: dict[str, np.ndarray], count: int) -> tuple[tuple[int, ...], tuple[float, ...], tuple[int, ...]]:
    """Numbers, times and held frames as our own files have them; nothing where others differ from that."""
    number, time_s, held = (arrays.get(name, np.zeros(0)).reshape(-1) for name in ("frame", "time_s", "held"))
    is_numbered = len(number) == count and number.dtype.kind in "iu" and bool((np.diff(number) > 0).all())
    numbers = number if is_numbered else np.arange(count)
    is_marked = len(held) == count and held.dtype.kind == "b"
    is_timed = len(time_s) == count and time_s.dtype.kind == "f" and bool((np.diff(time_s) > 0).all())
    return (
        tuple(int(one) for one in numbers),
        tuple(time_s.tolist()) if is_timed else (),
        tuple(int(one) for one in numbers[held]) if is_marked else (),
    )


def _checked(path: Path, name: str, array: np.ndarray, width: int, frames: int | None) -> np.ndarray:
    """(frames, width) float64."""
    if array.dtype.kind not in "fiu":
        raise InputError(f"{path}: {name}: expected numbers, got {array.dtype}")
    found = array.reshape(-1, width) if array.size and array.size % width == 0 and array.ndim in (1, 2, 3) else None
    if found is None or (array.ndim > 1 and len(array) != len(found)) or (frames is not None and len(found) != frames):
        expected = f"({'frames' if frames is None else frames}, {width})"
        raise InputError(f"{path}: {name}: expected an array {expected}, got {array.shape}")
    if not np.isfinite(found).all():
        raise InputError(f"{path}: {name}: expected finite numbers, got NaN or infinite ones")
    return np.ascontiguousarray(found, dtype=np.float64)


def _side(path: Path, arrays: dict[str, np.ndarray]) -> Side | None:
    if "is_rhand" not in arrays:
        return None
    if arrays["is_rhand"].size != 1 or arrays["is_rhand"].dtype.kind not in "biuf":
        raise InputError(f"{path}: is_rhand: expected True or False, got an array of {arrays['is_rhand'].shape}")
    return "right" if bool(arrays["is_rhand"].reshape(-1)[0]) else "left"


def _scalar(path: Path, arrays: dict[str, np.ndarray], names: tuple[str, ...], default: float) -> float:
    name = next((name for name in names if name in arrays), None)
    if name is None:
        return default
    array = arrays[name]
    if array.size != 1 or array.dtype.kind not in "fiu" or not 0 < float(array.reshape(-1)[0]) <= 1e6:
        raise InputError(
            f"{path}: {name}: expected a number of frames per second, got {array.reshape(-1)[:3].tolist()}"
        )
    return float(array.reshape(-1)[0])


def _up(path: Path, arrays: dict[str, np.ndarray]) -> Up:
    found = str(arrays["up"]) if "up" in arrays else "-y"
    allowed: tuple[Up, ...] = ("y", "-y", "z", "-z")
    for up in allowed:
        if found == up:
            return up
    raise InputError(f"{path}: up: expected one of {', '.join(allowed)}, got {found[:20]!r}")
