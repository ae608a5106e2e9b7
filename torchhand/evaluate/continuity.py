"""How long a hand was followed, and how soon it was found again."""

from collections.abc import Sequence
from dataclasses import dataclass

FOLLOWED = ("tracked", "recovered")
NOT_FOLLOWED = ("lost", "no_hand")


@dataclass(frozen=True, kw_only=True)
class Continuity:
    """Counted in processed frames, from the statuses that the tracker gave itself."""

    frames: int
    followed: int
    """Frames with a hand: status tracked or recovered."""
    frames_until_first_loss: int | None
    """Frames from the first followed one to the first loss; None if the hand was never lost after it (or never
    found)."""
    losses: int
    """Stretches without a hand after the first followed frame, however short."""
    frames_to_recover: tuple[int, ...]
    """Length of each loss that ended; the last, unended one (if any) is missing here."""


def continuity(status: Sequence[str]) -> Continuity:
    """Losses and recoveries in a sequence of `tracked`, `lost`, `recovered` and `no_hand`.

    Raises:
        ValueError: an unknown status.
    """
    unknown = sorted(set(status) - set(FOLLOWED) - set(NOT_FOLLOWED))
    if unknown:
        raise ValueError(f"status: expected one of {', '.join(FOLLOWED + NOT_FOLLOWED)}, got {unknown[0]!r}")
    is_followed = [value in FOLLOWED for value in status]
    since_start = is_followed[is_followed.index(True) :] if any(is_followed) else []
    gaps: list[int] = []
    length = 0
    losses = 0
    for is_here in since_start:
        if is_here and length:
            gaps.append(length)
            length = 0
        elif not is_here:
            losses += length == 0
            length += 1
    return Continuity(
        frames=len(status),
        followed=sum(is_followed),
        frames_until_first_loss=since_start.index(False) if False in since_start else None,
        losses=losses,
        frames_to_recover=tuple(gaps),
    )
