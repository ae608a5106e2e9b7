"""What the tests of learned proposals share: a few rendered hands."""

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.learn.proposals.rendering import RenderedHands, hand_pool

HANDS = 24


@pytest.fixture(scope="session")
def rendered() -> RenderedHands:
    return hand_pool(load_hand_model(), HANDS, torch.Generator().manual_seed(5))
