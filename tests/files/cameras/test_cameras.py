"""cameras.json: read back what was written, and name what is wrong."""

import copy
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files.cameras.aniposelib import aniposelib_entries
from torchhand.files.cameras.cameras import camera_for, load_cameras, save_cameras
from torchhand.files.cameras.opencv import opencv_entries
from torchhand.geometry import Camera, assumed_camera

ENTRY = {
    "name": "cam0",
    "width": 640,
    "height": 480,
    "K": [[700.0, 0.0, 319.5], [0.0, 700.0, 239.5], [0.0, 0.0, 1.0]],
    "R": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "t": [0, 0, 0.5],
    "distortion": [],
}


def _write(path: Path, *entries: Any) -> Path:
    path.write_text(json.dumps({"cameras": entries, "hand": "right", "note": "free"}))
    return path


def _changed(**changes: Any) -> dict[str, Any]:
    return {**copy.deepcopy(ENTRY), **changes}


def test_reading(tmp_path: Path):
    (camera,) = load_cameras(_write(tmp_path / "cameras.json", ENTRY))
    assert (camera.name, camera.width, camera.height, camera.kind) == ("cam0", 640, 480, "pinhole")
    assert not camera.is_assumed
    # A point 1 m before the camera and 0.1 m to its right appears 70 px right of the centre.
    torch.testing.assert_close(
        camera.project(torch.tensor([0.1, 0.0, 0.5], dtype=torch.float64)),
        torch.tensor([389.5, 239.5], dtype=torch.float64),
        atol=1e-12,
        rtol=0.0,
    )


@pytest.mark.parametrize("coefficients", [0, 4, 5, 8, 12, 14])
def test_distortion_is_opencvs(tmp_path: Path, coefficients: int):
    distortion = (np.random.default_rng(coefficients).normal(size=coefficients) * 0.02).tolist()
    turn = cv2.Rodrigues(np.array([0.1, -0.2, 0.3]))[0]
    path = _write(tmp_path / "cameras.json", _changed(distortion=distortion, R=turn.tolist()))
    points = np.random.default_rng(1).uniform(-0.1, 0.1, (20, 3))
    expected, _ = cv2.projectPoints(
        points, turn, np.array([0, 0, 0.5]), np.array(ENTRY["K"]), np.array(distortion) if distortion else None
    )
    projected = load_cameras(path)[0].project(torch.from_numpy(points))
    torch.testing.assert_close(projected, torch.from_numpy(expected[:, 0]), atol=1e-8, rtol=0.0)


def test_what_is_written_comes_back_bit_for_bit(tmp_path: Path, generator: torch.Generator):
    cameras = []
    for i, kind in enumerate(("pinhole", "orthographic")):
        rotation = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64)).Q
        cameras.append(
            Camera(
                intrinsics=assumed_camera(320, 240).intrinsics,
                rotation=rotation * torch.linalg.det(rotation),
                translation=torch.randn(3, generator=generator, dtype=torch.float64),
                distortion=torch.randn(5 * (1 - i), generator=generator, dtype=torch.float64),
                width=320,
                height=240,
                kind=kind,
                name=f"view{i}",
            )
        )
    save_cameras(cameras, tmp_path / "cameras.json")
    for before, after in zip(cameras, load_cameras(tmp_path / "cameras.json"), strict=True):
        for name in ("intrinsics", "rotation", "translation", "distortion"):
            assert torch.equal(getattr(before, name), getattr(after, name))
        assert (before.name, before.kind, before.width, before.height) == (after.name, after.kind, 320, 240)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({k: v for k, v in ENTRY.items() if k not in ("R", "t")}, r"cameras\[0\]: lacks R, t; expected name, width"),
        (_changed(K=[[700.0, 0.0, 319.5], [0.0, 700.0, 239.5]]), r"K: expected a list of 3, got 2"),
        (_changed(K=[[700.0, 0.0], [0.0, 700.0], [0.0, 0.0]]), r"K\[0\]: expected a list of 3, got 2"),
        (_changed(K=[[-7.0, 0, 1], [0, 7.0, 1], [0, 0, 1]]), r"K\[0\]\[0\]: expected a positive focal length, got -7"),
        (_changed(K=[[7.0, 0, 1], [0, 7.0, 1], [0, 0, 2]]), r"K: expected \[\[fx, s, cx\]"),
        (
            _changed(K=[[7.0, 0, float("nan")], [0, 7.0, 1], [0, 0, 1]]),
            r"K\[0\]\[2\]: expected a finite number, got nan",
        ),
        (_changed(R=[[1, 0, 0], [0, 1, 0], [0, 0.001, 1]]), r"R: expected a rotation .* got an error of 0.001"),
        (_changed(R=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]), r"R: expected a rotation .* determinant -1"),
        (_changed(t=[0, 0, "1"]), r"t\[2\]: expected a finite number, got '1'"),
        (_changed(t=[0, 0, 10**400]), r"t\[2\]: expected a finite number, got 1000"),
        (_changed(t=0.5), r"t: expected a list of 3, got 0.5"),
        (_changed(distortion=[0.1, 0.2, 0.3]), r"distortion: expected a list of 0, 4, 5, 8, 12 or 14 numbers, got 3"),
        (_changed(distortion=None), r"distortion: expected a list .* got None"),
        (_changed(width=0), r"width: expected a positive whole number of px, got 0"),
        (_changed(height=480.5), r"height: expected a positive whole number of px, got 480.5"),
        (_changed(width=True), r"width: expected a positive whole number of px, got True"),
        (_changed(name=7), r"name: expected a text, got 7"),
        (_changed(model="fisheye"), r"model: expected one of pinhole, orthographic, got 'fisheye'"),
        (_changed(modle="orthographic"), r"unknown key 'modle' \(did you mean model\?\)"),
        (_changed(model="orthographic", distortion=[0.1, 0, 0, 0]), r"distortion: expected none for an orthographic"),
        ("cam0", r"cameras\[0\]: expected an object with name, width"),
    ],
)
def test_a_wrong_or_partial_entry_is_named(tmp_path: Path, entry: Any, message: str):
    path = _write(tmp_path / "cameras.json", entry)
    with pytest.raises(InputError, match=message) as caught:
        load_cameras(path)
    assert str(caught.value).startswith(f"{path}: cameras[0]")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"cameras": [\n {"name": "cam0",\n', r"cameras.json, line 3: is no valid JSON"),
        ("[]", r'expected \{"cameras": \[...\]\} with at least one camera, got \[\]'),
        ('{"cameras": []}', "with at least one camera"),
    ],
)
def test_a_file_that_holds_no_cameras(tmp_path: Path, text: str, message: str):
    (tmp_path / "cameras.json").write_text(text)
    with pytest.raises(InputError, match=message):
        load_cameras(tmp_path / "cameras.json")


