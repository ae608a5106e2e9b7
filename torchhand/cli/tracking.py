"""One tracked sequence: from a source of pictures to a whole result folder; what `track` and `demo` share."""

import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

import torchhand
from torchhand.cli.overlays import draw_live, write_overlay
from torchhand.cli.request import Request, check_start_points, plate_of
from torchhand.errors import InputError
from torchhand.files import (
    FrameSource,
    Track,
    TrackHeader,
    TrackWriter,
    camera_entry,
    camera_for,
    check_output_folder,
    load_hand_model,
    load_track,
    open_source,
    save_hand,
    save_settings,
)
from torchhand.files.results import CONFIG_NAME, HAND_NAME, OVERLAY_NAME, UNFINISHED_NAME
from torchhand.files.track_file import JSONL_NAME
from torchhand.files.track_record import STATUSES
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandKinematics
from torchhand.track.sequence import TrackedFrame, follow
from torchhand.track.state import Memory, TrackerState
from torchhand.track.trackers import tracker_of
from torchhand.view import HandProjector

CHECKPOINT_EVERY = 30
"""Frames from one saved state of the tracker to the next."""
PROBLEMS_SHOWN = 3
"""Corrupt frames that are reported one by one; the others are counted."""

Say = Callable[[str], None]
"""Tells the user something on one line."""


class _Run:
    """The pieces of one run that belong together."""

    def __init__(self, source: str | Path, camera: Camera, frames_per_second: float, request: Request) -> None:
        self.source, self.request = source, request
        fitted = request.hand
        shape = None if fitted is None else torch.tensor(list(fitted.values.values()), dtype=torch.float64)
        self.tracker = tracker_of(
            load_hand_model().hand(side=request.side, dtype=torch.float64),
            camera,
            frames_per_second,
            request.settings,
            shape=shape,
            start_points=request.start_points,
            plate=plate_of(request.background, request.settings.silhouette.method, camera.width, camera.height),
        )
        self.given_camera, self.frames_per_second = camera, frames_per_second
        self.state: TrackerState | None = None
        self.memory = Memory()
        self.fitted_at: int | None = None

    @property
    def kinematics(self) -> HandKinematics:
        return self.tracker.kinematics

    @property
    def projector(self) -> HandProjector:
        return HandProjector(self.kinematics, self.tracker.camera, self.memory.shape)

    def header(self) -> TrackHeader:
        """What must be equal in a run that is to be resumed."""
        request = self.request
        made_with = {
            "torchhand": torchhand.__version__,
            "settings": asdict(request.settings),
            "hand": None if request.hand is None else request.hand.values,
            "start_points": request.start_points,
            "background": None if request.background is None else str(request.background),
            "start": request.start,
            "frames_per_second": self.frames_per_second,
            "seed": request.seed,
        }
        camera = {**camera_entry(self.given_camera), "is_assumed": self.given_camera.is_assumed}
        return TrackHeader(
            dof_names=DOFS,
            source=str(self.source),
            side=request.side,
            camera=json.loads(json.dumps(camera)),
            made_with=json.loads(json.dumps(made_with), parse_constant=str),  # JSON knows no infinity
        )

    def checkpoint(self) -> dict[str, Any]:
        return {"tracker": self.tracker.state_dict(self.state, self.memory), "fitted_at": self.fitted_at}

    def go_on_from(self, saved: Any) -> None:
        self.state, self.memory = self.tracker.restore(saved["tracker"])
        self.fitted_at = saved["fitted_at"]

    def advance(self, tracked: TrackedFrame, folder: Path) -> None:
        """Take over the state after a frame; the first fit is saved at once."""
        is_new = self.memory.shape is None and tracked.memory.shape is not None
        self.state, self.memory = tracked.state, tracked.memory
        if is_new:
            self.fitted_at = tracked.frame.index
            self.save_hand(folder)

    def save_hand(self, folder: Path) -> None:
        if self.memory.shape is None:
            return
        space = self.kinematics.shape_space
        camera = self.given_camera
        provenance = {
            "source": str(self.source),
            "frame": self.fitted_at,
            "method": "contour fit" if self.request.hand is None else "given",
            "camera": camera.name,
            "camera_is_assumed": camera.is_assumed,
            "posture": self.request.settings.posture,
        }
        values = self.memory.shape.tolist()
        save_hand(folder / HAND_NAME, space.names, values, self.kinematics.side, provenance, units=space.units)

    def save_config(self, folder: Path) -> None:
        request = self.request
        extra = {
            "input": str(self.source),
            "config": request.config,
            "side": request.side,
            "camera": request.camera,
            "camera_is_assumed": self.given_camera.is_assumed,
            "camera_used": camera_entry(self.given_camera),
            "hand_given": None if request.hand is None else request.hand.values,
            "start_points": request.start_points,
            "background": request.background,
            "start": request.start,
            "max_frames": request.max_frames,
            "frames_per_second": self.frames_per_second,
            "seed": request.seed,
        }
        save_settings(request.settings, folder / CONFIG_NAME, extra)


