"""BVH files through a reader written from the format's description, and our reader on wrong files."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.conventions.bvh import write_bvh
from torchhand.export.conventions.bvh_names import BVH_NAMES, bvh_names
from torchhand.export.conventions.bvh_reader import clip_of_bvh, read_bvh
from torchhand.hand import BONES, FINGERS, HandModel

ROUNDING = 1e-7  # metres: six digits of degrees at the end of a chain of 0.2 m, six of centimetres


def _forward(path: Path, frame: int) -> dict[str, np.ndarray]:
    """Places of all joints, and of the End Sites as NAME end, in the file's units."""
    text = path.read_text()
    hierarchy, motion = text.split("MOTION")
    lines = motion.strip().splitlines()
    values = [float(word) for word in lines[2 + frame].split()]
    places: dict[str, np.ndarray] = {}
    stack: list[tuple[str, np.ndarray, np.ndarray]] = []
    name, matrix, place, column = "", np.eye(3), np.zeros(3), 0
    for line in hierarchy.strip().splitlines()[1:]:
        words = line.split()
        if words[0] in ("ROOT", "JOINT"):
            name = words[1]
        elif words[0] == "End":
            name = f"{stack[-1][0]} end"
        elif words[0] == "{":
            matrix, place = (stack[-1][1], stack[-1][2]) if stack else (np.eye(3), np.zeros(3))
            stack.append((name, matrix, place))
        elif words[0] == "OFFSET":
            place = place + matrix @ np.array(words[1:], dtype=float)
            places[name] = place
            stack[-1] = (name, matrix, place)
        elif words[0] == "CHANNELS":
            for channel in words[2:]:
                if channel.endswith("position"):
                    place = place + np.eye(3)["XYZ".index(channel[0])] * values[column]
                else:
                    matrix = matrix @ Rotation.from_euler(channel[0].lower(), values[column], degrees=True).as_matrix()
                column += 1
            places[name] = place
            stack[-1] = (name, matrix, place)
        elif words[0] == "}":
            stack.pop()
    assert column == len(values)
    return places


@pytest.mark.parametrize("kind", BVH_NAMES)
def test_joints_stand_where_ours_do(clip: MotionClip, tmp_path: Path, kind) -> None:
    path = tmp_path / "hand.bvh"
    write_bvh(clip, path, names=kind)
    frames, names = clip.with_up("y").frames, bvh_names(clip.side, kind)
    for t in range(len(clip)):
        places = _forward(path, t)
        assert len(places) == 25
        got = np.stack([places[name] for name in names]) / 100
        assert np.abs(got - frames.position[t].numpy()).max() < ROUNDING
        tips = np.stack([places[f"{names[BONES.index(f'{f}_distal')]} end"] for f in FINGERS]) / 100
        assert np.abs(tips - frames.keypoints[t, [4, 8, 12, 16, 20]].numpy()).max() < ROUNDING


def test_names_of_other_programs() -> None:
    names = bvh_names("left", "mixamo")
    assert names[0] == "LeftHand"
    assert [names[BONES.index(b)] for b in ("thumb_metacarpal", "thumb_distal")] == ["LeftHandThumb1", "LeftHandThumb3"]
    assert [names[BONES.index(b)] for b in ("index_metacarpal", "little_distal")] == [
        "LeftHandIndex0",
        "LeftHandPinky3",
    ]
    assert bvh_names("right", "hanim")[BONES.index("little_proximal")] == "r_pinky1"
    for kind in BVH_NAMES:
        assert len({*bvh_names("left", kind), *bvh_names("right", kind)}) == 40


@pytest.mark.parametrize("kind", BVH_NAMES)
def test_the_pose_comes_back(clip: MotionClip, model: HandModel, tmp_path: Path, kind) -> None:
    write_bvh(clip, tmp_path / "hand.bvh", names=kind)
    back, fit = clip_of_bvh(tmp_path / "hand.bvh", model, clip.shape)
    expected = clip.with_up("y")
    assert back.side == clip.side
    assert abs(back.fps - 25) < 1e-6
    assert float(fit.residual.max()) < 1e-7
    assert float((back.poses[:, 6:] - expected.poses[:, 6:]).abs().max()) < 1e-6
    assert float((back.frames.keypoints - expected.frames.keypoints).abs().max()) < ROUNDING


def test_angles_do_not_jump(clip: MotionClip, tmp_path: Path) -> None:
    poses = clip.poses[:1].repeat(80, 1)
    poses[:, 3:6] = 0
    poses[:, 5] = 0.1 * torch.arange(80)  # more than a turn
    write_bvh(replace(clip, poses=poses, frame=()), tmp_path / "hand.bvh")
    assert float(read_bvh(tmp_path / "hand.bvh").values.diff(dim=0).abs().max()) < 10


