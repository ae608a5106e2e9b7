"""Points of the skin and how they move with the pose, for surfaces that are evaluated again and again.

What `skin_jacobian` gives, but for one shape, whose part is worked out once, and in one direction for each point: the
direction is a force there, and the derivative in an angle is the force's torque about the angle's axis (Ueda et al.
2003, figure 7), so that no 3 × 36 matrix is made for any point.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import are_equal, kept
from torchhand.fit import PosedHands
from torchhand.geometry import left_jacobian
from torchhand.hand import Hand, HandPose
from torchhand.hand.kinematics import world_axes


@dataclass(frozen=True, kw_only=True)
class WeightedVertices:
    """Skinning of some vertices of a shape; the leading dimension is 1 where all hands have the same vertices."""

    places: Float[Tensor, "#hands 20 4 points"]
    """Places in the bones' frames, times the weights; then the weights."""
    carried: Float[Tensor, "#hands 20 points"]
    """Weights of each bone and of those beyond it."""
    correctives: Float[Tensor, "#hands c 6 points"]
    """Correctives by feature, in the frames of the bones that the angles move."""

    def rows(self, rows: Int[Tensor, "n"]) -> "WeightedVertices":
        """The vertices of the given hands."""
        if len(self.places) == 1:
            return self
        return WeightedVertices(
            places=self.places[rows], carried=self.carried[rows], correctives=self.correctives[rows]
        )


@dataclass(frozen=True, kw_only=True)
class PosedBones:
    """The bones of a batch of hands, and what their angles make of the skin's correctives."""

    rotation: Float[Tensor, "hands 20 3 3"]
    """Rotations world_from_bone."""
    position: Float[Tensor, "hands 20 3"]
    """Origins in the world, metres."""
    turns: Float[Tensor, "hands 33 3"]
    """Axes of the rotation vector's columns, then of the angles."""
    bending: Float[Tensor, "hands c 3 6"]
    """world_from_bone of the bones that the correctives are given in, times the features of their angles."""
    slopes: Float[Tensor, "hands c 3 6"]
    """Derivative of `bending` in the correctives' angles."""


