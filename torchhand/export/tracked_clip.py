"""A result of tracking, or a fitted hand alone, as a clip: gaps held or cut, never written as NaN."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal, cast

import numpy as np
import torch

from torchhand.errors import InputError
from torchhand.export.clip import MISSING, MotionClip, Up, rest_clip
from torchhand.export.motion_files import MOTION_SUFFIXES, is_motion_file, load_motion
from torchhand.files import Track, load_hand, load_hand_model, load_track
from torchhand.files.disk import expanded, opened_arrays
from torchhand.files.pictures import ASSUMED_FPS
from torchhand.files.results import HAND_NAME, POSES_NAME
from torchhand.hand import DOFS, HandModel, Side

Gaps = Literal["hold", "cut"]
_MAX_FRAMES = 1_000_000
_MAX_RATE = 1e6


def load_clip(
    path: str | Path,
    *,
    gaps: Gaps = "hold",
    fps: float | None = None,
    hand: str | Path | None = None,
    up: Up | None = None,
    side: Side | None = None,
    model: HandModel | None = None,
) -> MotionClip:
    """The clip of a result folder, of a track.npz or track.jsonl with hand.json beside it, of a poses.npz of one hand
    (a single picture, or several fitted with one hand), of a hand.json alone, or of a motion in a file of another
    program (`load_motion`), with the proportions of `hand` or the default ones. A pose stream (.thp) has its own side,
    shape, fps and direction up.

    gaps: frames without an estimate repeat the last one before them ("hold"; those at the beginning the first after
        them) or are left out ("cut").
    fps: a rate to play the frames at; where it is not given, the track's own times and rate, else the rate that is
        assumed of pictures.
    hand: another file than the hand.json beside the track.
    up: which axis points up in the frame of the poses; where it is not given, what the file says, else -y of tracks.
    side: of the hand, where a file of another program does not tell it; a file that tells the other one is refused.

    Raises InputError naming the file and what is wrong with it; a track without a single estimate is refused.
    """
    path = expanded(path)
    model = model or load_hand_model()
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    clip = _loaded(path, model, gaps=gaps, fps=fps, hand=hand, up=up, side=side)
    if side is not None and clip.side != side:
        raise InputError(f"{path}: side: expected a {side} hand, got a {clip.side} one")
    return clip


def _loaded(
    path: Path,
    model: HandModel,
    *,
    gaps: Gaps,
    fps: float | None,
    hand: str | Path | None,
    up: Up | None,
    side: Side | None,
) -> MotionClip:
    """As `load_clip`; the side that the file tells, whichever is asked for."""
    if path.is_file() and is_motion_file(path):
        if hand is not None and path.suffix == ".thp":
            raise InputError(f"{path}: expected a track with another hand file, got a pose stream, which has its own")
        shape = None if hand is None else _hand_of(expanded(hand), model)[1]
        clip = load_motion(path, model, shape, side=side)
        clip = clip if up is None else replace(clip, up=up)
        return clip if fps is None else replace(clip, fps=fps, time_s=())
    if path.is_file() and path.suffix == ".json":
        if hand is not None:
            raise InputError(f"{path}: expected a track with another hand file, got a hand file itself")
        own, shape = _hand_of(path, model)
        return rest_clip(model, own, shape, name=_plain(path.stem), fps=fps or ASSUMED_FPS)
    if path.is_file() and path.suffix not in (".npz", ".jsonl"):
        raise InputError(
            f"{path}: expected a result folder, track.npz, track.jsonl, hand.json or a motion"
            f" ({', '.join(MOTION_SUFFIXES)}), got {path.suffix or path.name!r}"
        )
    folder = path if path.is_dir() else path.parent
    track = load_track(path)
    own_file = folder / HAND_NAME if hand is None else expanded(hand)
    if (folder / POSES_NAME).is_file() and not (folder / HAND_NAME).is_file():
        own, shape = _hand_of_pictures(folder / POSES_NAME, model)
        track = replace(track, header={**track.header, "side": own})
        own, shape = (own, shape) if hand is None else _hand_of(own_file, model)
    else:
        own, shape = _hand_of(own_file, model)
    clip = clip_of_track(track, model, shape, own, gaps=gaps, fps=fps, where=str(path))
    return replace(clip, name=_plain(folder.resolve().name), up=up or clip.up)


def clip_of_track(
    track: Track,
    model: HandModel,
    shape: torch.Tensor,
    side: Side,
    *,
    gaps: Gaps,
    fps: float | None = None,
    where: str = "track",
) -> MotionClip:
    """The clip of a track that was read already.

    Frames whose numbers the track leaves out are gaps as well. Times are the track's own, unless a rate is given.

    Raises InputError where the track has other DOFs, another side than the hand, or no estimate at all.
    """
    if tuple(track.dof_names) != DOFS:
        raise InputError(f"{where}: dof_names: expected the {len(DOFS)} of this version's hand, got others")
    if (tracked := track.header.get("side", side)) != side:
        raise InputError(f"{where}: expected a {side} hand as in the hand file, got a {tracked} one")
    is_known = np.isfinite(track.pose).all(-1)
    if not is_known.any():
        raise InputError(f"{where}: expected at least one tracked frame, got none in {len(track)} frames: all are lost")
    number, known = track.frame, np.flatnonzero(is_known)
    if not (np.diff(number) > 0).all():
        raise InputError(f"{where}: frame: expected increasing numbers, got others")
    if (span := int(number[-1] - number[0]) + 1) > _MAX_FRAMES:
        raise InputError(f"{where}: frame: expected numbers within {_MAX_FRAMES} of each other, got a span of {span}")
    if gaps == "cut":
        kept, frame = known, number[known]
    else:
        frame = np.arange(number[0], number[-1] + 1)
        kept = known[(np.searchsorted(number[known], frame, side="right") - 1).clip(0)]
    is_own = number[kept] == frame
    std = np.where(is_own[:, None], track.pose_std[kept], np.nan)
    quality = None
    if track.finger_quality is not None:
        quality = torch.from_numpy(np.where(is_own[:, None], track.finger_quality[kept], np.nan).astype(np.float64))
    cov = np.where(is_own[:, None, None, None], track.keypoints3d_cov[kept], np.nan)
    times = None if fps is not None or track.time_s is None else _times(number, track.time_s, frame)
    said = dict(zip(number.tolist(), track.status.tolist(), strict=True))
    return MotionClip(
        model=model,
        side=side,
        shape=shape,
        poses=torch.from_numpy(track.pose[kept].astype(np.float64)),
        fps=fps or _rate(track, number),
        time_s=() if times is None else tuple(times.tolist()),
        frame=tuple(int(f) for f in frame),
        held=tuple(int(f) for f in frame[~is_own]),
        pose_std=torch.from_numpy(std.astype(np.float64)),
        keypoints_cov=torch.from_numpy(cov.astype(np.float64)) if np.isfinite(cov).any() else None,
        finger_quality=quality,
        status=tuple(str(said.get(int(f), MISSING)) for f in frame),
    )


def _plain(name: str) -> str:
    """A file's name as text that every format can hold."""
    text = name.encode("utf-8", "replace").decode("utf-8")
    return "".join(letter if letter.isprintable() else "_" for letter in text) or "hand"


