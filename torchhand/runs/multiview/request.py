"""What a run on several cameras is asked for."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from torchhand.files import FittedHand
from torchhand.hand import Side
from torchhand.track.multiview import MultiViewSettings


@dataclass(frozen=True, kw_only=True)
class RigRequest:
    """What a run on several cameras is asked for."""

    settings: MultiViewSettings
    config: str
    side: Side = "right"
    hand: FittedHand | None = None
    cameras: Path | None = None
    unit: str | None = None
    """`hand`: to be fitted."""
    masks: bool | None = None
    """Silhouettes are given; None: where the rig holds them."""
    background: Path | None = None
    offsets: Mapping[str, int] = field(default_factory=dict)
    start: int = 0
    max_frames: int | None = None
    resume: bool = False
    overwrite: bool = False
    has_overlay: bool = True
