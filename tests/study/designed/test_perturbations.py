"""Starts are distributed as they are said to be."""

from pathlib import Path

import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.hand import named_pose_space
from torchhand.study.designed.perturbations import (
    GaussianPerturbation,
    Perturbation,
    SampledPerturbation,
    UniformPerturbation,
    perturbation_of,
)

SPACE = named_pose_space("dof26")
COUNT = 4000
JOINTS = [i for i, name in enumerate(SPACE.free_names) if not name.startswith("root")]


@pytest.mark.parametrize(
    "perturbation",
    [
        UniformPerturbation(),
        GaussianPerturbation(correlation=0.6),
        SampledPerturbation(samples=torch.randn(300, SPACE.size, generator=torch.Generator().manual_seed(1)).double()),
    ],
)
def test_spreads_are_those_that_are_told(perturbation: Perturbation, generator: torch.Generator) -> None:
    drawn = perturbation.draw(SPACE, COUNT, generator)
    found = drawn.square().mean(0).sqrt()
    torch.testing.assert_close(found, perturbation.std(SPACE), rtol=6 / COUNT**0.5, atol=0.0)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 1.0])
def test_joint_angles_are_correlated_and_the_root_is_not(correlation: float, generator: torch.Generator) -> None:
    drawn = GaussianPerturbation(correlation=correlation).draw(SPACE, COUNT, generator)
    found = torch.corrcoef(drawn.T)
    off = [float(found[i, j]) for i in JOINTS for j in JOINTS if i != j]
    assert np.mean(off) == pytest.approx(correlation, abs=0.02)
    roots = [i for i in range(SPACE.size) if i not in JOINTS]
    assert float(found[roots][:, JOINTS].abs().max()) < 0.1


def test_samples_are_drawn_from_those_of_a_file(tmp_path: Path, generator: torch.Generator) -> None:
    samples = torch.randn(5, SPACE.size, generator=generator, dtype=torch.float64)
    np.savez(tmp_path / "errors.npz", perturbation=samples.numpy())
    drawn = perturbation_of({"kind": "samples", "file": str(tmp_path / "errors.npz")}).draw(SPACE, 40, generator)
    assert {tuple(row) for row in drawn.tolist()} == {tuple(row) for row in samples.tolist()}


def test_samples_of_another_pose_space_are_refused(generator: torch.Generator) -> None:
    few = SampledPerturbation(samples=torch.ones(3, 4, dtype=torch.float64))
    with pytest.raises(InputError, match=r"perturbation.samples: expected 26 numbers a sample, .* got 4"):
        few.draw(SPACE, 2, generator)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kind": "cauchy"}, "perturbation.kind: expected uniform, gaussian, or samples with file, got 'cauchy'"),
        ({"kind": "gaussian", "angle": 3}, "perturbation: expected keys of angle_deg, .*, got 'angle'"),
        ({"kind": "gaussian", "correlation": 2}, "perturbation.correlation: expected 0 to 1, got 2"),
        ({"kind": "uniform", "angle_deg": "wide"}, "perturbation.angle_deg: expected a number, got 'wide'"),
    ],
)
def test_what_yaml_may_not_say(given: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        perturbation_of(given)
