"""A simulated sequence as a folder: pictures, exact masks, camera and truth; whole, or not there at all."""

import contextlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files import save_cameras, write_video
from torchhand.files.safe_write import explained_errors
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import DOFS, HandKinematics
from torchhand.simulate.motion import Motion
from torchhand.simulate.scene import RenderedFrame

PictureFormat = Literal["jpg", "png"]

FRAMES_NAME, MASKS_NAME, TRUTH_NAME = "frames", "masks", "truth.npz"
CAMERAS_NAME, VIDEO_NAME, ABOUT_NAME = "cameras.json", "video.mp4", "about.json"
SEQUENCE_NAMES = (FRAMES_NAME, MASKS_NAME, TRUTH_NAME, CAMERAS_NAME, VIDEO_NAME, ABOUT_NAME)
"""What a sequence folder may hold."""

UNITS = "metres, radians; keypoints2d px; flexion_deg degrees"
CONVENTION = (
    "keypoints3d in the camera frame of OpenCV (x right, y down, z forward), keypoints2d with the centre of the first"
    " pixel at (0, 0); pose in the world of cameras.json, its rotation vector turns root_reference; masks show the hand"
    " without its forearm"
)

_JPEG_QUALITY = 95

Measure = Callable[[Float[np.ndarray, "frames 21 3"]], np.ndarray]
"""Makes a further array of the truth from all keypoints."""


def write_sequence(
    out_dir: str | Path,
    rendered: Iterator[RenderedFrame],
    motion: Motion,
    camera: Camera,
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
    *,
    picture_format: PictureFormat = "jpg",
    with_video: bool = False,
    overwrite: bool = False,
    about: Mapping[str, Any] | None = None,
    measures: Mapping[str, Measure] | None = None,
) -> None:
    """Writes frames/, masks/, cameras.json, truth.npz, about.json, and video.mp4 if wanted.

    Everything grows in a folder beside `out_dir` and takes its name when all is there; when `rendered` raises, or the
    disk refuses, nothing is left and what was there before stays. `about` is saved as it is; `measures` adds arrays to
    the truth.

    Raises InputError where the folder cannot be used (see `check_sequence_folder`) or written.
    """
    out_dir = Path(out_dir)
    check_sequence_folder(out_dir, overwrite=overwrite)
    points_3d, points_2d, in_view = [], [], []
    with _whole_folder(out_dir) as folder, contextlib.ExitStack() as stack:
        (folder / FRAMES_NAME).mkdir()
        (folder / MASKS_NAME).mkdir()
        video = None
        if with_video:
            size = {"width": camera.width, "height": camera.height}
            video = stack.enter_context(write_video(folder / VIDEO_NAME, **size, fps=motion.fps))
        for frame in rendered:
            _write_picture(folder / FRAMES_NAME / f"{frame.index:04d}.{picture_format}", frame.image)
            _write_picture(folder / MASKS_NAME / f"{frame.index:04d}.png", frame.mask)
            points_3d.append(frame.keypoints_cam.double().numpy())
            points_2d.append(frame.keypoints_px.double().numpy())
            in_view.append(bool(frame.mask.any()))
            if video is not None:
                video.write(frame.image)
        if len(points_3d) != len(motion.poses):
            raise ValueError(f"rendered: expected {len(motion.poses)} frames, got {len(points_3d)}")
        keypoints3d = np.stack(points_3d)
        truth = {"keypoints3d": keypoints3d, "keypoints2d": np.stack(points_2d), "in_view": np.array(in_view)}
        truth |= {name: measure(keypoints3d) for name, measure in (measures or {}).items()}
        truth |= _pose_truth(motion, kinematics, shape)
        np.savez(folder / TRUTH_NAME, **truth)  # type: ignore[arg-type]
        save_cameras([camera], folder / CAMERAS_NAME)
        (folder / ABOUT_NAME).write_text(json.dumps(dict(about or {}), indent=1) + "\n", encoding="utf-8")


def check_sequence_folder(out_dir: str | Path, *, overwrite: bool = False) -> None:
    """Raise InputError where no sequence may be written: a file, or a folder with something in it.

    With `overwrite` an older sequence may be replaced, but no folder that holds anything else.
    """
    path = Path(out_dir)
    with explained_errors(path):
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: expected a folder for the sequence, got a file")
        content = sorted(entry.name for entry in path.iterdir()) if path.is_dir() else []
    if content and not overwrite:
        names = ", ".join(content[:3]) + (", ..." if content[3:] else "")
        raise InputError(
            f"{path}: the output folder exists and is not empty ({names}); give another, or --overwrite to replace the"
            " sequence in it"
        )
    foreign = [name for name in content if name not in SEQUENCE_NAMES]
    if foreign:
        raise InputError(
            f"{path}: cannot be replaced: it holds {foreign[0]}, which is no part of a simulated sequence"
            f" ({', '.join(SEQUENCE_NAMES)})"
        )


def _pose_truth(motion: Motion, kinematics: HandKinematics, shape: Tensor) -> dict[str, np.ndarray]:
    rotation = rotation_from_vector(motion.poses[:, 3:6]) @ motion.root_reference
    return {
        "frame": np.arange(len(motion.poses)),
        "pose": motion.poses.numpy(),
        "dof_names": np.array(DOFS),
        "root_reference": motion.root_reference.numpy(),
        "root_rotation": rotation.numpy(),
        "shape": shape.double().cpu().numpy(),
        "shape_names": np.array(kinematics.shape_space.names),
        "shape_units": np.array(kinematics.shape_space.units),
        "side": np.array(kinematics.side),
        "fps": np.array(motion.fps),
        "units": np.array(UNITS),
        "convention": np.array(CONVENTION),
    }


def _write_picture(path: Path, picture: UInt8[Tensor, "height width 3"] | Bool[Tensor, "height width"]) -> None:
    pixels = picture.cpu().numpy()
    pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR) if pixels.ndim == 3 else pixels.astype(np.uint8) * 255
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if path.suffix == ".jpg" else []
    _, encoded = cv2.imencode(path.suffix, pixels, options)
    path.write_bytes(encoded.tobytes())  # so that the system says why it refuses


@contextlib.contextmanager
def _whole_folder(path: Path) -> Iterator[Path]:
    """A temporary folder beside `path` that takes its place when the block ends well, and is removed otherwise."""
    temporary, replaced = path.with_name(f".{path.name}.partial"), path.with_name(f".{path.name}.replaced")
    with explained_errors(path):
        try:
            shutil.rmtree(temporary, ignore_errors=True)
            temporary.mkdir(parents=True)
            yield temporary
            if path.exists():
                shutil.rmtree(replaced, ignore_errors=True)
                os.replace(path, replaced)
            os.replace(temporary, path)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise
        finally:
            if path.exists():
                shutil.rmtree(replaced, ignore_errors=True)
            elif replaced.exists():
                os.replace(replaced, path)
