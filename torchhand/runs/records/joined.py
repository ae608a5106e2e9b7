"""One track from the two passes over a recording."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.files import FrameRecord, FrameStatus, Track
from torchhand.fit.hull import palm_of
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics
from torchhand.track import ONE_PLACE_M, HandPath, PosedHand, combined_hand, path_weights

EVIDENCE, EVIDENCE_BEFORE, IS_NEW, IS_SURE = "evidence", "evidence_before", "is_new", "is_sure"
"""Measures of the second pass alone: how far the views bear out its hand and that of the first pass, nats; whether the
hand was found otherwise than by following it; whether so much is explained that there is one."""

_APART_M = 0.020  # mean distance of keypoints beyond which the hand that is followed back is not the one of the track
_MAX_UNSURE = 3  # frames in a row in which that hand may be borne out less
_OPEN_M, _AROUND = 0.008, 8
"""Mean distance of keypoints, their common shift left out, beyond which two passes tell different hands; and frames
before and after these that another pass begins and ends with."""
_DROP = 0.15  # overlap by which a hand that fills a loss may have less than where the loss ends


@dataclass(frozen=True, kw_only=True)
class TwoPasses:
    """The same frames in both passes, row by row."""

    forward: Track
    backward: Track
    """NaN where the second pass did not look or had no hand."""
    begins_at: int = 0
    """Number of the frame from which on the first pass looked for a hand: those before it say nothing against one."""

    @classmethod
    def of(cls, forward: Track, backward: Track, *, begins_at: int = 0) -> "TwoPasses":
        """backward: any of the frames, in their order."""
        rows = {int(frame): row for row, frame in enumerate(backward.frame)}
        places = [rows.get(int(frame), -1) for frame in forward.frame]
        known = np.array(places) >= 0
        arrays: dict[str, np.ndarray] = {}
        for name in ("pose", "pose_std", "keypoints3d", "keypoints3d_cov", "finger_quality", "seconds"):
            values = getattr(backward, name)
            if values is not None:
                arrays[name] = values[places]
                arrays[name][~known] = 0.0 if name == "seconds" else np.nan
        measures = {name: np.where(known, values[places], np.nan) for name, values in backward.measures.items()}
        unused: dict[str, Any] = {"keypoints2d": None, "reason": None}
        own = {"frame": forward.frame, "time_s": forward.time_s, "status": forward.status, "measures": measures}
        return cls(forward=forward, backward=replace(backward, **own, **unused, **arrays), begins_at=begins_at)

    @property
    def has_hands(self) -> tuple[Bool[np.ndarray, " t"], Bool[np.ndarray, " t"]]:
        """Forwards and backwards."""
        return self.forward.has_hand, self.backward.has_hand

    def is_open(self, among: Bool[np.ndarray, " t"]) -> Bool[np.ndarray, " t"]:
        """Of some frames those in which the passes tell different hands, or one of them none, and those about them."""
        missed = self.forward.keypoints3d - self.backward.keypoints3d
        apart = np.linalg.norm(missed - missed.mean(1, keepdims=True), axis=-1).mean(-1)
        was, then = self.has_hands
        differ = (was | then) & ~(apart <= _OPEN_M) & among
        return among & (np.convolve(differ, np.ones(2 * _AROUND + 1), "full")[_AROUND : _AROUND + len(differ)] > 0)

    def weights(self) -> Float[Tensor, "t 2"]:
        """How far each pass is believed; 0 for both where there is no hand.

        A hand that the first pass has lost is one of the second where the views bear it out in every frame up to the
        loss's end, and it is the one that is tracked there.
        """
        was, then = self.has_hands
        both = was & then
        evidence = [
            np.where(both, self.backward.measures.get(name, np.full(len(was), np.nan)), 0.0)
            for name in (EVIDENCE_BEFORE, EVIDENCE)
        ]
        paths = [
            HandPath(keypoints=torch.from_numpy(track.keypoints3d), evidence=torch.from_numpy(nats))
            for track, nats in zip((self.forward, self.backward), evidence, strict=True)
        ]
        weights = path_weights(paths)
        weights[torch.from_numpy(~was & ~self._fills(weights))] = 0.0
        return weights

    def _fills(self, weights: Float[Tensor, "t 2"]) -> Bool[np.ndarray, " t"]:
        """Frames that the first pass has lost, and in which the hand of the second one is borne out; or that lie, a few
        in a row, between such frames or, where they are explained as well, before one that has a hand."""
        was, then = self.has_hands
        overlap = self.backward.measures.get("overlap", np.full(len(was), np.nan))
        is_sure = self.backward.measures.get(IS_SURE, np.zeros(len(was))) > 0
        is_sure |= self.forward.frame < self.begins_at
        is_new = self.backward.measures.get(IS_NEW, np.ones(len(was))) > 0
        fills = np.zeros(len(was), dtype=bool)
        least, unsure = math.inf, list[int]()
        for row in range(len(was) - 2, -1, -1):
            if was[row] or not then[row] or not then[row + 1]:
                if was[row]:
                    fills[unsure] = overlap[unsure] >= least
                unsure = []
                continue
            if was[row + 1]:
                is_same = bool(weights[row + 1, 1] > 0.5) or self._between_passes(row + 1) < _APART_M
                least = overlap[row + 1] - _DROP if is_same else math.inf
            # A followed hand that is tilted anew, or gets other fingers, is the same one.
            is_connected = not is_new[row] or self._to_next(row) < ONE_PLACE_M
            if not is_connected or not (was[row + 1] or fills[row + 1] or unsure):
                least, unsure = math.inf, []
            elif is_sure[row] and overlap[row] >= least:
                fills[[row, *unsure]] = True
                unsure = []
            elif len(unsure) < _MAX_UNSURE:
                unsure.append(row)
            else:
                least, unsure = math.inf, []
        return fills

    def _between_passes(self, row: int) -> float:
        """Metres between the hands of both passes in one frame, in the mean over the keypoints."""
        missed = self.forward.keypoints3d[row] - self.backward.keypoints3d[row]
        return float(np.linalg.norm(missed, axis=-1).mean())

    def _to_next(self, row: int) -> float:
        """Metres from the palm of the second pass in one frame to that in the frame after."""
        here, after = palm_of(torch.from_numpy(self.backward.keypoints3d[row : row + 2]))
        return float((after - here).norm())


def joined_records(
    passes: TwoPasses, kinematics: HandKinematics, shape: Float[Tensor, "shape"], camera: Camera | None
) -> Iterator[FrameRecord]:
    """The records of all frames. camera: that of the pictures; None where there are several.

    `seconds` is the time of both passes; measures and qualities are means of both as the passes are believed.
    """
    was, then = passes.has_hands
    weights = passes.weights()
    has_hand = (weights.sum(1) > 0).numpy()
    statuses = joined_status(passes.forward.status.tolist(), was, has_hand)
    for row, status in enumerate(statuses):
        forward, seconds = passes.forward, float(passes.forward.seconds[row] + passes.backward.seconds[row])
        if not then[row] or not has_hand[row]:
            yield _unchanged(forward, row, status, seconds)
            continue
        sides = [(passes.forward, was[row]), (passes.backward, True)]
        used = [(track, float(weight)) for (track, there), weight in zip(sides, weights[row], strict=True) if there]
        share = torch.tensor([weight for _, weight in used], dtype=torch.float64)
        hand = combined_hand([_hand(track, row) for track, _ in used], share, kinematics, shape)
        yield FrameRecord(
            frame=int(forward.frame[row]),
            time_s=_time_of(forward, row),
            status=status,
            pose=hand.pose.numpy(),
            pose_std=hand.pose_std.numpy(),
            keypoints3d=hand.keypoints.numpy(),
            keypoints3d_cov=hand.keypoints_cov.numpy(),
            keypoints2d=None if camera is None else camera.project(hand.keypoints).numpy(),
            seconds=seconds,
            finger_quality=_mean_of_fingers([(one.finger_quality, row, w) for one, w in used]),
            measures={name: _mean([(one.measures[name][row], w) for one, w in used]) for name in forward.measures},
            reason="",
        )


def joined_status(
    status: list[FrameStatus], was: Bool[np.ndarray, " t"], has_hand: Bool[np.ndarray, " t"]
) -> list[FrameStatus]:
    """Statuses once losses are filled: a hand is recovered where none is in the frame before and one was earlier.

    status, was: of the first pass, and where it has a hand.
    """
    found: list[FrameStatus] = []
    for row, own in enumerate(status):
        is_after_loss = row > 0 and not has_hand[row - 1]
        if not has_hand[row]:
            found.append(own)
        elif was[row]:
            found.append("tracked" if own == "recovered" and not is_after_loss else own)
        else:
            found.append("recovered" if is_after_loss and bool(has_hand[:row].any()) else "tracked")
    return found


def _time_of(track: Track, row: int) -> float | None:
    return None if track.time_s is None else float(track.time_s[row])


def _unchanged(track: Track, row: int, status: FrameStatus, seconds: float) -> FrameRecord:
    """The record of a row as it is, but for its status and time."""
    return FrameRecord(
        frame=int(track.frame[row]),
        time_s=_time_of(track, row),
        status=status,
        pose=track.pose[row],
        pose_std=track.pose_std[row],
        keypoints3d=track.keypoints3d[row],
        keypoints3d_cov=track.keypoints3d_cov[row],
        keypoints2d=None if track.keypoints2d is None else track.keypoints2d[row],
        seconds=seconds,
        finger_quality=None if track.finger_quality is None else track.finger_quality[row],
        measures={name: float(values[row]) for name, values in track.measures.items()},
        reason=None if track.reason is None else str(track.reason[row]),
    )


def _hand(track: Track, row: int) -> PosedHand:
    return PosedHand(
        pose=torch.from_numpy(track.pose[row]),
        pose_std=torch.from_numpy(track.pose_std[row]),
        keypoints=torch.from_numpy(track.keypoints3d[row]),
        keypoints_cov=torch.from_numpy(track.keypoints3d_cov[row]),
    )


def _mean_of_fingers(
    weighted: list[tuple[Float[np.ndarray, "t 5"] | None, int, float]],
) -> Float[np.ndarray, "5"] | None:
    """Of the rows of tracks that have qualities of fingers; None where none has."""
    known = [(values[row], weight) for values, row, weight in weighted if values is not None]
    if not known:
        return None
    fingers = range(len(known[0][0]))
    return np.array([_mean([(float(values[i]), weight) for values, weight in known]) for i in fingers])


def _mean(weighted: list[tuple[float, float]]) -> float:
    """Of the values that are known; NaN where none is."""
    known = [(float(value), weight) for value, weight in weighted if math.isfinite(value)]
    total = sum(weight for _, weight in known)
    return sum(value * weight for value, weight in known) / total if total > 0 else math.nan
