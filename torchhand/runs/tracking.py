"""Tracking into a result folder: a sequence of one camera, or a recording of several."""

import contextlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from torchhand.detect import HandDetector
from torchhand.errors import InputError
from torchhand.files import FrameRecord, Track, TrackWriter, check_output_folder, load_hand_model, load_track
from torchhand.files.results import JSONL_NAME, OVERLAY_NAME, STATUSES, UNFINISHED_NAME
from torchhand.geometry import Camera
from torchhand.hand import Anthropometry
from torchhand.runs.detected_tracks import kept_detections
from torchhand.runs.keypoint_tracks import KeypointSource, KeypointTracks
from torchhand.runs.overlays import draw_live, write_overlay, write_views
from torchhand.runs.recordings import LiveRecording, OneCameraRecording, RecordedFrame, RigRecording, rig_plates
from torchhand.runs.request import MEDIAPIPE, Request, check_start_points, plate_of
from torchhand.runs.run import CHECKPOINT_EVERY, Run, Say, header_of, track_frames
from torchhand.runs.second_pass import smooth_frames
from torchhand.track import Keyframe, Tracker, TrackerState
from torchhand.track.multiview import HandInitialization, Initialization, in_unit, initialize
from torchhand.track.scene import ViewSilhouettes
from torchhand.view import HandProjector


def track_sequence(source: str | Path, out_dir: Path, request: Request, say: Say) -> tuple[Track, HandProjector]:
    """Track one sequence into a result folder; returns the track and what projects its poses into the pictures.

    `source` is what `open_source` takes; a text is the number of a webcam, whose end is the user's Ctrl-C.

    Raises InputError before anything is touched where the input, the camera, the start points or the folder are wrong,
    and on the way where the disk refuses or a picture has another size; what is tracked by then stays.
    """
    is_webcam = isinstance(source, str)
    request = request.causal() if is_webcam or request.is_causal else request
    if is_webcam and request.resume:
        raise InputError(f"webcam {source}: cannot be resumed: expected a video or a folder with --resume")
    check_output_folder(out_dir, resume=request.resume, overwrite=request.overwrite)
    recording = OneCameraRecording(
        source,
        request.camera,
        start=request.start,
        max_frames=request.max_frames,
    )
    try:
        check_start_points(request.start_points, recording.width, recording.height)
        method = request.settings.silhouette.method
        plate = plate_of(request.background, method, recording.width, recording.height)
        request = request.with_side(recording, say)
        hand = load_hand_model().hand(side=request.known_side, dtype=torch.float64)
        tracker = Tracker(
            hand,
            recording.cameras,
            request.settings,
            shape=_known_shape(request),
            start_points=request.start_points,
            plates=None if plate is None else [plate],
        )
        files, detectors = request.keypoint_tracks(recording.cameras), request.detectors(recording.cameras)
        run = Run(recording, tracker, _provenance(request, recording.cameras[0]))
        with (
            _writer(out_dir, recording, request, detectors) as writer,
            _keypoints(files, detectors, writer, recording, request.start, say) as run.keypoints,
        ):
            for line in recording.notes:
                say(line)
            done = 0
            if writer.resume_point is not None:
                run.go_on_from(writer.resume_point.state)
                done = writer.resume_point.last_frame + 1 - request.start
            used = {"camera_is_assumed": recording.cameras[0].is_assumed}
            run.save_config(writer.folder, _asked(request) | used, recording.cameras)
            run.save_hand(writer.folder)
            _follow(run, recording, writer, done, request, say)
            if not request.is_causal:
                smooth_frames(run, writer, say)
            track, projector = load_track(writer.folder), _projector(run)
            if request.has_overlay and not is_webcam and len(track):
                write_overlay(writer.folder / OVERLAY_NAME, track, projector, source, recording.fps)
        return track, projector
    finally:
        recording.close()


def _follow(
    run: Run, recording: OneCameraRecording, writer: TrackWriter, done: int, request: Request, say: Say
) -> None:
    """Track what is left of one camera's recording; a webcam, which is drawn live, until the user's Ctrl-C."""
    is_drawn_live = recording.is_live and request.has_overlay
    with draw_live(writer.folder / OVERLAY_NAME if is_drawn_live else None, recording) as live:

        def draw(frame: RecordedFrame, record: FrameRecord) -> None:
            live(_projector(run) if is_drawn_live else None, frame, record)

        try:
            track_frames(run, writer, done, request.start, say, draw)
        except KeyboardInterrupt:
            if not recording.is_live:
                raise


