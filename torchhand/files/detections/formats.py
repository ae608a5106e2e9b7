"""Reading the keypoints of a hand from any of the files that detectors write."""

from pathlib import Path
from typing import Literal

from torchhand.errors import InputError
from torchhand.files.detections.keypoint_arrays import read_keypoint_arrays
from torchhand.files.detections.mediapipe_json import mediapipe_detections
from torchhand.files.detections.openpose_json import openpose_detections, read_openpose_folder
from torchhand.files.detections.record import Detections, Side, Units
from torchhand.files.detections.rig_arrays import read_rig_arrays
from torchhand.files.disk import expanded, read_json

__all__ = ["Detections", "read_detections", "read_rig_detections"]


def read_detections(
    path: str | Path,
    *,
    side: Side | None = None,
    points: Literal["auto", "space", "picture"] = "auto",
    units: Units | None = None,
    is_mirrored: bool = False,
) -> Detections:
    """The keypoints of one hand in a file or folder: JSON of MediaPipe or OpenPose, npz or npy arrays.

    side: which hand, where the file has both; without it the one seen more often. points: of files with both, "space"
    reads those in space alone (MediaPipe's world landmarks: metres, about the hand's centre), "picture" those in the
    pictures alone, auto both. units: of arrays, where their numbers do not tell. is_mirrored: MediaPipe names the
    hand as if the picture were a mirror image (a selfie); True says it was one, so its names hold, False swaps them.

    Raises InputError naming the file (and the frame), what was expected and what was got.
    """
    path = expanded(path)
    if path.is_dir():
        return read_openpose_folder(path, side=side)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    suffix = path.suffix.lower()
    if suffix in (".npz", ".npy"):
        return read_keypoint_arrays(path, side=side, units=units, points=points, is_mirrored=is_mirrored)
    if suffix != ".json":
        raise InputError(
            f"{path}: expected keypoints as .json (MediaPipe, OpenPose), .npz, .npy, or a folder of OpenPose's .json,"
            f" got {suffix or 'a file without suffix'}"
        )
    content = read_json(path)
    if isinstance(content, dict) and "people" in content:
        return openpose_detections([(path, 0, content)], side=side)
    return mediapipe_detections(path, content, side=side, points=points, is_mirrored=is_mirrored)


def read_rig_detections(
    path: str | Path, *, side: Side | None = None, units: Units | None = None, is_mirrored: bool = False
) -> list[Detections] | None:
    """The keypoints of one hand before all cameras in one file of arrays (cameras, frames, 21, 2), npy or npz; None
    where a file or folder is not of that kind.

    Raises InputError naming the file and the array, what was expected and what was got.
    """
    path = Path(path).expanduser()
    if path.suffix.lower() not in (".npz", ".npy") or not path.is_file():
        return None
    return read_rig_arrays(path, side=side, units=units, is_mirrored=is_mirrored)
