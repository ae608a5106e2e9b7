"""One result as a report takes it: the track, the hand it belongs to, and what was assumed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files import Track, load_hand, load_hand_model, load_track, setting_in
from torchhand.files.disk import expanded
from torchhand.files.pictures import ASSUMED_FPS
from torchhand.files.results import CONFIG_NAME, HAND_NAME, OVERLAY_NAME
from torchhand.hand import DOFS, HandModel, Side


@dataclass(frozen=True, kw_only=True)
class Result:
    """A track with everything that a report tells of it."""

    name: str
    track: Track
    model: HandModel
    side: Side
    shape: Float64[Tensor, "shape"]
    """Proportions of the hand."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """How the proportions were found, as hand.json tells."""
    run: Mapping[str, Any] = field(default_factory=dict)
    """What was asked for, as config.yaml tells; empty where there is none."""
    overlay: Path | None = None
    """The video with the hand drawn over it, if there is one."""

    @property
    def fps(self) -> float:
        """Frames per second; an assumed rate where the track tells none."""
        return self._told_fps or ASSUMED_FPS

    @property
    def has_assumed_fps(self) -> bool:
        return self._told_fps is None

    @property
    def _told_fps(self) -> float | None:
        made_with = self.track.header.get("made_with")
        told = made_with.get("frames_per_second") if isinstance(made_with, Mapping) else None
        return float(told) if isinstance(told, int | float) and told > 0 else None


def load_result(path: str | Path, *, track: Track | None = None, name: str | None = None) -> Result:
    """The result in a folder of `track`, `track_multiview` or `fit_keypoints`, or that of a file in such a folder.

    track: where it was read already. name: in place of the folder's.

    Raises InputError naming the file and what is wrong with it.
    """
    path = expanded(path)
    folder = path if path.is_dir() else path.parent
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    track = load_track(path) if track is None else track
    if track.image is not None and not (folder / HAND_NAME).is_file():
        raise InputError(f"{path}: expected the track of one hand, got single pictures with a hand each")
    if tuple(track.dof_names) != DOFS:
        raise InputError(f"{path}: dof_names: expected the {len(DOFS)} of this version's hand, got others")
    if not len(track):
        raise InputError(f"{path}: expected a track with frames, got one without any")
    model = load_hand_model()
    hand = load_hand(folder / HAND_NAME, model.shape_space.names)
    if (tracked := track.header.get("side", hand.side)) != hand.side:
        raise InputError(f"{path}: expected a {hand.side} hand as in {HAND_NAME}, got a {tracked} one")
    config, overlay = folder / CONFIG_NAME, folder / OVERLAY_NAME
    run = setting_in(config, "run") if config.is_file() else {}
    return Result(
        name=name or folder.resolve().name,
        track=track,
        model=model,
        side=cast(Side, hand.side),
        shape=torch.tensor(list(hand.values.values()), dtype=torch.float64),
        provenance=hand.provenance,
        run=run if isinstance(run, Mapping) else {},
        overlay=overlay if overlay.is_file() else None,
    )
