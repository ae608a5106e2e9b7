"""The evaluation of Ueda et al. 2003 again: an index finger bent in a hull, and fits over numbers of cameras."""

from torchhand.study.ueda.bent import converge
from torchhand.study.ueda.cases import BentCase, open_recording, own_bent, recorded_bent, subject
from torchhand.study.ueda.compare import fit_errors
from torchhand.study.ueda.folder import PartsFolder
from torchhand.study.ueda.methods import METHODS
from torchhand.study.ueda.results import DEFAULT_STEPS, RESULT_NAMES, comparison_rows, printed, write_results
from torchhand.study.ueda.stages import STAGES, stage_times

__all__ = [
    "DEFAULT_STEPS",
    "METHODS",
    "RESULT_NAMES",
    "STAGES",
    "BentCase",
    "PartsFolder",
    "comparison_rows",
    "converge",
    "fit_errors",
    "open_recording",
    "own_bent",
    "printed",
    "recorded_bent",
    "stage_times",
    "subject",
    "write_results",
]
