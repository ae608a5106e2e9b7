"""How well registration recovers a hand: thousands of perturbed starts on pictures whose hand is known."""

from torchhand.study.hypotheses.case_study import CaseStudy, StudyBatch, study_priors
from torchhand.study.hypotheses.cases import Given, cases_of, frames_of
from torchhand.study.hypotheses.folder import CSV_NAME, NPZ_NAME, PICTURE_NAME, StudyFolder, save_study
from torchhand.study.hypotheses.proportions import quantile_with_failures, wilson_interval
from torchhand.study.hypotheses.record import STATUS_NAMES, Hypotheses
from torchhand.study.hypotheses.running import run_batches
from torchhand.study.hypotheses.settings import STUDY_SPACES, HypothesisStudySettings, SurfaceName, with_iterations
from torchhand.study.hypotheses.simulated import SimulatedHand, simulated_hand
from torchhand.study.hypotheses.table import printed_table, study_rows
from torchhand.study.hypotheses.work import Work

__all__ = [
    "CSV_NAME",
    "NPZ_NAME",
    "PICTURE_NAME",
    "STATUS_NAMES",
    "STUDY_SPACES",
    "CaseStudy",
    "Given",
    "Hypotheses",
    "HypothesisStudySettings",
    "SimulatedHand",
    "StudyBatch",
    "StudyFolder",
    "SurfaceName",
    "Work",
    "cases_of",
    "frames_of",
    "printed_table",
    "quantile_with_failures",
    "run_batches",
    "save_study",
    "simulated_hand",
    "study_priors",
    "study_rows",
    "wilson_interval",
    "with_iterations",
]
