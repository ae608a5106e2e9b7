"""Rigs from every format give the same cameras; what is wrong with one is named."""

import copy
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files.cameras import save_cameras
from torchhand.files.rigs.rig import load_rig, rig_notes
from torchhand.geometry import Camera, rotation_from_vector

TURNS = ((0.0, 0.0, 0.0), (0.1, 0.7, 0.05), (-0.8, 0.1, 0.0))


def _camera(index: int, turn: tuple[float, float, float]) -> Camera:
    """0.5 m from the origin, looking a little beside it."""
    return Camera(
        intrinsics=torch.tensor([[600.0 + index, 0, 318.5], [0, 598.0, 241.25], [0, 0, 1]], dtype=torch.float64),
        rotation=rotation_from_vector(torch.tensor(turn, dtype=torch.float64)),
        translation=torch.tensor((0.01 * index, -0.02, 0.5), dtype=torch.float64),
        distortion=torch.tensor([-0.1, 0.02, 0.001, -0.002], dtype=torch.float64),
        width=640,
        height=480,
        name=f"cam{index}",
    )


CAMERAS = [_camera(i, turn) for i, turn in enumerate(TURNS)]


def same(found: Sequence[Camera], expected: Sequence[Camera] = CAMERAS, *, names: bool = True) -> None:
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        for field in ("intrinsics", "rotation", "translation", "distortion"):
            torch.testing.assert_close(getattr(a, field), getattr(b, field), atol=1e-9, rtol=1e-9)
        assert (a.width, a.height) == (b.width, b.height)
        assert not names or a.name == b.name


def storage(path: Path, values: dict[str, Any]) -> Path:
    """Written by OpenCV itself; dictionaries become mappings."""

    def put(values: dict[str, Any]) -> None:
        for key, value in values.items():
            if isinstance(value, dict):
                file.startWriteStruct(key, cv2.FileNode_MAP)
                put(value)
                file.endWriteStruct()
            else:
                file.write(key, value)

    file = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    put(values)
    file.release()
    return path


def numbers(camera: Camera, *, end: str = "") -> dict[str, Any]:
    return {
        f"K{end}": camera.intrinsics.numpy(),
        f"D{end}": camera.distortion.numpy()[None],
        f"R{end}": camera.rotation.numpy(),
        f"T{end}": camera.translation.numpy()[:, None],
    }


SIZE = {"image_width": 640, "image_height": 480}


def test_cameras_json_by_file_and_by_folder(tmp_path: Path) -> None:
    save_cameras(CAMERAS, tmp_path / "cameras.json")
    same(load_rig(tmp_path / "cameras.json"))
    same(load_rig(tmp_path))
    assert rig_notes(load_rig(tmp_path)) == []


@pytest.mark.parametrize("suffix", ["yml", "yaml", "xml"])
def test_opencv_one_file_per_camera(tmp_path: Path, suffix: str) -> None:
    for camera in CAMERAS:
        names = ("camera_matrix", "distortion_coefficients", "R", "T")
        values = dict(zip(names, numbers(camera).values(), strict=True))
        storage(tmp_path / f"{camera.name}.{suffix}", SIZE | values)
    same(load_rig(tmp_path))


def test_opencv_several_cameras_in_one_file(tmp_path: Path) -> None:
    nested = {camera.name: SIZE | numbers(camera) for camera in CAMERAS}
    same(load_rig(storage(tmp_path / "nested.yml", nested)))
    numbered = dict(SIZE)
    for i, camera in enumerate(CAMERAS):
        numbered |= numbers(camera, end=f"_{i}")
    same(load_rig(storage(tmp_path / "numbered.xml", numbered)))


def test_opencv_rotation_vector_and_size_as_pair(tmp_path: Path) -> None:
    camera = CAMERAS[1]
    vector = cv2.Rodrigues(camera.rotation.numpy())[0]
    values = numbers(camera) | {"R": vector, "image_size": np.array([640, 480])}
    same(load_rig(storage(tmp_path / "cam1.yml", values)), [camera])


