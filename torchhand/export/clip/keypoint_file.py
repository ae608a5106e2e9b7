"""The 21 keypoints over time, in files that `read_detections` and other programs read.

.json: MediaPipe's world landmarks, {"frames": [{"frame", "time_s", "held", "handedness", "hand_world_landmarks":
[[{x, y, z}, ...]], "covariances": 21 of 3 by 3}]}. .npz: keypoints3d (frames, 21, 3), frame, time_s, held, side, fps,
names, cov3d (frames, 21, 3, 3) m². .npy: keypoints3d alone. .csv: a line per frame, columns frame, time_s, held,
wrist_x, wrist_y, wrist_z, thumb_cmc_x …, then wrist_xx, wrist_xy, wrist_xz, wrist_yy, wrist_yz, wrist_zz …. Metres, in
the frame of the poses (a camera's: OpenCV) unless other axes are asked for. Covariances stand where they are known.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from torchhand.errors import InputError
from torchhand.export.clip.motion_clip import MotionClip
from torchhand.files.disk import replacing, write_text
from torchhand.hand import KEYPOINTS

KEYPOINT_SUFFIXES = (".json", ".npz", ".npy", ".csv")
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def write_keypoints(clip: MotionClip, path: str | Path) -> None:
    """Write the file; its ending says which of the forms."""
    path, placed = Path(path), clip.placed("camera")
    points = placed.frames.keypoints.numpy()
    suffix = path.suffix.lower()
    if suffix == ".json":
        write_text(path, _mediapipe(placed, points))
    elif suffix == ".csv":
        write_text(path, _table(placed, points))
    elif suffix in (".npz", ".npy"):
        with replacing(path) as temporary, temporary.open("wb") as file:
            if suffix == ".npy":
                np.save(file, points)
            else:
                np.savez(file, **_arrays(placed, points))  # pyright: ignore[reportArgumentType] - the stub lacks it
    else:
        raise InputError(
            f"{path}: expected keypoints as one of {', '.join(KEYPOINT_SUFFIXES)}, got {suffix or path.name!r}"
        )


def _arrays(clip: MotionClip, points: np.ndarray) -> dict[str, np.ndarray]:
    arrays = {
        "keypoints3d": points,
        "frame": np.array(clip.frame),
        "time_s": clip.seconds.numpy(),
        "held": ~np.array(clip.is_own),
        "side": np.array(clip.side),
        "fps": np.array(clip.fps),
        "names": np.array(KEYPOINTS),
    }
    return arrays if clip.keypoints_cov is None else arrays | {"cov3d": clip.keypoints_cov.numpy()}


def _mediapipe(clip: MotionClip, points: np.ndarray) -> str:
    """MediaPipe names a hand as if the picture were mirrored: ours is not, so the names are swapped."""
    label = "Right" if clip.side == "left" else "Left"
    frames: list[dict[str, Any]] = [
        {
            "frame": number,
            "time_s": second,
            "held": not is_own,
            "handedness": [[{"categoryName": label, "score": 1.0}]],
            "hand_world_landmarks": [[dict(zip("xyz", point, strict=True)) for point in hand]],
        }
        for number, second, is_own, hand in zip(
            clip.frame, clip.seconds.tolist(), clip.is_own, points.tolist(), strict=True
        )
    ]
    if clip.keypoints_cov is not None:
        for frame, cov in zip(frames, clip.keypoints_cov, strict=True):
            if bool(cov.isfinite().all()):
                frame["covariances"] = cov.tolist()
    return json.dumps({"frames": frames}, allow_nan=False) + "\n"


def _table(clip: MotionClip, points: np.ndarray) -> str:
    header = ["frame", "time_s", "held", *(f"{name}_{axis}" for name in KEYPOINTS for axis in "xyz")]
    rows = points.reshape(len(points), -1)
    if clip.keypoints_cov is not None:
        header += [f"{name}_{'xyz'[i]}{'xyz'[j]}" for name in KEYPOINTS for i, j in _PAIRS]
        entries = [clip.keypoints_cov[:, :, i, j].numpy() for i, j in _PAIRS]
        rows = np.concatenate((rows, np.stack(entries, -1).reshape(len(points), -1)), 1)
    lines = [",".join(header)]
    for number, second, is_own, row in zip(clip.frame, clip.seconds.tolist(), clip.is_own, rows.tolist(), strict=True):
        cells = [repr(value) if math.isfinite(value) else "" for value in row]
        lines.append(",".join([str(number), repr(second), str(int(not is_own)), *cells]))
    return "\n".join(lines) + "\n"
