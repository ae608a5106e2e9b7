"""Texture coordinates of a hand's skin: two charts side by side, the palm's and the back's, as one sees them flat.

Each face belongs to the side that it faces at the bind pose of the model's default hand, so all hands share one atlas.
The seam runs along the sides of the hand and of its fingers.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from torchhand.hand import Hand, HandModel, Side

_MARGIN = 0.02  # of the atlas, round each chart


@dataclass(frozen=True, kw_only=True)
class TextureAtlas:
    """Corners of faces on the texture. A vertex on the seam has a corner in each chart."""

    corners: Int64[Tensor, "faces 3"]
    """Corner of each face's vertices, index into the two arrays below."""
    vertex: Int64[Tensor, "corners"]
    """Vertex of each corner; the first corners are the vertices in their order, then those of the seam again."""
    uv: Float64[Tensor, "corners 2"]
    """Place on the texture, 0 to 1: u to the right, v up."""


def texture_atlas(model: HandModel, side: Side = "right") -> TextureAtlas:
    """The atlas of a model's mesh. Both sides share the texture; corners are in the order of the side's faces.

    Raises ValueError for a model without a mesh.
    """
    if model.mesh is None:
        raise ValueError(f"model: expected one with a mesh, {model.name!r} has none")
    hand: Hand = model.hand(side="right", dtype=torch.float64)
    vertices, faces = hand(model.mesh.bind_pose.double()).vertices.contiguous(), hand.faces
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    is_palm = torch.linalg.cross(b - a, c - a)[:, 0] < 0
    on_palm, on_back = torch.zeros(2, len(vertices), dtype=torch.bool)
    on_palm[faces[is_palm].flatten()], on_back[faces[~is_palm].flatten()] = True, True
    seam = (on_palm & on_back).nonzero()[:, 0]
    second = torch.arange(len(vertices))
    second[seam] = len(vertices) + torch.arange(len(seam))
    own = faces if side == "right" else model.hand(side=side, dtype=torch.float64).faces
    corners = torch.where(is_palm[:, None], own, second[own])
    vertex = torch.cat((torch.arange(len(vertices)), seam))
    chart = torch.cat((on_palm, torch.zeros(len(seam), dtype=torch.bool)))
    flat = vertices[:, 1:]
    low, high = flat.amin(0), flat.amax(0)
    scale = (1 - 2 * _MARGIN) / float((high - low).max())
    y, z = ((flat - low) * scale).unbind(-1)
    height, width = y[vertex], z[vertex]
    across = torch.where(chart, width, float(z.max()) - width)  # as one sees each side
    room = 0.5 - float(z.max()) * 0.5
    u = 0.5 * across + 0.5 * room + torch.where(chart, 0.0, 0.5)
    return TextureAtlas(corners=corners, vertex=vertex, uv=torch.stack((u, height + _MARGIN), -1))
