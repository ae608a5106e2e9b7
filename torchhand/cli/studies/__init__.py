"""What is a word of `torchhand study`: the studies `ueda` and `design`, and `export`."""

from torchhand.cli.studies.design import DESIGN, study_design
from torchhand.cli.studies.export import EXPORT, study_export
from torchhand.cli.studies.ueda import UEDA, study_ueda

__all__ = ["DESIGN", "EXPORT", "UEDA", "study_design", "study_export", "study_ueda"]
