"""Of the calls of a function, the first ones of a test and those at powers of two are checked against its shapes."""

import pytest
import torch
from jaxtyping import TypeCheckError

from tests import checked_calls
from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandPose


def _refusals(calls: int) -> list[int]:
    refused = []
    for call in range(1, calls + 1):
        try:
            rotation_from_vector(torch.zeros(3).tolist())  # pyright: ignore[reportArgumentType]
        except TypeCheckError:
            refused.append(call)
        except (AttributeError, TypeError):  # what the function itself says
            pass
    return refused


def test_first_calls_and_powers_of_two_are_checked_in_every_test() -> None:
    assert _refusals(40) == [1, 2, 3, 4, 8, 16, 32]
    checked_calls.begin_test()
    assert _refusals(5) == [1, 2, 3, 4]


def test_records_are_checked_as_they_are_made() -> None:
    with pytest.raises(TypeCheckError):
        HandPose(dofs=torch.zeros(36), reference=torch.zeros(4, 4))
