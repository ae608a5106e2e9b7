"""Recorded joint angles as motion."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera
from torchhand.hand import DOFS, JOINT_DOFS, HandKinematics
from torchhand.simulate.motion.motion import Motion, Staging
from torchhand.simulate.motion.recorded import GLOVE_COLUMNS, joints_of_glove, read_glove, recorded_motion

CAMERA = assumed_camera(120, 96)


@pytest.fixture(scope="module")
def kinematics() -> HandKinematics:
    return load_hand_model().kinematics("right", dtype=torch.float64)


def _line(seconds: float, **angles: float) -> str:
    """A row of a recording; column names with underscores."""
    values = [angles.get(column.replace("-", "_"), 0.0) for column in GLOVE_COLUMNS]
    minute, second = divmod(seconds, 60)
    return f"2014 11 28 09 {int(minute)} {second:.5f} 1 " + " ".join(f"{value:.5f}" for value in values)


def _write(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def _motion(path: Path, kinematics: HandKinematics, frames: int, **options) -> Motion:
    return recorded_motion(path, frames, kinematics, CAMERA, torch.Generator().manual_seed(0), **options)


def _joint(joints: Tensor, dof: str) -> Tensor:
    return joints[..., JOINT_DOFS.index(dof)]


def test_signs_and_columns(tmp_path: Path) -> None:
    """Recorded flexion is negative, ours positive; recorded abduction leads towards the thumb's side."""
    angles = {"T_TMC": -1.0, "T_MCP": -0.2, "T_IP": -0.3, "T_AA": -0.4, "arch": -0.4}
    angles |= {"I_MCP": -0.5, "I_PIP": -0.6, "I_DIP": -0.7, "I_AA": 0.1, "M_AA": -0.05}
    angles |= {"R_PIP": -0.8, "R_AA": -0.11, "L_DIP": -0.9, "L_AA": -0.12}
    path = _write(tmp_path / "glove.txt", _line(0, **angles), _line(1, **angles))
    joints = joints_of_glove(read_glove(path), np.array([0.5]))[0]
    expected = {"thumb_cmc_fe": 1.0 - math.radians(45), "thumb_mcp_fe": 0.2, "thumb_ip_fe": 0.3, "thumb_cmc_aa": 0.4}
    expected |= {"index_mcp_fe": 0.5, "index_pip_fe": 0.6, "index_dip_fe": 0.7, "index_mcp_aa": 0.1}
    expected |= {"middle_mcp_aa": -0.05, "ring_pip_fe": 0.8, "ring_mcp_aa": 0.11, "little_dip_fe": 0.9}
    expected |= {"little_mcp_aa": 0.12, "ring_cmc_fe": 0.1, "little_cmc_fe": 0.16}
    for dof in JOINT_DOFS:
        assert float(_joint(joints, dof)) == pytest.approx(expected.get(dof, 0.0), abs=1e-9), dof


def test_resampled_in_time(tmp_path: Path, kinematics: HandKinematics) -> None:
    rows = [_line(58 + t, I_MCP=-0.3 * t) for t in (0.0, 0.5, 1.5, 3.0)]  # uneven, over a full minute
    path = _write(tmp_path / "glove.txt", *rows, "")
    index = DOFS.index("index_mcp_fe")
    motion = _motion(path, kinematics, 5, staging=Staging(fps=4.0))
    torch.testing.assert_close(motion.poses[:, index], 0.075 * torch.arange(5, dtype=torch.float64), rtol=0, atol=1e-6)
    faster = _motion(path, kinematics, 5, start_s=0.5, staging=Staging(fps=4.0, pace=2.0))
    expected = 0.15 + 0.15 * torch.arange(5, dtype=torch.float64)
    torch.testing.assert_close(faster.poses[:, index], expected, rtol=0, atol=1e-6)