def test_foreign_order_of_channels(tmp_path: Path) -> None:
    path = tmp_path / "arm.bvh"
    path.write_text(
        "HIERARCHY\nROOT a\n{\nOFFSET 1 2 3\nCHANNELS 6 Yposition Xposition Zposition Xrotation Yrotation Zrotation\n"
        "JOINT b { OFFSET 0 1 0 CHANNELS 1 Zrotation End Site { OFFSET 0 1 0 } } }\n"
        "MOTION\nFrames: 1\nFrame Time: 0.04\n5 4 6 10 20 30 40\n"
    )
    motion = read_bvh(path)
    assert (motion.names, motion.parents) == (("a", "b"), (-1, 0))
    assert motion.positions(0).tolist() == [[4.0, 5.0, 6.0]]
    turns = motion.rotations()[0].numpy()
    assert np.abs(turns[0] - Rotation.from_euler("XYZ", [10, 20, 30], degrees=True).as_matrix()).max() < 1e-14
    assert np.abs(turns[1] - Rotation.from_euler("z", 40, degrees=True).as_matrix()).max() < 1e-14


def _broken(path: Path, text: str, old: str, new: str) -> None:
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("HIERARCHY", "HIERARCHIE", "expected a BVH file that begins with HIERARCHY, got 'HIERARCHIE'"),
        ("MOTION", "MOTIONS", "expected MOTION after the hierarchy, got the end of the file"),
        ("ROOT", "JOINT", "line 2: expected ROOT, got 'JOINT'"),
        ("OFFSET 0.000000", "OFFSET x", "line 4: expected a number, got 'x'"),
        ("OFFSET 0.000000", "OFFSET nan", "line 4: expected a finite number, got 'nan'"),
        ("CHANNELS 6", "CHANNELS six", "line 5: expected a whole number, got 'six'"),
        ("CHANNELS 6", "CHANNELS 60", "expected 0 to 6 channels, got 60"),
        ("Zrotation", "Wrotation", "expected channels Xposition … Zrotation, got 'wrotation'"),
        ("Frames: 7", "Frames: 8", "expected 8 frames as 'Frames:' says, got 7"),
        ("Frames: 7", "Frames: many", "expected a whole number, got 'many'"),
        ("Frames: 7", "Bilder: 7", "expected 'Frames: N' and 'Frame Time: SECONDS' after MOTION"),
        ("Frame Time: 0.04", "Frame Time: 0", "expected one frame or more and a time above 0"),
        ("}\nMOTION", "MOTION", "in the hierarchy, got MOTION: it is cut short"),
        ("}\nMOTION", "} }\nMOTION", "expected MOTION after the one ROOT"),
        ("JOINT right_thumb_metacarpal", "JOINT right_wrist", "expected each joint once, got 'right_wrist' again"),
        ("right_wrist", "hips", "expected the joints of a hand, its wrist named one of right_wrist"),
        ("JOINT right_index_middle", "JOINT finger", "expected the 20 joints of a hand, lacks right_index_middle"),
    ],
)
def test_broken_files_are_refused(
    clips: dict[str, MotionClip], model: HandModel, tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / "hand.bvh"
    write_bvh(clips["right"], path)
    _broken(path, path.read_text(), old, new)
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        clip_of_bvh(path, model)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_cut_anywhere_are_refused(clips: dict[str, MotionClip], tmp_path: Path) -> None:
    path = tmp_path / "hand.bvh"
    write_bvh(clips["right"], path)
    data = path.read_bytes().rstrip()
    last_number = len(data.split()[-1])
    for size in [*range(0, len(data) - last_number, 997), len(data) - last_number]:
        path.write_bytes(data[:size])
        with pytest.raises(InputError):
            read_bvh(path)


def test_files_that_are_no_text_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_bvh(tmp_path / "none.bvh")
    (tmp_path / "glb.bvh").write_bytes(b"glTF\xff\xfe\x00")
    with pytest.raises(InputError, match="expected a BVH file, a text file in UTF-8, got something else"):
        read_bvh(tmp_path / "glb.bvh")
    with pytest.raises(InputError, match="cannot be read"):
        read_bvh(tmp_path)
    deep = "HIERARCHY ROOT r { OFFSET 0 0 0 CHANNELS 0 " + "".join(
        f"JOINT j{i} {{ OFFSET 0 0 0 CHANNELS 0 " for i in range(3000)
    )
    (tmp_path / "deep.bvh").write_text(deep + "\nMOTION\nFrames: 1\nFrame Time: 1\n")
    with pytest.raises(InputError, match="nested 200 deep at most"):
        read_bvh(tmp_path / "deep.bvh")