@dataclass(frozen=True, kw_only=True)
class SkinMotion:
    """Vertices of a batch of hands in the world, and how they move."""

    points: Float[Tensor, "hands points 3"]
    levers: Float[Tensor, "hands 20 3 points"]
    """Levers from each joint to what it turns of each point."""
    fraction: Float[Tensor, "#hands points"]
    """Fraction of each point that all bones carry together: 1 up to rounding."""
    turns: Float[Tensor, "hands 33 3"]
    """Axes of the rotation vector's columns, then of the angles."""
    turn_rows: Int[Tensor, "33"]
    """Where each column of `turns` stands, three to a bone: those of bone b from 3 b on."""
    bends: Float[Tensor, "hands c 3 points"]
    """Derivatives of the correctives in their angles."""
    bend_rows: Int[Tensor, "c"]
    """Rows of the correctives' angles among the 36 DOFs."""

    def along(self, direction: Float[Tensor, "hands points 3"]) -> Float[Tensor, "hands points 36"]:
        """Derivative of direction · point in the DOFs, per metre and per radian, the direction held."""
        force = direction.mT
        torque = _cross(self.levers, force[:, None])
        axes = self.turns.new_zeros(len(self.turns), 3 * torque.shape[1], 3).index_copy_(1, self.turn_rows, self.turns)
        of_turns = (axes.unflatten(1, (-1, 3)) @ torque).flatten(1, 2).index_select(1, self.turn_rows)
        found = torch.cat((force * self.fraction[:, None], of_turns), 1)
        of_bends = (self.bends * force[:, None]).sum(2)
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
        places = torch.cat((loads[:60].unflatten(0, (20, 3)), loads[60:80, None]), 1).flatten(0, 1)
        self._together = torch.cat((places, loads[80:]))
        carried = _with_what_they_carry(loads[None, 60:80])[0]
        self._rows = torch.cat((places, carried, loads[80:])).T.contiguous()
        self._metres = metres[:, None]
        self._corners = hand.faces.T.flatten()
        self._around = _faces_around(hand.faces, self._together.shape[1])
        bones = [0, 0, 0, *hand.kinematics.skeleton.bone]
        self._bones = torch.tensor(bones, device=self.shape.device)
        rows = [3 * bone + bones[:place].count(bone) for place, bone in enumerate(bones)]
        self._turn_rows = torch.tensor(rows, device=self.shape.device)

    @cached_property
    def carries(self) -> Bool[Tensor, "20 20"]:
        """Whether a bone (row) is or carries another (column)."""
        return _with_what_they_carry(torch.eye(20, device=self.shape.device)[None])[0] > 0

    @property
    def bones_turned(self) -> Int[Tensor, "30"]:
        """Bone that each joint angle turns."""
        return self._bones[3:]

    def for_shape(self, hands: PosedHands) -> "SkinPoints":
        """The skin of the hands' own shape: this one where that is its shape."""

        def own() -> "SkinPoints":
            shape = hands.shape.to(self.shape)
            return self if are_equal(shape, self.shape) else SkinPoints(self.hand, shape)

        return self if hands.shape is self.shape else hands.once_for_shape(("skin", id(self)), own)

    def weighted(self, vertices: Int[Tensor, "points"] | Int[Tensor, "hands points"]) -> WeightedVertices:
        """Skinning of some vertices, the same ones of all hands or others of each."""
        each = vertices if vertices.ndim > 1 else vertices[None]
        own = self._rows.index_select(0, each.flatten()).unflatten(0, each.shape).mT.contiguous()  # hands k points
        return WeightedVertices(
            places=own[:, :80].unflatten(1, (20, 4)),
            carried=own[:, 80:100],
            correctives=own[:, 100:].unflatten(1, (-1, 6)),
        )

    def posed(self, pose: HandPose) -> PosedBones:
        """The bones of some hands, in the dtype of the skin."""
        pose = pose.to(self.shape)
        frames = self.hand.kinematics(pose.dofs, self.shape, root_reference=pose.reference)
        features, slopes = self.hand.skinning.corrective_features(pose.dofs.T, self._metres)
        constants = self.hand.kinematics.chain.constants
        axes = world_axes(pose.dofs.T, frames.rotation.permute(1, 2, 3, 0), constants).permute(2, 0, 1)
        turned = frames.rotation.index_select(1, self.hand.skinning.corrective_bones)[:, :, :, None]
        bending, bend_slopes = (
            (turned * factor.permute(2, 0, 1)[:, :, None, :, None]).flatten(-2) for factor in (features, slopes)
        )
        return PosedBones(
            rotation=frames.rotation,
            position=frames.position,
            turns=torch.cat((left_jacobian(pose.dofs[:, 3:6]).mT, axes), 1),
            bending=bending,
            slopes=bend_slopes,
        )

    def vertices(self, pose: HandPose) -> Float[Tensor, "hands vertices 3"]:
        """The whole skin of some hands in the world."""
        return self.skin_on(self.posed(pose))

    def skin_on(self, bones: PosedBones) -> Float[Tensor, "hands vertices 3"]:
        """The whole skin in the world, by its bones."""
        columns = torch.cat((bones.rotation, bones.position[..., None]), -1)  # hands 20 3 4
        coefficients = torch.cat((columns.transpose(1, 2).flatten(2), bones.bending.transpose(1, 2).flatten(2)), -1)
        return (coefficients.flatten(0, 1) @ self._together).unflatten(0, (-1, 3)).mT

    def normals(self, vertices: Float[Tensor, "hands vertices 3"]) -> Float[Tensor, "hands vertices 3"]:
        """Unit normals of whole skins, outward."""
        a, b, c = vertices.index_select(1, self._corners).unflatten(1, (3, -1)).unbind(1)
        of_face = torch.nn.functional.pad(_cross((b - a).mT, (c - a).mT).mT, (0, 0, 0, 1))
        total = of_face.index_select(1, self._around).unflatten(1, (-1, vertices.shape[1])).sum(1)
        return torch.nn.functional.normalize(total, dim=-1, eps=1e-30)

    def motion(self, bones: PosedBones, vertices: WeightedVertices) -> SkinMotion:
        """Some vertices of posed hands, and how they move."""
        columns = torch.cat((bones.rotation, bones.position[..., None]), -1)  # hands 20 3 4
        bent = bones.bending @ vertices.correctives
        parts = (columns @ vertices.places).index_add_(1, self.hand.skinning.corrective_bones, bent)
        whole = _gathered(parts)
        return SkinMotion(
            points=whole[:, 0].mT,
            levers=torch.addcmul(whole, vertices.carried[:, :, None], bones.position[..., None], value=-1),
            fraction=vertices.carried[:, 0],
            turns=bones.turns,
            turn_rows=self._turn_rows,
            bends=bones.slopes @ vertices.correctives,
            bend_rows=self.hand.skinning.corrective_rows,
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
    products = ((b * z, c, y), (c * x, a, z), (a * y, b, x))
    return torch.stack([product.addcmul_(left, right, value=-1) for product, left, right in products], -2)


def _with_what_they_carry(parts: Float[Tensor, "hands 20 *more"]) -> Float[Tensor, "hands 20 *more"]:
    """Sums over every bone and those beyond it, from the tips to the root."""
    return _gathered(parts.clone())


def _gathered(parts: Float[Tensor, "hands 20 *more"]) -> Float[Tensor, "hands 20 *more"]:
    """`_with_what_they_carry` in the place of the parts."""
    parts[:, 12:16] += parts[:, 16:]
    parts[:, 6:11] += parts[:, 11:16]
    parts[:, 1:6] += parts[:, 6:11]
    parts[:, 0] += parts[:, 1:6].sum(1)
    return parts


@kept(8)
def _faces_around(faces: Int[Tensor, "faces 3"], count: int) -> Int[Tensor, "places"]:
    """The faces at each vertex, the first of every vertex, then the second; where it has no more, one past the last."""
    corners = faces.flatten().cpu()
    order = corners.argsort(stable=True)
    owner = corners[order]
    place = torch.arange(len(owner)) - torch.searchsorted(owner, owner)
    around = torch.full((int(place.max()) + 1, count), len(faces))
    around[place, owner] = order // 3
    return around.flatten().to(faces.device)
