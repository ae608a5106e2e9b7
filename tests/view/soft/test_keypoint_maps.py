"""Keypoints as pictures of Gaussians."""

import math

import pytest
import torch

from torchhand.view.soft import keypoint_maps


@pytest.mark.parametrize("std_px", [0.05, 0.7, 2.5])
def test_a_map_holds_its_point_at_any_width(std_px: float) -> None:
    points = torch.tensor([[[20.3, 11.8], [15.5, 14.0]]], dtype=torch.float64, requires_grad=True)
    maps = keypoint_maps(points, (40, 28), std_px=std_px)
    torch.testing.assert_close(maps.sum((-2, -1)), torch.ones(1, 2).double(), atol=1e-5, rtol=0)
    column = (maps.sum(-2) * torch.arange(40)).sum(-1)
    if std_px > 0.5:  # narrower ones fall into one pixel
        torch.testing.assert_close(column, points[..., 0], atol=0.02, rtol=0)
    assert torch.autograd.gradcheck(lambda p: keypoint_maps(p, (40, 28), std_px=max(std_px, 0.5)), (points,))


def test_missing_points_have_empty_maps_and_no_gradient() -> None:
    points = torch.tensor([[math.nan, 3.0], [5.0, 4.0]], requires_grad=True)
    maps = keypoint_maps(points, (10, 8))
    assert maps[0].abs().sum() == 0
    maps.square().sum().backward()
    assert points.grad is not None
    assert points.grad[0].abs().sum() == 0
    with pytest.raises(ValueError, match="std_px: expected above 0"):
        keypoint_maps(points, (10, 8), std_px=0.0)
