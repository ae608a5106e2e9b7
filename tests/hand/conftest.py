"""A small mesh with all that a mesh can have: any bones, any weights, correctives of several angles of a bone."""

from dataclasses import replace

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.hand.kinematics import BONES, JOINT_DOFS
from torchhand.hand.model import HandModel
from torchhand.hand.skin import HandMesh

CORRECTIVES = ("index_mcp_aa", "thumb_cmc_fe", "index_mcp_fe", "little_dip_fe", "ring_cmc_fe")


@pytest.fixture(scope="session")
def small_model() -> HandModel:
    """The generic hand with a random mesh of 24 vertices, float64."""
    model, generator = load_hand_model(), torch.Generator().manual_seed(7)
    count, parameters = 24, len(model.shape_space.names)

    def normal(*sizes: int) -> torch.Tensor:
        return torch.randn(*sizes, generator=generator, dtype=torch.float64)

    weights = torch.rand(count, 4, generator=generator, dtype=torch.float64)
    bind_pose = torch.cat((torch.zeros(6, dtype=torch.float64), 0.2 * normal(30)))
    mesh = HandMesh(
        vertices=0.1 * normal(count, 3),
        faces=torch.randint(count, (30, 3), generator=generator),
        shape_basis=0.3 * normal(count, 3, parameters),
        skin_bones=torch.stack([torch.randperm(len(BONES), generator=generator)[:4] for _ in range(count)]),
        skin_weights=weights / weights.sum(1, keepdim=True),
        bind_pose=bind_pose,
        corrective_dofs=tuple(JOINT_DOFS.index(name) for name in CORRECTIVES),
        corrective_basis=0.01 * normal(count, 3, len(CORRECTIVES), 2),
    )
    return replace(model, mesh=mesh)
