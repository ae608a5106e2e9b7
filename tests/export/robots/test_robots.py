"""URDF and MJCF: kinematics in pytorch-kinematics and MuJoCo, limits, masses, inertias, closed meshes."""

import math
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import numpy as np
import pytest
import pytorch_kinematics
import torch
import trimesh

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.robots.link_solids import link_solids
from torchhand.export.robots.mjcf import MjcfSettings, write_mjcf
from torchhand.export.robots.strength import HAND_MASS, joint_torques
from torchhand.export.robots.urdf import write_urdf
from torchhand.hand import BONES, DOFS, JOINT_DOFS, HandModel

SAME_PLACE = 1e-6  # metres
AS_TRACKED = MjcfSettings(has_couplings=False, is_apart=False)


@pytest.fixture(scope="module")
def mujoco() -> ModuleType:
    return pytest.importorskip("mujoco", reason="needs MuJoCo: pip install mujoco")


def test_urdf_moves_as_ours_in_pytorch_kinematics(
    clip: MotionClip, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_urdf(clip, tmp_path / "hand.urdf")
    chain = pytorch_kinematics.build_chain_from_urdf((tmp_path / "hand.urdf").read_bytes()).to(dtype=torch.float64)
    capfd.readouterr()  # its parser speaks of the tag that is MuJoCo's
    names = chain.get_joint_parameter_names()
    assert set(names) == set(JOINT_DOFS)
    frames = clip.kinematics(torch.cat((torch.zeros(7, 6).double(), clip.poses[:, 6:]), 1), clip.shape)
    places = chain.forward_kinematics(clip.poses[:, [DOFS.index(name) for name in names]])
    for i, bone in enumerate(BONES):
        matrix = places[bone].get_matrix()
        assert float((matrix[:, :3, 3] - frames.position[:, i]).abs().max()) < SAME_PLACE
        assert float((matrix[:, :3, :3] - frames.rotation[:, i]).abs().max()) < 1e-6
    for finger, point in zip(("thumb", "index", "middle", "ring", "little"), (4, 8, 12, 16, 20), strict=True):
        tip = places[f"{finger}_tip"].get_matrix()[:, :3, 3]
        assert float((tip - frames.keypoints[:, point]).abs().max()) < SAME_PLACE


def test_urdf_states_what_simulators_need(clip: MotionClip, tmp_path: Path) -> None:
    solids = write_urdf(clip, tmp_path / "hand.urdf")
    root = ElementTree.parse(tmp_path / "hand.urdf").getroot()
    assert root.tag == "robot"
    joints = {joint.attrib["name"]: joint for joint in root.iter("joint")}
    for i, dof in enumerate(JOINT_DOFS):
        limit = joints[dof].find("limit")
        assert limit is not None
        assert abs(float(limit.attrib["lower"]) - float(clip.skeleton.lower[i])) < 1e-11
        assert abs(float(limit.attrib["upper"]) - float(clip.skeleton.upper[i])) < 1e-11
        assert 0.1 < float(limit.attrib["effort"]) < 15
        assert float(limit.attrib["velocity"]) > 0
    total = 0.0
    for link in root.iter("link"):
        inertial = link.find("inertial")
        assert inertial is not None  # PyBullet takes 1 kg for a link without, and tips would be five of these
        mass, entries = inertial.find("mass"), inertial.find("inertia")
        assert mass is not None
        assert entries is not None
        e = {key: float(value) for key, value in entries.attrib.items()}
        _check_possible(
            float(mass.attrib["value"]),
            np.array([[e["ixx"], e["ixy"], e["ixz"]], [e["ixy"], e["iyy"], e["iyz"]], [e["ixz"], e["iyz"], e["izz"]]]),
        )
        total += float(mass.attrib["value"])
        for mesh in link.iter("mesh"):
            assert (tmp_path / mesh.attrib["filename"]).is_file()
    assert total == pytest.approx(sum(solid.mass for solid in solids), rel=1e-8)


def test_srdf_names_links_and_pairs_of_the_robot(clip: MotionClip, tmp_path: Path) -> None:
    write_urdf(clip, tmp_path / "hand.urdf")
    robot = ElementTree.parse(tmp_path / "hand.urdf").getroot()
    semantic = ElementTree.parse(tmp_path / "hand.srdf").getroot()
    assert semantic.attrib["name"] == robot.attrib["name"]
    links = {link.attrib["name"] for link in robot.iter("link")}
    pairs = [(one.attrib["link1"], one.attrib["link2"]) for one in semantic.iter("disable_collisions")]
    chains = [(chain.attrib["base_link"], chain.attrib["tip_link"]) for chain in semantic.iter("chain")]
    assert {name for pair in [*pairs, *chains] for name in pair} <= links
    assert len({frozenset(pair) for pair in pairs}) == len(pairs)
    assert ("index_proximal", "index_middle") in pairs
    assert ("index_distal", "thumb_distal") not in pairs


def test_meshes_of_a_package(clip: MotionClip, tmp_path: Path) -> None:
    write_urdf(clip, tmp_path / "hand.urdf", package="my_hands")
    robot = ElementTree.parse(tmp_path / "hand.urdf").getroot()
    files = [mesh.attrib["filename"] for mesh in robot.iter("mesh")]
    assert files
    for file in files:
        assert file.startswith("package://my_hands/hand_urdf_meshes/")
        assert (tmp_path / file.removeprefix("package://my_hands/")).is_file()
    with pytest.raises(InputError, match="package: expected a name"):
        write_urdf(clip, tmp_path / "hand.urdf", package="../elsewhere")


def test_masses_are_those_of_an_adults_hand(clips: dict[str, MotionClip]) -> None:
    clip = replace(clips["right"], shape=clips["right"].model.shape_space.default.double())
    solids = link_solids(clip)
    assert sum(solid.mass for solid in solids) == pytest.approx(HAND_MASS, rel=1e-9)
    heavier = link_solids(clip, mass=0.5)
    for one, other in zip(solids, heavier, strict=True):
        assert other.mass == pytest.approx(one.mass * 0.5 / HAND_MASS, rel=1e-9)
        assert other.inertia == pytest.approx(one.inertia * 0.5 / HAND_MASS, rel=1e-9)


def test_torques_are_those_of_the_levers(clip: MotionClip) -> None:
    torques = dict(zip(JOINT_DOFS, joint_torques(clip).tolist(), strict=True))
    assert torques["index_dip_fe"] < torques["index_pip_fe"] < torques["index_mcp_fe"]
    assert torques["little_mcp_fe"] < torques["ring_mcp_fe"] < torques["index_mcp_fe"] < 10
    lever = float(clip.skeleton.tip_offset[1].norm())
    assert torques["index_dip_fe"] == pytest.approx(65.0 * lever, rel=1e-6)  # straight, nothing is longer than it


def _check_possible(mass: float, inertia: np.ndarray) -> None:
    """A body of positive density: positive moments, none larger than the other two together."""
    moments = np.linalg.eigvalsh(inertia)
    assert mass > 1e-5
    assert moments[0] > 0
    assert moments[2] <= moments[0] + moments[1] + 1e-15


def test_link_meshes_are_closed_and_add_up_to_the_hand(clip: MotionClip, tmp_path: Path) -> None:
    write_urdf(clip, tmp_path / "hand.urdf")
    assert clip.model.mesh is not None
    at_bind = clip.hand(clip.model.mesh.bind_pose.double(), clip.shape)
    whole = trimesh.Trimesh(at_bind.vertices.numpy(), clip.hand.faces.numpy(), process=False)
    volume, centre = 0.0, np.zeros(3)
    for i, bone in enumerate(BONES):
        mesh = trimesh.load_mesh(tmp_path / "hand_urdf_meshes" / f"{bone}.obj", process=False)
        assert isinstance(mesh, trimesh.Trimesh)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 1e-7
        volume += mesh.volume
        centre += mesh.volume * (
            at_bind.frames.rotation[i].numpy() @ mesh.center_mass + at_bind.frames.position[i].numpy()
        )
    assert volume == pytest.approx(whole.volume, rel=1e-6)
    assert np.abs(centre / volume - whole.center_mass).max() < 1e-7


def test_links_are_possible_bodies_over_people(model: HandModel, clips: dict[str, MotionClip]) -> None:
    _, shapes = model.prior(dtype=torch.float64).sample(3, torch.Generator().manual_seed(11))
    small = 0.5 * (model.shape_space.lower + model.shape_space.default)
    large = 0.5 * (model.shape_space.upper + model.shape_space.default)
    for shape in (*shapes.double(), small, large):
        for solid in link_solids(replace(clips["left"], shape=shape)):
            _check_possible(solid.mass, solid.inertia)
            assert trimesh.Trimesh(solid.vertices, solid.faces, process=False).is_watertight


def test_mjcf_moves_as_ours(clip: MotionClip, tmp_path: Path, mujoco: ModuleType) -> None:
    numbered = replace(clip, frame=tuple(range(5, 12)))
    solids, _ = write_mjcf(numbered, tmp_path / "hand.xml", AS_TRACKED)
    robot = mujoco.MjModel.from_xml_path(str(tmp_path / "hand.xml"))
    data, frames = mujoco.MjData(robot), clip.with_up("z").frames
    assert robot.nkey == len(clip)
    assert robot.key_time.tolist() == pytest.approx((np.arange(7) / 25).tolist(), abs=1e-9)
    for t in range(len(clip)):
        mujoco.mj_resetDataKeyframe(robot, data, robot.key(f"frame_{5 + t}").id)
        mujoco.mj_kinematics(robot, data)
        places = np.stack([data.body(bone).xpos for bone in BONES])
        turns = np.stack([data.body(bone).xmat.reshape(3, 3) for bone in BONES])
        assert np.abs(places - frames.position[t].numpy()).max() < SAME_PLACE
        assert np.abs(turns - frames.rotation[t].numpy()).max() < 1e-6
        tips = np.stack([data.site(f"{f}_tip").xpos for f in ("thumb", "index", "middle", "ring", "little")])
        assert np.abs(tips - frames.keypoints[t, [4, 8, 12, 16, 20]].numpy()).max() < SAME_PLACE
    for i, dof in enumerate(JOINT_DOFS):
        expected = [float(clip.skeleton.lower[i]), float(clip.skeleton.upper[i])]
        assert robot.joint(dof).range.tolist() == pytest.approx(expected, abs=1e-9)
        assert robot.joint(dof).limited[0]
    for solid, bone in zip(solids, BONES, strict=True):
        body = robot.body(bone)
        assert float(body.mass[0]) == pytest.approx(solid.mass, rel=1e-8)
        assert sorted(body.inertia) == pytest.approx(sorted(np.linalg.eigvalsh(solid.inertia)), rel=1e-6)


def test_mujoco_finds_the_same_inertias_in_the_meshes(clip: MotionClip, tmp_path: Path, mujoco: ModuleType) -> None:
    solids, _ = write_mjcf(clip, tmp_path / "hand.xml", AS_TRACKED)
    text = (tmp_path / "hand.xml").read_text().replace('inertiafromgeom="false"', 'inertiafromgeom="true"')
    solid = trimesh.Trimesh(solids[0].vertices, solids[0].faces, process=False)
    density = f'type="mesh" density="{solids[0].mass / solid.volume:.12g}"'
    text = text.replace("<mesh ", '<mesh inertia="exact" ').replace('type="mesh"', density)
    text = text.replace('type="capsule"', 'type="capsule" density="0"')
    (tmp_path / "other.xml").write_text(text)
    robot = mujoco.MjModel.from_xml_path(str(tmp_path / "other.xml"))
    for solid, bone in zip(solids, BONES, strict=True):
        body = robot.body(bone)
        assert float(body.mass[0]) == pytest.approx(solid.mass, rel=1e-4)
        assert np.abs(body.ipos - solid.centre).max() < 1e-6
        assert sorted(body.inertia) == pytest.approx(sorted(np.linalg.eigvalsh(solid.inertia)), rel=1e-3)


def test_a_hand_at_rest_stays_where_it_is(still: MotionClip, tmp_path: Path, mujoco: ModuleType) -> None:
    clip = replace(still, poses=still.poses.clone().index_fill_(1, torch.arange(6, 36), 0.02))
    write_mjcf(clip, tmp_path / "hand.xml", MjcfSettings(has_couplings=False))
    robot = mujoco.MjModel.from_xml_path(str(tmp_path / "hand.xml"))
    data = mujoco.MjData(robot)
    mujoco.mj_resetDataKeyframe(robot, data, 0)
    for _ in range(200):
        mujoco.mj_step(robot, data)
    assert np.isfinite(data.qpos).all()
    assert np.abs(data.qpos - robot.key_qpos[0]).max() < 1e-3


def test_servos_hold_a_hand_against_gravity(still: MotionClip, tmp_path: Path, mujoco: ModuleType) -> None:
    poses = still.poses.clone().index_fill_(1, torch.arange(6, 36), 0.02)
    poses[:, [DOFS.index(f"{finger}_pip_fe") for finger in ("index", "middle", "ring", "little")]] = 0.9
    write_mjcf(replace(still, poses=poses), tmp_path / "hand.xml", MjcfSettings(has_gravity=True))
    robot = mujoco.MjModel.from_xml_path(str(tmp_path / "hand.xml"))
    data = mujoco.MjData(robot)
    mujoco.mj_resetDataKeyframe(robot, data, 0)
    for _ in range(1000):
        mujoco.mj_step(robot, data)
    assert np.abs(data.qpos[:3] - robot.key_qpos[0, :3]).max() < 2e-3
    for dof in JOINT_DOFS:
        wanted = 0.6 if dof.endswith("dip_fe") else float(poses[0, DOFS.index(dof)])
        assert abs(float(data.joint(dof).qpos[0]) - wanted) < 0.02, dof
    assert robot.nu == 26
    write_mjcf(replace(still, poses=poses), tmp_path / "free.xml", MjcfSettings(has_couplings=False))
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "free.xml")).nu == 30