def test_past_midnight(tmp_path: Path) -> None:
    rows = [_line(0).replace(" 09 0 0.00000 ", " 23 59 59.50000 "), _line(0).replace(" 09 0 0.0", " 00 0 0.5")]
    assert read_glove(_write(tmp_path / "glove.txt", *rows)).seconds.tolist() == pytest.approx([0.0, 1.0])


def test_clamped_to_the_limits(tmp_path: Path, kinematics: HandKinematics) -> None:
    path = _write(tmp_path / "glove.txt", _line(0, I_PIP=-2.6, M_MCP=1.2), _line(2, I_PIP=-2.6, M_MCP=1.2))
    pose = _motion(path, kinematics, 2).poses[0]
    assert float(pose[DOFS.index("index_pip_fe")]) == pytest.approx(math.radians(110))
    assert float(pose[DOFS.index("middle_mcp_fe")]) == pytest.approx(math.radians(-15))


def test_planar_motion_on_top(tmp_path: Path, kinematics: HandKinematics) -> None:
    path = _write(tmp_path / "glove.txt", _line(0), _line(9))
    moving = _motion(path, kinematics, 90).poses
    assert (moving[:, :2].amax(0) - moving[:, :2].amin(0)).min() > 0.01
    assert moving[:, 3:5].abs().max() == 0
    torch.testing.assert_close(moving[:, 6:], moving[:1, 6:].expand(90, -1), rtol=0, atol=0)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "expected at least 2 rows of joint angles, got 0"),
        (_line(0), "expected at least 2 rows of joint angles, got 1"),
        (_line(0) + "\n" + "1 2 3", "row 2: expected 30 finite numbers, got 3 numbers"),
        (_line(0) + "\n\n" + "some words", "row 3: expected 30 numbers, got 'some words'"),
        (_line(0) + "\n" + _line(0)[:-7] + "nan", "row 2: expected 30 finite numbers"),
        (_line(5) + "\n" + _line(3), "recorded row 2: expected increasing times"),
        (_line(5) + "\n" + _line(5), "one and the same in all rows"),
    ],
)
def test_wrong_files_are_explained(content: str, message: str, tmp_path: Path) -> None:
    path = _write(tmp_path / "glove.txt", content)
    with pytest.raises(InputError, match=message) as caught:
        read_glove(path)
    assert "glove.txt" in str(caught.value)


def test_missing_and_short_files_are_explained(tmp_path: Path, kinematics: HandKinematics) -> None:
    with pytest.raises(InputError, match=r"gone\.txt: cannot be read \(No such file"):
        read_glove(tmp_path / "gone.txt")
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="not a text file"):
        read_glove(tmp_path / "binary.txt")
    path = _write(tmp_path / "glove.txt", _line(0), _line(1))
    with pytest.raises(InputError, match=r"at least 3\.30 s .*100 frames at 30 frames/s.* got 1\.00 s"):
        _motion(path, kinematics, 100)


def test_a_real_recording_closes_the_hand(data_dir: Path, kinematics: HandKinematics) -> None:
    path = data_dir / "real" / "joint_angles" / "00_calib-rad-su01.txt"
    recording = read_glove(path)
    assert recording.angles.shape == (len(recording.seconds), 23)
    assert recording.seconds[-1] == pytest.approx(111, abs=1)
    motion = _motion(path, kinematics, 1000, staging=Staging(fps=9.0))
    flexion = torch.rad2deg(motion.poses[:, [DOFS.index(f"{f}_mcp_fe") for f in ("index", "middle", "ring", "little")]])
    assert (flexion.amax(0) > 80).all()  # bends to the palm, not to the back
    assert (flexion.amin(0) >= -15).all()
    spread = torch.rad2deg(motion.poses[:, DOFS.index("index_mcp_aa")] + motion.poses[:, DOFS.index("little_mcp_aa")])
    assert spread.median() > 20  # an open hand most of the time
    assert (motion.poses[:, 6:] >= kinematics.skeleton.lower).all()
    assert (motion.poses[:, 6:] <= kinematics.skeleton.upper).all()
