"""What the tests of the learning example share: a small training, and what it draws from."""

import pytest

from torchhand.files import load_hand_model
from torchhand.learn.training import TrainingData, TrainingSettings, training_data

SMALL = TrainingSettings(steps=40, batch=32, pool=200, held_out=100, energy_hands=8, width=32, blocks=1)


@pytest.fixture(scope="session")
def small_settings() -> TrainingSettings:
    return SMALL


@pytest.fixture(scope="session")
def small_data() -> TrainingData:
    return training_data(SMALL, load_hand_model())
