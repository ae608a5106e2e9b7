"""What is written is read back by `load_clip`; recordings and MANO's files as other programs write them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.export import load_clip, write
from torchhand.export.clip import MotionClip
from torchhand.export.conventions.mano import clip_of_mano, write_mano
from torchhand.export.conventions.xr_recording import clip_of_xr_recording, webxr_name
from torchhand.files import save_hand
from torchhand.geometry import quaternion_of_rotation, rotation_from_vector
from torchhand.hand import DOFS
from torchhand.hand.conventions import OPENXR_JOINTS, openxr_joints


@pytest.fixture
def within(clip: MotionClip) -> MotionClip:
    """A clip that all formats can hold: the palm flat, no thumb MCP abduction; one frame held, times that are even."""
    poses = clip.poses.clone()
    still = [f"{finger}_cmc_fe" for finger in ("index", "middle", "ring", "little")]
    poses[:, [DOFS.index(name) for name in (*still, "thumb_mcp_aa")]] = 0
    return replace(clip, poses=poses, held=(3,))


@pytest.mark.parametrize(
    ("name", "within_mm"),
    [
        ("hand.bvh", 1e-3),
        ("hand.bap", 1.5),
        ("hand.mano.npz", 1e-3),
        ("hand.openxr.json", 1e-3),
        ("hand.joints.csv", 1e-6),
        ("hand.thp", 12.0),
    ],
)
def test_what_is_written_is_read_back(within: MotionClip, tmp_path: Path, name: str, within_mm: float) -> None:
    """To the same hand when its proportions are given, with frames held as before."""
    space = within.model.shape_space
    save_hand(tmp_path / "own.json", space.names, within.shape.tolist(), within.side, {}, units=space.units)
    write(within, tmp_path / name)
    found = load_clip(tmp_path / name, hand=None if name.endswith("thp") else tmp_path / "own.json")
    assert found.side == within.side
    ours, theirs = (one.with_up("y").frames.keypoints for one in (within, found))
    assert float((ours - theirs).norm(dim=-1).max()) < 1e-3 * within_mm
    assert np.abs(found.seconds.numpy() - within.seconds.numpy()).max() < 1e-8
    assert found.held == (3,)


@pytest.mark.parametrize("name", ["hand.bvh", "hand.bap", "hand.openxr.json", "hand.joints.csv"])
def test_files_that_do_not_tell_their_axes_are_read_in_those_that_are_said(
    within: MotionClip, tmp_path: Path, name: str
) -> None:
    space = within.model.shape_space
    save_hand(tmp_path / "own.json", space.names, within.shape.tolist(), within.side, {}, units=space.units)
    write(replace(within, axes="z-up"), tmp_path / name)
    found = load_clip(tmp_path / name, hand=tmp_path / "own.json", up="z")
    ours, theirs = (one.with_up("y").frames.keypoints for one in (within, found))
    assert float((ours - theirs).norm(dim=-1).max()) < 1.5e-3


def _recording(clip: MotionClip, form: str) -> object:
    """As other programs write it."""
    joints = openxr_joints(clip.with_up("y").frames)
    positions, turns = joints.position.tolist(), quaternion_of_rotation(joints.rotation).tolist()
    if form == "webxr objects":
        frames = [
            {
                "timestamp": 1000 + 40.0 * t,
                "hands": {
                    clip.side: {
                        webxr_name(name): {
                            "position": dict(zip("xyz", positions[t][j], strict=True)),
                            "orientation": dict(zip("xyzw", turns[t][j], strict=True)),
                        }
                        for j, name in enumerate(OPENXR_JOINTS)
                        if name != "palm"
                    }
                },
            }
            for t in range(len(clip))
        ]
        return frames
    rows = [
        [{"position": place, "rotation": turn} for place, turn in zip(positions[t][1:], turns[t][1:], strict=True)]
        for t in range(len(clip))
    ]
    frames = [{"handedness": clip.side, "time": 0.04 * t, "joints": row} for t, row in enumerate(rows)]
    return {"frames": [*frames, {"handedness": clip.side, "time": 9.0, "joints": []}]}


@pytest.mark.parametrize("form", ["webxr objects", "webxr lists"])
def test_recordings_of_hand_joints(clip: MotionClip, tmp_path: Path, form: str) -> None:
    (tmp_path / "recording.json").write_text(json.dumps(_recording(clip, form)))
    found, fit = clip_of_xr_recording(tmp_path / "recording.json", clip.model, clip.shape)
    assert found.side == clip.side
    assert len(found) == len(clip)
    assert found.fps == pytest.approx(25.0)
    assert float(fit.residual.max()) < 1e-6
    assert float((found.frames.keypoints - clip.with_up("y").frames.keypoints).norm(dim=-1).max()) < 1e-6
    assert torch.equal(load_clip(tmp_path / "recording.json").poses, found.poses)


def test_recordings_that_lack_something_are_refused(clip: MotionClip, tmp_path: Path) -> None:
    path = tmp_path / "recording.json"
    frames = _recording(clip, "webxr objects")
    assert isinstance(frames, list)
    del frames[2]["hands"][clip.side]["thumb-tip"]
    path.write_text(json.dumps(frames))
    with pytest.raises(InputError, match=r"frames\[2\]: thumb-tip: expected position and orientation, got None"):
        clip_of_xr_recording(path, clip.model)
    frames[2]["hands"][clip.side]["thumb-tip"] = {"position": [0, 0, 0], "orientation": [0, 0, 0, 2]}
    path.write_text(json.dumps(frames))
    with pytest.raises(InputError, match="thumb-tip: expected unit quaternions, got one of length 2"):
        clip_of_xr_recording(path, clip.model)
    other = "left" if clip.side == "right" else "right"
    with pytest.raises(InputError, match=f"expected joints of a {other} hand in one frame or more, got none in 7"):
        clip_of_xr_recording(path, clip.model, side=other)
    path.write_text(json.dumps([{"joints": {}}]))
    with pytest.raises(InputError, match="expected the joints of one hand, left or right, got neither"):
        clip_of_xr_recording(path, clip.model)


def _actions(clip: MotionClip) -> dict[str, Any]:
    """As IWER's recorder writes it: joints in the frame of a target ray, another hand and an input without one."""
    frames = clip.with_up("y").frames
    joints = openxr_joints(frames)
    ray_turn = rotation_from_vector(torch.tensor([0.4, -0.8, 0.3], dtype=torch.float64))
    ray = torch.tensor([0.1, 1.2, -0.4], dtype=torch.float64)
    places = (joints.position - ray) @ ray_turn
    turns = quaternion_of_rotation(ray_turn.mT @ joints.rotation)
    eight = torch.cat((places, turns, torch.full_like(places[..., :1], 0.01)), -1)[:, 1:].flatten(1).tolist()
    pose, nothing = [*ray.tolist(), *quaternion_of_rotation(ray_turn).tolist()], [0.0] * 6 + [1.0]
    names = [webxr_name(name) for name in OPENXR_JOINTS[1:]]
    other = "left" if clip.side == "right" else "right"
    schema = [
        [0, {"handedness": other, "hasHand": False, "hasGrip": True, "hasGamepad": True}],
        [1, {"handedness": clip.side, "hasHand": True, "hasGrip": True, "hasGamepad": True, "jointSequence": names}],
        [2, {"handedness": other, "hasHand": True, "hasGrip": False, "hasGamepad": False, "jointSequence": names}],
    ]
    rows: list[list[Any]] = [
        [521.0 + 40 * t, *nothing, [0, *nothing, nothing, [[1, 1, 0.3]]], [1, *pose, nothing, one, [[0, 0, 0]]]]
        for t, one in enumerate(eight)
    ]
    rows[-1].append([2, *nothing, [0.0, 0, 0, 0, 0, 0, 1, 0.01] * len(names)])  # seen in one frame
    return {"schema": schema, "frames": [*rows, [1000.0, *nothing]]}


