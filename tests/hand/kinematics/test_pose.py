"""Pose spaces against the degrees of freedom that the papers name, and the named postures."""

import math
from dataclasses import replace

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand.kinematics.pose import POSE_SPACES, POSTURES, named_pose_space, pose_space, posture, rebased
from torchhand.hand.kinematics.skeleton import DOFS, FINGERS, JOINT_DOFS, ROOT_DOFS

SIZES = {
    **{"planar": 3, "planar_scale": 4, "planar_abduction": 9},
    **{"dof26": 26, "dof27": 27, "dof28": 28, "dof31": 31, "dof36": 36},
}
# What each paper leaves free of the thumb and of every finger.
THUMB = {
    "dof26": {"cmc_fe", "cmc_aa", "cmc_tw", "ip_fe"},
    "dof27": {"cmc_fe", "cmc_aa", "mcp_fe", "mcp_aa", "ip_fe"},
    "dof28": {"cmc_fe", "cmc_aa", "cmc_tw", "mcp_fe", "mcp_aa", "ip_fe"},
    "dof31": {"cmc_fe", "cmc_aa", "cmc_tw", "mcp_fe", "ip_fe"},
}
FINGER = {
    "dof26": {"mcp_fe", "mcp_aa", "mcp_tw", "pip_fe"},
    "dof27": {"mcp_fe", "mcp_aa", "pip_fe", "dip_fe"},
    "dof28": {"mcp_fe", "mcp_aa", "pip_fe", "dip_fe"},
    "dof31": {"mcp_fe", "mcp_aa", "mcp_tw", "pip_fe", "dip_fe"},
}


def test_sizes() -> None:
    assert {name: named_pose_space(name).size for name in POSE_SPACES} == SIZES


@pytest.mark.parametrize("name", THUMB)
def test_columns_of_the_papers(name: str) -> None:
    expected = {*ROOT_DOFS, *(f"thumb_{joint}" for joint in THUMB[name])}
    expected |= {f"{finger}_{joint}" for finger in FINGERS[1:] for joint in FINGER[name]}
    space = named_pose_space(name)
    assert set(space.free_names) == expected
    assert list(space.free_names) == sorted(space.free_names, key=DOFS.index)


@pytest.mark.parametrize("name", POSE_SPACES)
def test_free_parameters_come_back(name: str, generator: torch.Generator) -> None:
    space = named_pose_space(name)
    free = torch.randn(2, 3, space.size, generator=generator, dtype=torch.float64)
    dof = space.dof(free)
    torch.testing.assert_close(space.free(dof), free, atol=1e-13, rtol=0)
    for column, dof_name in enumerate(space.free_names):
        torch.testing.assert_close(dof[..., DOFS.index(dof_name)], free[..., column], atol=0, rtol=0)


def test_ties(generator: torch.Generator) -> None:
    """Ouhaddi and Horain 1998, equations 1 and 4, flexion positive."""
    space = named_pose_space("dof26")
    dof = space.dof(torch.randn(space.size, generator=generator, dtype=torch.float64))
    value = dict(zip(DOFS, dof.tolist(), strict=True))
    for finger in FINGERS[1:]:
        assert value[f"{finger}_dip_fe"] == pytest.approx(2 / 3 * value[f"{finger}_pip_fe"])
    assert value["thumb_mcp_fe"] == pytest.approx(2 * (value["thumb_cmc_fe"] - math.pi / 6))


@pytest.mark.parametrize("name", list(POSE_SPACES))
def test_own_parameters_are_read_off_their_dofs(name: str, generator: torch.Generator) -> None:
    space = named_pose_space(name)
    free = torch.randn(2, 3, space.size, generator=generator, dtype=torch.float64)
    pose = space.dof(free)
    torch.testing.assert_close(space.own(pose), free, atol=1e-12, rtol=0)
    tied = [DOFS.index(n) for n in DOFS if n not in space.free_names]
    pose[..., tied] = 0.123  # stopped at some limit
    torch.testing.assert_close(space.own(pose), free, atol=1e-12, rtol=0)


def test_own_parameters_need_names_of_dofs() -> None:
    space = replace(named_pose_space("planar"), free_names=("root_tx", "synergy", "root_rz"))
    with pytest.raises(ValueError, match="free parameter 'synergy' is not named after a DOF"):
        space.own(torch.zeros(36, dtype=torch.float64))


def test_planar_spaces_move_only_in_the_picture() -> None:
    space = named_pose_space("planar")
    assert space.free_names == ("root_tx", "root_ty", "root_rz")
    pose = space.dof(torch.tensor((0.1, 0.2, 0.3), dtype=torch.float64))
    assert pose.nonzero().flatten().tolist() == [0, 1, 5]
    assert named_pose_space("planar_scale").free_names == ("root_tx", "root_ty", "root_tz", "root_rz")


