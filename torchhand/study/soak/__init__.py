"""Filters kept running on measurements that no camera should ever give them."""

from torchhand.study.soak.filters import KINDS, SoakResult, SoakSettings, soak_filters

__all__ = ["KINDS", "SoakResult", "SoakSettings", "soak_filters"]