def track_rig(folder: Path, out_dir: Path, request: Request, say: Say) -> Track:
    """Track one recording of several cameras into a result folder.

    Raises InputError before anything is touched where rig, pictures, options or folder are wrong, and on the way where
    the disk refuses; what is tracked by then stays.
    """
    check_output_folder(out_dir, resume=request.resume, overwrite=request.overwrite)
    request = request.causal() if request.is_causal else request
    recording = RigRecording(
        folder,
        cameras=request.camera,
        unit=request.unit,
        masks=request.masks,
        offsets=request.offsets,
        start=request.start,
        max_frames=request.max_frames,
    )
    return _track_views(recording, out_dir, request, say)


def track_live_rig(sources: Sequence[str | Path], folder: Path, out_dir: Path, request: Request, say: Say) -> Track:
    """Track several cameras while they take pictures into a result folder, until the last ends or the user's Ctrl-C.

    sources: webcams' numbers as texts, or files that are played as if live, in the order of the cameras. folder: of the
    rig, or the file of its cameras. Raises InputError as `track_rig` does, and for what live cameras cannot do.
    """
    for option, is_given in (
        ("--resume", request.resume),
        ("--start", request.start > 0),
        ("--offset", bool(request.offsets)),
        ("--keypoints FILE", bool(request.keypoints)),
        ("--silhouettes masks", bool(request.masks)),
    ):
        if is_given:
            raise InputError(f"--live: expected none of what needs a recording with it, got {option}")
    check_output_folder(out_dir, resume=False, overwrite=request.overwrite)
    cameras = folder if request.camera is None else request.camera
    recording = LiveRecording(sources, cameras, unit=request.unit, max_frames=request.max_frames)
    with recording:
        return _track_views(recording, out_dir, request.causal(), say)


def _track_views(recording: RigRecording | LiveRecording, out_dir: Path, request: Request, say: Say) -> Track:
    request = request.with_side(recording, say)
    files, detectors = request.keypoint_tracks(recording.cameras), request.detectors(recording.cameras)
    for line in recording.notes:
        say(line)
    start = _RigStart(recording, request)
    with (
        _writer(out_dir, recording, request, detectors) as writer,
        _keypoints(files, detectors, writer, recording, request.start, say) as keypoints,
    ):
        if writer.resume_point is None:
            run, done = start.begun(say), 0
            run.save_hand(writer.folder)
        else:
            saved = writer.resume_point.state
            run = Run(recording, start.tracker(float(saved["metres"])), {}, metres=float(saved["metres"]))
            run.go_on_from(saved)
            done = writer.resume_point.last_frame + 1 - request.start
        run.keypoints = keypoints
        cameras = in_unit(recording.cameras, run.metres)
        run.save_config(writer.folder, _asked(request) | {"masks_given": recording.has_masks}, cameras)
        try:
            track_frames(run, writer, done, request.start, say, lambda frame, record: None)
        except KeyboardInterrupt:
            if isinstance(recording, RigRecording):
                raise
        if not request.is_causal and not request.settings.smoothing_window_s:
            smooth_frames(run, writer, say)
        track, shape = load_track(writer.folder), run.shape
        if isinstance(recording, RigRecording) and request.has_overlay and len(track) and shape is not None:
            kinematics = run.tracker.kinematics
            write_views(writer.folder / OVERLAY_NAME, track, kinematics, cameras, shape, recording)
    return track


