"""Which ending means which format, and that no file ever holds what is not a number."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import torch
import trimesh

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.conventions import clip_of_bap, clip_of_openxr
from torchhand.export.formats import FORMATS, ExportOptions, format_of, write
from torchhand.export.stream import clip_of_stream
from torchhand.export.tracked_clip import load_clip
from torchhand.files import load_hand_model

ONE_NAME_EACH = {
    "glb": "hand.glb",
    "bvh": "hand.bvh",
    "urdf": "hand.urdf",
    "mjcf": "hand.xml",
    "obj": "hand.obj",
    "ply": "hand.ply",
    "mano": "hand.mano.npz",
    "openxr": "hand.openxr.json",
    "keypoints": "hand.keypoints.json",
    "joints": "hand.joints.csv",
    "teleoperation": "hand.teleop.jsonl",
    "angles": "angles.csv",
    "bap": "hand.bap",
    "x3d": "hand.x3d",
    "stream": "hand.thp",
}


def test_every_format_has_its_ending() -> None:
    assert [entry.name for entry in FORMATS] == list(ONE_NAME_EACH)
    for name, file in ONE_NAME_EACH.items():
        assert format_of(file).name == name
        assert format_of(f"some/FOLDER.bvh/{file.upper()}").name == name


@pytest.mark.parametrize(
    ("file", "name", "message"),
    [
        ("hand.foo", None, "hand.foo: expected a file name with a known ending (.glb, .bvh, "),
        ("hand", None, "hand: expected a file name with a known ending"),
        (".glb", None, "expected a file name with a known ending"),
        ("hand.json", None, ".json may be openxr (.openxr.json) or keypoints (.keypoints.json): name the format"),
        ("hand.npz", None, ".npz may be mano (.mano.npz) or keypoints (.keypoints.npz): name the format"),
        ("hand.glb", "bvh", "hand.glb: expected an ending .bvh for bvh, got '.glb'"),
    ],
)
def test_endings_that_mean_none_or_several_are_refused(file: str, name, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        format_of(file, name)


def test_a_named_format_takes_the_common_ending() -> None:
    assert format_of("hand.json", "openxr").name == "openxr"
    assert format_of("hand.json", "keypoints").name == "keypoints"
    assert format_of("hand.npz", "mano").name == "mano"


def _numbers(path: Path) -> np.ndarray:
    """All numbers of a file, whatever it is."""
    if path.suffix == ".glb":
        data = path.read_bytes()
        size = int.from_bytes(data[12:16], "little")
        content = json.loads(data[20 : 20 + size], parse_constant=_refuse)
        start = 28 + size
        arrays = []
        for accessor in content["accessors"]:
            if accessor["componentType"] == 5126:
                view = content["bufferViews"][accessor["bufferView"]]
                first = start + view["byteOffset"]
                arrays.append(np.frombuffer(data[first : first + view["byteLength"]], "<f4"))
        return np.concatenate(arrays)
    if path.suffix == ".npz":
        with np.load(path) as stored:
            return np.concatenate([stored[name].reshape(-1) for name in stored.files if stored[name].dtype.kind == "f"])
    if path.suffix == ".ply":
        mesh = trimesh.load_mesh(path, process=False)
        assert isinstance(mesh, trimesh.Trimesh)
        return np.asarray(mesh.vertices).reshape(-1)
    if path.suffix == ".thp":
        return clip_of_stream(path, load_hand_model()).poses.numpy().reshape(-1)
    text = path.read_text()
    if path.suffix == ".json":
        json.loads(text, parse_constant=_refuse)
    assert not re.search(r"(?i)(?<![a-z])(nan|inf|infinity)(?![a-z])", text), path
    return np.array([float(word) for word in re.findall(r"-?\d+\.\d+", text)] or [0.0])


def _refuse(word: str) -> float:
    raise AssertionError(word)


@pytest.mark.parametrize("gaps", ["hold", "cut"])
@pytest.mark.parametrize(("name", "file"), list(ONE_NAME_EACH.items()))
def test_lost_frames_leave_no_trace_in_any_file(
    make_result: Callable[..., Path], tmp_path: Path, name: str, file: str, gaps
) -> None:
    clip = load_clip(make_result(lost=(0, 3, 5)), gaps=gaps)
    assert len(clip) == (6 if gaps == "hold" else 3)
    (tmp_path / "out").mkdir()
    assert format_of(file).name == name
    write(clip, tmp_path / "out" / file)
    files = [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert sorted({path for path in files if path.parent == tmp_path / "out"}) == sorted(
        path for path in format_of(file).files(clip, tmp_path / "out" / file) if path.is_file()
    )
    for path in files:
        numbers = _numbers(path)
        assert len(numbers)
        assert all(map(math.isfinite, numbers[:: max(1, len(numbers) // 5000)]))
        assert np.isfinite(numbers).all()


def test_what_a_format_cannot_hold_is_told(clip: MotionClip, tmp_path: Path) -> None:
    (note,) = write(clip, tmp_path / "hand.bap", options=ExportOptions(bap_numbering="draft"))
    assert "index_cmc_fe" in note
    assert "thumb_mcp_aa" in note
    (note,) = write(clip, tmp_path / "hand.mano.npz")
    assert re.fullmatch(r"MANO's palm does not bend: keypoints off by \d+\.\d\d mm at most", note)
    skin, plain = write(clip, tmp_path / "hand.glb")
    assert re.fullmatch(r"skin within 0\.\d\d mm of torchhand's with \d+ morph targets", skin)
    assert float(plain.split()[-2]) > 2
    assert write(clip, tmp_path / "hand.bvh", options=ExportOptions(bvh_names="mixamo")) == []
    assert torch.isfinite(clip.poses).all()


@pytest.mark.parametrize("folder", ['a "quoted" & <odd> name #1', "b\x01\udcff", "\u624b"])
def test_any_folder_name_makes_files_that_can_be_read(
    make_result: Callable[..., Path], tmp_path: Path, folder: str
) -> None:
    clip = load_clip(make_result(name=folder, frames=2))
    for name in ("hand.urdf", "hand.xml", "hand.x3d"):
        write(clip, tmp_path / name)
        assert ElementTree.parse(tmp_path / name).getroot().tag in ("robot", "mujoco", "X3D")
    for name in ("hand.bap", "hand.glb", "hand.bvh", "hand.openxr.json"):
        write(clip, tmp_path / name)
    assert len(clip_of_bap(tmp_path / "hand.bap", clip.model)) == 2
    assert len(clip_of_openxr(tmp_path / "hand.openxr.json", clip.model)[0]) == 2
    assert len(trimesh.load_scene(tmp_path / "hand.glb").geometry) == 1


@pytest.mark.parametrize(("name", "file"), list(ONE_NAME_EACH.items()))
def test_axes_are_taken_or_refused(clips: dict[str, MotionClip], tmp_path: Path, name: str, file: str) -> None:
    """Another frame gives another file; formats that place no hand refuse it, and write nothing."""
    clip = clips["right"].only(3)
    if name in ("urdf", "angles"):
        with pytest.raises(InputError, match=rf"axes: expected none for {name} \(.+\), got z-up"):
            write(replace(clip, axes="z-up"), tmp_path / file)
        assert not any(tmp_path.iterdir())
        return
    texts = []
    for axes in ("camera", "z-up"):
        write(replace(clip, axes=axes), tmp_path / file)
        texts.append((tmp_path / file).read_bytes())
    assert texts[0] != texts[1]
