"""GLB files through a reader written from the specification, trimesh, and the Khronos validator where it is."""

import json
import os
import shutil
import struct
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from torchhand.export.clip import MotionClip, texture_atlas
from torchhand.export.rigged.glb import write_glb
from torchhand.hand import BONES, FINGERS, HandModel
from torchhand.hand.conventions import openxr_joints

FLOAT32 = 2e-6  # metres: rotations and weights are stored in float32, a hand measures 0.3 m and stands at 0.5 m


class Glb:
    """The parts of glTF 2.0 that a skinned animation has."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        magic, version, length = struct.unpack("<4sII", data[:12])
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack("<I4s", data[12:20])
        assert kind == b"JSON"
        assert size % 4 == 0
        self.json: dict[str, Any] = json.loads(data[20 : 20 + size])
        binary_size, kind = struct.unpack("<I4s", data[20 + size : 28 + size])
        assert kind == b"BIN\0"
        self.binary = data[28 + size :]
        assert len(self.binary) == binary_size == self.json["buffers"][0]["byteLength"]

    def array(self, index: int) -> np.ndarray:
        accessor = self.json["accessors"][index]
        view = self.json["bufferViews"][accessor["bufferView"]]
        dtype = {5126: "<f4", 5121: "u1", 5123: "<u2", 5125: "<u4"}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        flat = np.frombuffer(self.binary, dtype, count=accessor["count"] * width, offset=start)
        array = flat.reshape(accessor["count"], width)
        if accessor["type"] == "MAT4":  # by columns
            return array.reshape(-1, 4, 4).swapaxes(1, 2).astype(np.float64)
        if "min" in accessor:
            assert array.min(0).tolist() == accessor["min"]
            assert array.max(0).tolist() == accessor["max"]
        return array.astype(np.float64) if dtype == "<f4" else array

    def channel(self, node: int, path: str) -> np.ndarray | None:
        for animation in self.json.get("animations", []):
            for channel in animation["channels"]:
                if (channel["target"]["node"], channel["target"]["path"]) == (node, path):
                    return self.array(animation["samplers"][channel["sampler"]]["output"])
        return None

    def times(self) -> np.ndarray:
        (animation,) = self.json["animations"]
        (time,) = {sampler["input"] for sampler in animation["samplers"]}
        return self.array(time)[:, 0]

    def world(self, frame: int) -> np.ndarray:
        """Matrix of every node at a key."""
        nodes = self.json["nodes"]
        world = np.zeros((len(nodes), 4, 4))

        def place(index: int, parent: np.ndarray) -> None:
            node = nodes[index]
            rotation, shift = self.channel(index, "rotation"), self.channel(index, "translation")
            local = np.eye(4)
            quaternion = node.get("rotation", [0, 0, 0, 1]) if rotation is None else rotation[frame]
            local[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
            local[:3, 3] = node.get("translation", [0, 0, 0]) if shift is None else shift[frame]
            world[index] = parent @ local
            for child in node.get("children", []):
                place(child, world[index])

        for root in self.json["scenes"][self.json["scene"]]["nodes"]:
            place(root, np.eye(4))
        return world

    def skinned(self, frame: int) -> np.ndarray:
        """Vertices at a key: morph targets, then linear blending."""
        (mesh_node,) = (i for i, node in enumerate(self.json["nodes"]) if "mesh" in node)
        mesh, skin = self.json["meshes"][0], self.json["skins"][0]
        primitive = mesh["primitives"][0]
        attributes = primitive["attributes"]
        points = self.array(attributes["POSITION"]).copy()
        targets = [self.array(target["POSITION"]) for target in primitive.get("targets", [])]
        if targets:
            weights = self.channel(mesh_node, "weights")
            weights = mesh["weights"] if weights is None else weights.reshape(-1, len(targets))[frame]
            points += np.einsum("k,kvi->vi", weights, np.stack(targets))
        bones = self.world(frame)[skin["joints"]] @ self.array(skin["inverseBindMatrices"])
        joints, fraction = self.array(attributes["JOINTS_0"]), self.array(attributes["WEIGHTS_0"])
        assert np.abs(fraction.sum(1) - 1).max() < 1e-6
        blended = np.einsum("vk,vkij->vij", fraction, bones[joints])
        return np.einsum("vij,vj->vi", blended, np.c_[points, np.ones(len(points))])[:, :3]


def test_bones_move_as_ours(clip: MotionClip, tmp_path: Path) -> None:
    write_glb(clip, tmp_path / "hand.glb")
    glb, upright = Glb(tmp_path / "hand.glb"), clip.with_up("y")
    names = [node["name"] for node in glb.json["nodes"]]
    assert np.abs(glb.times() - np.arange(7) / 25).max() < 1e-7
    for t in range(len(clip)):
        world = glb.world(t)
        for i, bone in enumerate(BONES):
            matrix = world[names.index(bone)]
            assert np.abs(matrix[:3, 3] - upright.frames.position[t, i].numpy()).max() < FLOAT32
            assert np.abs(matrix[:3, :3] - upright.frames.rotation[t, i].numpy()).max() < 3e-6
        tips = np.stack([world[names.index(f"{finger}_tip")][:3, 3] for finger in FINGERS])
        assert np.abs(tips - upright.frames.keypoints[t, [4, 8, 12, 16, 20]].numpy()).max() < FLOAT32


def test_webxr_joints_move_as_a_tracked_hand_has_them(clip: MotionClip, tmp_path: Path) -> None:
    """25 joints by WebXR's names, with its axes, side by side; the skin is as near to ours as with our own bones."""
    said = write_glb(clip, tmp_path / "hand.glb", skeleton="webxr")
    glb, upright = Glb(tmp_path / "hand.glb"), clip.with_up("y")
    skin = glb.json["skins"][0]
    names = [glb.json["nodes"][joint]["name"] for joint in skin["joints"]]
    assert len(names) == 25
    assert names[0] == "wrist"
    assert {"thumb-phalanx-proximal", "index-finger-phalanx-intermediate", "pinky-finger-tip"} <= set(names)
    assert not any("children" in glb.json["nodes"][joint] for joint in skin["joints"])
    (root,) = glb.json["scenes"][0]["nodes"]  # in which three.js's XRHandMeshModel looks for the mesh and its joints
    inside = glb.json["nodes"][root]["children"]
    assert {"mesh" in glb.json["nodes"][one] for one in inside} == {True, False}
    assert set(skin["joints"]) < set(inside)
    joints, vertices = openxr_joints(upright.frames), texture_atlas(clip.model, clip.side).vertex.numpy()
    ours = upright.vertices().numpy()
    for t in range(len(clip)):
        world = glb.world(t)[skin["joints"]]
        assert np.abs(world[:, :3, 3] - joints.position[t, 1:].numpy()).max() < FLOAT32
        assert np.abs(world[:, :3, :3] - joints.rotation[t, 1:].numpy()).max() < 3e-6
        assert np.linalg.norm(glb.skinned(t) - ours[t][vertices], axis=-1).max() < said.error + FLOAT32


