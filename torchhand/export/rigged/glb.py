"""Motion as binary glTF 2.0 (.glb): the skinned hand with one animation; opens in Blender, browsers, game engines.

Frame: y up, z forward, metres; nodes named as our bones, with the fingertips as leaves. Each bone's node has our bone
frame (y along the bone). The skin is bound at the open hand. Its pose correctives are morph targets that this clip's
weights drive (`linear_skin`); with weights of zero the hand is blended linearly.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchhand import __version__
from torchhand.export.clip import MotionClip, texture_atlas
from torchhand.export.rigged.glb_container import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, GlbContainer
from torchhand.export.rigged.linear_skin import MAX_TARGETS, LinearSkin, linear_skin
from torchhand.geometry import continuous, quaternion_of_rotation
from torchhand.hand import BONES, FINGERS, PARENTS, PosedMesh

_SKIN_COLOUR = [0.80, 0.58, 0.47, 1.0]
_STILL = 1e-9  # a channel that changes by less than this is left out
_INFLUENCES = 4


def write_glb(clip: MotionClip, path: str | Path, *, has_correctives: bool = True) -> LinearSkin:
    """Write the file; returns the skin as it was written, with its distance from ours.

    A clip of one frame becomes a posed hand without animation.
    """
    upright = clip.placed("y-up")
    skin = linear_skin(upright, max_targets=MAX_TARGETS if has_correctives else 0)
    glb = GlbContainer()
    rotation, translation = _local(upright)
    quaternion = continuous(quaternion_of_rotation(rotation)).numpy().astype(np.float32)
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    shift = translation.numpy().astype(np.float32)
    nodes = _nodes(quaternion[0], shift[0], upright)
    mesh_node = len(nodes)
    nodes.append({"name": clip.name, "mesh": 0, "skin": 0})
    glb.content |= {
        "asset": {"version": "2.0", "generator": f"torchhand {__version__}"},
        "scene": 0,
        "scenes": [{"name": clip.name, "nodes": [0, mesh_node]}],
        "nodes": nodes,
        "materials": [
            {
                "name": "skin",
                "pbrMetallicRoughness": {
                    "baseColorFactor": _SKIN_COLOUR,
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.7,
                },
            }
        ],
        "meshes": [_mesh(glb, upright, skin)],
        "skins": [_skin(glb, skin)],
    }
    if len(clip) > 1:
        animation = _animation(glb, upright, quaternion, shift, skin, mesh_node)
        if animation["channels"]:
            glb.content["animations"] = [animation]
    glb.write(Path(path))
    return skin


def _local(clip: MotionClip) -> tuple[Tensor, Tensor]:
    """parent_from_bone of all frames; the wrist's parent is the world."""
    parents = [max(parent, 0) for parent in PARENTS]
    frames = clip.frames
    into_parent = frames.rotation[:, parents].mT
    rotation = into_parent @ frames.rotation
    lever = (into_parent @ (frames.position - frames.position[:, parents])[..., None]).squeeze(-1)
    rotation = torch.cat((frames.rotation[:, :1], rotation[:, 1:]), 1)
    return rotation, torch.cat((frames.position[:, :1], lever[:, 1:]), 1)


def _nodes(quaternion: np.ndarray, shift: np.ndarray, clip: MotionClip) -> list[dict[str, Any]]:
    """Bones posed as in the first frame, then the fingertips."""
    nodes: list[dict[str, Any]] = [
        {"name": name, "rotation": quaternion[i].tolist(), "translation": shift[i].tolist()}
        for i, name in enumerate(BONES)
    ]
    for bone, parent in enumerate(PARENTS):
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(bone)
    for finger, tip in zip(FINGERS, clip.skeleton.tip_offset, strict=True):
        nodes[BONES.index(f"{finger}_distal")]["children"] = [len(nodes)]
        nodes.append({"name": f"{finger}_tip", "translation": tip.numpy().astype(np.float32).tolist()})
    return nodes


