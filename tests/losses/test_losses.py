"""Losses for training loops: what they are at known answers, their slopes, and what they refuse."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.hand import posture
from torchhand.losses import (
    distance_map_loss,
    keypoint_loss,
    penetration_loss,
    prior_loss,
    signed_distance,
    silhouette_loss,
)


def squares(*lefts: int, side: int = 8, size: int = 32) -> Tensor:
    """A square in every picture, from column `left` on."""
    masks = torch.zeros(len(lefts), size, size, dtype=torch.bool)
    for mask, left in zip(masks, lefts, strict=True):
        mask[10 : 10 + side, left : left + side] = True
    return masks


def test_a_silhouette_is_compared_by_its_overlap() -> None:
    moved = silhouette_loss(squares(10, 14, 20).double(), squares(10), reduction="none")
    assert moved.tolist() == pytest.approx([0.0, 1 - 4 / 12, 1.0])
    known = torch.ones(1, 32, 32, dtype=torch.bool)
    known[..., 14:] = False  # what is wrong there does not count
    assert silhouette_loss(squares(10).double() * known, squares(10), known).item() == pytest.approx(0.0)
    assert silhouette_loss(torch.zeros(1, 8, 8), torch.zeros(1, 8, 8)).isfinite()


def test_the_distance_map_pulls_from_where_nothing_overlaps() -> None:
    distance = signed_distance(squares(4), dtype=torch.float64)
    losses = distance_map_loss(squares(4, 14, 20).double(), distance, reduction="none")
    assert losses[0] == 0
    assert 0 < losses[1] < losses[2]
    coverage = squares(20)[0].double().requires_grad_()
    distance_map_loss(coverage, distance[0], reduction="sum").backward()
    assert coverage.grad is not None
    torch.testing.assert_close(coverage.grad * squares(4).sum(), distance[0])
    empty = signed_distance(torch.zeros(1, 8, 8, dtype=torch.bool))
    assert distance_map_loss(torch.ones(1, 8, 8), empty).item() == 0


def test_signed_distances_are_those_of_a_half_plane() -> None:
    mask = torch.zeros(6, 9, dtype=torch.bool)
    mask[:, :4] = True
    torch.testing.assert_close(signed_distance(mask), (torch.arange(9) - 3.5).expand(6, 9))


def test_keypoints_are_squared_near_and_linear_far_and_may_be_missing() -> None:
    target = torch.zeros(3, 2, dtype=torch.float64)
    near, far = torch.tensor([1e-3, 0.0]).double(), torch.tensor([0.0, 1e6]).double()
    assert keypoint_loss(near.expand(3, 2), target, std=0.5).item() == pytest.approx(0.5 * (1e-3 / 0.5) ** 2, rel=1e-5)
    assert keypoint_loss(far.expand(3, 2), target, std=0.5).item() == pytest.approx(2e6, rel=1e-5)
    points = torch.stack((near, far, near)).requires_grad_()
    gone = torch.tensor([[0.0, 0.0], [math.nan, 0.0], [0.0, 0.0]], dtype=torch.float64)
    loss = keypoint_loss(points, gone, std=0.5)
    loss.backward()
    assert loss.item() == pytest.approx(2e-6, rel=1e-4)
    assert points.grad is not None
    assert points.grad[1].abs().sum() == 0
    weight = torch.tensor([1.0, 0.0, 3.0], dtype=torch.float64)
    assert keypoint_loss(points, target, weight, std=0.5).item() == pytest.approx(2e-6, rel=1e-4)
    with pytest.raises(ValueError, match="std: expected above 0, got 0"):
        keypoint_loss(points, target, std=0.0)


def test_losses_of_hands_are_those_of_the_prior_and_the_primitives() -> None:
    model = load_hand_model()
    prior, hand = model.prior(dtype=torch.float64), model.hand(dtype=torch.float64)
    poses = torch.stack([posture(name, dtype=torch.float64) for name in ("open", "fist")])
    bent = poses.clone()
    bent[:, 9] += 3  # far beyond its limit
    assert (prior_loss(prior, bent, reduction="none") > prior_loss(prior, poses, reduction="none")).all()
    through = posture("fist", dtype=torch.float64).expand(2, -1).clone()
    through[1, 6:] *= 1.6
    losses = penetration_loss(hand(through).primitives, reduction="none")
    assert losses[1] > losses[0] + 1


@pytest.mark.parametrize("loss", [silhouette_loss, distance_map_loss])
def test_reductions_are_those_of_torch(loss: Callable[..., Tensor]) -> None:
    masks = squares(10, 14, 20)
    arguments = (masks.double(), masks[:1] if loss is silhouette_loss else signed_distance(masks[0]).double())
    each = loss(*arguments, reduction="none")
    assert each.shape == (3,)
    torch.testing.assert_close(loss(*arguments), each.mean())
    torch.testing.assert_close(loss(*arguments, reduction="sum"), each.sum())


def test_the_example_fits_a_hand_to_a_mask() -> None:
    names: dict[str, Any] = {"__name__": "example"}
    file = Path(__file__).resolve().parents[2] / "docs" / "examples" / "fit_mask.py"
    exec(compile(file.read_text(encoding="utf-8"), file, "exec"), names)
    assert names["main"]() > 0.95
