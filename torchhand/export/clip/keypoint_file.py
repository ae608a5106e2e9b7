"""The 21 keypoints over time, in files that `read_detections` and other programs read.

.json: MediaPipe's world landmarks, {"frames": [{"frame", "handedness", "hand_world_landmarks": [[{x, y, z}, ...]]}]}.
.npz: keypoints3d (frames, 21, 3), frame, side, fps; .npy: keypoints3d alone; .csv: a line per frame, columns
frame, time, wrist_x, wrist_y, wrist_z, thumb_cmc_x ... Metres, in the frame of the poses (a camera's: OpenCV).
"""

import json
from pathlib import Path

import numpy as np

from torchhand.errors import InputError
from torchhand.export.clip.motion_clip import MotionClip
from torchhand.files.disk import replacing, write_text
from torchhand.hand import KEYPOINTS

KEYPOINT_SUFFIXES = (".json", ".npz", ".npy", ".csv")


def write_keypoints(clip: MotionClip, path: str | Path) -> None:
    """Write the file; its ending says which of the forms."""
    path = Path(path)
    points = clip.frames.keypoints.numpy()
    suffix = path.suffix.lower()
    if suffix == ".json":
        write_text(path, _mediapipe(clip, points))
    elif suffix == ".csv":
        write_text(path, _table(clip, points))
    elif suffix in (".npz", ".npy"):
        with replacing(path) as temporary, temporary.open("wb") as file:
            if suffix == ".npy":
                np.save(file, points)
            else:
                frame, side, fps = np.array(clip.frame), np.array(clip.side), np.array(clip.fps)
                np.savez(file, keypoints3d=points, frame=frame, side=side, fps=fps, names=np.array(KEYPOINTS))
    else:
        raise InputError(
            f"{path}: expected keypoints as one of {', '.join(KEYPOINT_SUFFIXES)}, got {suffix or path.name!r}"
        )


def _mediapipe(clip: MotionClip, points: np.ndarray) -> str:
    """MediaPipe names a hand as if the picture were mirrored: ours is not, so the names are swapped."""
    label = "Right" if clip.side == "left" else "Left"
    frames = [
        {
            "frame": number,
            "handedness": [[{"categoryName": label, "score": 1.0}]],
            "hand_world_landmarks": [[dict(zip("xyz", point, strict=True)) for point in hand]],
        }
        for number, hand in zip(clip.frame, points.tolist(), strict=True)
    ]
    return json.dumps({"frames": frames}, allow_nan=False) + "\n"


def _table(clip: MotionClip, points: np.ndarray) -> str:
    header = ["frame", "time", *(f"{name}_{axis}" for name in KEYPOINTS for axis in "xyz")]
    lines = [",".join(header)]
    for t, (number, hand) in enumerate(zip(clip.frame, points.reshape(len(points), -1).tolist(), strict=True)):
        lines.append(",".join([str(number), repr(t / clip.fps), *map(repr, hand)]))
    return "\n".join(lines) + "\n"