def test_recordings_of_an_emulator_of_webxr(clip: MotionClip, tmp_path: Path) -> None:
    path = tmp_path / "recording.json"
    content = _actions(clip)
    path.write_text(json.dumps(content))
    found = load_clip(path, side=clip.side)
    _, fit = clip_of_xr_recording(path, clip.model, clip.shape, side=clip.side)
    assert float(fit.residual.max()) < 1e-6
    assert found.seconds.tolist() == pytest.approx([0.04 * t for t in range(len(clip))])
    wrists = clip.with_up("y").frames.keypoints[:, 0]
    assert float((found.frames.keypoints[:, 0] - wrists).norm(dim=-1).max()) < 1e-9
    with pytest.raises(InputError, match="expected the joints of one hand, left or right, got both"):
        load_clip(path)
    content["frames"][2][9][9].pop()
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"frames\[2\], input 1: joints: expected a list of 200, got 199"):
        load_clip(path, side=clip.side)
    content["frames"] = [[521.0, 0.0, 0.0]]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"frames\[0\]: expected a time, the viewer's pose and inputs, got \[521"):
        load_clip(path, side=clip.side)


def test_mano_about_a_mean_posture_and_of_components(clip: MotionClip, tmp_path: Path) -> None:
    """The mean and the components are the file's own, as data sets carry them."""
    write_mano(clip, tmp_path / "flat.npz")
    flat = dict(np.load(tmp_path / "flat.npz"))
    known, _ = clip_of_mano(tmp_path / "flat.npz", clip.model, clip.shape)
    generator = np.random.default_rng(0)
    mean, basis = 0.2 * generator.normal(size=45), np.linalg.qr(generator.normal(size=(45, 45)))[0]
    turned = flat | {"hand_pose": flat["hand_pose"] - mean, "flat_hand_mean": np.array(False), "hands_mean": mean}
    np.savez(tmp_path / "mean.npz", **turned)
    found, _ = clip_of_mano(tmp_path / "mean.npz", clip.model, clip.shape)
    assert float((found.poses - known.poses).abs().max()) < 1e-9
    assert found.notes == ()
    some = (flat["hand_pose"] @ basis.T)[:, :12]
    np.savez(tmp_path / "some.npz", **(flat | {"hand_pose": some, "hands_components": basis}))
    np.savez(tmp_path / "full.npz", **(flat | {"hand_pose": some @ basis[:12]}))
    found, _ = clip_of_mano(tmp_path / "some.npz", clip.model, clip.shape)
    expected, _ = clip_of_mano(tmp_path / "full.npz", clip.model, clip.shape)
    assert float((found.poses - expected.poses).abs().max()) < 1e-9
    np.savez(tmp_path / "bare.npz", **(flat | {"hand_pose": some}))
    with pytest.raises(InputError, match="got 12 principal components, which need an array hands_components"):
        clip_of_mano(tmp_path / "bare.npz", clip.model)
    del turned["hands_mean"]
    np.savez(tmp_path / "unknown.npz", **turned)
    found, _ = clip_of_mano(tmp_path / "unknown.npz", clip.model, clip.shape)
    assert "a relaxed hand of ours stands for MANO's mean" in found.notes[0]
