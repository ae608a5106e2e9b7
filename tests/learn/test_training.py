"""Training: it learns, the same seed gives the same network, and a broken-off run ends as any other."""

import itertools
import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.learn.data import Samples
from torchhand.learn.estimate import estimate_hands
from torchhand.learn.figures import baseline_of, figures_of
from torchhand.learn.network import HandEstimate
from torchhand.learn.training import (
    LossWeights,
    Training,
    TrainingData,
    TrainingSettings,
    learning_rate,
    loss_terms,
    new_training,
    restored,
    snapshot,
    train,
    training_data,
)

MODEL = load_hand_model()


def _held_out(training: Training, data: TrainingData) -> dict[str, float]:
    estimate = estimate_hands(training.network, data.held_out.points_plane, data.held_out.seen)
    return figures_of(estimate.keypoints, data.held_out.keypoints)


def _weights(training: Training) -> torch.Tensor:
    return torch.cat([parameter.detach().flatten() for parameter in training.network.parameters()])


@pytest.mark.slow
def test_a_short_training_learns_far_more_than_the_mean_posture() -> None:
    settings = TrainingSettings(
        steps=200, batch=128, learning_rate=4e-3, pool=2000, held_out=300, energy_hands=4, width=192, blocks=2
    )
    data = training_data(settings, MODEL)
    training = new_training(settings, MODEL, data)
    baseline, before = baseline_of(training.network, data.held_out.keypoints), _held_out(training, data)
    losses = [reached.loss for reached in train(training, data, pause_every=50)]
    after = _held_out(training, data)
    assert training.step == 200
    assert losses[-1] < 0.6 * losses[0]
    assert after["flexion_deg"] < 0.7 * baseline["flexion_deg"]
    assert after["aligned_mm"] < 0.7 * baseline["aligned_mm"]
    assert after["root_relative_mm"] < 0.9 * baseline["root_relative_mm"]
    assert after["root_relative_mm"] < 0.25 * before["root_relative_mm"]


def test_a_resumed_training_ends_like_an_uninterrupted_one(
    small_settings: TrainingSettings, small_data: TrainingData
) -> None:
    whole = new_training(small_settings, MODEL, small_data)
    losses = [reached.loss for reached in train(whole, small_data, pause_every=10)]
    first = new_training(small_settings, MODEL, small_data)
    for reached in train(first, small_data, pause_every=10):
        if reached.step == 20:
            kept = snapshot(reached)
            break
    second = restored(new_training(small_settings, MODEL, small_data), kept)
    assert second.step == 20
    rest = [reached.loss for reached in train(second, small_data, pause_every=10)]
    assert rest == losses[2:]
    assert torch.equal(_weights(second), _weights(whole))
    assert list(train(second, small_data, pause_every=10)) == []


def test_the_same_seed_gives_the_same_network(small_settings: TrainingSettings, small_data: TrainingData) -> None:
    before = torch.random.get_rng_state()
    settings = replace(small_settings, steps=5)
    runs = []
    for seed in (0, 0, 1):
        own = replace(settings, seed=seed)
        training = new_training(own, MODEL, small_data)
        list(train(training, small_data, pause_every=5))
        runs.append(_weights(training))
    assert torch.equal(runs[0], runs[1])
    assert not torch.equal(runs[0], runs[2])
    assert torch.equal(torch.random.get_rng_state(), before), "torch's own generator is left alone"
    again = training_data(small_settings, MODEL)
    assert torch.equal(again.pool.joints, small_data.pool.joints)
    assert torch.equal(again.held_out.points_plane, small_data.held_out.points_plane)
    rows = (again.pool.joints[:, None, :4] == small_data.held_out.joints[None, :, :4]).all(-1)
    assert not bool(rows.any()), "what is measured on has not been trained on"


def _truth(samples: Samples, shape: torch.Tensor) -> HandEstimate:
    count = len(samples.joints)
    return HandEstimate(
        pose=torch.cat((torch.zeros(count, 6), samples.joints), -1),
        root_reference=torch.eye(3).expand(count, 3, 3),
        shape=shape.expand(count, -1),
        keypoints=samples.keypoints,
    )