def test_the_skin_is_as_far_from_ours_as_said(clip: MotionClip, tmp_path: Path) -> None:
    for has_correctives in (True, False):
        said = write_glb(clip, tmp_path / "hand.glb", has_correctives=has_correctives)
        glb, ours = Glb(tmp_path / "hand.glb"), clip.with_up("y").vertices().numpy()
        vertices = texture_atlas(clip.model, clip.side).vertex.numpy()
        worst = max(np.linalg.norm(glb.skinned(t) - ours[t][vertices], axis=-1).max() for t in range(len(clip)))
        assert abs(worst - said.error) < FLOAT32
        assert (said.error < 3e-4) == has_correctives
        assert (len(said.targets) > 0) == has_correctives
        assert bool(((said.target_weights >= 0) & (said.target_weights <= 1)).all())  # Blender clamps others
        assert said.linear_error > 2e-3


def test_faces_look_outwards(clip: MotionClip, tmp_path: Path) -> None:
    write_glb(clip, tmp_path / "hand.glb")
    glb = Glb(tmp_path / "hand.glb")
    primitive = glb.json["meshes"][0]["primitives"][0]
    mesh = trimesh.Trimesh(
        glb.array(primitive["attributes"]["POSITION"]), glb.array(primitive["indices"]).reshape(-1, 3), process=False
    )
    welded = mesh.copy()
    welded.merge_vertices(merge_norm=True, merge_tex=True)
    assert welded.is_watertight
    assert mesh.volume > 1e-4
    normals = glb.array(primitive["attributes"]["NORMAL"])
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-6
    whole = len(clip.hand.faces) // 2 + 2  # vertices of a closed surface of genus 0; those of the seam again follow
    smooth = trimesh.Trimesh(mesh.vertices[:whole], clip.hand.faces.numpy(), process=False).vertex_normals
    assert (np.einsum("vi,vi->v", normals[:whole], smooth) > 0.5).all()
    uv = glb.array(primitive["attributes"]["TEXCOORD_0"])
    atlas = texture_atlas(clip.model, clip.side).uv.numpy()
    assert np.abs(uv - np.c_[atlas[:, 0], 1 - atlas[:, 1]]).max() < 1e-6


