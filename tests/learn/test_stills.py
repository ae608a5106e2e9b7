"""Folders of pictures with true keypoints, good and bad."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.learn.stills import load_stills


def _arrays(count: int = 3) -> dict[str, Any]:
    points = np.random.default_rng(0).normal(scale=0.05, size=(count, 21, 3)) + [0.0, 0.0, 0.5]
    matrix = np.array([[400.0, 0.0, 120.0], [0.0, 410.0, 130.0], [0.0, 0.0, 1.0]])
    names = np.array([f"{i}.jpg" for i in range(count)])
    return {"image": names, "K": np.broadcast_to(matrix, (count, 3, 3)), "keypoints3d": points.astype(np.float32)}


def test_a_folder_is_read(tmp_path: Path) -> None:
    arrays = _arrays()
    np.savez(tmp_path / "truth.npz", **arrays)
    stills = load_stills(tmp_path)
    assert stills.names == ("0.jpg", "1.jpg", "2.jpg")
    np.testing.assert_array_equal(stills.keypoints.numpy(), arrays["keypoints3d"])
    x, y, z = arrays["keypoints3d"][1, 4].astype(np.float64)
    np.testing.assert_allclose(stills.points_px[1, 4], [400 * x / z + 120, 410 * y / z + 130], rtol=1e-12)
    torch.testing.assert_close(stills.points_plane[1, 4], torch.tensor([x / z, y / z], dtype=torch.float64))


def test_the_real_pictures_can_be_read(data_dir: Path) -> None:
    folder = data_dir / "real" / "joints3d_stills"
    if not folder.is_dir():
        pytest.skip("needs joints3d_stills")
    stills = load_stills(folder)
    assert len(stills.names) == len(stills.keypoints) == 120
    assert bool(((stills.points_px > -20) & (stills.points_px < 276)).all())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": None}, "truth.npz: expected the array 'K'; got image, keypoints3d"),
        ({"image": None}, "truth.npz: expected the array 'image'; got K, keypoints3d"),
        ({"K": np.eye(3)}, r"truth.npz: K: expected finite numbers of shape \(3, 3, 3\), got float64 \(3, 3\)"),
        (
            {"keypoints3d": np.ones((3, 20, 3))},
            r"keypoints3d: expected finite numbers of shape \(3, 21, 3\), got float64",
        ),
        ({"keypoints3d": np.ones((2, 21, 3))}, r"keypoints3d: expected finite numbers of shape \(3, 21, 3\)"),
        ({"keypoints3d": np.full((3, 21, 3), np.nan)}, "keypoints3d: expected finite numbers"),
        ({"keypoints3d": -np.ones((3, 21, 3))}, "keypoints3d: expected points before the camera .z above 0., got z -1"),
        ({"keypoints3d": np.full((3, 21, 3), "a")}, "keypoints3d: expected finite numbers"),
        ({"image": np.array("a.jpg")}, r"image: expected a list of names, got an array of shape \(\)"),
        ({"image": np.array([None, 1, 2])}, "truth.npz: expected an npz file with image, K, keypoints3d; it cannot be"),
    ],
)
def test_what_is_wrong_is_named(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    arrays = {name: array for name, array in (_arrays() | change).items() if array is not None}
    np.savez(tmp_path / "truth.npz", **arrays)
    with pytest.raises(InputError, match=message):
        load_stills(tmp_path)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a folder with truth.npz; there is none"):
        load_stills(tmp_path / "gone")
    for content in (b"", b"no zip file at all", b"PK\x03\x04 half a zip file"):
        (tmp_path / "truth.npz").write_bytes(content)
        with pytest.raises(InputError, match="expected an npz file with image, K, keypoints3d"):
            load_stills(tmp_path)
    np.savez(tmp_path / "truth.npz", **_arrays(0))
    with pytest.raises(InputError, match="expected at least one picture, got none"):
        load_stills(tmp_path)
