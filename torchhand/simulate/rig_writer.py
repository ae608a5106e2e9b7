"""A hand before several cameras: rendered by each, and written as a rig's recording with truth."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.files import save_cameras
from torchhand.geometry import Camera
from torchhand.hand import Hand, HandKinematics
from torchhand.simulate.folder import (
    ABOUT_NAME,
    CAMERAS_NAME,
    TRUTH_NAME,
    VIEW_MASKS_NAME,
    VIEW_NAME,
    SequenceFolder,
    write_picture,
)
from torchhand.simulate.motion import Motion
from torchhand.simulate.scene import RenderedFrame, SceneSettings, render_sequence
from torchhand.simulate.writer import Measure, MovingHand, pose_truth

RIG_CONVENTION = (
    "keypoints3d and pose in the world of cameras.json (x right, y down, z forward of OpenCV for its cameras); the"
    " pose's rotation vector turns root_reference; in_view and is_cut per frame and camera: whether it sees the hand,"
    " and whether its picture cuts it; masks show the hand without its forearm"
)


@dataclass(frozen=True, kw_only=True)
class RigRecord:
    """What the cameras saw of the hand, a column each."""

    in_view: np.ndarray
    """Whether the camera sees the hand, (frames, cameras)."""
    is_cut: np.ndarray
    """Whether the hand reaches the picture's edge."""


def render_rig(
    kinematics: HandKinematics,
    motion: Motion,
    cameras: Sequence[Camera],
    scene: SceneSettings,
    generator: torch.Generator,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    hand: Hand | None = None,
) -> Iterator[tuple[RenderedFrame, ...]]:
    """The frames of a motion, each as every camera sees it; arguments and promises as of `render_sequence`."""
    seeds = torch.randint(0, 2**63 - 1, (len(cameras),), generator=generator).tolist()
    views = [
        render_sequence(kinematics, motion, camera, scene, torch.Generator().manual_seed(seed), shape=shape, hand=hand)
        for camera, seed in zip(cameras, seeds, strict=True)
    ]
    return zip(*views, strict=True)


def write_rig_sequence(
    out: SequenceFolder,
    rendered: Iterator[tuple[RenderedFrame, ...]],
    hand: MovingHand,
    cameras: Sequence[Camera],
    *,
    about: Mapping[str, Any] | None = None,
    measures: Mapping[str, Measure] | None = None,
) -> RigRecord:
    """Writes cameras.json, view_K/ and masks_K/ per camera, truth.npz (in the world) and about.json.

    Otherwise as `write_sequence`: whole, or not there at all. Raises InputError where the folder cannot be used or
    written.
    """
    kinematics, motion, (in_view, is_cut) = hand.kinematics, hand.motion, ([], [])
    with out.written() as folder:
        for index in range(len(cameras)):
            (folder / VIEW_NAME.format(index)).mkdir()
            (folder / VIEW_MASKS_NAME.format(index)).mkdir()
        for views in rendered:
            for index, frame in enumerate(views):
                number = f"{frame.index:04d}"
                write_picture(folder / VIEW_NAME.format(index) / f"{number}.{out.picture_format}", frame.image)
                write_picture(folder / VIEW_MASKS_NAME.format(index) / f"{number}.png", frame.mask)
            in_view.append([bool(frame.mask.any()) for frame in views])
            is_cut.append([_touches_edge(frame.mask) for frame in views])
        if len(in_view) != len(motion.poses):
            raise ValueError(f"rendered: expected {len(motion.poses)} frames, got {len(in_view)}")
        record = RigRecord(in_view=np.array(in_view), is_cut=np.array(is_cut))
        like = kinematics.default_shape
        frames = kinematics(motion.poses.to(like), hand.shape.to(like), root_reference=motion.root_reference.to(like))
        keypoints3d = frames.keypoints.double().numpy()
        truth = {"keypoints3d": keypoints3d, "in_view": record.in_view, "is_cut": record.is_cut}
        truth |= {name: measure(keypoints3d) for name, measure in (measures or {}).items()}
        truth |= pose_truth(hand, RIG_CONVENTION)
        np.savez(folder / TRUTH_NAME, **truth)  # type: ignore[arg-type]
        save_cameras(list(cameras), folder / CAMERAS_NAME)
        (folder / ABOUT_NAME).write_text(json.dumps(dict(about or {}), indent=1) + "\n", encoding="utf-8")
    return record


def _touches_edge(mask: Tensor) -> bool:
    return bool(mask[0].any() | mask[-1].any() | mask[:, 0].any() | mask[:, -1].any())