def test_one_frame_is_a_posed_hand_without_animation(still: MotionClip, tmp_path: Path) -> None:
    skin = write_glb(still, tmp_path / "hand.glb")
    glb = Glb(tmp_path / "hand.glb")
    assert "animations" not in glb.json
    ours = still.with_up("y").vertices().numpy()[0]
    assert np.linalg.norm(glb.skinned(0)[: len(ours)] - ours, axis=-1).max() < max(skin.error, 1e-4) + FLOAT32


def test_what_stands_still_is_not_animated(clip: MotionClip, tmp_path: Path) -> None:
    poses = clip.poses[:1].repeat(3, 1)
    poses[:, 6 + 7] = torch.tensor([0.0, 0.2, 0.4], dtype=torch.float64)  # index MCP flexion
    write_glb(replace(clip, poses=poses, frame=()), tmp_path / "hand.glb", has_correctives=False)
    (animation,) = Glb(tmp_path / "hand.glb").json["animations"]
    assert [channel["target"] for channel in animation["channels"]] == [
        {"node": BONES.index("index_proximal"), "path": "rotation"}
    ]


def test_quaternions_take_the_short_way(model: HandModel, clip: MotionClip, tmp_path: Path) -> None:
    poses = torch.zeros(60, 36, dtype=torch.float64)
    poses[:, 5] = torch.linspace(0, 12.0, 60, dtype=torch.float64)  # almost two turns
    write_glb(replace(clip, poses=poses, frame=()), tmp_path / "hand.glb")
    quaternions = Glb(tmp_path / "hand.glb").channel(0, "rotation")
    assert quaternions is not None
    assert ((quaternions[1:] * quaternions[:-1]).sum(-1) > 0.9).all()
    assert np.abs(np.linalg.norm(quaternions, axis=1) - 1).max() < 1e-6


def test_trimesh_opens_it(clip: MotionClip, tmp_path: Path) -> None:
    write_glb(clip, tmp_path / "hand.glb")
    scene = trimesh.load_scene(tmp_path / "hand.glb")
    (geometry,) = scene.geometry.values()
    assert isinstance(geometry, trimesh.Trimesh)
    atlas = texture_atlas(clip.model, clip.side)
    assert geometry.faces.tolist() == atlas.corners.tolist()
    assert clip.model.mesh is not None
    at_bind = clip.hand(clip.model.mesh.bind_pose.double(), clip.shape).vertices.numpy()
    assert np.abs(geometry.vertices - at_bind[atlas.vertex.numpy()]).max() < 1e-7


def test_the_khronos_validator_finds_nothing(clip: MotionClip, still: MotionClip, tmp_path: Path) -> None:
    """Needs node and the npm package gltf-validator: npm install gltf-validator, NODE_PATH=.../node_modules."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node")
    known = subprocess.run([node, "-e", "require.resolve('gltf-validator')"], capture_output=True, env=os.environ)
    if known.returncode:
        pytest.skip("needs the npm package gltf-validator where NODE_PATH points")
    write_glb(clip, tmp_path / "moving.glb")
    write_glb(still, tmp_path / "still.glb")
    script = (
        "const v=require('gltf-validator'),fs=require('fs');"
        "v.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])))"
        ".then(r=>console.log(JSON.stringify(r.issues)))"
    )
    for name in ("moving.glb", "still.glb"):
        run = subprocess.run([node, "-e", script, str(tmp_path / name)], capture_output=True, check=True, text=True)
        issues = json.loads(run.stdout)
        assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]
