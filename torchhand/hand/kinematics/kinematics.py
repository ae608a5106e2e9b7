"""Forward kinematics of the hand: pose and shape in, bone transforms and keypoints out, gradients to both."""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchhand.geometry import batch_last
from torchhand.hand.kinematics.chain import place_chain
from torchhand.hand.kinematics.constants import LEVER_ENDS, ChainBuffers, chain_constants
from torchhand.hand.kinematics.shape import ShapeSpace, offset_matrix
from torchhand.hand.kinematics.skeleton import BONES, DOFS, KEYPOINTS, Skeleton
from torchhand.precision import own_precision, record

Side = Literal["left", "right"]


@record()
@dataclass(frozen=True, kw_only=True)
class HandFrames:
    """Where the bones of a hand are, metres."""

    rotation: Float[Tensor, "*batch 20 3 3"]
    """Rotations world_from_bone."""
    position: Float[Tensor, "*batch 20 3"]
    """Origin of each bone in the world."""
    keypoints: Float[Tensor, "*batch 21 3"]
    """The 21 keypoints in the world."""


class HandKinematics(nn.Module):
    """Bone transforms and keypoints of a hand of one side; any batch shape, device-agnostic, differentiable any number
    of times.

    A left hand is the exact mirror of the right one: same pose numbers, z of the hand frame reversed.
    """

    def __init__(self, skeleton: Skeleton, shape_space: ShapeSpace, side: Side = "right") -> None:
        super().__init__()
        if side not in ("left", "right"):
            raise ValueError(f"side: expected 'left' or 'right', got {side!r}")
        self.side: Side = side
        self.skeleton = skeleton
        self.shape_space = shape_space
        self.chain = ChainBuffers(chain_constants(skeleton if side == "right" else mirrored(skeleton)))
        offsets = offset_matrix(shape_space, skeleton.rest_rotation[1:6]).to(skeleton.axis)
        if side == "left":
            offsets = offsets * _mirror(offsets)[:, None]
        levers = offsets[torch.tensor(LEVER_ENDS, device=offsets.device)]
        default = shape_space.metres(shape_space.default).to(levers)
        units = torch.tensor([[float(unit == own) for own in shape_space.units] for unit in ("m", "/HL", "/HB")])
        self.units: Tensor
        self.lever_matrix: Tensor
        self.default_shape: Tensor
        self.default_levers: Tensor
        self.register_buffer("units", units.to(levers), persistent=False)
        self.register_buffer("lever_matrix", levers.flatten(0, 1), persistent=False)
        self.register_buffer("default_shape", shape_space.default.clone(), persistent=False)
        self.register_buffer("default_levers", (levers @ default)[..., None], persistent=False)

    def on(self, device: torch.device) -> "HandKinematics":
        """The same hand on a device; itself where it is there."""
        if self.default_shape.device == device:
            return self
        space, dtype = self.shape_space.to(device=device), self.default_shape.dtype
        return HandKinematics(self.skeleton.to(device=device), space, self.side).to(dtype)

    @own_precision
    def forward(
        self,
        pose: Float[Tensor, "*batch 36"],
        shape: Float[Tensor, "*#batch shape"] | None = None,
        *,
        root_reference: Float[Tensor, "*#batch 3 3"] | None = None,
    ) -> HandFrames:
        """Frames of the hand in the world.

        pose: metres and radians in the order of DOFS; its rotation vector turns the hand frame, or `root_reference`
        where that is given (left perturbation: world_from_hand = exp(pose[3:6]) · root_reference).
        shape: parameters of the shape space, broadcast against the batch; the default proportions where it is None.
        """
        if pose.shape[-1] != len(DOFS):
            raise ValueError(f"pose: expected {len(DOFS)} numbers in the last dimension, got shape {tuple(pose.shape)}")
        if pose.dtype != self.default_levers.dtype:
            raise ValueError(
                f"pose: expected {self.default_levers.dtype}, in which the hand computes, got {pose.dtype}"
            )
        batch = pose.shape[:-1]
        flat = pose.reshape(-1, len(DOFS)).T.contiguous()
        reference = None if root_reference is None else batch_last(root_reference, 2, batch)
        rotation, position, keypoints = place_chain(flat, reference, self._levers(shape, batch), self.chain.constants)
        return HandFrames(
            rotation=rotation.permute(3, 0, 1, 2).reshape(*batch, len(BONES), 3, 3),
            position=position.permute(2, 0, 1).reshape(*batch, len(BONES), 3),
            keypoints=keypoints.permute(2, 0, 1).reshape(*batch, len(KEYPOINTS), 3),
        )

    @own_precision
    def metres(self, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch shape"]:
        """`ShapeSpace.metres` from what lies on the module's device, in a form that compilers take."""
        names = self.shape_space.names
        length, breadth = (shape[..., names.index(name), None] for name in ("hand_length", "hand_breadth"))
        return shape * (self.units[0] + self.units[1] * length + self.units[2] * breadth)

    def _levers(self, shape: Tensor | None, batch: torch.Size) -> Float[Tensor, "24 3 n"]:
        """The offset at the end of every bone, with the batch (or 1) last."""
        if shape is None:
            return self.default_levers
        expected = self.default_shape.shape[-1]
        if shape.shape[-1] != expected:
            raise ValueError(
                f"shape: expected {expected} numbers in the last dimension, got shape {tuple(shape.shape)}"
            )
        metres = batch_last(self.metres(shape), 1, batch)
        return (self.lever_matrix @ metres).unflatten(0, (len(LEVER_ENDS), 3))


def _mirror(like: Tensor) -> Tensor:
    return torch.tensor((1.0, 1.0, -1.0), dtype=like.dtype, device=like.device)


def mirrored(skeleton: Skeleton) -> Skeleton:
    """The mirror image in z = 0. Axes are axial vectors: a mirror reverses them and reflects them, so the same angles
    bend both hands alike."""
    mirror = _mirror(skeleton.axis)
    return replace(
        skeleton,
        rest_rotation=skeleton.rest_rotation * mirror[:, None] * mirror,
        rest_offset=skeleton.rest_offset * mirror,
        tip_offset=skeleton.tip_offset * mirror,
        axis=-skeleton.axis * mirror,
    )
