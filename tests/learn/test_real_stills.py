"""A network that has only seen the prior's hands, on the keypoints of a real hand in another maker's definition."""

from pathlib import Path

import pytest

from torchhand.files import load_hand_model
from torchhand.learn.estimate import estimate_hands
from torchhand.learn.figures import baseline_of, figures_of
from torchhand.learn.stills import load_stills
from torchhand.learn.training import TrainingSettings, new_training, train, training_data


@pytest.mark.slow
def test_it_carries_over_to_a_real_hand(data_dir: Path) -> None:
    folder = data_dir / "real" / "joints3d_stills"
    if not folder.is_dir():
        pytest.skip("needs joints3d_stills")
    stills, model = load_stills(folder), load_hand_model()
    settings = TrainingSettings(steps=1000, pool=10_000, held_out=500)
    data = training_data(settings, model)
    training = new_training(settings, model, data)
    list(train(training, data, pause_every=1000))
    own = figures_of(estimate_hands(training.network, data.held_out.points_plane).keypoints, data.held_out.keypoints)
    held_out = baseline_of(training.network, data.held_out.keypoints)
    assert own["flexion_deg"] < 0.5 * held_out["flexion_deg"]
    assert own["aligned_mm"] < 0.5 * held_out["aligned_mm"]
    real = figures_of(estimate_hands(training.network, stills.points_plane, side="left").keypoints, stills.keypoints)
    usual = baseline_of(training.network, stills.keypoints, is_left=True)
    assert real["flexion_deg"] < 0.65 * usual["flexion_deg"]
    assert real["aligned_mm"] < 0.6 * usual["aligned_mm"]
    wrong = figures_of(estimate_hands(training.network, stills.points_plane, side="right").keypoints, stills.keypoints)
    assert wrong["aligned_mm"] > 1.3 * real["aligned_mm"], "which hand it is matters"
