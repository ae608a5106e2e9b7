"""Clips and results of tracking for the exporters, made on the spot."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from torchhand.export.clip import MotionClip
from torchhand.files import Track, load_hand_model, save_hand
from torchhand.files.results import CONVENTION, UNITS, write_npz
from torchhand.hand import DOFS, HandModel, Side


@pytest.fixture(scope="session")
def model() -> HandModel:
    return load_hand_model()


def _poses(model: HandModel, frames: int) -> torch.Tensor:
    """Smooth motion through the limits' range, the wrist turning about half a turn in front of a camera."""
    generator = torch.Generator().manual_seed(7)
    start, end = torch.rand(2, 30, generator=generator, dtype=torch.float64)
    fraction = torch.linspace(0, 1, frames, dtype=torch.float64)[:, None]
    skeleton = model.skeleton
    angles = skeleton.lower + (start + fraction * (end - start)) * (skeleton.upper - skeleton.lower)
    root = torch.cat(
        (0.1 * fraction, -0.05 * fraction, 0.4 + 0.1 * fraction, 1.5 * fraction, 2.0 - fraction, 0.3 + fraction), 1
    )
    return torch.cat((root, angles), 1)


@pytest.fixture(scope="session")
def clips(model: HandModel) -> dict[str, MotionClip]:
    """A right and a left hand of shapes other than the default, 7 frames at 25 per second."""
    sides: tuple[Side, ...] = ("right", "left")
    _, shapes = model.prior(dtype=torch.float64).sample(2, torch.Generator().manual_seed(3))
    return {
        side: MotionClip(model=model, side=side, shape=shape.double(), poses=_poses(model, 7), fps=25.0, name=side)
        for side, shape in zip(sides, shapes, strict=True)
    }


@pytest.fixture(params=["right", "left"])
def clip(request: pytest.FixtureRequest, clips: dict[str, MotionClip]) -> MotionClip:
    return clips[request.param]


@pytest.fixture
def make_result(tmp_path: Path, model: HandModel) -> Callable[..., Path]:
    """make_result(lost=[...], frames=6, ...) writes a result folder; lost frames hold NaN."""

    def make(
        *,
        lost: tuple[int, ...] = (),
        numbers: tuple[int, ...] | None = None,
        frames: int = 6,
        side: str = "right",
        hand_side: str | None = None,
        name: str = "result",
        dof_names: tuple[str, ...] = DOFS,
    ) -> Path:
        folder = tmp_path / name
        folder.mkdir(parents=True)
        space = model.shape_space
        save_hand(folder / "hand.json", space.names, space.default.tolist(), hand_side or side, {}, units=space.units)
        pose = _poses(model, frames).numpy().copy()
        pose[list(lost)] = np.nan
        status = np.array(["lost" if t in lost else "tracked" for t in range(frames)], dtype="<U16")
        track = Track(
            frame=np.arange(frames) if numbers is None else np.array(numbers),
            status=status,
            pose=pose,
            pose_std=np.full_like(pose, np.nan),
            keypoints3d=np.full((frames, 21, 3), np.nan),
            keypoints2d=None,
            keypoints3d_cov=np.full((frames, 21, 3, 3), np.nan),
            seconds=np.zeros(frames),
            dof_names=dof_names,
            units=UNITS,
            convention=CONVENTION,
            header={"side": side, "source": "nowhere.mp4"},
        )
        write_npz(track, folder / "track.npz")
        return folder

    return make


@pytest.fixture
def still(clips: dict[str, MotionClip]) -> MotionClip:
    """One frame."""
    return replace(clips["right"], poses=clips["right"].poses[3:4], frame=(3,))
