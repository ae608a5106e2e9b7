"""Entropy coding of integers: a range coder, and steps of a sequence coded with it."""

from torchhand.numerics.coding.step_coder import RowDecoder, RowEncoder, followed

__all__ = [
    "RowDecoder",
    "RowEncoder",
    "followed",
]
