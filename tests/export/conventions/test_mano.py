"""MANO's rotations in .npz, through its own kinematics written out here, and our reader on wrong files."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.conventions.mano import clip_of_mano, write_mano
from torchhand.hand import BONES, DOFS, HandModel

ORDER = ("wrist", *(f"{f}{i}" for f in ("index", "middle", "little", "ring", "thumb") for i in (1, 2, 3)))
PARENTS = [-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14]


def _bones() -> list[int]:
    levels = {"thumb": ("metacarpal", "proximal", "distal")}
    own = [f"{n[:-1]}_{levels.get(n[:-1], ('proximal', 'middle', 'distal'))[int(n[-1]) - 1]}" for n in ORDER[1:]]
    return [0, *(BONES.index(name) for name in own)]


@pytest.mark.parametrize("frame", [0, 6])
def test_rotations_pose_a_chain_whose_frames_are_parallel(clip: MotionClip, tmp_path: Path, frame: int) -> None:
    """Joints at rest in MANO's axes (fingers along -x right, +x left; back +y; thumb +z), turned as MANO turns them."""
    write_mano(clip, tmp_path / "hand.mano.npz")
    with np.load(tmp_path / "hand.mano.npz") as stored:
        assert tuple(stored["joint_names"]) == ORDER
        assert bool(stored["is_rhand"]) == (clip.side == "right")
        local = np.concatenate((stored["global_orient"][frame], stored["hand_pose"][frame])).reshape(16, 3)
        wrist, residual = stored["wrist"][frame], stored["residual"][frame]
    rest = clip.kinematics(clip.poses[0] * 0, clip.shape)
    joints = rest.position.numpy()[_bones()]
    across = 1.0 if clip.side == "right" else -1.0
    joints = np.stack((-across * joints[:, 1], joints[:, 0], across * joints[:, 2]), -1)
    assert joints[13, 2] > 0.005  # the thumb
    turns, places = [Rotation.from_rotvec(local[0])], [wrist]
    for j in range(1, 16):
        parent = PARENTS[j]
        places.append(places[parent] + turns[parent].apply(joints[j] - joints[parent]))
        turns.append(turns[parent] * Rotation.from_rotvec(local[j]))
    points = [0, *(k for f in (5, 9, 17, 13, 1) for k in (f, f + 1, f + 2))]
    ours = clip.frames.keypoints[frame].numpy()[points]
    off = np.linalg.norm(np.stack(places) - ours, axis=-1)
    assert np.abs(off - residual[points]).max() < 1e-12
    assert off[13:].max() < 1e-12  # of the thumb nothing is lost
    assert off[1:13].max() > 1e-4  # the palm of these poses is bent


def _flat_palm(clip: MotionClip) -> MotionClip:
    poses = clip.poses.clone()
    poses[:, [i for i, dof in enumerate(DOFS) if dof.endswith("cmc_fe") and not dof.startswith("thumb")]] = 0
    return replace(clip, poses=poses)


def test_the_pose_comes_back(clip: MotionClip, model: HandModel, tmp_path: Path) -> None:
    flat = _flat_palm(clip)
    mano = write_mano(flat, tmp_path / "hand.mano.npz")
    assert float(mano.residual.max()) < 1e-12
    back, fit = clip_of_mano(tmp_path / "hand.mano.npz", model, clip.shape)
    assert (back.side, back.fps, back.up) == (clip.side, clip.fps, clip.up)
    assert float(fit.residual.max()) < 1e-12
    assert float((back.poses[:, 6:] - flat.poses[:, 6:]).abs().max()) < 1e-7
    assert float((back.frames.keypoints - flat.frames.keypoints).abs().max()) < 1e-12


def test_a_bent_palm_is_reported(clip: MotionClip, model: HandModel, tmp_path: Path) -> None:
    mano = write_mano(clip, tmp_path / "hand.mano.npz")
    back, _ = clip_of_mano(tmp_path / "hand.mano.npz", model, clip.shape)
    off = (back.frames.keypoints - clip.frames.keypoints).norm(dim=-1)
    assert float((off - mano.residual).abs().max()) < 1e-12
    assert 1e-3 < float(off.max()) < 0.03


def test_files_of_others(clip: MotionClip, model: HandModel, tmp_path: Path) -> None:
    flat = _flat_palm(clip)
    write_mano(flat, tmp_path / "own.npz")
    with np.load(tmp_path / "own.npz") as stored:
        poses = np.concatenate((stored["global_orient"], stored["hand_pose"]), 1).astype(np.float32)
        trans = stored["wrist"]
    np.savez(tmp_path / "other.npz", poses=poses, trans=trans, mocap_framerate=np.array(120.0))
    with pytest.raises(InputError, match="expected is_rhand, the file has none; say which side"):
        clip_of_mano(tmp_path / "other.npz", model)
    back, _ = clip_of_mano(tmp_path / "other.npz", model, clip.shape, side=clip.side)
    assert back.fps == 120.0
    assert float((back.frames.keypoints - flat.frames.keypoints).abs().max()) < 1e-6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda a: a.pop("hand_pose"),
            "expected an array hand_pose (frames, 45) or poses (frames, 48), got global_orient",
        ),
        (
            lambda a: a.update(hand_pose=a["hand_pose"][:, :44]),
            "hand_pose: expected 45 rotations a frame, got 44 principal components",
        ),
        (lambda a: a.update(wrist=a["wrist"][:3]), "wrist: expected an array (7, 3), got (3, 3)"),
        (lambda a: a["hand_pose"].__setitem__((2, 3), np.nan), "hand_pose: expected finite numbers"),
        (lambda a: a.update(hand_pose=a["hand_pose"].astype(str)), "hand_pose: expected numbers, got <U"),
        (lambda a: a.update(joint_names=a["joint_names"][::-1]), "joint_names: expected MANO's 16 in its order"),
        (lambda a: a.update(fps=np.array(-1.0)), "fps: expected a number of frames per second, got [-1.0]"),
        (lambda a: a.update(is_rhand=np.array([1, 0])), "is_rhand: expected True or False, got an array of (2,)"),
        (lambda a: a.update(up=np.array("sideways")), "up: expected one of y, -y, z, -z, got 'sideways'"),
    ],
)
def test_wrong_files_are_refused(
    clips: dict[str, MotionClip],
    model: HandModel,
    tmp_path: Path,
    change: Callable[[dict[str, Any]], None],
    message: str,
) -> None:
    path = tmp_path / "hand.mano.npz"
    write_mano(clips["right"], path)
    with np.load(path) as stored:
        arrays = dict(stored)
    change(arrays)
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        clip_of_mano(path, model)
    assert str(path) in str(caught.value)


def test_broken_and_foreign_files_are_refused(clips: dict[str, MotionClip], model: HandModel, tmp_path: Path) -> None:
    path = tmp_path / "hand.mano.npz"
    write_mano(clips["right"], path)
    data = path.read_bytes()
    for content in (b"", data[: len(data) // 2], b"HIERARCHY"):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"expected MANO's rotations in an \.npz that can be read"):
            clip_of_mano(path, model)
    with pytest.raises(InputError, match="cannot be read"):
        clip_of_mano(tmp_path / "none.npz", model)
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"expected a left hand, got a right one \(is_rhand\)"):
        clip_of_mano(path, model, side="left")
