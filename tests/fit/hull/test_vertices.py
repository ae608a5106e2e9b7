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


def test_each_vertex_is_the_farthest_from_those_before(rig: Any) -> None:
    chosen, fraction = spread_vertices(rig.hand, 40)
    hand, faces = rig.hand, rig.hand.faces
    metres = hand.kinematics.metres(hand.kinematics.default_shape)
    vertices = hand.skinning.rest_vertices.T + (hand.skinning.rest_basis @ metres).T
    away = torch.cdist(vertices, vertices[chosen], compute_mode="donot_use_mm_for_euclid_dist")
    for count in range(1, 40):
        nearest = away[:, :count].amin(1)
        assert float(nearest[chosen[count]]) == pytest.approx(float(nearest.max()), abs=1e-12)
    a, b, c = vertices[faces].unbind(1)
    each = (torch.linalg.cross(b - a, c - a).norm(dim=-1) / 6).repeat_interleave(3)
    area = torch.zeros(len(vertices), dtype=torch.float64).index_add(0, faces.flatten(), each)
    share = torch.zeros(40, dtype=torch.float64).index_add(0, away.argmin(1), area) / area.sum()
    torch.testing.assert_close(fraction, share, rtol=0, atol=1e-12)
