"""BAP text files in both numberings through a parser of the format's description, and our reader on wrong files."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.conventions.bap import clip_of_bap, read_bap, write_bap
from torchhand.hand import DOFS, JOINT_DOFS, HandModel
from torchhand.hand.conventions import NUMBERINGS

HALF_UNIT = 0.5e-5 * (1 + 1e-9)
HALF_MM = 0.5e-3 * (1 + 1e-9)


def _parse(path: Path) -> tuple[list[str], list[dict[int, int]]]:
    """Header, and values by parameter of each frame."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    frames = []
    for number, (mask, data) in enumerate(zip(lines[1::2], lines[2::2], strict=True)):
        ids = [k for k, flag in enumerate(mask.split(), start=1) if flag == "1"]
        first, *values = map(int, data.split())
        assert first == number
        frames.append(dict(zip(ids, values, strict=True)))
    return lines[0].split(), frames


def test_values_stand_under_the_numbers_of_the_standard(clips: dict[str, MotionClip], tmp_path: Path) -> None:
    """ISO/IEC 14496-2: left ids; right = left + 1."""
    left = {"little_cmc_fe": 123, "ring_mcp_aa": 139, "middle_mcp_tw": 153, "index_dip_fe": 169, "thumb_mcp_fe": 177}
    draft = {"little_mcp_fe": 120, "ring_mcp_aa": 132, "middle_mcp_tw": 144, "index_dip_fe": 158, "thumb_mcp_fe": 166}
    for side, clip in clips.items():
        for numbering, table in (("final", left), ("draft", draft)):
            write_bap(clip, tmp_path / "hand.bap", numbering="final" if numbering == "final" else "draft")
            header, frames = _parse(tmp_path / "hand.bap")
            assert header == ["3.1", side, "25", "7"]
            assert len(frames[0]) == (35 if numbering == "final" else 31)
            for dof, number in table.items():
                angles = clip.poses[:, DOFS.index(dof)].numpy() * 1e5
                got = np.array([frame[number + (side == "right")] for frame in frames])
                assert np.abs(got - angles).max() <= 0.5 + 1e-9


@pytest.mark.parametrize("numbering", NUMBERINGS)
@pytest.mark.parametrize("version", ["3.1", "3.2"])
def test_the_motion_comes_back(clip: MotionClip, model: HandModel, tmp_path: Path, numbering, version) -> None:
    lost = write_bap(clip, tmp_path / "hand.bap", numbering=numbering, version=version)
    mask = (tmp_path / "hand.bap").read_text().splitlines()[3].split()
    assert len(mask) == {"3.1": 186, "3.2": 296}[version]
    back = clip_of_bap(tmp_path / "hand.bap", model, clip.shape, numbering=numbering)
    upright = clip.with_up("y")
    assert (back.side, back.fps, back.name) == (clip.side, clip.fps, clip.name)
    without = [
        d for d in JOINT_DOFS if d == "thumb_mcp_aa" or (numbering == "draft" and d[-6:] == "cmc_fe" and d[0] != "t")
    ]
    for place, dof in enumerate(JOINT_DOFS):
        off = (back.poses - upright.poses)[:, 6 + place]
        if dof in without:
            assert not back.poses[:, 6 + place].any()
            assert torch.equal(lost[:, place], upright.poses[:, 6 + place])
        else:
            assert float(off.abs().max()) <= HALF_UNIT, dof
            assert torch.allclose(lost[:, place], -off, rtol=0, atol=1e-12)
    assert float((back.poses[:, :3] - upright.poses[:, :3]).abs().max()) <= HALF_MM
    angle = (back.frames.rotation[:, 0].mT @ upright.frames.rotation[:, 0]).diagonal(dim1=-2, dim2=-1).sum(-1)
    assert float(((angle.clamp(max=3) - 1) / 2).acos().max()) < 3e-5


@pytest.mark.parametrize("has_comment", [True, False])
@pytest.mark.parametrize(("written", "asked"), [("final", "draft"), ("draft", "final")])
def test_the_other_numbering_is_refused(
    clip: MotionClip, model: HandModel, tmp_path: Path, written, asked, has_comment: bool
) -> None:
    path = tmp_path / "hand.bap"
    write_bap(clip, path, numbering=written)
    if not has_comment:
        path.write_text("\n".join(line for line in path.read_text().splitlines() if line[0] != "#"))
    with pytest.raises(InputError, match=f"expected a BAP file of the {asked} numbering, got one of the '{written}'"):
        clip_of_bap(path, model, numbering=asked)
    assert clip_of_bap(path, model, numbering=written).side == clip.side


