"""Crops of a recording, with what a detector and the colours of skin say of them: nobody has labelled them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files import open_source, read_detections
from torchhand.geometry import assumed_camera
from torchhand.hand import Side
from torchhand.image import bootstrap_skin, hand_region
from torchhand.learn.pictures.cutting import (
    SHARE,
    cut,
    mirrored_intrinsics,
    moved_intrinsics,
    moved_points,
    window_about,
)

_REGION_PX = 160
_REGION_SHARE = 0.4
_WRIST, _KNUCKLE = 0, 9
_SHARES, _SHIFT = (0.6, 0.9), 0.1


@dataclass(frozen=True, kw_only=True)
class RecordedCrops:
    """Crops of right hands, or of left ones in the mirror."""

    image: UInt8[Tensor, "crops side side 3"]
    intrinsics: Float[Tensor, "crops 3 3"]
    points_px: Float[Tensor, "crops 21 2"]
    """Detected points in the crop; NaN where there is none."""
    mask: Float[Tensor, "crops side side"]
    """Share of each pixel that has the colour of skin."""
    known: Bool[Tensor, "crops side side"]
    """Where the mask tells of the hand: not beyond the wrist, and nowhere where no skin was found."""
    scale: Float[Tensor, "crops"]
    """Pixels of the crop for one of the recording."""
    frame: Int[Tensor, "crops"]

    def __len__(self) -> int:
        return len(self.image)


def recorded_crops(
    recording: Path,
    points: Path,
    frames: range,
    *,
    views: int = 0,
    generator: torch.Generator | None = None,
    side: Side | None = None,
    tick: Callable[[int], object] = lambda count: None,
) -> RecordedCrops:
    """Crops of frames of a recording in which a detector saw a hand.

    points: file with the detections (`read_detections`). views: crops of each frame, of random size and place; 0 makes
    one that follows from the points alone. side: which hand; as the file tells if None. tick: is told of each frame.

    Raises InputError for files of another kind, and where no frame has a hand.
    """
    found = read_detections(points, side=side, points="picture")
    if found.picture is None:
        raise InputError(f"{points}: expected points in pictures; it has none")
    is_left = (side or found.side) == "left"
    rows = {int(number): row for row, number in enumerate(found.frame)}
    crops: list[dict[str, Tensor]] = []
    with open_source(recording, start=frames.start, max_frames=len(frames)) as source:
        size = (source.width, source.height)
        intrinsics = assumed_camera(*size, dtype=torch.float32).intrinsics
        for frame in source:
            row = rows.get(frame.index)
            if row is not None and frame.image is not None and np.isfinite(found.picture[row]).all():
                seen = torch.from_numpy(found.picture[row]).float()
                seen = seen * torch.tensor(size) - 0.5 if found.is_normalised else seen
                own = _crops(frame.image.numpy(), seen, intrinsics, views, generator)
                crops += [one | {"frame": torch.tensor(frame.index)} for one in own]
            tick(1)
    if not crops:
        raise InputError(f"{points}: expected a hand in some of the frames {frames.start} to {frames.stop - 1}; none")
    stacked = {name: torch.stack([one[name] for one in crops]) for name in crops[0]}
    return _mirrored(stacked) if is_left else RecordedCrops(**stacked)


def _crops(
    image: np.ndarray, points: Tensor, intrinsics: Tensor, views: int, generator: torch.Generator | None
) -> list[dict[str, Tensor]]:
    """Crops of one frame; the colours of skin are learned about the hand."""
    wide = window_about(points, share=_REGION_SHARE)
    region = cut(image, wide, _REGION_PX)
    points, intrinsics = moved_points(points, wide, _REGION_PX), moved_intrinsics(intrinsics, wide, _REGION_PX)
    skin = bootstrap_skin(torch.from_numpy(region)).mask
    side = hand_region((_REGION_PX, _REGION_PX), points[_WRIST], points[_KNUCKLE])
    done = []
    for _ in range(max(1, views)):
        share, shift = SHARE, None
        if views:
            uniform = torch.rand(3, generator=generator)
            share = _SHARES[0] + (_SHARES[1] - _SHARES[0]) * float(uniform[0])
            shift = _SHIFT * (2 * uniform[1:] - 1)
        window = window_about(points, share=share, shift=shift)
        shares, known = (torch.from_numpy(cut(x.numpy().astype(np.uint8) * 255, window)) for x in (skin, side))
        done.append(
            {
                "image": torch.from_numpy(cut(region, window)),
                "intrinsics": moved_intrinsics(intrinsics, window),
                "points_px": moved_points(points, window),
                "mask": shares.float() / 255,
                "known": (known > 127) & bool(skin.any()),
                "scale": torch.tensor(len(shares) / window[2] * _REGION_PX / wide[2]),
            }
        )
    return done


def _mirrored(stacked: dict[str, Tensor]) -> RecordedCrops:
    """Crops of left hands as those of right ones."""
    side = stacked["image"].shape[1]
    pixels = {name: stacked[name].flip(2) for name in ("image", "mask", "known")}
    points = stacked["points_px"] * torch.tensor((-1.0, 1.0)) + torch.tensor((side - 1.0, 0.0))
    intrinsics = torch.stack([mirrored_intrinsics(one, side) for one in stacked["intrinsics"]])
    return RecordedCrops(**{**stacked, **pixels, "points_px": points, "intrinsics": intrinsics})
