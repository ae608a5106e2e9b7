"""Overlap of masks, and the cut at the wrist."""

import numpy as np

from torchhand.evaluate.silhouettes import cut_at_wrist, intersection_over_union


def box(left: int, right: int) -> np.ndarray:
    mask = np.zeros((10, 20), dtype=bool)
    mask[2:6, left:right] = True
    return mask


def test_known_overlaps() -> None:
    first = np.stack([box(0, 8), box(0, 8), box(0, 8), np.zeros((10, 20), dtype=bool)])
    second = np.stack([box(0, 8), box(4, 12), box(8, 12), np.zeros((10, 20), dtype=bool)])
    np.testing.assert_allclose(intersection_over_union(first, second), [1.0, 1.0 / 3.0, 0.0, np.nan])
    assert intersection_over_union(first[1], second[1]) == 1.0 / 3.0


def test_the_forearm_goes_and_the_line_itself_stays() -> None:
    arm = box(0, 20)
    np.testing.assert_array_equal(cut_at_wrist(arm, np.array([7.0, 4.0]), np.array([12.0, 4.0])), box(7, 20))
    np.testing.assert_array_equal(cut_at_wrist(arm, np.array([7.0, 4.0]), np.array([2.0, 4.0])), box(0, 8))


def test_the_cut_is_square_to_the_hand() -> None:
    everything = np.ones((11, 11), dtype=bool)
    x, y = np.meshgrid(np.arange(11), np.arange(11))
    np.testing.assert_array_equal(
        cut_at_wrist(everything, np.array([5.0, 5.0]), np.array([7.0, 7.0])), (x - 5) + (y - 5) >= 0
    )


def test_an_unknown_wrist_cuts_nothing() -> None:
    for wrist in (np.array([np.nan, 4.0]), np.array([12.0, 4.0])):
        np.testing.assert_array_equal(cut_at_wrist(box(0, 20), wrist, np.array([12.0, 4.0])), box(0, 20))
