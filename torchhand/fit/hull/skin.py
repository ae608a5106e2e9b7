"""Points of the skin and how they move with the pose, for surfaces that are evaluated again and again.

What `skin_jacobian` gives, but for one shape, whose part is worked out once, and in one direction for each point: the
direction is a force there, and the derivative in an angle is the force's torque about the angle's axis (Ueda et al.
2003, figure 7), so that no 3 × 36 matrix is made for any point.
"""

from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit import PosedHands
from torchhand.geometry import left_jacobian
from torchhand.hand import Hand, HandPose
from torchhand.hand.kinematics import world_axes


@dataclass(frozen=True, kw_only=True)
class WeightedVertices:
    """Skinning of some vertices of a shape; the leading dimension is 1 where all hands have the same vertices."""

    places: Float[Tensor, "#hands 20 3 points"]
    """In the bones' frames, times the weights."""
    weights: Float[Tensor, "#hands 20 points"]
    correctives: Float[Tensor, "2 #hands c 3 points"]
    """By feature, in the frames of the bones that the angles move."""

    def rows(self, rows: Int[Tensor, "n"]) -> "WeightedVertices":
        """Those of the given hands."""
        if len(self.weights) == 1:
            return self
        return WeightedVertices(
            places=self.places[rows], weights=self.weights[rows], correctives=self.correctives[:, rows]
        )


@dataclass(frozen=True, kw_only=True)
class PosedBones:
    """The bones of a batch of hands, and what their angles make of the skin's correctives."""

    rotation: Float[Tensor, "hands 20 3 3"]
    """world_from_bone"""
    position: Float[Tensor, "hands 20 3"]
    """Origins in the world, metres."""
    turns: Float[Tensor, "hands 33 3"]
    """Axes of the rotation vector's columns, then of the angles."""
    corrective_rotation: Float[Tensor, "hands c 3 3"]
    """world_from_bone of the bones that the correctives are given in."""
    features: Float[Tensor, "c 2 hands"]
    slopes: Float[Tensor, "c 2 hands"]
    """Derivatives of the features in their angles."""


@dataclass(frozen=True, kw_only=True)
class SkinMotion:
    """Vertices of a batch of hands in the world, and how they move."""

    points: Float[Tensor, "hands points 3"]
    levers: Float[Tensor, "hands 20 3 points"]
    """What each joint turns of each point, from the joint."""
    share: Float[Tensor, "#hands points"]
    """Of each point that all bones carry together: 1 up to rounding."""
    turns: Float[Tensor, "hands 33 3"]
    """Axes of the rotation vector's columns, then of the angles."""
    bones: Int[Tensor, "33"]
    """Bone that each of them turns."""
    corrective_rotation: Float[Tensor, "hands c 3 3"]
    """world_from_bone of the bones that the correctives are given in."""
    bends: Float[Tensor, "hands c 3 points"]
    """Derivatives of the correctives in their angles, in the bones' frames."""
    bend_rows: Int[Tensor, "c"]
    """Their angles, among the 36 DOFs."""

    def along(self, direction: Float[Tensor, "hands points 3"]) -> Float[Tensor, "hands points 36"]:
        """Derivative of direction · point in the DOFs, per metre and per radian, the direction held."""
        force = direction.mT
        torque = _cross(self.levers, force[:, None])
        of_turns = (self.turns[..., None] * torque.index_select(1, self.bones)).sum(2)
        of_shift = force * self.share[:, None]
        found = torch.cat((of_shift, of_turns), 1)
        local = self.corrective_rotation.mT @ force[:, None]
        of_bends = (self.bends * local).sum(2)
        return found.index_add(1, self.bend_rows, of_bends).mT


