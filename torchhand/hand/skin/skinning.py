"""Linear blend skinning with pose correctives, as one product of matrices.

With the batch last, a coordinate of vertex v is a sum over some hundred numbers that depend on the pose alone (the
pose terms: the columns of every bone's rotation, every bone's origin, and rotations times the features of the
correctives) times numbers that depend on the shape alone (the loads: weighted places of the vertex in the bones'
frames, the weights, the correctives):

    x_v = Σ_b w_vb (R_b u_vb + p_b) + Σ_ck R_bone(c) d_vck φ_ck(θ_c)

So hands of one shape need no blended matrix per vertex, and derivatives are products of matrices as well.
"""

from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from torchhand.geometry import compose, turn
from torchhand.hand.kinematics import BONES, LEVER_ENDS, ROOT_DOFS, HandKinematics, place_chain
from torchhand.hand.skin.mesh import HandMesh
from torchhand.precision import own_precision

_HANDS_AT_ONCE = 128  # with a shape each: what is blended for them fits the processor's cache


class Skinning(nn.Module):
    """Carries the vertices of a mesh with the bones. Holds constants only: nothing is kept from call to call.

    The batch stands last in what it takes; a shape that all hands share has a batch of one.
    """

    weights: Tensor
    rest_vertices: Tensor
    rest_basis: Tensor
    bone_from_hand: Tensor
    origin_basis: Tensor
    correctives: Tensor
    corrective_bones: Tensor
    corrective_rows: Tensor
    corrective_zero: Tensor
    breadth_scale: Tensor

    def __init__(self, mesh: HandMesh, kinematics: HandKinematics) -> None:
        """The mesh and the kinematics are of the same side; constants are computed in their dtype."""
        super().__init__()
        space = kinematics.shape_space
        default = space.metres(space.default)
        hand_from_bone, origins = _bind_frames(mesh, kinematics)
        basis = mesh.shape_basis.transpose(0, 1)
        breadth = space.names.index("hand_breadth")
        scale = torch.zeros_like(default)
        scale[breadth] = 1 / default[breadth]
        rows = torch.tensor([len(ROOT_DOFS) + dof for dof in mesh.corrective_dofs], dtype=torch.long)
        constants = {
            "weights": _dense_weights(mesh),  # (20, V)
            "rest_vertices": mesh.vertices.T - basis @ default,  # (3, V), at the bind pose, plus
            "rest_basis": basis,  # (3, V, S) times the metres
            "bone_from_hand": hand_from_bone.mT,  # (20, 3, 3), at the bind pose
            "origin_basis": hand_from_bone.mT @ origins,  # (20, 3, S): bones' origins there, in their own frames
            "correctives": mesh.corrective_basis.permute(2, 3, 1, 0),  # (C, 2, 3, V)
            "corrective_bones": torch.tensor([kinematics.skeleton.bone[d] for d in mesh.corrective_dofs]).long(),
            "corrective_rows": rows,  # of the pose
            "corrective_zero": mesh.bind_pose[rows][:, None],
            "breadth_scale": scale,  # times the metres is the hand's breadth over the default one
        }
        for name, value in constants.items():
            self.register_buffer(name, value.to(mesh.vertices.device).contiguous(), persistent=False)

    @own_precision
    def forward(
        self,
        rotation: Float[Tensor, "20 3 3 n"],
        position: Float[Tensor, "20 3 n"],
        pose: Float[Tensor, "36 n"],
        metres: Float[Tensor, "shape #n"],
    ) -> Float[Tensor, "n vertices 3"]:
        """The vertices in the world, from the bones there; in memory x, y and z of all hands follow each other."""
        if metres.shape[-1] == 1:
            bending = self._bending(rotation, pose, metres)
            pose_terms = torch.cat((rotation.transpose(1, 2).flatten(0, 1), position, bending))
            return _product(pose_terms, self.loads(metres[:, 0])).permute(1, 2, 0)
        if torch.compiler.is_compiling():
            return self._own_shapes(rotation, position, pose, metres).permute(1, 2, 0)
        parts = (x.split(_HANDS_AT_ONCE, -1) for x in (rotation, position, pose, metres))
        return torch.cat([self._own_shapes(*part) for part in zip(*parts, strict=True)], 1).permute(1, 2, 0)

    def _own_shapes(self, rotation: Tensor, position: Tensor, pose: Tensor, metres: Tensor) -> Tensor:
        """(3, n, vertices) of hands with a shape each: blended rotations times the vertices at the bind pose."""
        turned = compose(rotation, self.bone_from_hand[..., None])  # world_from_bone · bone_from_hand
        shifted = position - turn(rotation, self.origin_basis @ metres)
        loads = torch.cat((self.weights, self.correctives.flatten(0, 2)))
        vertices = _product(torch.cat((shifted, self._bending(rotation, pose, metres))), loads)
        blended = _product(turned.flatten(1, 2), self.weights).unflatten(0, (3, 3))
        rest = (metres.T @ self.rest_basis.flatten(0, 1).T).unflatten(-1, (3, -1)) + self.rest_vertices
        for column, part in zip(blended.unbind(1), rest.unbind(1), strict=True):
            vertices = torch.addcmul(vertices, column, part)
        return vertices

    def _bending(self, rotation: Tensor, pose: Tensor, metres: Tensor) -> Tensor:
        """Pose terms of the correctives: columns of the rotations of their bones times their features."""
        features, _ = self.corrective_features(pose, metres)
        columns = rotation.index_select(0, self.corrective_bones).transpose(1, 2)
        return (columns[:, None] * features[:, :, None, None]).flatten(0, 2)

    @own_precision
    def loads(self, metres: Float[Tensor, "shape"]) -> Float[Tensor, "k vertices"]:
        """The part of the shape: 60 rows of places in the bones' frames, 20 of weights, then the correctives."""
        rest = self.rest_vertices + self.rest_basis @ metres
        places = self.bone_from_hand @ rest - (self.origin_basis @ metres)[..., None]
        weighted = places * self.weights[:, None]
        return torch.cat((weighted.flatten(0, 1), self.weights, self.correctives.flatten(0, 2)))

    @own_precision
    def loads_at(
        self, index: Int[Tensor, "points #n"], metres: Float[Tensor, "shape #n"]
    ) -> tuple[Float[Tensor, "20 3 points #n"], Float[Tensor, "20 points #n"], Float[Tensor, "c 2 3 points #n"]]:
        """The three parts of `loads` for some vertices, which may differ from hand to hand, as may the shapes."""
        rest = self.rest_vertices[..., None] + self.rest_basis @ metres
        rest = torch.take_along_dim(rest, index[None], 1)
        places = torch.einsum("bji,ipn->bjpn", self.bone_from_hand, rest)
        weights = self.weights[:, index]
        weighted = (places - (self.origin_basis @ metres)[:, :, None]) * weights[:, None]
        return weighted, weights, self.correctives[..., index]

    def corrective_features(
        self, pose: Float[Tensor, "36 n"], metres: Float[Tensor, "shape #n"]
    ) -> tuple[Float[Tensor, "c 2 n"], Float[Tensor, "c 2 n"]]:
        """sin and 1 − cos of the correctives' angles, times the hand's relative breadth; and their derivatives."""
        angle = pose.index_select(0, self.corrective_rows) - self.corrective_zero
        breadth, sine, cosine = self.breadth_scale @ metres, angle.sin(), angle.cos()
        return torch.stack((sine, 1 - cosine), 1) * breadth, torch.stack((cosine, sine), 1) * breadth