def test_the_terms_of_the_loss(small_settings: TrainingSettings, small_data: TrainingData) -> None:
    samples = small_data.held_out
    truth = _truth(samples, MODEL.shape_space.default.float())
    terms = loss_terms(truth, samples, small_data.prior, small_settings)
    assert set(terms) == {"keypoints", "reprojection", "distance", "joints", "energy"}
    for name in ("keypoints", "reprojection", "distance", "joints"):
        assert float(terms[name]) == 0, name
    few = slice(small_settings.energy_hands)
    energy = 1e-3 * small_data.prior.energy(truth.pose[few], truth.shape[few]).mean()
    torch.testing.assert_close(terms["energy"], energy)

    moved = samples.keypoints.clone()
    moved[:, 8] += torch.tensor((0.0, 0.0, 0.02))
    changed = loss_terms(replace(truth, keypoints=moved), samples, small_data.prior, small_settings)
    assert float(changed["keypoints"]) == pytest.approx(2 / 20, rel=1e-3)
    assert 0 < float(changed["reprojection"]) < 0.2
    assert float(changed["distance"]) == 0
    far = loss_terms(replace(truth, keypoints=1.1 * samples.keypoints), samples, small_data.prior, small_settings)
    assert float(far["distance"]) == pytest.approx(math.log(1.1), rel=1e-4)
    assert float(far["reprojection"]) == pytest.approx(0, abs=1e-5)
    bent = loss_terms(replace(truth, pose=truth.pose + 0.1), samples, small_data.prior, small_settings)
    assert float(bent["joints"]) == pytest.approx(0.1, rel=1e-4)
    assert float(bent["energy"]) > float(terms["energy"])
    double = replace(small_settings, weights=LossWeights(keypoints=2.0, energy=0.0))
    terms = loss_terms(replace(truth, keypoints=moved), samples, small_data.prior, double)
    assert float(terms["keypoints"]) == pytest.approx(2 * float(changed["keypoints"]))
    assert "energy" not in terms


def test_the_learning_rate_rises_and_falls() -> None:
    settings = TrainingSettings(steps=1000, learning_rate=0.002)
    rates = [learning_rate(settings, step) for step in range(1000)]
    assert rates[0] < 0.1 * 0.002
    assert max(rates) == pytest.approx(0.002, rel=0.01)
    assert rates.index(max(rates)) == pytest.approx(50, abs=5)
    assert 0 < rates[-1] < 1e-2 * 0.002
    assert all(a >= b for a, b in itertools.pairwise(rates[60:]))


def test_figures_of_known_errors(small_data: TrainingData) -> None:
    truth = small_data.held_out.keypoints
    moved = truth + torch.tensor((0.01, 0.0, 0.02))
    figures = figures_of(1.1 * moved, truth)
    assert figures["aligned_mm"] == pytest.approx(0, abs=1e-3)
    assert figures["flexion_deg"] == pytest.approx(0, abs=1e-2)
    wrong = truth.clone()
    wrong[:, 1:] += torch.tensor((0.003, 0.0, 0.0))
    assert figures_of(wrong, truth)["root_relative_mm"] == pytest.approx(3 * 20 / 21, rel=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steps": 0}, "steps: expected 1 to 10000000, got 0"),
        ({"batch": 1}, "batch: expected 2 to 100000, got 1"),
        ({"seed": -1}, "seed: expected 0 to"),
        ({"learning_rate": math.nan}, "learning_rate: expected above 0, at most 1, got nan"),
    ],
)
def test_wrong_settings_are_named(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TrainingSettings(**change)


def test_it_learns_the_same_on_any_device(device: torch.device) -> None:
    settings = TrainingSettings(steps=3, batch=16, pool=40, held_out=20, energy_hands=4, width=16, blocks=1)
    ends = []
    for there in (torch.device("cpu"), device):
        data = training_data(settings, MODEL, there)
        training = new_training(settings, MODEL, data, there)
        losses = [reached.loss for reached in train(training, data, pause_every=1)]
        assert all(parameter.device.type == there.type for parameter in training.network.parameters())
        ends.append((losses, snapshot(training)["network"], _held_out(training, data)))
    (losses, network, figures), (found_losses, found_network, found_figures) = ends
    assert found_losses == pytest.approx(losses, rel=1e-4)
    for name, value in network.items():
        assert found_network[name].device.type == "cpu"
        torch.testing.assert_close(found_network[name], value, rtol=1e-3, atol=1e-4)
    assert found_figures == pytest.approx(figures, rel=1e-3)
