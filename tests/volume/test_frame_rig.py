"""Hulls of the hand in a frame of four cameras: on our own mesh, and on rendered sequences of another maker's hand."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.cli.benchmarks import frame_cameras, octree
from torchhand.files import load_cameras
from torchhand.volume.carving import Carver
from torchhand.volume.carving_settings import CarvingSettings
from torchhand.volume.cube import RootCube
from torchhand.volume.field import hull_field


def test_cameras_of_the_frame_look_at_its_middle() -> None:
    for camera in frame_cameras():
        middle = camera.project(torch.zeros(1, 3, dtype=torch.float64))[0]
        assert middle.tolist() == pytest.approx([319.5, 239.5])
        assert float(torch.linalg.det(camera.rotation)) == pytest.approx(1.0)


def test_figure_of_the_benchmark_is_of_the_hull_of_dense_carving() -> None:
    figure = octree("octree_6", 1, level=6, must=1000.0, aim=500.0)
    assert figure.details["equals_dense"]
    assert figure.note == ""
    assert figure.value == figure.details[f"{figure.details['slowest']}_ms"] > 0


def test_joints_of_another_hand_are_in_its_hull(data_dir: Path) -> None:
    folder = data_dir / "synthetic" / "mv_static"
    cameras = load_cameras(folder / "cameras.json")
    frames = (0, 5, 11)
    pictures = [[cv2.imread(str(folder / f"masks_{k}" / f"{t:04d}.png"), 0) for t in frames] for k in range(4)]
    masks = [
        torch.from_numpy(np.stack([picture > 127 for picture in view if picture is not None])) for view in pictures
    ]
    joints = torch.from_numpy(np.load(folder / "truth.npz")["keypoints3d"][list(frames)]).double()
    carver = Carver(cameras, RootCube(centre=(0.0, 0.0, 0.0), side=0.512), CarvingSettings(level=7))
    hulls = carver.carve(masks)
    value, _ = hull_field(hulls).sample(joints)
    assert float(value.max()) < -0.002
    assert bool(((hulls.volume() > 2e-4) & (hulls.volume() < 2e-3)).all())
