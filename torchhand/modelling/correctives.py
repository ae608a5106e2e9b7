"""What blend skinning lacks at bent joints: offsets that put the vertices back on the skin of the bent hand."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import JOINT_DOFS, ROOT_DOFS, Hand, HandMesh, HandModel
from torchhand.modelling.diffusion import Diffusion
from torchhand.modelling.field import HandField
from torchhand.modelling.surface import projected

CORRECTED = (
    *("thumb_cmc_fe", "thumb_cmc_aa", "thumb_cmc_tw", "thumb_mcp_fe", "thumb_ip_fe"),
    *(
        f"{finger}_{joint}"
        for finger in ("index", "middle", "ring", "little")
        for joint in ("mcp_fe", "mcp_aa", "pip_fe", "dip_fe")
    ),
)
"""Joint angles that have correctives."""

_ANGLES = 9  # samples over each angle's range
_LONGEST = 6e-3  # metres; longer offsets come from a projection that went astray
_EVENING = 1.5e-3  # metres over which offsets are evened out
_RIDGE = 0.03  # keeps the two features apart where an angle has a small range
_MIN_OFFSET = 5e-5  # smaller offsets are dropped


def with_correctives(
    model: HandModel,
    mesh: HandMesh,
    names: Sequence[str] = CORRECTED,
    *,
    on_step: Callable[[int], object] = lambda steps: None,
) -> HandMesh:
    """The mesh with least-squares offsets for the features (sin, 1 − cos) of each of the named angles, fitted with all
    other angles as in the bind pose. `mesh` has no correctives yet. on_step: called after every angle.
    """
    hand = replace(model, mesh=mesh).hand(dtype=torch.float64)
    dofs = tuple(JOINT_DOFS.index(name) for name in names)
    columns = []
    for dof in dofs:
        columns.append(_of_angle(hand, mesh, dof))
        on_step(1)
    return replace(mesh, corrective_dofs=dofs, corrective_basis=torch.stack(columns, 2))


def _of_angle(hand: Hand, mesh: HandMesh, dof: int) -> Float[Tensor, "vertices 3 2"]:
    skeleton, row = hand.kinematics.skeleton, len(ROOT_DOFS) + dof
    space, shape = hand.kinematics.shape_space, hand.kinematics.default_shape
    even = Diffusion(mesh.vertices, mesh.faces)
    level = HandField(space, hand.kinematics(mesh.bind_pose), shape)(mesh.vertices)
    angles = torch.linspace(float(skeleton.lower[dof]), float(skeleton.upper[dof]), _ANGLES, dtype=torch.float64)
    offsets, features = [], []
    for angle in angles:
        pose = mesh.bind_pose.clone()
        pose[row] = angle
        state = hand(pose)
        wanted = projected(HandField(space, state.frames, shape), state.vertices, level, rounds=8) - state.vertices
        length = wanted.norm(dim=-1, keepdim=True).clamp_min(1e-12)
        wanted = even(wanted * (length.clamp_max(_LONGEST) / length), _EVENING)
        offsets.append(wanted @ state.frames.rotation[skeleton.bone[dof]])  # into the bone's frame
        bend = angle - mesh.bind_pose[row]
        features.append(torch.stack((bend.sin(), 1 - bend.cos())))
    matrix = torch.stack(features)
    ridge = _RIDGE * torch.eye(2, dtype=matrix.dtype)
    solution = torch.linalg.solve(matrix.T @ matrix + ridge, matrix.T @ torch.stack(offsets).flatten(1))
    basis = solution.unflatten(-1, (-1, 3)).permute(1, 2, 0)
    return torch.where(basis.norm(dim=(1, 2), keepdim=True) > _MIN_OFFSET, basis, 0.0)
