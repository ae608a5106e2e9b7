"""Figures of proposals on hands whose errors are known."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import posture
from torchhand.learn.proposals.figures import FIGURES, figures_table, proposal_figures

KINEMATICS = load_hand_model().kinematics(dtype=torch.float64)


def _hands(*names: str) -> Tensor:
    return KINEMATICS(torch.stack([posture(name, dtype=torch.float64) for name in names])).keypoints


def test_the_truth_among_others_is_the_best_and_the_heaviest_is_the_likeliest() -> None:
    truth = _hands("fist", "open", "point")
    turn = rotation_from_vector(torch.tensor([0.0, math.radians(40.0), 0.0], dtype=torch.float64))
    both = torch.stack((truth @ turn.mT, truth + 0.1), 1)
    found = proposal_figures(both, torch.tensor([[0.7, 0.3]] * 3), truth)
    for name in FIGURES:
        assert found.best[name] == pytest.approx(0, abs=1e-5)
    assert found.top["rotation_deg"] == pytest.approx(40.0, abs=1e-6)
    assert found.top["aligned_mm"] == pytest.approx(0, abs=1e-6)
    assert found.top["placed_mm"] > 5
    assert found.within == 1.0


def test_pictures_without_hypotheses_count_as_failures() -> None:
    truth = _hands("fist", "open")
    own = truth[:, None].clone()
    own[1] = torch.nan
    found = proposal_figures(own, torch.ones(2, 1), truth)
    assert (found.pictures, found.within) == (2, 0.5)
    assert found.top["placed_mm"] == pytest.approx(0, abs=1e-6)
    nothing = proposal_figures(own[1:], torch.ones(1, 1), truth[1:])
    assert math.isnan(nothing.top["placed_mm"])
    assert nothing.within == 0


def test_the_table_has_every_figure() -> None:
    truth = _hands("fist", "open")
    table = figures_table([("some", proposal_figures(truth[:, None], torch.ones(2, 1), truth))])
    head, row = table.splitlines()
    assert all(name in head for name in FIGURES)
    assert row.split()[:3] == ["some", "2", "0.0"]
    assert row.split()[-1] == "100%"
