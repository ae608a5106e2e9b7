"""The nodes of a glTF hand and how they move: our bones one below the other, or the 25 joints of WebXR side by side."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.export.clip import MotionClip
from torchhand.export.conventions import webxr_name
from torchhand.geometry import continuous, quaternion_of_rotation
from torchhand.hand import BONES, FINGERS, PARENTS, HandFrames
from torchhand.hand.conventions import OPENXR_JOINTS, openxr_joints

GlbSkeleton = Literal["torchhand", "webxr"]
_XR = tuple(name for name in OPENXR_JOINTS if name != "palm")


@dataclass(frozen=True, kw_only=True)
class GlbRig:
    """Joints of a skin, in the order of the file's nodes, and the leaves after them."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    """Parent of each joint; -1 for those that stand in the world."""
    rotation: Float64[Tensor, "frames joints 3 3"]
    """world_from_joint"""
    position: Float64[Tensor, "frames joints 3"]
    bind_rotation: Float64[Tensor, "joints 3 3"]
    bind_position: Float64[Tensor, "joints 3"]
    joint_of_bone: tuple[int, ...]
    """Joint that carries what is bound to each of BONES."""
    leaves: tuple[tuple[str, int, list[float]], ...]
    """Name, parent and place of nodes that carry no skin."""

    def local(self) -> tuple[np.ndarray, np.ndarray]:
        """Quaternions (frames, joints, 4) and places (frames, joints, 3) in the parents' frames, float32."""
        above = [max(parent, 0) for parent in self.parents]
        stands = torch.tensor([parent < 0 for parent in self.parents])
        into = torch.where(stands[:, None, None], torch.eye(3, dtype=torch.float64), self.rotation[:, above].mT)
        base = torch.where(stands[:, None], torch.zeros(3, dtype=torch.float64), self.position[:, above])
        places = (into @ (self.position - base)[..., None]).squeeze(-1)
        quaternions = continuous(quaternion_of_rotation(into @ self.rotation)).numpy().astype(np.float32)
        quaternions /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
        return quaternions, places.numpy().astype(np.float32)

    def nodes(self, quaternion: np.ndarray, place: np.ndarray) -> list[dict[str, Any]]:
        """Joints posed as in one frame, then the leaves."""
        nodes: list[dict[str, Any]] = [
            {"name": name, "rotation": quaternion[i].tolist(), "translation": place[i].tolist()}
            for i, name in enumerate(self.names)
        ]
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                nodes[parent].setdefault("children", []).append(joint)
        for name, parent, offset in self.leaves:
            nodes[parent].setdefault("children", []).append(len(nodes))
            nodes.append({"name": name, "translation": offset})
        return nodes

    def inverse_binds(self) -> np.ndarray:
        """joint_from_hand at the bind pose, (joints, 4, 4) float32."""
        inverse = torch.eye(4, dtype=torch.float64).repeat(len(self.names), 1, 1)
        inverse[:, :3, :3] = self.bind_rotation.mT
        inverse[:, :3, 3] = -(self.bind_rotation.mT @ self.bind_position[..., None]).squeeze(-1)
        return inverse.numpy().astype(np.float32)


def rig_of(clip: MotionClip, bind: HandFrames, skeleton: GlbSkeleton) -> GlbRig:
    """The nodes of a clip. bind: the bones of the pose at which the skin is bound."""
    if skeleton == "webxr":
        joints, at_bind = openxr_joints(clip.frames), openxr_joints(bind)
        bones = {name.replace("intermediate", "middle"): _XR.index(name) for name in _XR}
        return GlbRig(
            names=tuple(webxr_name(name) for name in _XR),
            parents=(-1,) * len(_XR),
            rotation=joints.rotation[:, 1:],
            position=joints.position[:, 1:],
            bind_rotation=at_bind.rotation[1:],
            bind_position=at_bind.position[1:],
            joint_of_bone=tuple(bones[bone] for bone in BONES),
            leaves=(),
        )
    tips = zip(FINGERS, clip.skeleton.tip_offset, strict=True)
    return GlbRig(
        names=BONES,
        parents=PARENTS,
        rotation=clip.frames.rotation,
        position=clip.frames.position,
        bind_rotation=bind.rotation,
        bind_position=bind.position,
        joint_of_bone=tuple(range(len(BONES))),
        leaves=tuple(
            (f"{finger}_tip", BONES.index(f"{finger}_distal"), tip.numpy().astype(np.float32).tolist())
            for finger, tip in tips
        ),
    )