def _hand_of(path: Path, model: HandModel) -> tuple[Side, torch.Tensor]:
    space = model.shape_space
    fitted = load_hand(path, space.names)
    shape = torch.tensor([fitted.values[name] for name in space.names], dtype=torch.float64)
    try:
        space.check(shape)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    return cast(Side, fitted.side), shape


def _hand_of_pictures(file: Path, model: HandModel) -> tuple[Side, torch.Tensor]:
    """The hand of a single picture, or of several that were fitted with one. Raises InputError for several hands."""
    with opened_arrays(file, complaint="is no result of fit_pose that can be read") as stored:
        shapes, sides = stored["shape"], stored["side"]
        is_known = np.isfinite(shapes).all(1)
        shape, side = np.unique(shapes[is_known], axis=0), np.unique(sides[is_known])
        if tuple(stored["shape_names"].tolist()) != model.shape_space.names:
            raise InputError(f"{file}: shape_names: expected those of this version's hand, got others")
    if len(shape) != 1 or len(side) != 1:
        got = f"{is_known.sum()} pictures with a hand each" if len(shape) else "pictures without any"
        raise InputError(
            f"{file}: expected one hand, got {got}: fit one picture alone, or all with the same hand (fit_pose --hand)"
        )
    return cast(Side, str(side[0])), torch.from_numpy(shape[0])


def _times(number: np.ndarray, time_s: np.ndarray, frame: np.ndarray) -> np.ndarray | None:
    """When these frames were taken, in between by their numbers; None where the track's times do not grow."""
    if not (np.isfinite(time_s).all() and (np.diff(time_s) > 0).all()):
        return None
    return np.interp(frame, number, time_s)


def _rate(track: Track, number: np.ndarray) -> float:
    """Frames per second as the track's times have it, else as its header says, else as is assumed of pictures."""
    if track.time_s is not None and len(number) > 1:
        rate = float(np.median(np.diff(number) / np.diff(track.time_s))) if (np.diff(track.time_s) > 0).all() else 0.0
        if np.isfinite(rate) and 0 < rate <= _MAX_RATE:
            return rate
    made_with = track.header.get("made_with")
    told = made_with.get("frames_per_second") if isinstance(made_with, Mapping) else None
    if isinstance(told, int | float) and not isinstance(told, bool) and 0 < told <= _MAX_RATE:
        return float(told)
    return ASSUMED_FPS
