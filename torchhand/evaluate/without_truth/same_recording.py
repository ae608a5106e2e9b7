"""Whether two results, or a result and a truth, tell of the same hand before the same cameras."""

from collections.abc import Collection
from dataclasses import dataclass

from torchhand.files import Track


@dataclass(frozen=True, kw_only=True)
class RecordingFacts:
    """What must agree where two tell of one recording; None where one does not tell it."""

    side: str | None
    frames: int | None
    sizes_px: Collection[tuple[int, int]] | None
    """Widths and heights of the cameras' pictures."""

    @classmethod
    def of_track(cls, track: Track) -> "RecordingFacts":
        """Of a result, as its header tells."""
        side = track.header.get("side")
        sizes = {(one.get("width"), one.get("height")) for one in track.cameras}
        known = {(width, height) for width, height in sizes if isinstance(width, int) and isinstance(height, int)}
        return cls(side=side if isinstance(side, str) else None, frames=len(track), sizes_px=known or None)


def differences(one: RecordingFacts, other: RecordingFacts) -> list[str]:
    """Parts of a sentence, such as "a right hand against a left one"; empty where nothing speaks against one recording.

    Cameras differ where no picture of one is as large as one of the other: a result of some cameras of a rig may be
    compared with that of all.
    """
    found = []
    if None not in (one.side, other.side) and one.side != other.side:
        found.append(f"a {one.side} hand against a {other.side} one")
    if None not in (one.frames, other.frames) and one.frames != other.frames:
        found.append(f"{one.frames} frames against {other.frames}")
    if one.sizes_px and other.sizes_px and set(one.sizes_px).isdisjoint(other.sizes_px):
        here, there = (
            " and ".join(f"{width}x{height}" for width, height in sorted(sizes))
            for sizes in (one.sizes_px, other.sizes_px)
        )
        found.append(f"pictures of {here} px against {there} px")
    return found
