"""Which evidence tells fingers that are right from those that are not, on simulated hands."""

from torchhand.study.quality.calibration import calibrated, figures, fitted
from torchhand.study.quality.collect import FingerSample, collect, collect_rigs, collect_single

__all__ = ["FingerSample", "calibrated", "collect", "collect_rigs", "collect_single", "figures", "fitted"]
