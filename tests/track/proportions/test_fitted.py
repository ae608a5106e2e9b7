"""Whether frames that were held out contradict proportions."""

import pytest
import torch

from torchhand.track import FittedShape

NOTHING = torch.zeros(1, dtype=torch.float64)


def fitted(more: list[float]) -> FittedShape:
    """Proportions with which frames cost so much more than with those before."""
    before = torch.tensor([40.0, 52.0, 33.0, 60.0, 45.0], dtype=torch.float64)[: len(more)]
    return FittedShape(
        shape=NOTHING,
        shape_std=NOTHING,
        keypoints_cov=torch.zeros(21, 3, 3, dtype=torch.float64),
        costs=before + torch.tensor(more, dtype=torch.float64),
        costs_before=before,
    )


@pytest.mark.parametrize(
    ("more", "is_contradicted"),
    [
        ([-1.0, -2.0, -1.5, -0.5], False),
        ([14.8, 1.9, -0.1, -3.6], False),  # one frame that fits badly
        ([0.4, 0.7, 2.6, -1.2], False),
        ([3.0, 2.5, 3.5, 2.8], True),
        ([1.0, 1.0, 1.0], True),
        ([3.0, 2.0], False),  # two frames tell little
        ([3.0, 2.9], True),
        ([0.5], True),
        ([-0.5], False),
    ],
)
def test_several_frames_are_believed_unless_others_contradict_them_by_more_than_chance(
    more: list[float], is_contradicted: bool
) -> None:
    assert fitted(more).is_contradicted is is_contradicted


@pytest.mark.parametrize(("count", "t"), [(2, 6.314), (3, 2.920), (4, 2.353), (5, 2.132)])
def test_one_in_twenty_fits_that_are_no_worse_is_contradicted(count: int, t: float) -> None:
    """The largest deviation that is not contradicted is Student's t of count - 1 degrees of freedom."""
    away = torch.linspace(-1, 1, count, dtype=torch.float64)
    edge = t * away.std() / count**0.5
    assert fitted((away + 1.01 * edge).tolist()).is_contradicted
    assert not fitted((away + 0.99 * edge).tolist()).is_contradicted
