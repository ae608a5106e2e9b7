"""OpenXR's joints as JSON: order and axes of the specification, and our reader on wrong files."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.conventions.openxr import clip_of_openxr, write_openxr
from torchhand.hand import HandModel

DROPPED = (0, 6, 11, 16, 21)  # without these the order is that of the 21 keypoints


def _read(path: Path) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    content = json.loads(path.read_text())
    poses = [frame["poses"] for frame in content["frames"]]
    position = np.array([[pose["position"] for pose in frame] for frame in poses])
    quaternion = np.array([[pose["orientation"] for pose in frame] for frame in poses])
    return (
        content,
        position,
        Rotation.from_quat(quaternion.reshape(-1, 4)).as_matrix().reshape(*quaternion.shape[:2], 3, 3),
    )


def test_joints_in_the_order_of_the_specification(clip: MotionClip, tmp_path: Path) -> None:
    write_openxr(clip, tmp_path / "hand.openxr.json")
    content, position, _ = _read(tmp_path / "hand.openxr.json")
    names = ["palm", "wrist", "thumb_metacarpal", "thumb_proximal", "thumb_distal", "thumb_tip"]
    for finger in ("index", "middle", "ring", "little"):
        names += [f"{finger}_{part}" for part in ("metacarpal", "proximal", "intermediate", "distal", "tip")]
    assert content["joints"] == names
    assert (content["side"], content["fps"], len(content["frames"])) == (clip.side, 25.0, 7)
    kept = [i for i in range(26) if i not in DROPPED]
    assert np.abs(position[:, kept] - clip.with_up("y").frames.keypoints.numpy()).max() < 1e-12
    assert np.abs(position[:, 0] - 0.5 * (position[:, 11] + position[:, 12])).max() < 1e-12
    radius = {name: pose["radius"] for name, pose in zip(names, content["frames"][0]["poses"], strict=True)}
    metres = clip.model.shape_space.metric(clip.shape)
    for name, parameter in (
        ("thumb_distal", "thumb_ip"),
        ("index_intermediate", "index_pip"),
        ("little_tip", "little_tip"),
    ):
        assert radius[name] == pytest.approx(float(metres[f"{parameter}_radius"]), abs=1e-15)
    assert radius["palm"] == pytest.approx(0.5 * float(metres["palm_thickness"]), abs=1e-15)


def test_axes_of_the_specification(clip: MotionClip, tmp_path: Path) -> None:
    """-z from each joint to the next one of its finger; +y out of the back of the hand."""
    write_openxr(clip, tmp_path / "hand.openxr.json")
    _, position, rotation = _read(tmp_path / "hand.openxr.json")
    for start, stop in ((2, 5), (6, 10), (11, 15), (16, 20), (21, 25)):
        for joint in range(start, stop):
            along = position[:, joint + 1] - position[:, joint]
            along /= np.linalg.norm(along, axis=-1, keepdims=True)
            tolerance = 1e-9 if start == 2 or joint > start else 0.15  # a finger's metacarpal leads to a raised knuckle
            assert np.abs(along + rotation[:, joint, :, 2]).max() < tolerance
        assert np.abs(rotation[:, stop] - rotation[:, stop - 1]).max() < 1e-12
    bent = rotation[:, 8, :, 2] - rotation[:, 7, :, 2]  # an intermediate phalanx bends to the palm
    flexion = clip.poses[:, 6 + 10].numpy()
    assert ((np.einsum("ti,ti->t", bent, rotation[:, 7, :, 1]) > 0) == (flexion > 0)).all()
    right = rotation[:, 1, :, 0]
    across = position[:, 7] - position[:, 22]  # from the little finger's knuckle to the index finger's
    assert ((np.einsum("ti,ti->t", right, across) < 0) == (clip.side == "right")).all()


def test_the_pose_comes_back(clip: MotionClip, model: HandModel, tmp_path: Path) -> None:
    write_openxr(clip, tmp_path / "hand.openxr.json")
    back, fit = clip_of_openxr(tmp_path / "hand.openxr.json", model, clip.shape)
    upright = clip.with_up("y")
    assert (back.side, back.fps, back.frame) == (clip.side, clip.fps, clip.frame)
    assert float(fit.residual.max()) < 1e-12
    assert float((back.poses[:, 6:] - upright.poses[:, 6:]).abs().max()) < 1e-7
    assert float((back.frames.keypoints - upright.frames.keypoints).abs().max()) < 1e-12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(format="other"), "expected joints of OpenXR ('format': 'torchhand openxr 1'), got 'other'"),
        (lambda c: c.pop("side"), "side: expected left or right, got None"),
        (lambda c: c.update(fps=0), "fps: expected more than 0"),
        (lambda c: c.update(fps="fast"), "fps: expected a finite number, got 'fast'"),
        (lambda c: c["joints"].reverse(), "joints: expected the 26 of OpenXR in its order"),
        (lambda c: c.update(frames=[]), "frames: expected a list of one frame or more, got []"),
        (lambda c: c["frames"][2]["poses"].pop(), "frames[2].poses: expected a list of 26, got 25"),
        (
            lambda c: c["frames"][1]["poses"].__setitem__(4, 7),
            "frames[1].poses[4]: expected position and orientation, got 7",
        ),
        (
            lambda c: c["frames"][1]["poses"][4].update(position=[1, 2]),
            "frames[1].poses[4].position: expected a list of 3, got 2",
        ),
        (
            lambda c: c["frames"][1]["poses"][4].update(orientation=[0, 0, 0, 2]),
            "frames[1].poses[4].orientation: expected a unit quaternion, got length 2",
        ),
        (
            lambda c: c["frames"][3]["poses"][0].update(position=[0, float("nan"), 0]),
            "frames[3].poses[0].position[1]: expected a finite number, got nan",
        ),
    ],
)
def test_wrong_files_are_refused(
    clips: dict[str, MotionClip],
    model: HandModel,
    tmp_path: Path,
    change: Callable[[dict[str, Any]], None],
    message: str,
) -> None:
    path = tmp_path / "hand.openxr.json"
    write_openxr(clips["left"], path)
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        clip_of_openxr(path, model)
    assert str(path) in str(caught.value)


def test_broken_and_foreign_files_are_refused(clips: dict[str, MotionClip], model: HandModel, tmp_path: Path) -> None:
    path = tmp_path / "hand.openxr.json"
    write_openxr(clips["left"], path)
    text = path.read_text()
    for content, message in (
        (text[: len(text) // 2], "is no valid JSON"),
        ("[]", "expected joints of OpenXR"),
        ("", "JSON"),
    ):
        path.write_text(content)
        with pytest.raises(InputError, match=message):
            clip_of_openxr(path, model)
    path.write_bytes(b"\xff\xd8\xff")
    with pytest.raises(InputError, match="expected a JSON text file in UTF-8"):
        clip_of_openxr(path, model)
