"""Poses of a truth: our own simulator's as they are, others' from keypoints, and clear words for the rest."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files import FittedHand, load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, posture
from torchhand.simulate import sample_shape
from torchhand.study.hypotheses.known_poses import load_known_poses

MODEL = load_hand_model()
SPACE = MODEL.shape_space
SHAPE = sample_shape(SPACE, torch.Generator().manual_seed(2))


def poses() -> torch.Tensor:
    found = torch.stack([posture(name, dtype=torch.float64) for name in ("open", "point", "four")])
    found[:, :3] = torch.tensor((0.02, -0.01, 0.5))
    found[:, 3:6] = torch.tensor((0.1, -0.3, 2.0))
    return found


def own() -> dict[str, Any]:
    return {
        "pose": poses().numpy(),
        "root_reference": rotation_from_vector(torch.tensor((0.0, 1.0, 0.0)).double()).numpy(),
        "shape": SHAPE.numpy(),
        "side": np.array("left"),
        "dof_names": np.array(DOFS),
        "shape_names": np.array(SPACE.names),
    }


def saved(path: Path, content: dict[str, Any]) -> Path:
    np.savez(path / "truth.npz", **content)
    return path / "truth.npz"


def test_our_own_truth_is_taken_as_it_is(tmp_path: Path) -> None:
    content = own()
    known = load_known_poses(saved(tmp_path, content | {"keypoints3d": np.zeros((3, 21, 3))}))
    assert len(known) == 3
    assert known.side == "left"
    assert known.source == "exact, of the truth"
    for name in ("pose", "root_reference", "shape"):
        np.testing.assert_array_equal(getattr(known, name).numpy(), content[name])


@pytest.mark.parametrize("side", ["left", "right"])
def test_keypoints_tell_pose_shape_and_side(side: str, tmp_path: Path) -> None:
    kinematics = MODEL.kinematics("left" if side == "left" else "right", dtype=torch.float64)
    keypoints = kinematics(poses(), SHAPE).keypoints
    known = load_known_poses(saved(tmp_path, {"keypoints3d": keypoints.numpy()}))
    assert known.side == side
    assert f"{side} hand" in known.source
    again = kinematics(known.pose, known.shape, root_reference=known.root_reference).keypoints
    assert float((again - keypoints).norm(dim=-1).mean()) < 1.5e-3
    assert float((known.pose - poses())[:, 6:].abs().mean()) < np.radians(3)


def test_a_known_shape_is_kept(tmp_path: Path) -> None:
    values = dict(zip(SPACE.names, SHAPE.tolist(), strict=True))
    hand = FittedHand(side="right", values=values, units={}, provenance={})
    keypoints = MODEL.kinematics(dtype=torch.float64)(poses(), SHAPE).keypoints
    known = load_known_poses(saved(tmp_path, {"keypoints3d": keypoints.numpy()}), hand=hand)
    torch.testing.assert_close(known.shape, SHAPE)
    assert known.side == "right"


def test_frames_without_keypoints_have_no_pose(tmp_path: Path) -> None:
    keypoints = MODEL.kinematics(dtype=torch.float64)(poses(), SHAPE).keypoints.numpy()
    keypoints[1] = np.nan
    known = load_known_poses(saved(tmp_path, {"keypoints3d": keypoints}), side="right")
    assert known.pose.isfinite().all(-1).tolist() == [True, False, True]


@pytest.mark.parametrize(
    ("change", "given", "message"),
    [
        ({"pose": np.zeros((3, 35))}, {}, r"pose: expected numbers of shape \(3, 36\), got \(3, 35\)"),
        ({"shape": np.zeros(4)}, {}, r"shape: expected numbers of shape \(52,\), got \(4,\)"),
        ({"side": np.array("both")}, {}, "side: expected left or right, got 'both'"),
        ({"dof_names": np.array(["x"] * 36)}, {}, "dof_names: expected the 36 of this version's hand, got others"),
        ({}, {"side": "right"}, "--side: expected left, that of .*truth.npz, got right"),
        (
            {},
            {"hand": FittedHand(side="left", values={}, units={}, provenance={})},
            "--hand: expected none: .*truth.npz tells the hand's shape",
        ),
    ],
)
def test_mistakes_in_our_own_are_named(
    change: dict[str, Any], given: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        load_known_poses(saved(tmp_path, own() | change), **given)


def test_mistakes_in_keypoints_are_named(tmp_path: Path) -> None:
    for content, message in (
        ({"keypoints3d": np.zeros((3, 20, 3))}, r"keypoints3d: expected numbers of shape \(frames, 21, 3\)"),
        ({"keypoints3d": np.full((2, 21, 3), np.nan)}, r"keypoints3d: no frame can be fitted \(too few points\)"),
        ({"pose": np.zeros((3, 36))}, "expected keypoints3d, or pose, root_reference, .* shape_names; got pose"),
        ({"x": np.zeros(3)}, "got none of these"),
    ):
        with pytest.raises(InputError, match=message):
            load_known_poses(saved(tmp_path, content))
    (tmp_path / "truth.npz").write_text("no zip")
    with pytest.raises(InputError, match="expected an npz file with keypoints3d, or with pose"):
        load_known_poses(tmp_path / "truth.npz")
