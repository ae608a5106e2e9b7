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
from torchhand.export.rigged.glb_rig import GlbRig, GlbSkeleton, rig_of
from torchhand.export.rigged.linear_skin import MAX_TARGETS, LinearSkin, linear_skin
from torchhand.hand import PosedMesh

_SKIN_COLOUR = [0.80, 0.58, 0.47, 1.0]
_STILL = 1e-9  # a channel that changes by less than this is left out
_INFLUENCES = 4


def write_glb(
    clip: MotionClip, path: str | Path, *, has_correctives: bool = True, skeleton: GlbSkeleton = "torchhand"
) -> LinearSkin:
    """Write the file; returns the skin as it was written, with its distance from ours.

    A clip of one frame becomes a posed hand without animation. skeleton: nodes named as our bones with our axes, or the
    25 joints of WebXR with its names and axes (-z along the bone, y out of the back of the hand), side by side, as
    programs set them that place every joint of a tracked hand in the world.
    """
    upright = clip.placed("y-up")
    skin = linear_skin(upright, max_targets=MAX_TARGETS if has_correctives else 0)
    rig = rig_of(upright, skin.bind, skeleton)
    glb = GlbContainer()
    quaternion, shift = rig.local()
    nodes = rig.nodes(quaternion[0], shift[0])
    roots = [joint for joint, parent in enumerate(rig.parents) if parent < 0]
    mesh_node = len(nodes)
    nodes.append({"name": clip.name, "mesh": 0, "skin": 0})
    stands = [*roots, mesh_node]
    if len(roots) > 1:  # a skin's joints need a root in common, in which three.js's XRHandMeshModel looks for the mesh
        nodes.append({"name": "hand", "children": stands})
        stands = roots = [len(nodes) - 1]
    binds = glb.add(rig.inverse_binds())
    joints = list(range(len(rig.names)))
    glb.content |= {
        "asset": {"version": "2.0", "generator": f"torchhand {__version__}"},
        "scene": 0,
        "scenes": [{"name": clip.name, "nodes": stands}],
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
        "meshes": [_mesh(glb, upright, skin, rig)],
        "skins": [{"name": "hand", "skeleton": roots[0], "joints": joints, "inverseBindMatrices": binds}],
    }
    if len(clip) > 1:
        animation = _animation(glb, upright, rig, skin, mesh_node)
        if animation["channels"]:
            glb.content["animations"] = [animation]
    glb.write(Path(path))
    return skin


def _mesh(glb: GlbContainer, clip: MotionClip, skin: LinearSkin, rig: GlbRig) -> dict[str, Any]:
    faces = clip.hand.faces
    posed = PosedMesh(vertices=skin.vertices, faces=faces, part_of_face=faces[:, 0])
    atlas = texture_atlas(clip.model, clip.side)
    corner = atlas.vertex  # a vertex on the texture's seam stands twice
    bones, weights = _influences(skin.weights[corner])
    joints = np.where(weights > 0, np.array(rig.joint_of_bone)[bones], 0).astype(np.uint8)

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


def _animation(glb: GlbContainer, clip: MotionClip, rig: GlbRig, skin: LinearSkin, mesh_node: int) -> dict[str, Any]:
    quaternion, shift = rig.local()
    time = glb.add(clip.seconds.numpy().astype(np.float32), has_bounds=True)
    held = [place for place, is_own in enumerate(clip.is_own) if not is_own]
    animation: dict[str, Any] = {"name": clip.name, "samplers": [], "channels": []}
    animation["extras"] = {"frame": list(clip.frame), "held": held}

    def add(node: int, path: str, values: np.ndarray) -> None:
        animation["channels"].append(
            {"sampler": len(animation["samplers"]), "target": {"node": node, "path": path}},
        )
        animation["samplers"].append({"input": time, "output": glb.add(values), "interpolation": "LINEAR"})

    for i, parent in enumerate(rig.parents):
        if np.abs(quaternion[:, i] - quaternion[0, i]).max() > _STILL:
            add(i, "rotation", np.ascontiguousarray(quaternion[:, i]))
        if parent < 0 and np.abs(shift[:, i] - shift[0, i]).max() > _STILL:
            add(i, "translation", np.ascontiguousarray(shift[:, i]))
    if len(skin.targets):
        add(mesh_node, "weights", skin.target_weights.numpy().astype(np.float32).reshape(-1))
    return animation
