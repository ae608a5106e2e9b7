"""Training of proposals: the loss's laws, and that it learns."""

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.learn.proposals.measuring import measured_on_views
from torchhand.learn.proposals.observing import SeenHands, seen_hands
from torchhand.learn.proposals.rendering import RenderedHands
from torchhand.learn.proposals.training import (
    ProposalTraining,
    hypothesis_errors,
    mixture_loss,
    new_network,
    train_proposals,
)
from torchhand.propose import ViewedHands

MODEL = load_hand_model()
KINEMATICS = MODEL.kinematics(dtype=torch.float32)
SMALL = ProposalTraining(steps=24, batch=8, hands=24, held_out=24, hypotheses=3, width=4)


def _hypotheses(seen: SeenHands, weights: tuple[float, ...]) -> ViewedHands:
    """The truth, and further hypotheses that are turned by half a turn."""
    count, k = len(seen.joints), len(weights)
    turn = torch.diag(torch.tensor([-1.0, -1.0, 1.0]))
    rotation = torch.stack([seen.rotation, *[turn @ seen.rotation] * (k - 1)], 1)
    return ViewedHands(
        rotation=rotation,
        joints=seen.joints[:, None].expand(-1, k, -1),
        place=seen.place[:, None].expand(-1, k, -1),
        log_size=seen.log_size[:, None].expand(-1, k),
        spread=torch.full((count, k), 0.1),
        log_weight=torch.tensor(weights).log().expand(count, k),
    )


def test_the_truth_has_no_error_and_others_have(rendered: RenderedHands) -> None:
    seen = seen_hands(rendered, torch.Generator().manual_seed(0))
    errors = hypothesis_errors(_hypotheses(seen, (0.5, 0.5)), seen, KINEMATICS)
    torch.testing.assert_close(errors[:, 0], torch.zeros(len(rendered)), atol=1e-5, rtol=0)
    assert bool((errors[:, 1] > 0.1).all())


def test_the_loss_rewards_weights_on_the_truth(rendered: RenderedHands) -> None:
    """By exactly the logarithm of what they gain, where the others explain nothing."""
    seen = seen_hands(rendered, torch.Generator().manual_seed(0))
    losses = []
    for weights in ((0.8, 0.2), (0.2, 0.8)):
        found = _hypotheses(seen, weights)
        losses.append(float(mixture_loss(found, hypothesis_errors(found, seen, KINEMATICS))))
    assert losses[1] - losses[0] == pytest.approx(math.log(4), abs=0.02)


def test_the_best_spread_is_the_error() -> None:
    """The exponential's maximum of likelihood: error over spread plus its logarithm is least where both are equal."""
    errors = torch.full((1, 1), 0.2)
    empty = torch.zeros(1, 1)
    base = ViewedHands(
        rotation=torch.eye(3).expand(1, 1, 3, 3),
        joints=torch.zeros(1, 1, 30),
        place=torch.zeros(1, 1, 2),
        log_size=empty,
        spread=empty,
        log_weight=empty,
    )
    losses = [float(mixture_loss(replace(base, spread=torch.full((1, 1), s)), errors)) for s in (0.15, 0.2, 0.25)]
    assert losses[1] < min(losses[0], losses[2])


def test_it_learns_and_follows_from_the_seed(rendered: RenderedHands) -> None:
    losses, networks = [], []
    for _ in range(2):
        network = new_network(SMALL, MODEL)
        networks.append(network)
        losses.append([r.loss for r in train_proposals(network, rendered, SMALL, MODEL, report_every=6)])
    assert losses[0] == losses[1]
    assert losses[0][-1] < losses[0][0] - 0.5
    assert torch.equal(networks[0].heads.weight, networks[1].heads.weight)
    figures = measured_on_views(networks[0], rendered, MODEL, 0)
    assert figures.errors.best["placed_mm"] < figures.errors.top["placed_mm"]
    assert 1 / 3 < figures.promised < 1


def test_hypotheses_begin_with_unlike_directions() -> None:
    network = new_network(replace(SMALL, hypotheses=6), MODEL).eval()
    with torch.no_grad():
        found = network(torch.zeros(1, 3, 48, 48))
    cosine = ((found.rotation[0][:, None].mT @ found.rotation[0]).diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    assert float(cosine[~torch.eye(6, dtype=torch.bool)].max()) < 0.95


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"steps": 0}, "steps: expected 1 to"),
        ({"batch": 1}, "batch: expected 2"),
        ({"learning_rate": 0.0}, "learning_rate"),
    ],
)
def test_settings_out_of_range_are_refused(change: dict[str, float], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        ProposalTraining(**change)  # type: ignore[arg-type]


def test_it_learns_the_same_on_any_device(
    device: torch.device, rendered: RenderedHands, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By steps in proportion to the gradient: those of AdamW are its sign at first, which rounding decides where a
    gradient is nothing but rounding."""
    monkeypatch.setattr(torch.optim, "AdamW", _descent)
    settings = replace(SMALL, steps=3)
    ends = []
    for there in (torch.device("cpu"), device):
        network = new_network(settings, MODEL).to(there)
        losses = [reached.loss for reached in train_proposals(network, rendered, settings, MODEL, report_every=1)]
        ends.append((losses, measured_on_views(network, rendered, MODEL, 3).errors.best["aligned_mm"]))
    assert ends[0][0][2] != pytest.approx(ends[0][0][0], rel=0.1)
    assert ends[1][0][0] == pytest.approx(ends[0][0][0], rel=1e-5)
    assert ends[1][0] == pytest.approx(ends[0][0], rel=1e-4)
    assert ends[1][1] == pytest.approx(ends[0][1], rel=1e-3)


def _descent(parameters: Iterator[torch.nn.Parameter], lr: float, weight_decay: float) -> torch.optim.Optimizer:
    """Plain steps along the gradient; `lr` is large for those of AdamW, which are as long as it is."""
    return torch.optim.SGD(parameters, lr=lr, weight_decay=weight_decay)
