"""Entropy coding of integers: a range coder, and steps of a sequence coded with it."""

from torchhand.numerics.coding.step_coder import decode_rows, encode_rows, followed

__all__ = [
    "decode_rows",
    "encode_rows",
    "followed",
]
