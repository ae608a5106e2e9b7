"""Truth files, whole and broken."""

from pathlib import Path

import numpy as np
import pytest

from torchhand.errors import InputError
from torchhand.evaluate.truth import load_truth


def test_a_folder_and_its_file_hold_the_same(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(scale=0.05, size=(4, 21, 3)).astype(np.float32)
    np.savez(tmp_path / "truth.npz", keypoints3d=points, other=np.arange(3))
    for path in (tmp_path, tmp_path / "truth.npz"):
        truth = load_truth(path)
        assert truth.frames == 4
        assert truth.keypoints3d is not None
        np.testing.assert_array_equal(truth.keypoints3d, points.astype(np.float64))
        assert truth.keypoints2d is None


def test_masks_are_found_by_their_numbers(tmp_path: Path) -> None:
    (tmp_path / "masks").mkdir()
    for name in ("cam0_0007.png", "10.png", "readme.txt", "none.png"):
        (tmp_path / "masks" / name).touch()
    truth = load_truth(tmp_path)
    assert truth.frames is None
    assert {number: file.name for number, file in truth.mask_files.items()} == {7: "cam0_0007.png", 10: "10.png"}


def test_the_project_truth_is_read(data_dir: Path) -> None:
    truth = load_truth(data_dir / "synthetic" / "planar_open")
    assert truth.frames == 100
    assert sorted(truth.mask_files) == list(range(100))


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"pose": np.zeros((3, 36))}, "expected at least one of keypoints3d, keypoints2d, flexion_deg; got pose"),
        (
            {"keypoints3d": np.zeros((3, 21, 2))},
            r"keypoints3d: expected numbers of shape \(frames, 21, 3\), got \(3, 21, 2\)",
        ),
        (
            {"keypoints3d": np.zeros((3, 21, 3)), "flexion_deg": np.zeros((4, 5, 3))},
            "expected arrays of one length, got keypoints3d 3, flexion_deg 4",
        ),
        ({"keypoints2d": np.full((3, 21, 2), np.nan)}, "keypoints2d: expected known numbers, got none in 3 frames"),
        (
            {"keypoints3d": 90.0 * np.arange(63.0).reshape(1, 21, 3) / 27 / 3**0.5},
            "keypoints3d: expected metres, in which the middle finger's MCP is some 0.09 from the wrist, got 90",
        ),
    ],
)
def test_wrong_arrays_are_named(tmp_path: Path, arrays: dict[str, np.ndarray], message: str) -> None:
    np.savez(tmp_path / "truth.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        load_truth(tmp_path)


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 cut off"])
def test_a_broken_file_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "truth.npz").write_bytes(content)
    with pytest.raises(InputError, match=r"truth.npz: expected an npz file .* cannot be read as one"):
        load_truth(tmp_path)


def test_missing_places_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone: expected a folder with truth.npz, or that file; there is nothing"):
        load_truth(tmp_path / "gone")
    with pytest.raises(InputError, match=r"expected truth.npz or masks/ in this folder; neither is there"):
        load_truth(tmp_path)
