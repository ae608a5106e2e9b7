"""MPEG-4 BAPs: both numberings, units, and what they leave out."""

import math

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand.conventions.baps import LARGEST_ID, NUMBERINGS, bap_ids, baps_of_pose, pose_of_baps
from torchhand.hand.kinematics import DOFS, JOINT_DOFS

FINAL_LEFT = {  # as ISO/IEC 14496-2 prints them
    **{"little_cmc_fe": 123, "little_mcp_fe": 125, "little_mcp_aa": 127, "little_mcp_tw": 129, "little_pip_fe": 131},
    **{"little_dip_fe": 133, "ring_cmc_fe": 135, "ring_mcp_fe": 137, "ring_mcp_aa": 139, "ring_mcp_tw": 141},
    **{"ring_pip_fe": 143, "ring_dip_fe": 145, "middle_cmc_fe": 147, "middle_mcp_fe": 149, "middle_mcp_aa": 151},
    **{"middle_mcp_tw": 153, "middle_pip_fe": 155, "middle_dip_fe": 157, "index_cmc_fe": 159, "index_mcp_fe": 161},
    **{"index_mcp_aa": 163, "index_mcp_tw": 165, "index_pip_fe": 167, "index_dip_fe": 169, "thumb_cmc_fe": 171},
    **{"thumb_cmc_aa": 173, "thumb_cmc_tw": 175, "thumb_mcp_fe": 177, "thumb_ip_fe": 179},
}
DRAFT_LEFT = {"little": 120, "ring": 130, "middle": 140, "index": 150, "thumb": 160}


def _poses(count: int, generator: torch.Generator) -> torch.Tensor:
    skeleton = load_hand_model().skeleton
    fraction = torch.rand(count, 30, generator=generator, dtype=torch.float64)
    root = torch.randn(count, 6, generator=generator, dtype=torch.float64)
    return torch.cat((root, skeleton.lower + fraction * (skeleton.upper - skeleton.lower)), 1)


def test_the_final_numbering() -> None:
    left, right = bap_ids("final", "left"), bap_ids("final", "right")
    angles = {name: k for name, k in left.items() if name in JOINT_DOFS}
    assert angles == FINAL_LEFT
    assert all(right[name] == k + 1 for name, k in angles.items())
    root = ("tr_vertical", "tr_lateral", "tr_frontal", "rt_body_turn", "rt_body_roll", "rt_body_tilt")
    assert [left[name] for name in root] == [181, 182, 183, 184, 185, 186] == [right[name] for name in root]


def test_the_draft_numbering() -> None:
    left, right = bap_ids("draft", "left"), bap_ids("draft", "right")
    assert len(left) == 31
    for finger, base in DRAFT_LEFT.items():
        parts = (
            ("cmc_fe", "cmc_aa", "cmc_tw", "mcp_fe", "ip_fe")
            if finger == "thumb"
            else ("mcp_fe", "mcp_aa", "mcp_tw", "pip_fe", "dip_fe")
        )
        assert [left[f"{finger}_{part}"] for part in parts] == [base + 2 * i for i in range(5)]
        assert [right[f"{finger}_{part}"] for part in parts] == [base + 2 * i + 1 for i in range(5)]
    assert [left["tr_vertical"], left["rt_body_tilt"]] == [170, 175]
    assert max(left.values()) == LARGEST_ID["draft"]


@pytest.mark.parametrize("numbering", NUMBERINGS)
@pytest.mark.parametrize("side", ["left", "right"])
def test_rounding_is_half_a_unit(numbering, side, generator: torch.Generator) -> None:
    poses = _poses(50, generator)
    baps = baps_of_pose(poses, numbering, side)
    back = pose_of_baps(baps.values, numbering, side)
    kept = [i for i, dof in enumerate(JOINT_DOFS) if dof in baps.names]
    assert len(kept) == {"final": 29, "draft": 25}[numbering]
    assert float(baps.residual[:, kept].abs().max()) <= 0.5e-5 * (1 + 1e-9)
    assert torch.allclose(baps.residual, (poses - back)[:, 6:], rtol=0, atol=1e-15)
    lost = [i for i in range(30) if i not in kept]
    assert torch.equal(baps.residual[:, lost], poses[:, 6:][:, lost])
    assert float((poses - back)[:, :3].abs().max()) <= 0.5e-3 * (1 + 1e-9)


def test_the_root_is_turn_roll_tilt() -> None:
    names = tuple(bap_ids("final", "right"))
    for name, place in (("rt_body_turn", 4), ("rt_body_roll", 5), ("rt_body_tilt", 3)):
        values = torch.zeros(len(names), dtype=torch.long)
        values[names.index(name)] = 50000
        pose = pose_of_baps(values, "final", "right")
        assert float(pose[place]) == pytest.approx(0.5, abs=1e-12)
        assert float(pose.abs().sum()) == pytest.approx(0.5, abs=1e-12)
    for place, name in enumerate(("tr_lateral", "tr_vertical", "tr_frontal")):
        values = torch.zeros(len(names), dtype=torch.long)
        values[names.index(name)] = -250
        assert pose_of_baps(values, "final", "right")[:3].tolist() == [-0.25 if i == place else 0.0 for i in range(3)]


def test_a_root_rolled_by_a_right_angle() -> None:
    pose = torch.zeros(3, 36, dtype=torch.float64)
    pose[:, 5] = math.pi / 2
    pose[1, 4], pose[2, 3] = 0.3, -0.8
    back = pose_of_baps(baps_of_pose(pose, "final", "left").values, "final", "left")
    assert float((rotation_from_vector(back[:, 3:6]) - rotation_from_vector(pose[:, 3:6])).abs().max()) < 3e-5


def test_any_batch_is_a_loop(generator: torch.Generator) -> None:
    poses = _poses(6, generator)
    many = baps_of_pose(poses.unflatten(0, (2, 3)), "draft", "left")
    back = pose_of_baps(many.values, "draft", "left")
    for i in range(6):
        one = baps_of_pose(poses[i], "draft", "left")
        assert torch.equal(many.values[i // 3, i % 3], one.values)
        assert torch.allclose(back[i // 3, i % 3], pose_of_baps(one.values, "draft", "left"), rtol=0, atol=1e-14)
    assert len(DOFS) == back.shape[-1]
