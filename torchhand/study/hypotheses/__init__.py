"""How well registration recovers a hand: thousands of perturbed starts on pictures whose hand is known."""

from torchhand.study.hypotheses.case_study import CaseStudy, StudyBatch
from torchhand.study.hypotheses.cases import Given, cases_of, frames_of
from torchhand.study.hypotheses.folder import CSV_NAME, NPZ_NAME, PICTURE_NAME, StudyFolder
from torchhand.study.hypotheses.record import STATUS_NAMES, Hypotheses
from torchhand.study.hypotheses.settings import HypothesisStudySettings, SurfaceName, with_iterations
from torchhand.study.hypotheses.table import printed_table, study_rows
from torchhand.study.hypotheses.work import Work

__all__ = [
    "CSV_NAME",
    "NPZ_NAME",
    "PICTURE_NAME",
    "STATUS_NAMES",
    "CaseStudy",
    "Given",
    "Hypotheses",
    "HypothesisStudySettings",
    "StudyBatch",
    "StudyFolder",
    "SurfaceName",
    "Work",
    "cases_of",
    "frames_of",
    "printed_table",
    "study_rows",
    "with_iterations",
]