def _mesh(glb: GlbContainer, clip: MotionClip, skin: LinearSkin) -> dict[str, Any]:
    faces = clip.hand.faces
    posed = PosedMesh(vertices=skin.vertices, faces=faces, part_of_face=faces[:, 0])
    atlas = texture_atlas(clip.model, clip.side)
    corner = atlas.vertex  # a vertex on the texture's seam stands twice
    joints, weights = _influences(skin.weights[corner])

    def add(array: Tensor | np.ndarray, *, has_bounds: bool = False) -> int:
        stored = np.asarray(array, dtype=None if isinstance(array, np.ndarray) else np.float32)
        return glb.add(stored, target=ARRAY_BUFFER, has_bounds=has_bounds)

    index = np.uint16 if len(corner) < 65535 else np.uint32
    downwards = torch.stack((atlas.uv[:, 0], 1 - atlas.uv[:, 1]), -1)  # glTF's v grows downwards
    primitive: dict[str, Any] = {
        "attributes": {
            "POSITION": add(skin.vertices[corner], has_bounds=True),
            "NORMAL": add(posed.vertex_normals()[corner]),
            "TEXCOORD_0": add(downwards),
            "JOINTS_0": add(joints),
            "WEIGHTS_0": add(weights),
        },
        "indices": glb.add(atlas.corners.reshape(-1).numpy().astype(index), target=ELEMENT_ARRAY_BUFFER),
        "material": 0,
    }
    mesh: dict[str, Any] = {"name": "hand", "primitives": [primitive]}
    if len(skin.targets):
        primitive["targets"] = [{"POSITION": add(target[corner], has_bounds=True)} for target in skin.targets]
        mesh["weights"] = skin.target_weights[0].numpy().astype(np.float32).tolist()
        mesh["extras"] = {"targetNames": [f"corrective_{i}" for i in range(len(skin.targets))]}
    return mesh


def _influences(weights: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """The four strongest bones of every vertex and their shares, which add up to one in float32; unused ones are 0."""
    fraction, bone = weights.topk(_INFLUENCES, dim=-1)
    fraction = (fraction / fraction.sum(-1, keepdim=True)).numpy().astype(np.float32)
    fraction[:, 0] = 1 - fraction[:, 1:].sum(-1)
    bones = np.where(fraction > 0, bone.numpy(), 0).astype(np.uint8)
    return bones, fraction


def _skin(glb: GlbContainer, skin: LinearSkin) -> dict[str, Any]:
    inverse = torch.eye(4, dtype=torch.float64).repeat(len(BONES), 1, 1)
    inverse[:, :3, :3] = skin.bind.rotation.mT
    inverse[:, :3, 3] = -(skin.bind.rotation.mT @ skin.bind.position[..., None]).squeeze(-1)
    accessor = glb.add(inverse.numpy().astype(np.float32))
    return {"name": "hand", "skeleton": 0, "joints": list(range(len(BONES))), "inverseBindMatrices": accessor}


def _animation(
    glb: GlbContainer, clip: MotionClip, quaternion: np.ndarray, shift: np.ndarray, skin: LinearSkin, mesh_node: int
) -> dict[str, Any]:
    time = glb.add(clip.seconds.numpy().astype(np.float32), has_bounds=True)
    held = [place for place, is_own in enumerate(clip.is_own) if not is_own]
    animation: dict[str, Any] = {"name": clip.name, "samplers": [], "channels": []}
    animation["extras"] = {"frame": list(clip.frame), "held": held}

    def add(node: int, path: str, values: np.ndarray) -> None:
        animation["channels"].append(
            {"sampler": len(animation["samplers"]), "target": {"node": node, "path": path}},
        )
        animation["samplers"].append({"input": time, "output": glb.add(values), "interpolation": "LINEAR"})

    for i in range(len(BONES)):
        if np.abs(quaternion[:, i] - quaternion[0, i]).max() > _STILL:
            add(i, "rotation", np.ascontiguousarray(quaternion[:, i]))
    if np.abs(shift[:, 0] - shift[0, 0]).max() > _STILL:
        add(0, "translation", np.ascontiguousarray(shift[:, 0]))
    if len(skin.targets):
        add(mesh_node, "weights", skin.target_weights.numpy().astype(np.float32).reshape(-1))
    return animation
