"""Forearms as meshes: elliptic cones that are bent at the wrist."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import constant_tensor
from torchhand.geometry import rotation_from_vector
from torchhand.simulate.crops.draws import Draws

FOREARM_LENGTH = 0.24
"""Metres."""
FIRST_OF_FOREARM, LAST_OF_FOREARM = 2, 255
"""Labels of its faces, from the wrist to its end; 1 is left to the hand."""
_RINGS, _SPOKES = 25, 16
_THICKNESS, _WIDENING = 0.72, 1.45  # of the forearm: thickness over breadth, and breadth at the elbow over the wrist's
_ROUND = 0.12  # share of the forearm over which its end is rounded
_OVERLAP = 0.012  # metres by which the forearm reaches into the palm
_WRIST_BEND = (0.45, 0.25)  # radians: standard deviations of the wrist's flexion and abduction


def forearm_meshes(
    wrist_breadth: Float[Tensor, "*#hands"], generator: torch.Generator
) -> tuple[Float[Tensor, "hands points 3"], Int[Tensor, "faces 3"], Int[Tensor, "faces"]]:
    """Elliptic cones in the frames of right hands, metres, closed and bent at the wrist; the labels of their faces.

    On the device of the breadths; the generator is one of the processor.
    """
    count, device = len(wrist_breadth), wrist_breadth.device
    draws = Draws(generator=generator, device=device)
    spread = 1 + 0.1 * draws.normal(count, 2)
    along = torch.linspace(0, 1, _RINGS, device=device)
    angle = torch.arange(_SPOKES, device=device) * (2 * math.pi / _SPOKES)
    rounded = (along / _ROUND).clamp_max(1).sqrt()  # the end inside the palm
    half = 0.5 * wrist_breadth[:, None, None] * ((0.6 + 0.4 * rounded) * (1 + (_WIDENING - 1) * along))[:, None]
    x = _THICKNESS * half * spread[:, :1, None] * angle.cos()
    z = half * spread[:, 1:, None] * angle.sin()
    y = (_OVERLAP - FOREARM_LENGTH * along)[:, None].expand_as(x)
    points = torch.stack((x, y, z), -1).flatten(1, 2)
    ends = points.unflatten(1, (_RINGS, _SPOKES))[:, [0, -1]].mean(2)
    flexion, abduction = (std * draws.normal(count) for std in _WRIST_BEND)
    bend = rotation_from_vector(torch.stack((abduction, 0 * abduction, flexion), -1))
    ring, spoke = torch.meshgrid(
        torch.arange(_RINGS - 1, device=device), torch.arange(_SPOKES, device=device), indexing="ij"
    )
    here, beside = ring * _SPOKES + spoke, ring * _SPOKES + (spoke + 1) % _SPOKES
    sides = torch.cat(
        (torch.stack((here, beside, here + _SPOKES), -1), torch.stack((beside, beside + _SPOKES, here + _SPOKES), -1))
    ).flatten(0, 1)
    caps = [
        torch.stack((torch.full_like(pair[0], _RINGS * _SPOKES + end), *pair), -1)
        for end, pair in enumerate(((beside[0], here[0]), (here[-1] + _SPOKES, beside[-1] + _SPOKES)))
    ]
    step = (LAST_OF_FOREARM - FIRST_OF_FOREARM) / (_RINGS - 2)
    of_sides = (FIRST_OF_FOREARM + step * ring).round().long().reshape(-1).repeat(2)
    of_caps = constant_tensor((FIRST_OF_FOREARM, LAST_OF_FOREARM), torch.long, device).repeat_interleave(_SPOKES)
    faces = torch.cat((sides, *caps))
    return torch.cat((points, ends), 1) @ bend.mT, faces, torch.cat((of_sides, of_caps))
