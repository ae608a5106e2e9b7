"""A study is the same from Python and from YAML, cells carry the factors' values, and mistakes are named."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from torchhand.errors import InputError
from torchhand.files import configs_dir
from torchhand.study.designed import FACTORS, Between, GaussianPerturbation, LatinHypercube, Study, Trial, load_study

YAML = """
factors:
  observation: [outline, points]
  blur_px: {low: 0, high: 6}
  hypotheses: {low: 1, high: 8}
  perturbation:
    - {kind: gaussian, angle_deg: 6, correlation: 0.5}
    - {kind: uniform}
design: {latin_hypercube: 6}
crossed: observation
fixed: {occlusion: 0.1}
trials: 12
pictures: 3
seed: 4
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "study.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_yaml_says_what_python_says(tmp_path: Path) -> None:
    own = Study(
        factors={
            "observation": ["outline", "points"],
            "blur_px": Between(0, 6),
            "hypotheses": Between(1, 8),
            "perturbation": [GaussianPerturbation(angle_deg=6.0, correlation=0.5), {"kind": "uniform"}],
        },
        design=LatinHypercube(6),
        crossed="observation",
        fixed={"occlusion": 0.1},
        trials=12,
        pictures=3,
        seed=4,
    )
    assert load_study(written(tmp_path, YAML)).described() == own.described()
    for cell in own.cells:
        assert isinstance(cell.trial.hypotheses, int)
        assert cell.trial.occlusion == 0.1
        assert all(getattr(cell.trial, name) == value for name, value in cell.values.items())


def test_half_the_frame_rate_is_twice_the_perturbation() -> None:
    study = Study(factors={"frame_rate": [30, 15]}, fixed={"perturbation_size": 0.7})
    assert [cell.trial.scale for cell in study.cells] == [0.7, 1.4]


@dataclass(frozen=True)
class Dusk:
    """A factor that changes two things at once."""

    def value(self, given: Any) -> float:
        return float(given)

    def apply(self, trial: Trial, value: Any) -> Trial:
        return replace(trial, ambient=0.45 * (1 - value), noise=2 + 20 * value)


def test_a_factor_of_ones_own_is_one_class() -> None:
    study = Study(factors={"dusk": [0, 0.5]}, kinds={**FACTORS, "dusk": Dusk()})
    assert [(cell.trial.ambient, cell.trial.noise) for cell in study.cells] == [(0.45, 2.0), (0.225, 12.0)]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("blur_px:", "blur:", r"factors: blur: unknown \(did you mean blur_px\?\); allowed: .*, camera_turn_deg, "),
        ("high: 6", "high: 600", "blur_px: expected a number, 0 to 50, got 600"),
        ("[outline, points]", "[outline, depth]", "observation: expected one of contour, .* got 'depth'"),
        ("trials: 12", "trials: 2", "pictures: expected 1 to 2, got 3"),
        ("trials: 12", "trials: many", "trials: expected .*'many'"),
        ("seed: 4", "seeds: 4", r"seeds: unknown key \(did you mean seed\?\); allowed: factors, "),
        ("crossed: observation", "crossed: noise", "crossed: expected one of observation, .* got 'noise'"),
        ("occlusion: 0.1", "blur_px: 1", "fixed: expected no factor that is varied, got 'blur_px'"),
        ("design: {latin_hypercube: 6}", "design: full", "blur_px: expected levels"),
        (
            "design: {latin_hypercube: 6}",
            "design: {latin_hypercube: 0}",
            "latin_hypercube: expected 1 to 100000, got 0",
        ),
    ],
)
def test_mistakes_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_study(written(tmp_path, YAML.replace(old, new)))


@pytest.mark.parametrize("path", sorted((configs_dir() / "studies").glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_studies_load(path: Path) -> None:
    """With every level of every factor in some cell."""
    study, content = load_study(path), yaml.safe_load(path.read_text(encoding="utf-8"))
    for name, levels in content["factors"].items():
        assert {cell.values[name] for cell in study.cells} == set(levels)
