"""The mesh of a hand model from its skeleton and shape table alone."""

import torch

from torchhand.hand import posture
from torchhand.hand.mesh import HandMesh
from torchhand.hand.model import HandModel
from torchhand.modelling.correctives import with_correctives
from torchhand.modelling.field import HandField
from torchhand.modelling.shape_basis import shape_basis
from torchhand.modelling.surface import even_mesh
from torchhand.modelling.weights import skin_weights

VERTICES = 2000
BIND_POSTURE = "open"  # fingers apart, so that the skins of neighbours do not touch


def build_mesh(model: HandModel, *, vertices: int = VERTICES) -> HandMesh:
    """Skin of the right hand, float64; takes a few minutes and is deterministic."""
    kinematics = model.kinematics(dtype=torch.float64)
    space, shape, pose = model.shape_space, kinematics.default_shape, posture(BIND_POSTURE)
    frames = kinematics(pose)
    points, faces = even_mesh(HandField(space, frames, shape), frames.keypoints, vertices)
    bones, weights = skin_weights(space, frames, shape, points, faces)
    mesh = HandMesh(
        vertices=points,
        faces=faces,
        shape_basis=shape_basis(kinematics, pose, points, bones, weights),
        skin_bones=bones,
        skin_weights=weights,
        bind_pose=pose,
        corrective_dofs=(),
        corrective_basis=points.new_zeros(len(points), 3, 0, 2),
    )
    return with_correctives(model, mesh)