def test_missing_and_binary_files(tmp_path: Path):
    with pytest.raises(InputError, match=r"cameras.json: no such file"):
        load_cameras(tmp_path / "cameras.json")
    (tmp_path / "cameras.json").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="expected a JSON text file in UTF-8"):
        load_cameras(tmp_path / "cameras.json")


def test_two_cameras_of_one_name(tmp_path: Path):
    with pytest.raises(InputError, match="a different name for every camera, got 'cam0' twice"):
        load_cameras(_write(tmp_path / "cameras.json", ENTRY, ENTRY))


def test_a_name_that_no_line_holds(tmp_path: Path):
    entry = {**ENTRY, "name": 3000 * "x"}
    with pytest.raises(InputError, match=r"name: expected a text of at most 100 characters, got 3000$"):
        load_cameras(_write(tmp_path / "cameras.json", entry, entry))
    (tmp_path / "rig.toml").write_text(f'[cam_{3000 * "x"}]\nname = "a"\n')
    (tmp_path / "rig.yml").write_text(f"%YAML:1.0\n---\n{3000 * 'x'}:\n   R: [0, 0, 1]\ny:\n   K: [1, 2]\n")
    for name, read in (("rig.toml", aniposelib_entries), ("rig.yml", opencv_entries)):
        with pytest.raises(InputError) as told:
            read(tmp_path / name)
        assert len(str(told.value)) < 500
        assert name in str(told.value)


def test_the_camera_of_a_sequence(tmp_path: Path):
    one = _write(tmp_path / "one.json", ENTRY)
    assert camera_for(one, 640, 480).intrinsics[0, 0] == 700.0
    with pytest.raises(InputError, match=r"one.json: expected a camera of 320x240 px.* got 640x480"):
        camera_for(one, 320, 240)
    two = _write(tmp_path / "two.json", ENTRY, _changed(name="cam1"))
    with pytest.raises(InputError, match=r"two.json: expected one camera, got 2 \(cam0, cam1\)"):
        camera_for(two, 640, 480)


def test_a_camera_that_is_given_must_be_one_of_such_pictures(tmp_path: Path):
    camera = load_cameras(_write(tmp_path / "one.json", ENTRY))[0]
    assert camera_for(camera, 640, 480) is camera
    with pytest.raises(InputError, match=r"^camera: expected a camera of 320x240 px.* got 640x480$"):
        camera_for(camera, 320, 240)


def test_without_a_file_a_field_of_view_is_assumed():
    camera = camera_for(None, 640, 426)
    assert camera.is_assumed
    half_width = (camera.width / 2) / float(camera.intrinsics[0, 0])
    assert np.degrees(2 * np.arctan(half_width)) == pytest.approx(55.0, abs=1e-9)


def test_all_development_cameras_load(data_dir: Path):
    files = sorted((data_dir / "synthetic").glob("*/cameras.json"))
    assert files
    for file in files:
        stored = json.loads(file.read_text())["cameras"]
        cameras = load_cameras(file)
        assert [camera.name for camera in cameras] == [entry["name"] for entry in stored]
        assert [camera.intrinsics.tolist() for camera in cameras] == [entry["K"] for entry in stored]
