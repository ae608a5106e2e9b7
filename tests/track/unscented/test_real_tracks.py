"""The contour tracker on the development data, against the truth that comes with it."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from torchhand.evaluate import planar_motion_errors
from torchhand.files import find_config, load_cameras, load_hand_model, load_settings, open_source
from torchhand.geometry import Camera, assumed_camera
from torchhand.track import Estimate, Tracker, TrackerSettings, View


def _tracked(
    source: Path,
    *,
    config: str,
    side: str = "right",
    camera: Camera | None = None,
    frames: int | None = None,
    **options: Any,
) -> list[Estimate]:
    changes = {name: options.pop(name) for name in ("posture",) if name in options}
    settings = load_settings(TrackerSettings(**changes), find_config(config))
    hand = load_hand_model().hand(side="left" if side == "left" else "right", dtype=torch.float64)
    state, estimates = None, []
    with open_source(source, max_frames=frames) as pictures:
        tracker = Tracker(hand, camera or assumed_camera(pictures.width, pictures.height), settings, **options)
        for index, frame in enumerate(pictures):
            state, estimate = tracker.step(state, (View(image=frame.image),), index / pictures.fps)
            estimates.append(estimate)
    return estimates


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "posture", "has_points", "max_px", "max_deg"),
    [
        ("planar_open", "open", False, 1.0, 0.7),
        ("planar_point", "point", False, 1.0, 0.7),
        ("planar_clutter", "open", True, 1.5, 1.0),
    ],
)
def test_planar_motion_of_a_foreign_hand(
    name: str, posture: str, has_points: bool, max_px: float, max_deg: float, data_dir: Path
) -> None:
    folder = data_dir / "synthetic" / name
    if not folder.is_dir():
        pytest.skip(f"needs {folder}")
    truth = np.load(folder / "truth.npz")["keypoints2d"]
    points = (*truth[0, 0].tolist(), *truth[0, 12].tolist()) if has_points else None
    estimates = _tracked(
        folder / "frames",
        config="contour_planar",
        camera=load_cameras(folder / "cameras.json")[0],
        posture=posture,
        start_points=points,
    )
    assert [estimate.status for estimate in estimates] == ["tracked"] * len(truth)
    found = np.stack([estimate.keypoints_px[0].numpy() for estimate in estimates if estimate.keypoints_px is not None])
    errors = planar_motion_errors(found, truth)
    assert errors is not None
    assert math.sqrt(float(np.mean(errors.displacement_px[1:] ** 2))) <= max_px
    assert math.sqrt(float(np.mean(errors.rotation_deg[1:] ** 2))) <= max_deg


def test_a_real_hand_waves(data_dir: Path) -> None:
    video = data_dir / "real" / "open_hand_wave" / "hand_white.mov"
    if not video.is_file():
        pytest.skip(f"needs {video}")
    estimates = _tracked(video, config="contour_planar_scale", side="left", frames=40)
    assert [estimate.status for estimate in estimates] == ["tracked"] * 40
    overlaps = [estimate.overlap or 0.0 for estimate in estimates]
    assert float(np.median(overlaps)) >= 0.85
    assert min(overlaps) > 0.85
    points = torch.stack([e.keypoints_px[0] for e in estimates if e.keypoints_px is not None])
    assert float((points - points[0]).norm(dim=-1).max()) > 5.0  # it moves


@pytest.mark.slow
def test_a_real_hand_that_leaves_is_lost(data_dir: Path) -> None:
    video = data_dir / "real" / "open_hand_wave" / "hand_white.mov"
    if not video.is_file():
        pytest.skip(f"needs {video}")
    status = [e.status for e in _tracked(video, config="contour_planar_scale", side="left")]
    assert status[:171] == ["tracked"] * 171
    assert set(status[180:]) <= {"lost", "no_hand"}  # the bare wall
