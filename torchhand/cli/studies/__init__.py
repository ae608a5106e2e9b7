"""Studies that are a word of `torchhand study`: `torchhand study ueda`, `torchhand study design`."""

from torchhand.cli.studies.design import DESIGN, study_design
from torchhand.cli.studies.ueda import UEDA, study_ueda

__all__ = ["DESIGN", "UEDA", "study_design", "study_ueda"]