def test_gravity_points_down_in_any_axes(still: MotionClip, tmp_path: Path, mujoco: ModuleType) -> None:
    """The camera's y points down; frames that turn with the hand have no down."""
    settings = MjcfSettings(has_gravity=True)
    for axes, down in ((None, (0, 0, -1)), ("z-up", (0, 0, -1)), ("y-up", (0, -1, 0)), ("camera", (0, 1, 0))):
        write_mjcf(replace(still, axes=axes), tmp_path / "hand.xml", settings)
        gravity = mujoco.MjModel.from_xml_path(str(tmp_path / "hand.xml")).opt.gravity
        assert np.abs(gravity - 9.81 * np.array(down)).max() < 1e-9, axes
    for axes in ("wrist", "mano"):
        with pytest.raises(InputError, match=f"gravity: expected axes camera, y-up or z-up, got {axes}"):
            write_mjcf(replace(still, axes=axes), tmp_path / "other.xml", settings)
    assert not list(tmp_path.glob("other*"))


def test_keyframes_part_digits_that_are_in_each_other(still: MotionClip, tmp_path: Path, mujoco: ModuleType) -> None:
    poses = torch.zeros(1, 36, dtype=torch.float64)
    for finger, aside in (("index", -0.15), ("middle", 0.0), ("ring", -0.12)):
        poses[:, DOFS.index(f"{finger}_mcp_aa")] = aside
    crossed = replace(still, poses=poses)
    as_tracked, unmoved = _deepest(crossed, AS_TRACKED, tmp_path, mujoco)
    parted, moved = _deepest(crossed, MjcfSettings(), tmp_path, mujoco)
    assert as_tracked < -4e-3
    assert parted > -2e-3
    assert unmoved == 0
    assert 0 < moved < 0.5


