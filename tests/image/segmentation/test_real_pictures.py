"""Skin on photographs and video of real hands, where the development data is at hand."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.image.segmentation.silhouette import segment
from torchhand.image.segmentation.skin_start import bootstrap_skin


def read_picture(path: Path) -> torch.Tensor:
    return torch.from_numpy(cv2.imread(str(path), cv2.IMREAD_COLOR_RGB))


def read_frames(path: Path, wanted: set[int]) -> dict[int, torch.Tensor]:
    """Frames by number, read in order: some containers cannot be sought in."""
    capture, frames = cv2.VideoCapture(str(path)), {}
    for number in range(max(wanted) + 1):
        if not capture.grab():
            break
        if number in wanted:
            frames[number] = torch.from_numpy(np.ascontiguousarray(capture.retrieve()[1][..., ::-1]))
    return frames


def overlap(mask: torch.Tensor, truth: torch.Tensor) -> float:
    return float((mask & truth).sum()) / float((mask | truth).sum())


# The backgrounds of id01_1 (mustard wall) and id04_1 (red shirt) are themselves skin-like.
@pytest.mark.parametrize(
    ("name", "minimum"),
    [("id02_1", 0.93), ("id02_2", 0.93), ("id03_1", 0.93), ("id03_2", 0.94), ("id05_1", 0.9), ("id05_2", 0.89)]
    + [("id05_3", 0.93), ("id06_2", 0.87), ("id06_3", 0.89), ("id01_2", 0.88), ("id01_3", 0.85), ("id04_2", 0.87)],
)
def test_still_of_an_open_hand(data_dir: Path, name: str, minimum: float) -> None:
    folder = data_dir / "real" / "open_hand_stills"
    start = bootstrap_skin(read_picture(folder / f"5_P_hgr1_{name}.jpg"))
    truth = read_picture(folder / f"5_P_hgr1_{name}_mask.png")[..., 0] > 127
    assert start.has_skin
    assert overlap(start.mask, truth) > minimum


def test_waving_hand_is_there_until_it_leaves(data_dir: Path) -> None:
    with_hand, without = (0, 60, 110, 160), (180, 190, 204)
    frames = read_frames(data_dir / "real" / "open_hand_wave" / "hand_white.mov", {*with_hand, *without})
    first = bootstrap_skin(frames[0])
    for number in with_hand:
        start = bootstrap_skin(frames[number])
        assert start.has_skin
        assert start.separability > 1.8
        assert 0.08 < start.area_fraction < 0.14
        assert overlap(segment(frames[number], skin=first.model), start.mask) > 0.85
    for number in without:
        assert not bootstrap_skin(frames[number]).has_skin
        assert float(segment(frames[number], skin=first.model).float().mean()) < 0.004


def test_hand_and_forearm_are_the_largest_skin_before_distractors(data_dir: Path) -> None:
    """The hand sequence's frames have a yellow ball, wood and a pink sticker besides the arm."""
    frames = read_frames(data_dir / "real" / "palm_gestures" / "human_hand_video.mp4", {0, 100})
    first = bootstrap_skin(frames[0])
    for frame in frames.values():
        mask = segment(frame, skin=first.model)
        assert 0.06 < float(mask.float().mean()) < 0.09
        ys, xs = mask.nonzero(as_tuple=True)
        assert int(ys.max()) == mask.shape[0] - 1  # the forearm comes from below
        assert int(ys.min()) > 80
        assert int(xs.min()) > 560
        assert int(xs.max()) < 960


def test_synthetic_hand_against_its_exact_mask(data_dir: Path) -> None:
    for name, minimum in (("planar_open", 0.96), ("abduction28", 0.94), ("free", 0.92)):
        folder = data_dir / "synthetic" / name
        start = bootstrap_skin(read_picture(folder / "frames" / "0000.jpg"))
        truth = read_picture(folder / "masks" / "0000.png")[..., 0] > 127
        assert overlap(start.mask, truth) > minimum