class SkinPoints:
    """The skin of one hand of one shape.

    hand: of the dtype to compute in; shape: in place of its own, of one hand.
    """

    def __init__(self, hand: Hand, shape: Float[Tensor, "shape"] | None = None) -> None:
        self.hand, self.shape = hand, hand.shape if shape is None else shape
        if self.shape.ndim != 1:
            raise ValueError(f"shape: expected that of one hand, got shape {tuple(self.shape.shape)}")
        metres = hand.kinematics.metres(self.shape)
        loads = hand.skinning.loads(metres)
        correctives = loads[80:].unflatten(0, (-1, 2, 3)).movedim(1, 0)  # 2 c 3 vertices
        self._rows = torch.cat((loads[:80], correctives.flatten(0, 2))).T.contiguous()
        of_bones = torch.cat((loads[:60].unflatten(0, (20, 3)), loads[60:80, None]), 1)  # 20 4 vertices
        self._together = torch.cat((of_bones.flatten(0, 1), correctives.flatten(0, 2)))
        self._metres = metres[:, None]
        self._corners = hand.faces.T.flatten()
        self._around = _faces_around(hand.faces, self._together.shape[1])
        bones = [0, 0, 0, *hand.kinematics.skeleton.bone]
        self._bones = torch.tensor(bones, device=self.shape.device)

    def for_shape(self, hands: PosedHands) -> "SkinPoints":
        """The skin of the hands' own shape where that is among the unknowns, else this one."""
        if hands.unknowns is None:
            return self
        return hands.once_for_shape(("skin", id(self)), lambda: SkinPoints(self.hand, hands.shape.to(self.shape)))

    def weighted(self, vertices: Int[Tensor, "points"] | Int[Tensor, "hands points"]) -> WeightedVertices:
        """Skinning of some vertices, the same ones of all hands or others of each."""
        each = vertices if vertices.ndim > 1 else vertices[None]
        own = self._rows.index_select(0, each.flatten()).unflatten(0, each.shape).mT.contiguous()  # hands k points
        return WeightedVertices(
            places=own[:, :60].unflatten(1, (20, 3)),
            weights=own[:, 60:80],
            correctives=own[:, 80:].unflatten(1, (2, -1, 3)).movedim(1, 0),
        )

    def posed(self, pose: HandPose) -> PosedBones:
        """The bones of some hands, in the dtype of the skin."""
        pose = pose.to(self.shape)
        frames = self.hand.kinematics(pose.dofs, self.shape, root_reference=pose.reference)
        features, slopes = self.hand.skinning.corrective_features(pose.dofs.T, self._metres)
        constants = self.hand.kinematics.chain.constants
        axes = world_axes(pose.dofs.T, frames.rotation.permute(1, 2, 3, 0), constants).permute(2, 0, 1)
        return PosedBones(
            rotation=frames.rotation,
            position=frames.position,
            turns=torch.cat((left_jacobian(pose.dofs[:, 3:6]).mT, axes), 1),
            corrective_rotation=frames.rotation.index_select(1, self.hand.skinning.corrective_bones),
            features=features,
            slopes=slopes,
        )

    def vertices(self, pose: HandPose) -> Float[Tensor, "hands vertices 3"]:
        """The whole skin of some hands in the world."""
        return self.skin_on(self.posed(pose))

    def skin_on(self, bones: PosedBones) -> Float[Tensor, "hands vertices 3"]:
        """The whole skin in the world, by its bones."""
        bending = bones.corrective_rotation[:, None] * bones.features.permute(2, 1, 0)[..., None, None]  # hands 2 c 3 3
        columns = torch.cat((bones.rotation, bones.position[..., None]), -1)  # hands 20 3 4
        coefficients = torch.cat((columns.mT.flatten(1, 2), bending.mT.flatten(1, 3)), 1).mT  # hands 3 k
        return (coefficients.flatten(0, 1) @ self._together).unflatten(0, (-1, 3)).mT

    def normals(self, vertices: Float[Tensor, "hands vertices 3"]) -> Float[Tensor, "hands vertices 3"]:
        """Unit normals of whole skins, outward."""
        a, b, c = vertices.index_select(1, self._corners).unflatten(1, (3, -1)).unbind(1)
        of_face = torch.nn.functional.pad(torch.linalg.cross(b - a, c - a), (0, 0, 0, 1))
        total = of_face.index_select(1, self._around).unflatten(1, (-1, vertices.shape[1])).sum(1)
        return torch.nn.functional.normalize(total, dim=-1, eps=1e-30)

    def motion(self, bones: PosedBones, vertices: WeightedVertices) -> SkinMotion:
        """Some vertices of posed hands, and how they move."""
        skinning, rotation, position = self.hand.skinning, bones.rotation, bones.position
        bent = _weighted(vertices.correctives, bones.features)
        parts = rotation @ vertices.places + vertices.weights[:, :, None] * position[..., None]
        parts = parts.index_add(1, skinning.corrective_bones, bones.corrective_rotation @ bent)
        beyond, share = _beyond(parts), _beyond(vertices.weights)
        return SkinMotion(
            points=beyond[:, 0].mT,
            levers=beyond - share[:, :, None] * position[..., None],
            share=share[:, 0],
            turns=bones.turns,
            bones=self._bones,
            corrective_rotation=bones.corrective_rotation,
            bends=_weighted(vertices.correctives, bones.slopes),
            bend_rows=skinning.corrective_rows,
        )


def bones_of(skin: SkinPoints, hands: PosedHands) -> PosedBones:
    """The bones of posed hands; computed once for all factors."""
    return hands.once(("bones", id(skin)), lambda: skin.posed(hands.pose))


def skin_at(skin: SkinPoints, hands: PosedHands) -> Float[Tensor, "hands vertices 3"]:
    """The whole skin of posed hands in the world; computed once for all factors."""
    return hands.once(("vertices", id(skin)), lambda: skin.skin_on(bones_of(skin, hands)))


def _cross(one: Float[Tensor, "*#batch 3 n"], other: Float[Tensor, "*#batch 3 n"]) -> Float[Tensor, "*batch 3 n"]:
    """The cross product along the last but one dimension, faster than torch's own."""
    (a, b, c), (x, y, z) = one.unbind(-2), other.unbind(-2)
    return torch.stack((b * z - c * y, c * x - a * z, a * y - b * x), -2)


def _weighted(correctives: Tensor, factors: Tensor) -> Tensor:
    """Offsets of the two features times their factors (c, 2, n): (n, c, 3, points)."""
    sine, cosine = factors.permute(1, 2, 0)[..., None, None]
    return torch.addcmul(correctives[0] * sine, correctives[1], cosine)


def _beyond(parts: Tensor) -> Tensor:
    """Sums over every bone and those that it carries, from the tips to the root; hands first, then bones."""
    fourth = parts[:, 16:]
    third = torch.cat((parts[:, 11:12], parts[:, 12:16] + fourth), 1)
    second = parts[:, 6:11] + third
    first = parts[:, 1:6] + second
    return torch.cat((parts[:, :1] + first.sum(1, keepdim=True), first, second, third, fourth), 1)


@lru_cache(maxsize=8)
def _faces_around(faces: Int[Tensor, "faces 3"], count: int) -> Int[Tensor, "places"]:
    """The faces at each vertex, the first of every vertex, then the second; where it has no more, one past the last."""
    with torch.inference_mode(False):  # kept for callers in any mode
        corners = faces.flatten().cpu()
        order = corners.argsort(stable=True)
        owner = corners[order]
        place = torch.arange(len(owner)) - torch.searchsorted(owner, owner)
        around = torch.full((int(place.max()) + 1, count), len(faces))
        around[place, owner] = order // 3
        return around.flatten().to(faces.device)
