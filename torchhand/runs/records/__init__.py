"""From estimates to the records that a result folder holds: of one frame, and of two passes over all of them."""

from torchhand.runs.records.joined import (
    EVIDENCE,
    EVIDENCE_BEFORE,
    IS_NEW,
    IS_SURE,
    TwoPasses,
    joined_records,
)
from torchhand.runs.records.record import MEASURES, record_of, undetermined_fingers
from torchhand.runs.records.widened import widened

__all__ = [
    "EVIDENCE",
    "EVIDENCE_BEFORE",
    "IS_NEW",
    "IS_SURE",
    "MEASURES",
    "TwoPasses",
    "joined_records",
    "record_of",
    "undetermined_fingers",
    "widened",
]
