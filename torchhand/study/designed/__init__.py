"""Studies that people design themselves: factors, a design, and what becomes of registration in every cell."""

from torchhand.study.designed.designs import Between, Design, Full, LatinHypercube, OneAtATime
from torchhand.study.designed.factor import Choice, Factor, Number
from torchhand.study.designed.factors import FACTORS
from torchhand.study.designed.perturbations import (
    GaussianPerturbation,
    Perturbation,
    SampledPerturbation,
    UniformPerturbation,
)
from torchhand.study.designed.study import Study, load_study
from torchhand.study.designed.table import CellRow, printed_table
from torchhand.study.designed.trial import Trial
from torchhand.study.designed.work import DesignedResults, run_study

__all__ = [
    "FACTORS",
    "Between",
    "CellRow",
    "Choice",
    "Design",
    "DesignedResults",
    "Factor",
    "Full",
    "GaussianPerturbation",
    "LatinHypercube",
    "Number",
    "OneAtATime",
    "Perturbation",
    "SampledPerturbation",
    "Study",
    "Trial",
    "UniformPerturbation",
    "load_study",
    "printed_table",
    "run_study",
]
