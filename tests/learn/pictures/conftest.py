"""A small recording of a simulated hand, detected, and a small training from it."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.learn.pictures import PictureTraining
from torchhand.simulate import CropMaker, CropSettings

SMALL = PictureTraining(
    steps=4,
    recorded_steps=4,
    batch=8,
    recorded_batch=4,
    pool=64,
    held_out=16,
    width=4,
    hidden=16,
    blocks=1,
    views=2,
    energy_hands=0,
)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Pictures and a file with points, and the same seen in a mirror."""

    pictures: Path
    points: Path
    mirrored_pictures: Path
    mirrored_points: Path
    points_px: np.ndarray


@pytest.fixture(scope="session")
def small_training() -> PictureTraining:
    return SMALL


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Right hands in one folder, left ones in another: eight frames, in one of which no hand was detected."""
    folder, generator = tmp_path_factory.mktemp("recording"), torch.Generator().manual_seed(5)
    settings = CropSettings(side_px=160, left=0.0, forearm=0.0, occluder=0.0, noise=(0.0, 0.0), fill=(0.5, 0.6))
    crops = next(CropMaker(load_hand_model(), settings, generator).batches(2, generator))
    points = crops.keypoints_px.numpy().copy()
    points[3] = np.nan
    paths = []
    for name, label, turned in (("right", "Left", False), ("left", "Right", True)):  # as MediaPipe names them
        (folder / name).mkdir()
        for index, (image, mask) in enumerate(zip(crops.image.numpy(), crops.mask.numpy(), strict=True)):
            picture = np.where(mask[..., None], (196, 148, 124), (70, 90, 120)).astype(np.uint8) // 2 + image // 8
            picture = np.ascontiguousarray(picture[:, ::-1] if turned else picture)
            cv2.imwrite(str(folder / name / f"{index:03d}.png"), picture[..., ::-1])
        own = np.stack((159 - points[..., 0], points[..., 1]), -1) if turned else points
        labels = np.array([label] * 8)
        np.savez(folder / f"{name}.npz", points_px=own.astype(np.float32), label=labels)
        paths += [folder / name, folder / f"{name}.npz"]
    names = ("pictures", "points", "mirrored_pictures", "mirrored_points")
    return Recording(**dict(zip(names, paths, strict=True)), points_px=points)
