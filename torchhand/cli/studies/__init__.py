"""Studies that are a word of `torchhand study`: `torchhand study ueda`."""

from torchhand.cli.studies.ueda import UEDA, study_ueda

__all__ = ["UEDA", "study_ueda"]