def test_opencv_stereo_pair(tmp_path: Path) -> None:
    """R and T of stereoCalibrate lead from the first camera to the second."""
    pair = [replace(CAMERAS[0], rotation=torch.eye(3).double(), translation=torch.zeros(3).double()), CAMERAS[1]]
    values = {"M1": pair[0].intrinsics.numpy(), "D1": pair[0].distortion.numpy()}
    values |= {"M2": pair[1].intrinsics.numpy(), "D2": pair[1].distortion.numpy()}
    values |= {"R": pair[1].rotation.numpy(), "T": pair[1].translation.numpy()}
    same(load_rig(storage(tmp_path / "stereo.yml", values), size=(640, 480)), pair, names=False)


def test_yaml_of_other_tools(tmp_path: Path) -> None:
    """Matrices as rows, cols and data, without OpenCV's tags."""
    (tmp_path / "camera.yaml").write_text(
        "image_width: 640\nimage_height: 480\ncamera_name: left\n"
        "camera_matrix: {rows: 3, cols: 3, data: [600., 0., 318.5, 0., 598., 241.25, 0., 0., 1.]}\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.02, 0.001, -0.002, 0.]}\n"
    )
    (camera,) = load_rig(tmp_path / "camera.yaml")
    assert camera.name == "left"
    assert camera.distortion.tolist() == [-0.1, 0.02, 0.001, -0.002, 0.0]
    assert camera.translation.tolist() == [0.0, 0.0, 0.0]