def test_values_without_flag_stay(tmp_path: Path, model: HandModel) -> None:
    path = tmp_path / "few.bap"
    masks = [" ".join("1" if k in ids else "0" for k in range(1, 187)) for ids in ({162, 164}, {164}, set())]
    path.write_text(f"# few\n3.1 few 20 3\n{masks[0]}\n0 100000 -2000\n{masks[1]} 1 3000\n{masks[2]}\n2\n")
    motion = read_bap(path)
    assert motion.flagged == (162, 164)
    assert motion.values.tolist() == [[100000, -2000], [100000, 3000], [100000, 3000]]
    clip = clip_of_bap(path, model)
    assert (clip.side, clip.fps) == ("right", 20.0)
    assert clip.poses[:, DOFS.index("index_mcp_fe")].tolist() == [1.0, 1.0, 1.0]
    assert clip.poses[:, DOFS.index("index_mcp_aa")].tolist() == pytest.approx([-0.02, 0.03, 0.03], abs=1e-15)
    other = clip_of_bap(path, model, unit="1e-5 pi rad")
    assert float(other.poses[0, DOFS.index("index_mcp_fe")]) == pytest.approx(np.pi, abs=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("3.1 right 25 7", "2.1 right 25 7", "expected a BAP file that begins with '3.1 NAME FPS FRAMES'"),
        ("3.1 right 25 7", "3.1 right 25", "expected a BAP file that begins with '3.1 NAME FPS FRAMES'"),
        ("3.1 right 25 7", "3.1 right 25 8", "in frame 7 of 8, got the end of the file: it is cut short"),
        ("3.1 right 25 7", "3.1 right 25 6", "expected the end after 6 frames"),
        ("3.1 right 25 7", "3.1 right 0 7", "expected a rate above 0 and one frame or more, got 0 and 7"),
        ("3.1 right 25 7", "3.1 right 25 -1", "expected a rate above 0 and one frame or more, got 25 and -1"),
        ("3.1 right 25 7", "3.2 right 25 7", "expected 296 flags 0 or 1 (version 3.2)"),
        ("0 0 0", "0 2 0", "expected 186 flags 0 or 1 (version 3.1), got '2'"),
        ("0 0 0", "0 0", "line 5: expected 186 flags, then a frame number and 35 values on one line"),
        ("# numbering final", "# numbering later", "got one of the 'later' numbering (it says so)"),
    ],
)
def test_broken_files_are_refused(
    clips: dict[str, MotionClip], model: HandModel, tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / "hand.bap"
    clip = replace(clips["right"], poses=clips["right"].poses + 0.0123)
    write_bap(clip, path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        clip_of_bap(path, model)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("word", "message"), [("nan", "expected a finite number"), ("x7", "expected a number, got 'x7'")]
)
def test_values_that_are_no_numbers_are_refused(
    clips: dict[str, MotionClip], tmp_path: Path, word: str, message: str
) -> None:
    path = tmp_path / "hand.bap"
    write_bap(clips["right"], path)
    lines = path.read_text().splitlines()
    lines[6] = " ".join([*lines[6].split()[:4], word, *lines[6].split()[5:]])
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=f"line 7: {message}"):
        read_bap(path)


def test_files_cut_anywhere_are_refused(clips: dict[str, MotionClip], tmp_path: Path) -> None:
    path = tmp_path / "hand.bap"
    write_bap(clips["right"], path)
    data = path.read_bytes().rstrip()
    last_number = len(data.split()[-1])
    for size in [*range(0, len(data) - last_number, 499), len(data) - last_number]:
        path.write_bytes(data[:size])
        with pytest.raises(InputError):
            read_bap(path)


def test_which_hand(clips: dict[str, MotionClip], model: HandModel, tmp_path: Path) -> None:
    path = tmp_path / "hand.bap"
    write_bap(clips["right"], path)
    with pytest.raises(InputError, match="expected angles of a left hand, got right"):
        clip_of_bap(path, model, side="left")
    masks = " ".join("1" if k in (161, 162) else "0" for k in range(1, 187))
    path.write_text(f"3.1 both 20 1\n{masks}\n0 100 200\n")
    with pytest.raises(InputError, match="expected one hand, got both; say which one"):
        clip_of_bap(path, model)
    assert float(clip_of_bap(path, model, side="left").poses[0, DOFS.index("index_mcp_fe")]) == 0.001
    path.write_text(f"3.1 none 20 1\n{masks.replace('1', '0')}\n0\n")
    with pytest.raises(InputError, match="expected angles of a left or right hand, got none"):
        clip_of_bap(path, model)
    path.write_bytes(b"\xff\x00BAP")
    with pytest.raises(InputError, match="a text file in UTF-8"):
        read_bap(path)
