"""X3D H-Anim through xml.etree: names and hierarchy of the standard, interpolators, skin."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from torchhand.export.clip import MotionClip
from torchhand.export.rigged.x3d import write_x3d
from torchhand.hand import BONES, JOINT_DOFS

PLACES = 2e-6  # metres: seven digits of places up to a metre, nine of axes and angles


def _floats(text: str, *shape: int) -> np.ndarray:
    return np.array(text.split(), dtype=float).reshape(*shape)


class Player:
    """What an X3D player makes of the file at a key, as the H-Anim standard says."""

    def __init__(self, path: Path) -> None:
        self.root = ElementTree.parse(path).getroot()
        assert (self.root.tag, self.root.attrib["version"]) == ("X3D", "4.0")
        scene = self.root.find("Scene")
        assert scene is not None
        self.scene = scene
        (self.humanoid,) = scene.iter("HAnimHumanoid")
        self.defined = {node.attrib["DEF"]: node for node in scene.iter() if "DEF" in node.attrib}
        self.driven: dict[tuple[str, str], np.ndarray] = {}
        widths = {"OrientationInterpolator": 4, "PositionInterpolator": 3}
        for route in scene.iter("ROUTE"):
            a = route.attrib
            assert a["fromNode"] in self.defined
            assert a["toNode"] in self.defined
            if a["fromField"] == "value_changed":
                source = self.defined[a["fromNode"]]
                keys = len(source.attrib["key"].split())
                width = widths.get(source.tag)
                shape = (keys, width) if width else (keys, -1, 3)
                self.driven[a["toNode"], a["toField"]] = _floats(source.attrib["keyValue"], *shape)

    def field(self, node: ElementTree.Element, name: str, key: int, default: str) -> np.ndarray:
        moving = self.driven.get((node.attrib["DEF"], name))
        return _floats(node.attrib.get(name, default), -1) if moving is None else moving[key]

    def joints(self, key: int) -> dict[str, np.ndarray]:
        """humanoid_from_joint of every joint: T · C · R · C⁻¹ down the tree."""
        matrices: dict[str, np.ndarray] = {}

        def place(node: ElementTree.Element, parent: np.ndarray) -> None:
            x, y, z, angle = self.field(node, "rotation", key, "0 0 1 0")
            centre = _floats(node.attrib.get("center", "0 0 0"), 3)
            local = np.eye(4)
            local[:3, :3] = Rotation.from_rotvec(angle * np.array((x, y, z))).as_matrix()
            local[:3, 3] = self.field(node, "translation", key, "0 0 0") + centre - local[:3, :3] @ centre
            matrices[node.attrib["name"]] = parent @ local
            for child in node.findall("HAnimJoint"):
                place(child, matrices[node.attrib["name"]])

        (root,) = (node for node in self.humanoid.findall("HAnimJoint") if node.get("containerField") == "skeleton")
        place(root, np.eye(4))
        return matrices


@pytest.fixture
def player(clip: MotionClip, tmp_path: Path) -> Player:
    write_x3d(clip, tmp_path / "hand.x3d", skin="weights")
    return Player(tmp_path / "hand.x3d")


def test_names_and_hierarchy_of_h_anim(clip: MotionClip, player: Player) -> None:
    """ISO/IEC 19774: thumb 1 to little 5, prefix l_ or r_."""
    p = "l_" if clip.side == "left" else "r_"
    parents = {
        child.attrib["name"]: node.attrib["name"]
        for node in player.humanoid.iter("HAnimJoint")
        for child in node.findall("HAnimJoint")
    }
    expected = {f"{p}radiocarpal": "humanoid_root"}
    for n in range(1, 6):
        expected |= {
            f"{p}carpometacarpal_{n}": f"{p}radiocarpal",
            f"{p}metacarpophalangeal_{n}": f"{p}carpometacarpal_{n}",
        }
        if n == 1:
            expected[f"{p}carpal_interphalangeal_1"] = f"{p}metacarpophalangeal_1"
        else:
            expected[f"{p}carpal_proximal_interphalangeal_{n}"] = f"{p}metacarpophalangeal_{n}"
            expected[f"{p}carpal_distal_interphalangeal_{n}"] = f"{p}carpal_proximal_interphalangeal_{n}"
    assert parents == expected
    segments = {node.attrib["name"] for node in player.humanoid.iter("HAnimSegment") if "name" in node.attrib}
    assert {f"{p}carpal", f"{p}metacarpal_1", f"{p}carpal_distal_phalanx_1", f"{p}carpal_middle_phalanx_5"} < segments
    assert len(segments) == 20
    for field, count in (("joints", 21), ("segments", 20), ("sites", 5)):
        used = [node for node in player.humanoid if node.get("containerField") == field]
        assert len(used) == count
        assert all(node.attrib["USE"] in player.defined for node in used)


def test_joints_and_tips_move_as_ours(clip: MotionClip, player: Player) -> None:
    frames = clip.with_up("y").frames
    names = [node.attrib["name"] for node in player.humanoid.iter("HAnimJoint") if "name" in node.attrib]
    by_bone = _by_bone(clip, names)
    for key in range(len(clip)):
        matrices = player.joints(key)
        for i, bone in enumerate(BONES):
            node = next(n for n in player.humanoid.iter("HAnimJoint") if n.get("name") == by_bone[bone])
            centre = _floats(node.attrib["center"], 3)
            got = (matrices[by_bone[bone]] @ np.append(centre, 1))[:3]
            assert np.abs(got - frames.position[key, i].numpy()).max() < PLACES
        for n, point in enumerate((4, 8, 12, 16, 20), start=1):
            site = next(s for s in player.humanoid.iter("HAnimSite") if s.get("name", "").endswith(f"phalanx_{n}_tip"))
            last = by_bone[("thumb", "index", "middle", "ring", "little")[n - 1] + "_distal"]
            got = (matrices[last] @ np.append(_floats(site.attrib["translation"], 3), 1))[:3]
            assert np.abs(got - frames.keypoints[key, point].numpy()).max() < PLACES


def _by_bone(clip: MotionClip, names: list[str]) -> dict[str, str]:
    words = {"metacarpal": "carpometacarpal", "proximal": "metacarpophalangeal"}
    words |= {"middle": "carpal_proximal_interphalangeal", "distal": "carpal_distal_interphalangeal"}
    p = "l_" if clip.side == "left" else "r_"
    table = {"wrist": f"{p}radiocarpal", "thumb_distal": f"{p}carpal_interphalangeal_1"}
    for bone in BONES[1:]:
        finger, level = bone.split("_")
        number = ("thumb", "index", "middle", "ring", "little").index(finger) + 1
        table.setdefault(bone, f"{p}{words[level]}_{number}")
    assert set(table.values()) | {"humanoid_root"} == set(names)
    return table


def test_the_skin_is_ours_blended_linearly(clip: MotionClip, player: Player) -> None:
    (points,) = (node for node in player.humanoid if node.get("containerField") == "skinCoord")
    rest = _floats(points.attrib["point"], -1, 3)
    assert clip.model.mesh is not None
    bind = clip.hand(clip.model.mesh.bind_pose.double(), clip.shape)
    assert np.abs(rest - bind.vertices.numpy()).max() < PLACES
    ours = clip.with_up("y").vertices().numpy()
    for key in (0, 6):
        matrices, blended, total = player.joints(key), np.zeros_like(rest), np.zeros(len(rest))
        for node in player.humanoid.iter("HAnimJoint"):
            if "skinCoordIndex" not in node.attrib:
                continue
            index = _floats(node.attrib["skinCoordIndex"], -1).astype(int)
            weight = _floats(node.attrib["skinCoordWeight"], -1)
            moved = rest[index] @ matrices[node.attrib["name"]][:3, :3].T + matrices[node.attrib["name"]][:3, 3]
            blended[index] += weight[:, None] * moved
            total[index] += weight
        assert np.abs(total - 1).max() < 1e-6
        off = np.linalg.norm(blended - ours[key], axis=-1)
        assert np.median(off) < 4e-4  # pose correctives are left out: vertices away from the joints have none
        assert off.max() < 0.015
    faces = next(player.humanoid.iter("IndexedFaceSet"))
    assert _floats(faces.attrib["coordIndex"], -1, 4)[:, :3].astype(int).tolist() == clip.hand.faces.tolist()


def test_any_player_shows_our_own_skin(clip: MotionClip, tmp_path: Path) -> None:
    write_x3d(clip, tmp_path / "hand.x3d")
    moving = Player(tmp_path / "hand.x3d").driven["skin_points", "point"]
    assert np.abs(moving - clip.with_up("y").vertices().numpy()).max() < PLACES


def test_times_and_limits(clip: MotionClip, player: Player) -> None:
    (clock,) = player.scene.iter("TimeSensor")
    assert float(clock.attrib["cycleInterval"]) == pytest.approx(6 / 25, abs=1e-9)
    for kind in ("OrientationInterpolator", "PositionInterpolator"):
        for node in player.scene.iter(kind):
            assert np.abs(_floats(node.attrib["key"], -1) - np.arange(7) / 6).max() < 1e-8
    assert clip.model.mesh is not None
    joint = next(
        n for n in player.humanoid.iter("HAnimJoint") if n.get("name", "").endswith("pal_distal_interphalangeal_2")
    )
    dof = JOINT_DOFS.index("index_dip_fe")
    assert _floats(joint.attrib["llimit"], 3)[2] == pytest.approx(float(clip.skeleton.lower[dof]), abs=1e-6)
    assert _floats(joint.attrib["ulimit"], 3)[2] == pytest.approx(float(clip.skeleton.upper[dof]), abs=1e-6)


def test_one_frame_is_posed_without_clock(still: MotionClip, tmp_path: Path) -> None:
    write_x3d(still, tmp_path / "hand.x3d")
    player = Player(tmp_path / "hand.x3d")
    assert not list(player.scene.iter("TimeSensor"))
    wrist = next(n for n in player.humanoid.iter("HAnimJoint") if n.get("name") == "r_radiocarpal")
    place = still.with_up("y").poses[0, :3].numpy()
    assert np.abs(_floats(wrist.attrib["translation"], 3) - place).max() < PLACES
    tip = next(n for n in player.humanoid.iter("HAnimSite") if n.get("name", "").endswith("phalanx_2_tip"))
    point = player.joints(0)["r_carpal_distal_interphalangeal_2"] @ np.append(_floats(tip.attrib["translation"], 3), 1)
    assert np.abs(point[:3] - still.with_up("y").frames.keypoints[0, 8].numpy()).max() < PLACES
