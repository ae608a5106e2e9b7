"""The evidence for a hand in a single picture: edges beyond chance, support, and how it is counted."""

import json
import math
from pathlib import Path

import torch

from tests.studio import Studio
from torchhand.hand import HandPose
from torchhand.image import mean_skin_likeness
from torchhand.track.quality import LogisticModel
from torchhand.track.single import EVIDENCE, HandOdds, SinglePoseSettings, counted, evidence
from torchhand.track.single.evidence import hand_odds, outline_rank, supported
from torchhand.track.single.registration import Registered


def test_an_outline_on_edges_has_the_greatest_ranks_and_one_laid_anywhere_half_of_them() -> None:
    placed = Studio().placed(size=0.8)
    mask = placed.mask
    assert outline_rank(placed.picture(), mask) > 0.9
    noise = torch.randint(0, 256, (*mask.shape, 3), generator=torch.Generator().manual_seed(0), dtype=torch.uint8)
    assert abs(outline_rank(noise, mask) - 0.5) < 0.05  # some 400 pixels, correlated over three
    assert outline_rank(noise, torch.ones_like(mask)) == 0.5  # no outline within the picture


def test_likeness_to_skin_is_the_mean_over_the_mask() -> None:
    image = torch.tensor((205, 150, 125), dtype=torch.uint8).repeat(4, 6, 1)
    image[:, 3:] = torch.tensor((60, 90, 200), dtype=torch.uint8)
    left = torch.arange(6).repeat(4, 1) < 3
    assert mean_skin_likeness(image, left) > 0.5
    assert mean_skin_likeness(image, ~left) == 0
    whole = mean_skin_likeness(image, torch.ones_like(left))
    assert math.isclose(whole, 0.5 * mean_skin_likeness(image, left), rel_tol=1e-9)
    assert mean_skin_likeness(image, torch.zeros_like(left)) == 0


def test_hands_at_one_place_support_one_another_and_those_elsewhere_do_not() -> None:
    placed = Studio().placed(size=0.8)
    pose, away = placed.pose.clone(), placed.pose.clone()
    away[0] += 0.3
    own, far = (_registered(HandPose.of(dofs, placed.root_reference), placed.shape) for dofs in (pose, away))
    nothing = torch.full((len(EVIDENCE),), torch.nan, dtype=torch.float64)

    def support(others: list[Registered]) -> float:
        return float(supported(nothing, own, others, placed.camera, placed.kinematics)[EVIDENCE.index("support")])

    assert math.isclose(support([own, own, own, far]), 1, abs_tol=1e-9)  # of the three nearest
    assert support([far, far]) < 0.05
    assert math.isclose(support([own, far]), 0.5, abs_tol=0.03)
    assert math.isnan(support([]))


def test_better_evidence_than_a_right_hand_s_counts_as_this_and_what_is_open_does_too() -> None:
    usual = torch.tensor((1.0, 2.0, 3.0), dtype=torch.float64)
    told = torch.tensor((5.0, -1.0, torch.nan), dtype=torch.float64)
    assert counted(told, usual).tolist() == [1.0, -1.0, 3.0]
    model = LogisticModel(bias=0.5, weights=torch.tensor((1.0, 10.0, 2.0), dtype=torch.float64))
    assert HandOdds(model=model, usual=usual)(told) == 0.5 + 1 - 10 + 6
    assert HandOdds(model=model, usual=usual).most == 0.5 + 1 + 20 + 6


def test_the_model_of_the_package_asks_for_what_speaks_for_a_hand_and_tells_how_it_was_made() -> None:
    odds = hand_odds()
    assert bool((odds.model.weights > -0.5).all())  # none speaks against a hand, but for chance
    table = json.loads(Path(evidence.__file__).with_suffix(".json").read_text(encoding="utf-8"))
    assert table["command"].startswith("torchhand measure_status --photographs")
    asked = SinglePoseSettings().alone_odds
    assert asked in [row["log_odds"] for row in table["fitted"].values()]


def _registered(pose: HandPose, shape: torch.Tensor) -> Registered:
    return Registered(
        pose=pose, shape=shape, covariance=torch.eye(28, dtype=torch.float64), edges=1.0, cost=0.0, modes=1
    )
