"""Silhouettes at a detector's keypoints."""

from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.fit.detect.keypoint_cut import CutAtKeypoints, are_colours_shared, cut_at_keypoints
from torchhand.image import intersection_over_union


def _before_more_skin(placed: Any) -> Tensor:
    """The hand before a wall of its own colours, a little darker about its outline."""
    image = placed.picture(seed=1).float()
    colour = image[placed.mask].mean(0)
    image[~placed.mask] = 0.8 * colour
    return image.to(torch.uint8)


@pytest.mark.parametrize("scale", [1, 3])
def test_the_hand_is_cut_out_of_a_wall_of_its_colours(scale: int, studio: Any) -> None:
    """Without its forearm, in pictures of any size."""
    placed = studio.placed(size=0.7, camera=studio.camera(scale * 200, scale * 160))
    cut = cut_at_keypoints(_before_more_skin(placed), placed.keypoints_px)
    assert cut is not None
    near = torch.zeros_like(cut)
    top, bottom = (round(float(one)) for one in placed.keypoints_px[:, 1].aminmax())
    near[max(0, top - 5) : bottom + 5] = True
    assert float(intersection_over_union(cut, placed.mask, near, empty=0.0)) > 0.8
    told = CutAtKeypoints().probability(_before_more_skin(placed), placed.keypoints_px)
    assert told is not None
    assert torch.equal(told > 0.5, cut)


def test_keypoints_that_are_missing_or_elsewhere_tell_no_silhouette(studio: Any) -> None:
    placed = studio.placed()
    image, missing = placed.picture(), placed.keypoints_px.clone()
    missing[4] = torch.nan
    for points in (missing, placed.keypoints_px + 5000.0):
        assert cut_at_keypoints(image, points) is None
        assert CutAtKeypoints().probability(image, points) is None


def test_colours_are_shared_with_things_that_are_no_part_of_the_hand(studio: Any) -> None:
    """Neither a forearm nor fingers that a cut about wrong points lacks are such things; colours that half of the hand
    has tell it no better."""
    placed = studio.placed(size=0.4, at=(0.0, 0.05))
    hand, points = placed.mask, placed.keypoints_px
    height, width = hand.shape
    probability = hand.double()

    def shared(row: int, column: int, cut: Tensor = hand) -> bool:
        seen = probability.clone()
        seen[row : row + 12, column : column + 12] = 1.0
        return are_colours_shared(seen, cut, points)

    assert not are_colours_shared(probability, hand, points)
    assert shared(2, 2)
    assert shared(2, width - 14)
    assert not shared(height - 14, int(points[0, 0]))
    without_tip = hand.clone()
    without_tip[: int(points[12, 1]) + 15] = False
    assert not are_colours_shared(probability, without_tip, points)
    half = probability.clone()
    half[:, : int(points[9, 0])] = 0.0
    assert are_colours_shared(half, hand, points)
