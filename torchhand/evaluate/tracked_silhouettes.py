"""The silhouettes of a tracked hand, drawn from what a result folder holds."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool

from torchhand.errors import InputError
from torchhand.files import Track, camera_of_entry, load_hand, load_hand_model
from torchhand.hand import DOFS
from torchhand.view import HandProjector

MaskOfFrame = Callable[[int], Bool[np.ndarray, "height width"] | None]
"""The hand's silhouette in the frame of a number; None where there is none."""


def tracked_projector(track: Track, hand_file: Path) -> HandProjector:
    """What projects the poses of a single camera's track into its pictures: the fitted hand and the header's camera.

    The poses are in the camera frame, whatever place in the world the header gives the camera.

    Raises:
        InputError: the track lacks its side or camera or has other degrees of freedom, or the file holds no such hand.
    """
    where = f"{hand_file.parent}: track"
    side = track.header.get("side")
    if side not in ("left", "right"):
        raise InputError(f"{where}: side: expected left or right, got {side!r}")
    if track.dof_names != DOFS:
        raise InputError(f"{where}: dof_names: expected the {len(DOFS)} of this version's hand, got others")
    camera = camera_of_entry(f"{where}: camera", track.header.get("camera"))
    camera = replace(
        camera, rotation=torch.eye(3, dtype=torch.float64), translation=torch.zeros_like(camera.translation)
    )
    kinematics = load_hand_model().kinematics(side, dtype=torch.float64)
    values = load_hand(hand_file, kinematics.shape_space.names).values
    return HandProjector(kinematics, camera, torch.tensor(list(values.values()), dtype=torch.float64))


def tracked_silhouettes(track: Track, projector: HandProjector) -> MaskOfFrame:
    """The silhouette by frame number; None for numbers that the track lacks or whose pose is unknown."""
    poses = {int(frame): pose for frame, pose in zip(track.frame, track.pose, strict=True) if np.isfinite(pose).all()}
    reference = torch.eye(3, dtype=torch.float64)  # a track's root rotation is the whole rotation

    def silhouette(number: int) -> Bool[np.ndarray, "height width"] | None:
        pose = poses.get(number)
        return None if pose is None else projector.silhouette(torch.from_numpy(pose), reference).numpy()

    return silhouette
