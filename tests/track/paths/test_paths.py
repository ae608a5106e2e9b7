"""The probabilities of several paths against the sum over all ways through them."""

import itertools

import numpy as np
import pytest
import torch

from torchhand.track import HandPath, path_weights

MOTION, TURN = 100.0, 25.0
"""Nats per metre, and of half a turn."""


def _paths(frames: int, count: int, seed: int = 0) -> list[HandPath]:
    generator = torch.Generator().manual_seed(seed)
    return [
        HandPath(
            keypoints=0.02 * torch.randn(frames, 21, 3, generator=generator, dtype=torch.float64),
            evidence=2 * torch.randn(frames, generator=generator, dtype=torch.float64),
        )
        for _ in range(count)
    ]


def _enumerated(paths: list[HandPath]) -> torch.Tensor:
    """Every way through the frames, each with its probability."""
    frames, count = len(paths[0].evidence), len(paths)
    weights = torch.zeros(frames, count, dtype=torch.float64)
    for way in itertools.product(range(count), repeat=frames):
        if any(not bool(paths[own].has_hand[t]) for t, own in enumerate(way)):
            continue
        hands = [paths[own].keypoints[t] for t, own in enumerate(way)]
        moved = sum(float((b - a).norm(dim=-1).mean()) for a, b in itertools.pairwise(hands))
        facing = [np.cross(hand[5] - hand[0], hand[17] - hand[0]) for hand in hands]
        cosines = [a @ b / np.linalg.norm(a) / np.linalg.norm(b) for a, b in itertools.pairwise(facing)]
        turned = sum((1 - float(cosine)) / 2 for cosine in cosines)
        evidence = sum(float(paths[own].evidence[t]) for t, own in enumerate(way))
        weight = torch.tensor(evidence - MOTION * moved - TURN * turned, dtype=torch.float64).exp()
        for t, own in enumerate(way):
            weights[t, own] += weight
    return weights / weights.sum(1, keepdim=True)


@pytest.mark.parametrize("count", [2, 3])
def test_weights_are_those_of_all_ways_together(count: int) -> None:
    paths = _paths(5, count)
    torch.testing.assert_close(path_weights(paths), _enumerated(paths), rtol=0, atol=1e-12)


def test_a_path_without_a_hand_has_no_part_in_a_frame() -> None:
    paths = _paths(5, 2, seed=1)
    paths[0].keypoints[2] = torch.nan
    weights = path_weights(paths)
    assert weights[2].tolist() == [0.0, 1.0]
    paths[1].keypoints[2] = torch.nan
    assert path_weights(paths)[2].tolist() == [0.0, 0.0]


def test_frames_without_a_hand_part_those_before_from_those_after() -> None:
    paths = _paths(5, 2, seed=2)
    for path in paths:
        path.keypoints[2] = torch.nan
    parts = [
        [HandPath(keypoints=path.keypoints[rows], evidence=path.evidence[rows]) for path in paths]
        for rows in (slice(0, 2), slice(3, 5))
    ]
    expected = [_enumerated(part) for part in parts]
    torch.testing.assert_close(path_weights(paths)[[0, 1, 3, 4]], torch.cat(expected), rtol=0, atol=1e-12)


def test_a_frame_is_decided_by_its_neighbours_where_it_tells_nothing_itself() -> None:
    still = torch.zeros(5, 21, 3, dtype=torch.float64)
    evidence = torch.tensor([3.0, 3.0, 0.0, 3.0, 3.0], dtype=torch.float64)
    sure = HandPath(keypoints=still, evidence=evidence)
    other = HandPath(keypoints=still + 0.1, evidence=torch.zeros(5, dtype=torch.float64))
    assert float(path_weights([sure, other])[2, 0]) > 0.99


@pytest.mark.parametrize(("wrong", "is_believed"), [(10, False), (40, True)])
def test_a_hand_turns_over_where_much_speaks_for_it(wrong: int, is_believed: bool) -> None:
    """Some frames of a path from its other side, which is a bit likelier in each."""
    generator = torch.Generator().manual_seed(3)
    still = (0.02 * torch.randn(21, 3, generator=generator, dtype=torch.float64)).expand(60, 21, 3)
    turned = still.clone()
    rows = slice(10, 10 + wrong)
    turned[rows] = turned[rows] * torch.tensor((-1.0, 1.0, -1.0), dtype=torch.float64)
    nothing = torch.zeros(60, dtype=torch.float64)
    evidence = nothing.clone()
    evidence[rows] = 2.0
    weights = path_weights([HandPath(keypoints=still, evidence=nothing), HandPath(keypoints=turned, evidence=evidence)])
    assert bool((weights[rows, 1] > 0.8).all()) is is_believed
    assert bool((weights[rows, 1] < 0.1).all()) is not is_believed


def test_evidence_is_wanted_of_every_hand() -> None:
    paths = _paths(3, 2)
    paths[0].evidence[1] = torch.nan
    with pytest.raises(ValueError, match="evidence: expected a finite number"):
        path_weights(paths)