def colmap(folder: Path, lenses: list[str], *, names: tuple[str, ...] = ("cam0.jpg", "cam1.jpg", "cam2.jpg")) -> Path:
    lines = ["# Image list with two lines of data per image:"]
    for i, (camera, name) in enumerate(zip(CAMERAS, names, strict=True)):
        x, y, z = rotation_vector(camera)
        angle = math.sqrt(x * x + y * y + z * z)
        fraction = math.sin(angle / 2) / angle if angle else 0.0
        quaternion = (math.cos(angle / 2), x * fraction, y * fraction, z * fraction)
        words = [i + 1, *map(repr, quaternion), *map(repr, camera.translation.tolist()), min(i + 1, len(lenses)), name]
        lines += [" ".join(map(str, words)), "10.5 20.5 -1 30.0 40.0 7" if i else ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    (folder / "cameras.txt").write_text("# Camera list\n" + "\n".join(lenses) + "\n")
    return folder


def rotation_vector(camera: Camera) -> list[float]:
    return cv2.Rodrigues(camera.rotation.numpy())[0][:, 0].tolist()


def test_colmap(tmp_path: Path) -> None:
    """The centre of COLMAP's first pixel is (0.5, 0.5)."""
    lenses = [f"{i + 1} OPENCV 640 480 {600 + i} 598 319 241.75 -0.1 0.02 0.001 -0.002" for i in range(3)]
    same(load_rig(colmap(tmp_path, lenses)))
    same(load_rig(tmp_path / "images.txt"))


@pytest.mark.parametrize(
    ("line", "focal", "distortion"),
    [
        ("1 SIMPLE_PINHOLE 640 480 610 319 241.75", (610, 610), []),
        ("1 PINHOLE 640 480 610 605 319 241.75", (610, 605), []),
        ("1 SIMPLE_RADIAL 640 480 610 319 241.75 -0.1", (610, 610), [-0.1, 0, 0, 0]),
        ("1 RADIAL 640 480 610 319 241.75 -0.1 0.03", (610, 610), [-0.1, 0.03, 0, 0]),
    ],
)
def test_colmap_lens_models(tmp_path: Path, line: str, focal: tuple[float, float], distortion: list[float]) -> None:
    names = ("left/1.jpg", "right/1.jpg", "up/1.jpg")
    cameras = load_rig(colmap(tmp_path, [line], names=names))
    assert [camera.name for camera in cameras] == ["left", "right", "up"]
    for camera in cameras:
        assert camera.intrinsics.tolist() == [[focal[0], 0, 318.5], [0, focal[1], 241.25], [0, 0, 1]]
        assert camera.distortion.tolist() == distortion


def plain_text(folder: Path) -> Path:
    for i, camera in enumerate(CAMERAS):
        rows = "\n".join(" ".join(map(repr, row)) + " " for row in camera.intrinsics.tolist())
        lens = " ".join(map(repr, camera.distortion.tolist()))
        (folder / f"c{i}.dat").write_text(f"intrinsic:\n{rows}\ndistortion:\n{lens} \n")
        rows = "\n".join(" ".join(map(repr, row)) for row in camera.rotation.tolist())
        shift = " \n".join(map(repr, camera.translation.tolist()))
        (folder / f"rot_trans_c{i}.dat").write_text(f"R:\n{rows}\nT:\n{shift}\n\n#another pose\nR:\n1 2 3\n")
    return folder


def test_plain_text_files(tmp_path: Path, make_video: Callable[..., Path]) -> None:
    same(load_rig(plain_text(tmp_path), size=(640, 480)))
    same(load_rig(tmp_path / "c1.dat", size=(640, 480)))
    with pytest.raises(InputError, match="the size of the pictures is not known"):
        load_rig(tmp_path)
    for i in range(3):
        make_video(f"cam{i}_board.mp4", 2)
    with pytest.raises(InputError, match="principal point inside the picture of 64x48 px"):
        load_rig(tmp_path)


def test_real_stereo_rig(data_dir: Path) -> None:
    folder = data_dir / "real" / "stereo_desk"
    cameras = load_rig(folder)
    assert [(camera.name, camera.width, camera.height) for camera in cameras] == [
        ("cam0", 720, 720),
        ("cam1", 720, 720),
    ]
    cosine = float(cameras[0].rotation[2] @ cameras[1].rotation[2])
    assert math.degrees(math.acos(cosine)) == pytest.approx(44, abs=0.5)
    assert any("12.5" in note and "if the unit is metres" in note for note in rig_notes(cameras))
    scaled = load_rig(folder, unit=0.037)
    torch.testing.assert_close(scaled[1].translation, 0.037 * cameras[1].translation, atol=1e-12, rtol=0.0)
    assert rig_notes(scaled) == []


@pytest.mark.parametrize("name", ["mv_static", "mv_motion", "mv_index10"])
def test_synthetic_rigs_are_not_suspicious(data_dir: Path, name: str) -> None:
    assert rig_notes(load_rig(data_dir / "synthetic" / name)) == []


def test_units(tmp_path: Path) -> None:
    millimetres = [replace(camera, translation=1000 * camera.translation) for camera in CAMERAS]
    save_cameras(millimetres, tmp_path / "cameras.json")
    with pytest.raises(
        InputError, match=r"expected metres, but cameras lie up to \d+.* apart; .*unit mm makes it 0\.\d"
    ):
        load_rig(tmp_path)
    same(load_rig(tmp_path, unit="mm"))
    same(load_rig(tmp_path, unit="0.001"))
    assert load_rig(tmp_path, unit="m")[0].translation[2] == 500.0
    with pytest.raises(InputError, match=r"unit: expected one of m, cm, mm, inch or a number of metres, got 'milli'"):
        load_rig(tmp_path, unit="milli")


def entries() -> list[dict[str, Any]]:
    from torchhand.files.cameras import camera_entry

    return copy.deepcopy([camera_entry(camera) for camera in CAMERAS])


def written(folder: Path, content: list[dict[str, Any]]) -> Path:
    (folder / "cameras.json").write_text(json.dumps({"cameras": content}))
    return folder


def test_wrong_numbers_are_named(tmp_path: Path) -> None:
    for change, words in (
        ({"name": "cam1"}, "different name for every camera, got 'cam1' twice"),
        ({"R": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "expected a rotation .*determinant -1"),
        ({"R": [[2, 0, 0], [0, 2, 0], [0, 0, 2]]}, "expected a rotation"),
        ({"K": [[-600, 0, 300], [0, 600, 200], [0, 0, 1]]}, "positive focal length"),
        ({"K": [[600, 0, 700], [0, 600, 200], [0, 0, 1]]}, r"cam0: expected the principal point inside.*\(700, 200\)"),
        ({"t": [0, 0, float("nan")]}, "expected a finite number"),
    ):
        content = entries()
        content[0] |= change
        with pytest.raises(InputError, match=words):
            load_rig(written(tmp_path, content))


def test_rotations_in_another_convention_are_told(tmp_path: Path) -> None:
    """Cameras whose axes point away from each other's common point."""
    flip = np.diag([1.0, -1.0, -1.0])
    content = entries()
    for entry in content:
        entry["R"], entry["t"] = (flip @ np.array(entry["R"])).tolist(), (flip @ np.array(entry["t"])).tolist()
    with pytest.raises(InputError, match=r"OpenGL's \(y up, z backward\)"):
        load_rig(written(tmp_path, content))
    content = entries()
    for entry in content:  # of a world whose origin the cameras do not look at, so that the mistake shows
        rotation = np.array(entry["R"])
        entry["t"] = (np.array(entry["t"]) - rotation @ np.array([0.3, -0.2, 1.5])).tolist()
        entry["R"] = rotation.T.tolist()
    with pytest.raises(InputError, match=r"look away from each other's common point; .* if R is transposed"):
        load_rig(written(tmp_path, content))


def test_camera_that_looks_elsewhere_is_noted(tmp_path: Path) -> None:
    content = entries()
    for key in ("R", "t"):  # turned on the spot
        content[1][key] = (np.diag([-1.0, 1.0, -1.0]) @ np.array(content[1][key])).tolist()
    notes = rig_notes(load_rig(written(tmp_path, content)))
    assert any("cam0, cam2 share a volume that cam1 cannot see" in note for note in notes)


def test_cameras_without_anything_in_common_are_refused(tmp_path: Path) -> None:
    content = entries()[:2]
    content[0] |= {"R": np.eye(3).tolist(), "t": [0, 0, 0]}
    content[1] |= {"R": np.diag([-1.0, 1.0, -1.0]).tolist(), "t": [0, 0, -0.5]}
    with pytest.raises(InputError, match="no two cameras see anything together"):
        load_rig(written(tmp_path, content))


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("cameras.yml", "%YAML:1.0\n---\nK: [1, 2\n", "no OpenCV YAML or XML that can be read"),
        ("cameras.yml", "%YAML:1.0\n---\nfoo: 3\n", "expected a camera_matrix"),
        ("cameras.yml", "", "is empty"),
        ("cameras.yml", "%YAML:1.0\n---\nK: [1., 0., 0., 0., 1., 0., 0., 0., 1.]\n", "lacks the picture's size"),
        ("cameras.xml", "<html><b></html>", "no OpenCV YAML or XML"),
        ("cameras.cfg", "a = 3", "no file of cameras that is known; expected cameras.json, OpenCV's YAML"),
        ("cameras.toml", "a = 3", "expected tables of cameras ([cam_0] with size, matrix, distortions"),
        ("cameras.toml", "a = ", "is no TOML that can be read"),
        ("cameras.toml", "[cam_0]\nmatrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "cam_0: lacks size, distortions"),
        (
            "cameras.txt",
            "1 OPENCV_FISHEYE 640 480 1 2 3 4 5 6 7 8",
            "'OPENCV_FISHEYE' cannot be read; allowed: SIMPLE_PIN",
        ),
        ("cameras.txt", "1 PINHOLE 640 480 1 2 3", "line 1: expected 4 parameters of PINHOLE, got 3"),
        ("cameras.txt", "1 PINHOLE 640 480 1 2 3 x", "line 1: expected a number, got 'x'"),
        ("cameras.txt", "1 PINHOLE 640 480 1 2 3 4", "images.txt: no such file"),
        ("c0.dat", "intrinsic:\n1 2 3\ndistortion:\n0", "rot_trans_c0.dat: no such file"),
    ],
)
def test_unreadable_files(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as caught:
        load_rig(tmp_path / name, size=(640, 480) if name == "c0.dat" else None)
    assert words in str(caught.value)


def test_missing_titles_of_plain_text(tmp_path: Path) -> None:
    plain_text(tmp_path)
    (tmp_path / "rot_trans_c1.dat").write_text("R:\n1 0 0 0 1 0 0 0 1\n")
    with pytest.raises(InputError, match=r"rot_trans_c1\.dat: lacks the title 'T'; found: r"):
        load_rig(tmp_path, size=(640, 480))
    (tmp_path / "rot_trans_c1.dat").write_text("R:\n1 0 0 0 1 0 0 0\nT: \n0 0 0")
    with pytest.raises(InputError, match="R: expected 9 numbers, got 8"):
        load_rig(tmp_path, size=(640, 480))


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no cameras; expected cameras"):
        load_rig(tmp_path)
    with pytest.raises(InputError, match="no such file or folder"):
        load_rig(tmp_path / "none")
