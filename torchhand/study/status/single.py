"""The model by which a hand in a single picture is believed, fitted to photographs with hands and without."""

import fnmatch
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.files import read_picture
from torchhand.geometry import assumed_camera
from torchhand.image import reduced_mask
from torchhand.study.quality import fitted
from torchhand.track import View
from torchhand.track.scene import SilhouetteComparison
from torchhand.track.single import EVIDENCE, HandOdds, SinglePoseFitter, counted

RATES = (0.01, 0.02, 0.05, 0.1)
"""Shares of pictures without a hand in which one is believed, for which log odds are told."""
_RIGHT = 0.8  # intersection over union with the hand from which on a registered one is the right one
_CHECK_SIDE_PX = 320
_MIN_PICTURES = 10  # with hands and without


@dataclass(frozen=True, kw_only=True)
class WeighedPicture:
    """All hands that were weighed in one picture."""

    name: str
    evidence: Float[Tensor, "hands evidence"]
    overlap: Float[Tensor, "hands"]
    """With the hand that the picture shows; NaN where it shows none."""
    has_hand: bool
    """Whether the picture shows one."""


def weighed_pictures(
    fitter: SinglePoseFitter, pictures: Sequence[tuple[Path, Path | None]]
) -> Iterator[WeighedPicture]:
    """Pictures and the masks of their hands, None for those without a hand.

    Raises InputError where one cannot be read.
    """
    for path, mask_path in pictures:
        image = read_picture(path)
        camera = assumed_camera(int(image.shape[1]), int(image.shape[0]))
        found, seen_by = fitter.hypotheses(View(image=image), camera)
        overlap = torch.full((len(found),), torch.nan, dtype=torch.float64)
        if mask_path is not None:
            mask = reduced_mask(read_picture(mask_path).amax(-1) > 127, seen_by.height, seen_by.width).to(fitter.device)
            for row, one in enumerate(found):
                compare = SilhouetteComparison(fitter.kinematics, (seen_by,), one.hand.shape, side_px=_CHECK_SIDE_PX)
                overlap[row] = compare.overlaps(one.hand.pose, (mask,))[0]
        rows = [one.evidence for one in found]
        evidence = torch.stack(rows) if rows else torch.zeros(0, len(EVIDENCE), dtype=torch.float64)
        yield WeighedPicture(name=path.name, evidence=evidence, overlap=overlap, has_hand=mask_path is not None)


def evidence_table(pictures: Sequence[WeighedPicture], held_out: Sequence[str]) -> dict[str, Any]:
    """The model for evidence.json, fitted to pictures whose names match none of some patterns, and its figures on those
    and on the others.

    fitted, held_out: for log odds that so large a share of the fitted pictures without a hand reaches, the share of
    pictures without one, and of photographs of hands, in which a hand is believed; and of the believed ones the share
    whose overlap with the hand is below 0.75. Raises ValueError where too few pictures show a hand or none.
    """
    own = [one for one in pictures if not _matches(one.name, held_out)]
    evidence = torch.cat([torch.zeros(0, len(EVIDENCE), dtype=torch.float64), *(one.evidence for one in own)])
    is_right = torch.cat([torch.zeros(0, dtype=torch.float64), *(one.overlap for one in own)]) >= _RIGHT
    without = [one for one in own if not one.has_hand]
    if int(is_right.sum()) < _MIN_PICTURES or len(without) < _MIN_PICTURES:
        got = f"{int(is_right.sum())} right hands and {len(without)} pictures without a hand"
        raise ValueError(f"expected {_MIN_PICTURES} of each or more to fit a model to, got {got}")
    usual = evidence[is_right].nanmedian(0).values
    model = fitted(counted(evidence, usual), is_right)
    odds = HandOdds(model=model, usual=usual)
    best = torch.tensor([_best(one, odds)[0] for one in without], dtype=torch.float64)
    thresholds = {rate: float(torch.quantile(best, 1 - rate)) for rate in RATES}
    groups = {"fitted": own, "held_out": [one for one in pictures if _matches(one.name, held_out)]}
    return {
        "bias": round(model.bias, 4),
        "weights": {name: round(float(w), 4) for name, w in zip(EVIDENCE, model.weights, strict=True)},
        "usual": {name: round(float(u), 4) for name, u in zip(EVIDENCE, usual, strict=True)},
        "overlap": {name: _overlaps(group, odds) for name, group in groups.items()},
        **{
            name: {
                str(rate): {"log_odds": round(at, 3), **_believed(group, odds, at)} for rate, at in thresholds.items()
            }
            for name, group in groups.items()
        },
    }


def _matches(name: str, patterns: Sequence[str]) -> bool:
    return any(fnmatch.fnmatch(name, pattern) for pattern in patterns)


def _best(one: WeighedPicture, odds: HandOdds) -> tuple[float, float]:
    """The greatest log odds in a picture, and the overlap of that hand; minus infinity and 0 where there is none."""
    if not len(one.evidence):
        return -math.inf, 0.0
    told = [odds(row) for row in one.evidence]
    row = max(range(len(told)), key=told.__getitem__)
    return told[row], float(one.overlap[row])


def _overlaps(pictures: Sequence[WeighedPicture], odds: HandOdds) -> dict[str, Any]:
    """Of the likeliest hand in each picture that shows one, believed or not."""
    overlap = torch.tensor([_best(one, odds)[1] for one in pictures if one.has_hand], dtype=torch.float64)
    return {"pictures": len(overlap), "median": _median(overlap), "below_0.75": _share(overlap < 0.75)}


def _believed(pictures: Sequence[WeighedPicture], odds: HandOdds, at: float) -> dict[str, Any]:
    told, overlap = (
        torch.tensor([_best(one, odds) for one in pictures if one.has_hand], dtype=torch.float64).reshape(-1, 2).T
    )
    is_believed = told >= at
    empty = torch.tensor([_best(one, odds)[0] for one in pictures if not one.has_hand], dtype=torch.float64)
    return {
        "pictures": [len(told), len(empty)],
        "hands": _share(is_believed),
        "without": _share(empty >= at),
        "below_0.75": _share(overlap[is_believed] < 0.75),
    }


def _share(hits: Bool[Tensor, "n"]) -> float | None:
    return round(float(hits.double().mean()), 3) if len(hits) else None


def _median(values: Float[Tensor, "n"]) -> float | None:
    return round(float(values.median()), 3) if len(values) else None
