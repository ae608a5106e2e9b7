"""The mesh of a hand model from its skeleton and shape table alone."""

from collections.abc import Callable

import torch

from torchhand.hand import HandMesh, HandModel, posture
from torchhand.modelling.correctives import CORRECTED, with_correctives
from torchhand.modelling.field import HandField
from torchhand.modelling.shape_basis import shape_basis
from torchhand.modelling.surface import even_mesh
from torchhand.modelling.weights import skin_weights

VERTICES = 2000
_MESH_STEPS = 10
BIND_POSTURE = "open"  # fingers apart, so that the skins of neighbours do not touch


def build_steps(model: HandModel) -> int:
    """How many steps `build_mesh` reports."""
    return _MESH_STEPS + len(model.shape_space.names) + len(CORRECTED)


def build_mesh(
    model: HandModel,
    *,
    vertices: int = VERTICES,
    grid: float = 0.0015,
    on_step: Callable[[int], object] = lambda steps: None,
) -> HandMesh:
    """Skin of the right hand, float64; the same bits for the same model, libraries and machine.

    grid: step of the grid on which the surface is found, metres. on_step: told how many steps have been done since the
    last call, for a progress bar.
    """
    kinematics = model.kinematics(dtype=torch.float64)
    space, shape, pose = model.shape_space, kinematics.default_shape, posture(BIND_POSTURE, dtype=torch.float64)
    frames = kinematics(pose)
    points, faces = even_mesh(HandField(space, frames, shape), frames.keypoints, vertices, step=grid)
    bones, weights = skin_weights(space, frames, shape, points, faces)
    on_step(_MESH_STEPS)
    mesh = HandMesh(
        vertices=points,
        faces=faces,
        shape_basis=shape_basis(kinematics, pose, points, bones, weights, on_step=on_step),
        skin_bones=bones,
        skin_weights=weights,
        bind_pose=pose,
        corrective_dofs=(),
        corrective_basis=points.new_zeros(len(points), 3, 0, 2),
    )
    return with_correctives(model, mesh, on_step=on_step)
