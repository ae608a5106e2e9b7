"""Bounds of the free parameters of a pose space."""

import torch

from torchhand.files import load_hand_model
from torchhand.fit.bounds import free_bounds
from torchhand.hand import DOFS, named_pose_space


def test_every_free_angle_keeps_its_own_limits() -> None:
    space, skeleton = named_pose_space("dof26"), load_hand_model().skeleton
    lower, upper = free_bounds(space, skeleton)
    assert bool(lower[:6].isinf().all())
    assert bool((lower[6:] < upper[6:]).all())
    rows = [DOFS.index(name) - 6 for name in space.free_names[6:]]
    torch.testing.assert_close(lower[6:], skeleton.lower[rows])  # those of the thumb's CMC, not of the MCP tied to it
    torch.testing.assert_close(upper[6:], skeleton.upper[rows])