def test_about_keeps_ties_as_ties_of_changes(generator: torch.Generator) -> None:
    pose = torch.randn(36, generator=generator, dtype=torch.float64)
    space = named_pose_space("dof26").about(pose)
    free = torch.zeros(space.size, dtype=torch.float64)
    torch.testing.assert_close(space.dof(free), pose, atol=0, rtol=0)
    free[space.free_names.index("index_pip_fe")] = 0.3
    change = space.dof(free) - pose
    assert float(change[DOFS.index("index_dip_fe")]) == pytest.approx(0.2)


def test_rebased_is_the_same_hand(generator: torch.Generator) -> None:
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    pose = 0.5 * torch.randn(4, 36, generator=generator, dtype=torch.float64)
    reference = rotation_from_vector(torch.randn(4, 3, generator=generator, dtype=torch.float64))
    straight, turned = rebased(pose, reference)
    assert bool((straight[:, 3:6] == 0).all())
    before, after = kinematics(pose, root_reference=reference), kinematics(straight, root_reference=turned)
    torch.testing.assert_close(after.keypoints, before.keypoints, atol=1e-14, rtol=0)


@pytest.mark.parametrize("name", POSTURES)
def test_postures_lie_within_the_limits(name: str) -> None:
    skeleton, pose = load_hand_model().skeleton, posture(name, dtype=torch.float64)
    assert bool((pose[:6] == 0).all())
    assert bool((pose[6:] >= skeleton.lower - 1e-9).all())
    assert bool((pose[6:] <= skeleton.upper + 1e-9).all())


def test_what_postures_mean() -> None:
    """The fist brings every fingertip near the palm, pointing leaves the index straight, the open hand is widest."""
    kinematics = load_hand_model().kinematics(dtype=torch.float64)

    def reach(name: str) -> list[float]:
        points = kinematics(posture(name, dtype=torch.float64)).keypoints
        return [float((points[tip] - points[tip - 3]).norm()) for tip in (8, 12, 16, 20)]

    straight, closed, pointing = reach("flat"), reach("fist"), reach("point")
    assert all(fist < 0.55 * flat for fist, flat in zip(closed, straight, strict=True))
    assert pointing[0] == pytest.approx(straight[0])
    assert pointing[1:] == pytest.approx(closed[1:])
    spread = {
        n: float((p := kinematics(posture(n, dtype=torch.float64)).keypoints)[4].sub(p[20]).norm())
        for n in ("open", "flat")
    }
    assert spread["open"] > 1.3 * spread["flat"]


def test_the_fists_thumb_lies_on_its_fingers() -> None:
    """Its tip is before the middle finger's middle phalanx: touching to a few millimetres, not inside."""
    model = load_hand_model()
    points = model.kinematics(dtype=torch.float64)(posture("fist", dtype=torch.float64)).keypoints
    metric = model.shape_space.metric(model.shape_space.default)
    phalanx = torch.stack([points[10] + t * (points[11] - points[10]) for t in torch.linspace(0, 1, 20).double()])
    distance = float((phalanx - points[4]).norm(dim=-1).min())
    touching = float(metric["middle_pip_radius"] + metric["thumb_tip_radius"])
    assert touching - 3e-3 < distance < touching + 8e-3


def test_what_spaces_refuse() -> None:
    with pytest.raises(ValueError, match="unknown pose space 'dof99'; allowed: planar, "):
        named_pose_space("dof99")
    with pytest.raises(ValueError, match="unknown DOF 'nose'; allowed: root_tx, "):
        pose_space("mine", ("nose",))
    with pytest.raises(ValueError, match="unknown DOF 'nose'"):
        pose_space("mine", ("root_tx",), ties={"nose": ("root_tx", 1.0, 0.0)})
    with pytest.raises(ValueError, match="tie of root_ty: 'root_tz' is not free"):
        pose_space("mine", ("root_tx",), ties={"root_ty": ("root_tz", 1.0, 0.0)})
    with pytest.raises(ValueError, match="unknown posture 'wave'; allowed: open, "):
        posture("wave", dtype=torch.float64)


def test_names() -> None:
    assert len(DOFS) == 36
    assert DOFS[:6] == ROOT_DOFS
    assert DOFS[6:12] == tuple(f"thumb_{j}" for j in ("cmc_fe", "cmc_aa", "cmc_tw", "mcp_fe", "mcp_aa", "ip_fe"))
    assert JOINT_DOFS[6:12] == tuple(f"index_{j}" for j in ("cmc_fe", "mcp_fe", "mcp_aa", "mcp_tw", "pip_fe", "dip_fe"))
