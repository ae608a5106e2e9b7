import itertools

import torch

from torchhand.geometry import rotation_from_vector
from torchhand.track.multiview.continuity import viterbi_path


def _facing(*degrees: float) -> torch.Tensor:
    return rotation_from_vector(torch.deg2rad(torch.tensor([[0.0, angle, 0.0] for angle in degrees])).double())


def test_sure_frames_decide_for_the_others():
    scores = [torch.tensor(pair) for pair in ((0.95, 0.80), (0.90, 0.91), (0.90, 0.92), (0.94, 0.85))]
    facing = [_facing(0.0, 180.0), _facing(10.0, 190.0), _facing(20.0, 170.0), _facing(15.0, 200.0)]
    assert viterbi_path(scores, facing) == [0, 0, 0, 0]


def test_a_clear_turn_is_believed():
    scores = [torch.tensor(pair) for pair in ((0.95, 0.80), (0.94, 0.82), (0.70, 0.92), (0.75, 0.93))]
    facing = [_facing(0.0, 180.0)] * 4
    assert viterbi_path(scores, facing) == [0, 0, 1, 1]


def test_it_is_the_best_of_all_paths():
    generator = torch.Generator().manual_seed(1)
    counts = (3, 1, 4, 2)
    scores = [0.8 + 0.2 * torch.rand(n, generator=generator) for n in counts]
    facing = [rotation_from_vector(2 * torch.randn(n, 3, generator=generator)) for n in counts]

    def worth(path: tuple[int, ...]) -> float:
        total = sum(float(score[i]) for score, i in zip(scores, path, strict=True))
        for (a, i), (b, j) in itertools.pairwise(zip(facing, path, strict=True)):
            total -= 0.06 * (1 - (float((a[i] * b[j]).sum()) - 1) / 2) / 2
        return total

    best = max(itertools.product(*map(range, counts)), key=worth)
    assert viterbi_path(scores, facing) == list(best)


def test_nothing_to_choose_from():
    assert viterbi_path([], []) == []
    assert viterbi_path([torch.tensor([0.5])], [_facing(0.0)]) == [0]