def mirrored_mesh(mesh: HandMesh) -> HandMesh:
    """The mesh of the left hand: z reversed, faces still counter-clockwise from outside."""
    mirror = mesh.vertices.new_tensor((1.0, 1.0, -1.0))
    return replace(
        mesh,
        vertices=mesh.vertices * mirror,
        faces=mesh.faces[:, [0, 2, 1]],
        shape_basis=mesh.shape_basis * mirror[:, None],
        corrective_basis=mesh.corrective_basis * mirror[:, None, None],
    )


def _product(pose_terms: Float[Tensor, "k i n"], loads: Float[Tensor, "k vertices"]) -> Float[Tensor, "i n vertices"]:
    return (pose_terms.flatten(1).T @ loads).unflatten(0, pose_terms.shape[1:])


def _dense_weights(mesh: HandMesh) -> Float[Tensor, "20 vertices"]:
    weights = mesh.skin_weights.new_zeros(len(mesh.vertices), len(BONES))
    return weights.scatter_add(1, mesh.skin_bones.long(), mesh.skin_weights).T


def _bind_frames(
    mesh: HandMesh, kinematics: HandKinematics
) -> tuple[Float[Tensor, "20 3 3"], Float[Tensor, "20 3 shape"]]:
    """hand_from_bone at the bind pose, and the bones' origins there as a linear map of the metres.

    The origins are linear in the levers and those in the metres: the columns of the map are the hands whose metres are
    unit vectors.
    """
    columns = kinematics.lever_matrix.unflatten(0, (len(LEVER_ENDS), 3))
    poses = mesh.bind_pose[:, None].expand(-1, columns.shape[-1]).contiguous()
    rotation, position, _ = place_chain(poses, None, columns, kinematics.chain.constants)
    return rotation[..., 0], position
