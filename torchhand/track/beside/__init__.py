"""Searches in a process of their own, so that pictures that do not wait are followed at their own rate."""

from torchhand.track.beside.process import SearchBeside, opened_tracker

__all__ = ["SearchBeside", "opened_tracker"]