def track_sequence(source: str | Path, out_dir: Path, request: Request, say: Say) -> tuple[Track, HandProjector]:
    """Track one sequence into a result folder; returns the track and what projects its poses into the pictures.

    `source` is what `open_source` takes; a text is the number of a webcam, whose end is the user's Ctrl-C.

    Raises InputError before anything is touched where the input, the camera, the start points or the folder are wrong,
    and on the way where the disk refuses or a picture has another size; what is tracked by then stays.
    """
    is_webcam = isinstance(source, str)
    if is_webcam and request.resume:
        raise InputError(f"webcam {source}: cannot be resumed: expected a video or a folder with --resume")
    check_output_folder(out_dir, resume=request.resume, overwrite=request.overwrite)
    frames = open_source(source, start=request.start, max_frames=request.max_frames)
    try:
        camera = camera_for(request.camera, frames.width, frames.height)
        check_start_points(request.start_points, frames.width, frames.height)
        run = _Run(source, camera, frames.fps, request)
        writer = TrackWriter(
            out_dir,
            run.header(),
            resume=request.resume,
            overwrite=request.overwrite,
            checkpoint_every=CHECKPOINT_EVERY,
        )
        with writer:
            if camera.is_assumed:
                say("no --camera given: a field of view is assumed, so distances are metric only up to that assumption")
            if writer.resume_point is not None:
                run.go_on_from(writer.resume_point.state)
                done = writer.resume_point.last_frame + 1 - request.start
                frames.close()
                frames = open_source(source, start=request.start, max_frames=request.max_frames, already_done=done)
            run.save_config(writer.folder)
            run.save_hand(writer.folder)
            overlay = writer.folder / OVERLAY_NAME if request.has_overlay else None
            with draw_live(overlay if is_webcam else None, frames) as draw:
                try:
                    _track_frames(run, frames, writer, say, draw)
                except KeyboardInterrupt:
                    if not is_webcam:
                        raise
            track = load_track(writer.folder)
            if overlay is not None and not is_webcam and len(track):
                write_overlay(overlay, track, run.projector, source, frames.fps)
        return track, run.projector
    finally:
        frames.close()


def _track_frames(run: _Run, frames: FrameSource, writer: TrackWriter, say: Say, draw: Callable[..., None]) -> None:
    counts = dict.fromkeys(STATUSES, 0)
    problems = 0
    with tqdm(
        total=frames.count, desc=frames.name, unit="frame", dynamic_ncols=True, disable=not sys.stderr.isatty()
    ) as bar:
        for tracked in follow(run.tracker, frames, run.state, run.memory):
            run.advance(tracked, writer.folder)
            writer.append(tracked.record, run.checkpoint)
            draw(run.projector, tracked)
            if tracked.frame.image is None:
                problems += 1
                if problems <= PROBLEMS_SHOWN:
                    say(f"{tracked.frame.problem} (frame {tracked.frame.index} is skipped)")
            counts[tracked.record.status] += 1
            bar.set_postfix({name: count for name, count in counts.items() if count}, refresh=False)
            bar.update()
    if problems > PROBLEMS_SHOWN:
        say(f"{frames.name}: {problems - PROBLEMS_SHOWN} more corrupt frames are skipped")
    if frames.ended_early:
        say(frames.ended_early)


def summary_of(name: str, track: Track, out_dir: Path) -> str:
    """One line about a finished run."""
    counts = ", ".join(f"{int((track.status == status).sum())} {status.replace('_', ' ')}" for status in STATUSES)
    parts = [f"{name}: {len(track)} frames ({counts})"]
    if len(track):
        parts.append(f"median {1e3 * float(np.median(track.seconds)):.1f} ms per frame")
    overlaps = track.measures.get("overlap", np.empty(0))
    if np.isfinite(overlaps).any():
        parts.append(f"median overlap {float(np.nanmedian(overlaps)):.2f}")
    return f"{'; '.join(parts)}; saved in {out_dir}"


def how_to_go_on(out_dir: Path, *, overwrite: bool) -> str:
    """What to tell who has stopped a run."""
    folder = next((place for place in (out_dir / UNFINISHED_NAME, out_dir) if (place / JSONL_NAME).exists()), None)
    if folder is None:
        return "stopped by Ctrl-C"
    option = "--resume in place of --overwrite" if overwrite else "--resume"
    return f"stopped by Ctrl-C; what is tracked so far is in {folder}, and the same command with {option} goes on"