def test_keyframes_of_fists_part_the_fingers_from_the_palm(
    still: MotionClip, tmp_path: Path, mujoco: ModuleType
) -> None:
    """A fist as it was tracked. The metacarpals' meshes stand out from the palm's primitive, and bend; it does not."""
    angles = {
        "thumb": {"cmc_fe": 30, "mcp_fe": 8, "mcp_aa": -15, "ip_fe": 32},
        "index": {"mcp_fe": 59, "mcp_aa": 21, "pip_fe": 110, "dip_fe": 41},
        "middle": {"mcp_fe": 67, "pip_fe": 101, "dip_fe": 89},
        "ring": {"mcp_fe": 100, "mcp_aa": 10, "pip_fe": 102, "dip_fe": 57},
        "little": {"mcp_fe": 100, "mcp_aa": 2, "pip_fe": 98, "dip_fe": 77},
    }
    poses = torch.zeros(1, 36, dtype=torch.float64)
    for finger, joints in angles.items():
        for joint, degrees in joints.items():
            poses[:, DOFS.index(f"{finger}_{joint}")] = math.radians(degrees)
    fist = replace(still, poses=poses, shape=still.model.shape_space.default.double())
    as_tracked, _ = _deepest(fist, AS_TRACKED, tmp_path, mujoco)
    parted, _ = _deepest(fist, MjcfSettings(), tmp_path, mujoco)
    assert as_tracked < -5e-3
    assert parted > -2e-3


