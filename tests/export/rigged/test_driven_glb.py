"""A mesh of others, with WebXR's joints, moved by a clip: our own hand of other proportions stands for it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.export.rigged.test_glb import FLOAT32, Glb
from torchhand.errors import InputError
from torchhand.export.clip import MotionClip, rest_clip
from torchhand.export.conventions import webxr_name
from torchhand.export.rigged.driven_glb import write_driven_glb
from torchhand.export.rigged.glb import write_glb
from torchhand.hand.conventions import OPENXR_JOINTS, openxr_joints


def test_joints_turn_as_ours_on_the_meshs_own_lengths(clip: MotionClip, tmp_path: Path) -> None:
    other = rest_clip(clip.model, clip.side)  # the default proportions, which the clip's hand does not have
    write_glb(other, tmp_path / "other.glb", has_correctives=False, skeleton="webxr")
    write_driven_glb(clip, tmp_path / "other.glb", tmp_path / "driven.glb")
    glb, upright = Glb(tmp_path / "driven.glb"), clip.with_up("y")
    names = [node["name"] for node in glb.json["nodes"]]
    expected = replace(upright, shape=other.shape, axes="y-up")
    joints, whole = openxr_joints(upright.frames), openxr_joints(expected.frames)
    assert np.abs(glb.times() - np.arange(7) / 25).max() < 1e-7
    assert {"wrist", "thumb-tip", "pinky-finger-phalanx-distal"} <= set(names)
    for t in range(len(clip)):
        world = glb.world(t)
        for i, name in enumerate(OPENXR_JOINTS):
            if name == "palm":
                continue
            matrix = world[names.index(webxr_name(name))]
            assert np.abs(matrix[:3, :3] - joints.rotation[t, i].numpy()).max() < 3e-6
            assert np.abs(matrix[:3, 3] - whole.position[t, i].numpy()).max() < 1e-5
        assert np.abs(world[names.index("wrist")][:3, 3] - joints.position[t, 1].numpy()).max() < FLOAT32


def test_meshes_that_do_not_fit_are_refused(clip: MotionClip, tmp_path: Path) -> None:
    write_glb(rest_clip(clip.model, clip.side), tmp_path / "ours.glb", has_correctives=False)
    with pytest.raises(InputError, match="expected nodes named as WebXR's hand joints, lacks thumb-metacarpal"):
        write_driven_glb(clip, tmp_path / "ours.glb", tmp_path / "driven.glb")
    far = "left" if clip.side == "right" else "right"
    write_glb(rest_clip(clip.model, far), tmp_path / "far.glb", has_correctives=False, skeleton="webxr")
    with pytest.raises(InputError, match=f"expected the mesh of a {clip.side} hand, got that of a {far} one"):
        write_driven_glb(clip, tmp_path / "far.glb", tmp_path / "driven.glb")
    (tmp_path / "text.glb").write_text("no mesh at all, and longer than a header")
    with pytest.raises(InputError, match="expected binary glTF"):
        write_driven_glb(clip, tmp_path / "text.glb", tmp_path / "driven.glb")
    (tmp_path / "cut.glb").write_bytes((tmp_path / "ours.glb").read_bytes()[:2000])
    with pytest.raises(InputError, match="got another or a cut file"):
        write_driven_glb(clip, tmp_path / "cut.glb", tmp_path / "driven.glb")
    assert not (tmp_path / "driven.glb").exists()
