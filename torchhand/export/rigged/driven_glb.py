"""A rigged hand mesh of others, as binary glTF with the joint names of WebXR, moved by a clip.

The mesh keeps its own proportions, skin and materials: its joints turn as ours do, and its wrist goes where ours is.
Joints have WebXR's axes, as its specification wants them: -z along the bone, y out of the back of the hand. They may
hang on one another or stand side by side.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float64

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.conventions import webxr_name
from torchhand.export.rigged.glb_container import GlbContainer
from torchhand.geometry import continuous, quaternion_of_rotation, rotation_of_quaternion
from torchhand.hand.conventions import OPENXR_JOINTS, openxr_joints

_JOINTS = tuple(name for name in OPENXR_JOINTS if name != "palm")
_LEAST_COSINE = 0.7  # between a bone and its joint's -z at rest
_UNIFORM = 1e-3  # share by which scales of one node may differ


class _Place(NamedTuple):
    """world_from_node: a rotation, a place and one scale."""

    rotation: Float64[np.ndarray, "*frames 3 3"]
    position: Float64[np.ndarray, "*frames 3"]
    scale: float


def write_driven_glb(clip: MotionClip, mesh: Path, path: Path) -> None:
    """Write the mesh of the file `mesh` with the clip as its animation; its own animations are left out.

    Raises InputError for a file that is no binary glTF, lacks a joint, has other axes or is of the other hand.
    """
    glb = GlbContainer.read(mesh)
    nodes = glb.content.get("nodes", [])
    parents = {child: i for i, node in enumerate(nodes) for child in node.get("children", [])}
    named = {node.get("name", "").casefold(): i for i, node in enumerate(nodes)}
    if missing := [webxr_name(name) for name in _JOINTS if name[-3:] != "tip" and webxr_name(name) not in named]:
        raise InputError(f"{mesh}: expected nodes named as WebXR's hand joints, lacks {', '.join(missing[:3])}")
    joints = {name: named[webxr_name(name)] for name in _JOINTS if webxr_name(name) in named}
    rest = {i: _rest(mesh, nodes, parents, i) for i in range(len(nodes))}
    _check_axes(mesh, {name: rest[i] for name, i in joints.items()}, clip.side)
    moved = _moved(clip.placed("y-up"), joints, rest)
    time = glb.add(clip.seconds.numpy().astype(np.float32), has_bounds=True)
    held = [place for place, is_own in enumerate(clip.is_own) if not is_own]
    extras = {"frame": list(clip.frame), "held": held}
    animation: dict[str, Any] = {"name": clip.name, "samplers": [], "channels": [], "extras": extras}
    for node in joints.values():
        above = moved.get(parents.get(node, -1)) or (rest[parents[node]] if node in parents else _world())
        rotation = np.swapaxes(above.rotation, -1, -2) @ moved[node].rotation
        offset = moved[node].position - above.position
        place = np.einsum("...ji,...j->...i", np.broadcast_to(above.rotation, rotation.shape), offset) / above.scale
        quaternion = continuous(quaternion_of_rotation(torch.from_numpy(np.ascontiguousarray(rotation)))).numpy()
        for kind, values in (("rotation", quaternion), ("translation", place)):
            target = {"node": node, "path": kind}
            animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
            output = glb.add(np.ascontiguousarray(values.astype(np.float32)))
            animation["samplers"].append({"input": time, "output": output, "interpolation": "LINEAR"})
        # As in the first frame, for programs that play nothing.
        nodes[node].pop("matrix", None)
        nodes[node] |= {"rotation": quaternion[0].tolist(), "translation": place[0].tolist()}
    glb.content["animations"] = [animation]
    glb.write(path)


def _world() -> _Place:
    return _Place(np.eye(3), np.zeros(3), 1.0)


def _moved(clip: MotionClip, joints: dict[str, int], rest: dict[int, _Place]) -> dict[int, _Place]:
    """world_from_node of the joints in all frames: our rotations on the mesh's own lengths."""
    ours = openxr_joints(clip.frames)
    found: dict[int, _Place] = {}
    for name, node in joints.items():
        index = OPENXR_JOINTS.index(name)
        rotation, own = ours.rotation[:, index].numpy(), rest[node]
        if name == "wrist":
            position = ours.position[:, index].numpy()
        else:
            base = joints[_before(name)]
            lever = rest[base].rotation.T @ (own.position - rest[base].position)
            position = found[base].position + found[base].rotation @ lever
        found[node] = _Place(rotation, position, own.scale)
    return found


def _before(name: str) -> str:
    """The joint that is nearer to the wrist."""
    return "wrist" if name.endswith("_metacarpal") else _JOINTS[_JOINTS.index(name) - 1]


def _rest(path: Path, nodes: list[dict[str, Any]], parents: dict[int, int], node: int) -> _Place:
    """world_from_node as the file has it."""
    chain = [node]
    while chain[-1] in parents:
        chain.append(parents[chain[-1]])
        if len(chain) > len(nodes):
            raise InputError(f"{path}: expected nodes in a tree, got a circle at node {node}")
    matrix = np.eye(4)
    for one in reversed(chain):
        matrix = matrix @ _local(nodes[one])
    scales = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.isfinite(matrix).all() or scales.min() <= 0 or np.ptp(scales) > _UNIFORM * scales.max():
        told = ", ".join(f"{scale:g}" for scale in scales)
        raise InputError(f"{path}: node {node}: expected one scale for all axes, got {told}")
    return _Place(matrix[:3, :3] / scales, matrix[:3, 3], float(scales.mean()))


def _local(node: dict[str, Any]) -> Float64[np.ndarray, "4 4"]:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    quaternion = torch.tensor(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), dtype=torch.float64)
    matrix[:3, :3] = rotation_of_quaternion(quaternion).numpy() * np.array(node.get("scale", (1.0, 1.0, 1.0)))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _check_axes(path: Path, rest: dict[str, _Place], side: str) -> None:
    """Raise InputError where joints do not have WebXR's axes, or the thumb is on the other hand's side."""
    for name in rest:
        before = _before(name)
        if name == "wrist" or before == "wrist":
            continue
        along = rest[name].position - rest[before].position
        cosine = float(-rest[before].rotation[:, 2] @ along) / max(float(np.linalg.norm(along)), 1e-12)
        if cosine < _LEAST_COSINE:
            raise InputError(
                f"{path}: {webxr_name(before)}: expected WebXR's axes, -z along the bone, got a bone that is"
                f" {np.degrees(np.arccos(np.clip(cosine, -1, 1))):.0f} degrees off"
            )
    wrist = rest["wrist"]
    across = rest["index_proximal"].position - rest["little_proximal"].position
    found = "right" if float(wrist.rotation[:, 0] @ across) < 0 else "left"
    if found != side:
        raise InputError(f"{path}: expected the mesh of a {side} hand, got that of a {found} one")