class _RigStart:
    """How a hand is found before it is followed: in frames from all over the recording."""

    def __init__(self, recording: RigRecording | LiveRecording, request: Request) -> None:
        self.recording, self.request, self.settings = recording, request, request.settings
        self.hand = load_hand_model().hand(side=request.known_side, dtype=torch.float64)
        self.known = _known_shape(request)
        method, has_masks = self.settings.silhouette.method, recording.has_masks
        self.plates = rig_plates(recording.cameras, request.background, method, has_masks=has_masks)

    def tracker(self, metres: float) -> Tracker:
        """metres: of one unit of the cameras' translations."""
        cameras = in_unit(self.recording.cameras, metres)
        return Tracker(self.hand, cameras, self.settings, shape=self.known, plates=self.plates)

    def begun(self, say: Say) -> Run:
        """A run that knows the hand's colours, its proportions and its pose in some frames.

        Raises InputError where the rig's unit is to be fitted and no hand is found.
        """
        recording = self.recording
        found = self._initialization()
        if self.request.unit == "hand":
            if found.metres is None:
                raise InputError(f"{recording.folder}: --unit hand: expected a hand in some views, found none")
            say(f"one unit of the rig is {1e3 * found.metres:.4g} mm, by the size of the hand")
        metres = found.metres or 1.0
        state = TrackerState(
            shape=found.hand.shape,
            appearance=tuple(found.skins) if any(found.skins) else (),
            keyframes=tuple(
                Keyframe(time_s=frame / recording.fps, pose=pose) for frame, pose in found.hand.poses.items()
            ),
        )
        provenance = self._provenance(found.hand) | {"unit_m": metres}
        return Run(recording, self.tracker(metres), provenance, state=state, metres=metres)

    def _initialization(self) -> Initialization:
        silhouettes = ViewSilhouettes(self.recording.cameras, self.settings.silhouette, plates=self.plates)
        sample = self.recording.sample(max(1, self.settings.rig.shape_frames))
        given = self.recording.has_masks
        frames = [
            (
                frame.index,
                [view.image for view in frame.views],
                [view.mask for view in frame.views] if given else None,
            )
            for frame in sample
        ]
        with tqdm(
            total=len(frames), desc="initializing", unit="frame", dynamic_ncols=True, disable=not sys.stderr.isatty()
        ) as bar:
            return initialize(
                self.hand,
                silhouettes,
                frames,
                Anthropometry(self.hand.kinematics.shape_space),
                self.settings.rig,
                shape=self.known,
                fits_unit=self.request.unit == "hand",
                done=bar.update,
            )

    def _provenance(self, found: HandInitialization) -> dict[str, Any]:
        method = "visual hulls" if self.known is None else "given"
        content: dict[str, Any] = {"method": method, "frames": list(found.shape_frames)}
        if found.shape_std is not None:
            names = self.hand.kinematics.shape_space.names
            content["std"] = dict(zip(names, found.shape_std.tolist(), strict=True))
        return content


def _known_shape(request: Request) -> Float[Tensor, "shape"] | None:
    hand = request.hand
    return None if hand is None else torch.tensor(list(hand.values.values()), dtype=torch.float64)


@contextlib.contextmanager
def _keypoints(
    files: KeypointTracks | None,
    detectors: Sequence[HandDetector],
    writer: TrackWriter,
    recording: OneCameraRecording | RigRecording | LiveRecording,
    start: int,
    say: Say,
) -> Iterator[KeypointSource | None]:
    """Where keypoints come from, if any are used."""
    if not detectors:
        yield files
        return
    with kept_detections(detectors, writer, recording, start) as detected:
        yield detected
        for line in detected.notes():
            say(line)


def _writer(
    out_dir: Path,
    recording: OneCameraRecording | RigRecording | LiveRecording,
    request: Request,
    detectors: Sequence[HandDetector],
) -> TrackWriter:
    made_with = {
        "hand": None if request.hand is None else request.hand.values,
        "keypoints": [str(path) for path in request.keypoints] or [detector.name for detector in detectors],
        "start_points": request.start_points,
        "background": None if request.background is None else str(request.background),
        "unit": request.unit,
        "masks": isinstance(recording, RigRecording) and recording.has_masks,
        "offsets": dict(request.offsets),
        "causal": request.is_causal,
        "start": request.start,
        "seed": request.seed,
    }
    return TrackWriter(
        out_dir,
        header_of(recording, request.settings, made_with, side=request.known_side),
        resume=request.resume,
        overwrite=request.overwrite,
        checkpoint_every=CHECKPOINT_EVERY,
    )


def _provenance(request: Request, camera: Camera) -> dict[str, Any]:
    return {
        "method": "contour fit" if request.hand is None else "given",
        "camera": camera.name,
        "camera_is_assumed": camera.is_assumed,
        "posture": request.settings.posture,
    }


def _asked(request: Request) -> dict[str, Any]:
    """What the user asked for, for config.yaml."""
    return {
        "config": request.config,
        "side_is": request.side_source,
        "camera": request.camera,
        "hand_given": None if request.hand is None else request.hand.values,
        "keypoints": [MEDIAPIPE] if request.has_detector else [str(path) for path in request.keypoints],
        "hand_model": request.hand_model,
        "start_points": request.start_points,
        "background": request.background,
        "unit": request.unit,
        "offsets": dict(request.offsets),
        "causal": request.is_causal,
        "start": request.start,
        "max_frames": request.max_frames,
        "seed": request.seed,
    }


def _projector(run: Run) -> HandProjector:
    """What projects poses into the pictures of one camera."""
    return HandProjector(run.tracker.kinematics, run.tracker.own_cameras[0], run.shape)


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
