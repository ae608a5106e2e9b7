"""Vertices spread over the skin."""

from typing import Any

import pytest
import torch

from torchhand.fit.hull.vertices import spread_vertices


def test_vertices_are_spread_evenly_with_their_areas(rig: Any) -> None:
    chosen, fraction = spread_vertices(rig.hand, 200)
    assert len(chosen) == len(chosen.unique()) == 200
    assert float(fraction.sum()) == pytest.approx(1)
    assert float(fraction.min()) > 0
    vertices = rig.hand(torch.zeros(36, dtype=torch.float64)).vertices
    to_all = torch.cdist(vertices, vertices[chosen]).amin(1)
    random = torch.randperm(len(vertices), generator=torch.Generator().manual_seed(1))[:200]
    assert float(to_all.max()) < 0.7 * float(torch.cdist(vertices, vertices[random]).amin(1).max())
    everything, _ = spread_vertices(rig.hand, 10_000)
    assert len(everything) == len(vertices)
