"""A simulated sequence as a folder: pictures, exact masks, camera and truth; whole, or not there at all."""

import contextlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from torch import Tensor

from torchhand.files import save_cameras, write_video
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import DOFS, HandKinematics
from torchhand.simulate.folder import (
    ABOUT_NAME,
    CAMERAS_NAME,
    FRAMES_NAME,
    MASKS_NAME,
    TRUTH_NAME,
    VIDEO_NAME,
    SequenceFolder,
    write_picture,
)
from torchhand.simulate.motion import Motion
from torchhand.simulate.scene import RenderedFrame

UNITS = "metres, radians; keypoints2d px; flexion_deg degrees"
CONVENTION = (
    "keypoints3d in the camera frame of OpenCV (x right, y down, z forward), keypoints2d with the centre of the first"
    " pixel at (0, 0); pose in the world of cameras.json, its rotation vector turns root_reference; masks show the hand"
    " without its forearm"
)

Measure = Callable[[Float[np.ndarray, "frames 21 3"]], np.ndarray]
"""Makes a further array of the truth from all keypoints."""


@dataclass(frozen=True, kw_only=True)
class MovingHand:
    """The hand of a sequence: its skeleton, proportions and motion."""

    kinematics: HandKinematics
    shape: Float[Tensor, "shape"]
    motion: Motion


def write_sequence(
    out: SequenceFolder,
    rendered: Iterator[RenderedFrame],
    hand: MovingHand,
    camera: Camera,
    *,
    with_video: bool = False,
    about: Mapping[str, Any] | None = None,
    measures: Mapping[str, Measure] | None = None,
) -> None:
    """Writes frames/, masks/, cameras.json, truth.npz, about.json, and video.mp4 if wanted.

    Everything grows in a folder beside `out` and takes its name when all is there; when `rendered` raises, or the
    disk refuses, nothing is left and what was there before stays. `about` is saved as it is; `measures` adds arrays to
    the truth.

    Raises InputError where the folder cannot be used (see `check_sequence_folder`) or written.
    """
    motion, (points_3d, points_2d, in_view) = hand.motion, ([], [], [])
    with out.written() as folder, contextlib.ExitStack() as stack:
        (folder / FRAMES_NAME).mkdir()
        (folder / MASKS_NAME).mkdir()
        video = None
        if with_video:
            size = {"width": camera.width, "height": camera.height}
            video = stack.enter_context(write_video(folder / VIDEO_NAME, **size, fps=motion.fps))
        for frame in rendered:
            write_picture(folder / FRAMES_NAME / f"{frame.index:04d}.{out.picture_format}", frame.image)
            write_picture(folder / MASKS_NAME / f"{frame.index:04d}.png", frame.mask)
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
        truth |= pose_truth(hand)
        np.savez(folder / TRUTH_NAME, **truth)  # type: ignore[arg-type]
        save_cameras([camera], folder / CAMERAS_NAME)
        (folder / ABOUT_NAME).write_text(json.dumps(dict(about or {}), indent=1) + "\n", encoding="utf-8")


def pose_truth(hand: MovingHand, convention: str = CONVENTION) -> dict[str, np.ndarray]:
    """What truth.npz holds of poses and shape."""
    motion, space = hand.motion, hand.kinematics.shape_space
    rotation = rotation_from_vector(motion.poses[:, 3:6]) @ motion.root_reference
    return {
        "frame": np.arange(len(motion.poses)),
        "pose": motion.poses.numpy(),
        "dof_names": np.array(DOFS),
        "root_reference": motion.root_reference.numpy(),
        "root_rotation": rotation.numpy(),
        "shape": hand.shape.double().cpu().numpy(),
        "shape_names": np.array(space.names),
        "shape_units": np.array(space.units),
        "side": np.array(hand.kinematics.side),
        "fps": np.array(motion.fps),
        "units": np.array(UNITS),
        "convention": np.array(convention),
    }