def _deepest(clip: MotionClip, settings: MjcfSettings, folder: Path, mujoco: ModuleType) -> tuple[float, float]:
    """Distance of the contact that is deepest in the first keyframe, and by how much joints were moved."""
    _, moved = write_mjcf(clip, folder / "hand.xml", settings)
    robot = mujoco.MjModel.from_xml_path(str(folder / "hand.xml"))
    data = mujoco.MjData(robot)
    mujoco.mj_resetDataKeyframe(robot, data, 0)
    mujoco.mj_forward(robot, data)
    return min((float(contact.dist) for contact in data.contact), default=0.0), moved


def test_mujoco_reads_the_urdf(clip: MotionClip, tmp_path: Path, mujoco: ModuleType) -> None:
    solids = write_urdf(clip, tmp_path / "hand.urdf")
    robot = mujoco.MjModel.from_xml_path(str(tmp_path / "hand.urdf"))
    data = mujoco.MjData(robot)
    poses = torch.cat((torch.zeros(7, 6).double(), clip.poses[:, 6:]), 1)
    frames = clip.kinematics(poses, clip.shape)
    for t in range(len(clip)):
        for dof in JOINT_DOFS:
            data.joint(dof).qpos[:] = float(poses[t, DOFS.index(dof)])
        mujoco.mj_kinematics(robot, data)
        for i, bone in enumerate(BONES):
            assert np.abs(data.body(bone).xpos - frames.position[t, i].numpy()).max() < SAME_PLACE
    assert float(robot.body_mass.sum()) == pytest.approx(sum(solid.mass for solid in solids), rel=1e-6)


def test_a_failed_export_leaves_the_old_robot(clip: MotionClip, tmp_path: Path) -> None:
    write_urdf(clip, tmp_path / "hand.urdf")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    (tmp_path / "hand.urdf").unlink()
    (tmp_path / "hand.urdf").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        write_urdf(replace(clip, shape=clip.model.shape_space.default), tmp_path / "hand.urdf")
    after = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert after == {path: data for path, data in before.items() if path.suffix in (".obj", ".srdf")}
    (tmp_path / "hand.urdf").rmdir()
    write_urdf(clip, tmp_path / "hand.urdf")
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
