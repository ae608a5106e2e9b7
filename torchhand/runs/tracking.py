"""Tracking into a result folder: a sequence of one camera, or a recording of several."""

import contextlib
import logging
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from torchhand.detect import HandDetector
from torchhand.errors import InputError
from torchhand.files import Track, TrackWriter, check_output_folder, load_hand_model, load_track, setting_in
from torchhand.files.disk import read_json
from torchhand.files.pictures import file_identity, input_identity, is_webcam, shown_address
from torchhand.files.results import (
    CONFIG_NAME,
    DETERMINED,
    HAND_NAME,
    HEADER_NAME,
    OVERLAY_NAME,
    REPORT_NAME,
    STATUSES,
    unfinished_run,
)
from torchhand.geometry import Camera, Rig
from torchhand.hand import Side
from torchhand.report import load_result, write_report
from torchhand.runs.detected_tracks import DetectedTracks, kept_detections
from torchhand.runs.further_passes import smooth_frames
from torchhand.runs.keypoint_tracks import KeypointSource, KeypointTracks, with_keypoints
from torchhand.runs.overlays import write_overlay, write_views
from torchhand.runs.recordings import (
    LiveCamera,
    LiveRecording,
    OneCameraRecording,
    RecordedFrame,
    RigRecording,
    first_open_hand,
    rig_plates,
)
from torchhand.runs.request import MEDIAPIPE, Request, check_start_points, plate_of
from torchhand.runs.run import CHECKPOINT_EVERY, Run, Say, header_of, track_frames
from torchhand.runs.watchers import opened_watchers, projector_of
from torchhand.track import Keyframe, Tracker, TrackerState, opened_tracker, scenes_ahead
from torchhand.track.multiview import HandInitialization, HandProposer, Initialization, initialize
from torchhand.track.scene import View, ViewSilhouettes, WorkingViews
from torchhand.view import HandProjector

_log = logging.getLogger(__name__)

_SIDE_FRAMES = 3  # in which hands of both sides are tried where several cameras see one

OneCamera = OneCameraRecording | LiveCamera
"""What one camera gives."""


def track_sequence(source: str | Path, out_dir: Path, request: Request, say: Say) -> tuple[Track, HandProjector]:
    """Track one sequence into a result folder; returns the track and what projects its poses into the pictures.

    `source` is what `open_source` takes; a text is what can be read only once: the number of a webcam, which is tracked
    live, whose end is the user's Ctrl-C; an address, or standard input.

    Raises InputError before anything is touched where the input, the camera, the start points or the folder are wrong,
    and on the way where the disk refuses or a picture has another size; what is tracked by then stays.
    """
    is_live = request.is_live or is_webcam(source)
    is_read_once = is_live or isinstance(source, str)
    request = request.causal() if is_read_once or request.is_causal else request
    if is_read_once and request.resume:
        what = f"webcam {source}" if is_webcam(source) else shown_address(str(source))
        raise InputError(f"{what}: cannot be resumed: expected a video or a folder, and no --live, with --resume")
    if is_live and (request.start or (request.keypoints and isinstance(source, str))):
        option = "--start" if request.start else "--keypoints FILE"
        raise InputError(f"--live: expected none of what needs a recording with it, got {option}")
    check_output_folder(out_dir, resume=request.resume, overwrite=request.overwrite)
    recording = (
        LiveCamera(source, request.camera, max_frames=request.max_frames)
        if is_live
        else OneCameraRecording(source, request.camera, start=request.start, max_frames=request.max_frames)
    )
    try:
        check_start_points(request.start_points, recording.width, recording.height)
        method = request.settings.silhouette.method
        plate = plate_of(request.background, method, recording.width, recording.height)
        request = request.with_side(recording, say)
        camera, count = recording.cameras[0], "unknown" if recording.count is None else recording.count
        _log.debug("%s: %dx%d px, %s frames, %s hand", source, camera.width, camera.height, count, request.known_side)
        hand = load_hand_model().to(device=request.device).hand(side=request.known_side, dtype=torch.float64)
        make = partial(
            Tracker,
            hand,
            recording.cameras,
            request.settings,
            shape=_known_shape(request),
            start_points=request.start_points,
            plates=None if plate is None else [plate],
            accumulates_shape=request.is_causal,
        )
        files, detectors = request.keypoint_tracks(recording.cameras), request.detectors(recording.cameras)
        with (
            opened_tracker(make, waits=not is_live) as (tracker, beside),
            _writer(out_dir, recording, request, detectors) as writer,
        ):
            run = Run(recording, tracker, _provenance(request, recording.cameras[0]), beside=beside)
            if writer.is_finished:
                _say_finished(writer, say)
                run.recall_shape(writer.folder)
            else:
                with _keypoints(files, detectors, writer, recording, request.start, say) as run.keypoints:
                    _track_one(run, recording, writer, request, say)
            track, projector = load_track(writer.folder), projector_of(run)
            if request.has_overlay and not is_read_once and not writer.is_finished and len(track):
                write_overlay(writer.folder / OVERLAY_NAME, track, projector, source, recording.fps)
            if not writer.is_finished:
                _write_report(writer, track, request)
        return track, projector
    finally:
        recording.close()


def _with_side_before(request: Request, out_dir: Path) -> Request:
    """The request with the side for which the run that is to be resumed has tried hands."""
    if not request.resume or request.side is not None:
        return request
    if (folder := unfinished_run(out_dir)) is None:
        return request
    config, header = folder / CONFIG_NAME, folder / HEADER_NAME
    run = setting_in(config, "run") if config.is_file() and header.is_file() else None
    was_tried = isinstance(run, Mapping) and run.get("side_is") == "tried"
    return replace(request, side=read_json(header).get("side"), side_source="tried") if was_tried else request


def _track_one(run: Run, recording: OneCamera, writer: TrackWriter, request: Request, say: Say) -> None:
    """Track what is left of one camera's recording, in both passes."""
    for line in (*recording.notes, *([] if writer.note is None else [writer.note])):
        say(line)
    done = 0
    if writer.resume_point is not None:
        run.go_on_from(writer.resume_point.state)
        done = writer.resume_point.last_frame + 1 - request.start
    used = {"camera_is_assumed": recording.cameras[0].is_assumed}
    run.save_config(writer.folder, _asked(request) | used, recording.cameras)
    run.save_hand(writer.folder)
    if _may_begin_later(run, request):
        begins_at, left = first_open_hand(recording) or 0, request.start + done
        has_hand = run.state is not None and run.state.has_started
        if not (has_hand and begins_at >= left):  # of a run that ended before that frame, and began without it
            run.begins_at = begins_at
        if run.begins_at > left:
            say(f"frame {run.begins_at} shows the hand open: it is followed from there, forwards and then back")
    _follow(run, recording, writer, done, request, say)
    if not request.is_causal:
        _log.debug("forward pass done")
        smooth_frames(run, writer, say, workers=request.workers)


def _may_begin_later(run: Run, request: Request) -> bool:
    """Whether a hand is better looked for where it is seen open: what a silhouette shows of other postures is often one
    of its back where it is the palm's. Where nothing is followed back, a detector tells, or the user, it is not."""
    s = request.settings
    is_told = run.keypoints is not None or request.start_points is not None
    is_silhouette = s.silhouette.method == "skin" and s.posture == "open" and run.tracker.parts.has_learned_posture
    return is_silhouette and not (request.is_causal or is_told)


def _follow(run: Run, recording: OneCamera, writer: TrackWriter, done: int, request: Request, say: Say) -> None:
    """Track what is left of one camera's recording; what is read once, which is drawn meanwhile, until the user's
    Ctrl-C."""
    with opened_watchers(run, recording, writer, request, say) as watch:
        try:
            track_frames(run, writer, done, request.start, say, watch)
        except KeyboardInterrupt:
            if not recording.is_live:
                raise
            for line in recording.warnings():
                say(line)


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
        ("--keypoints FILE", bool(request.keypoints) and any(isinstance(source, str) for source in sources)),
        ("--silhouettes masks", bool(request.masks)),
        ("--unit hand", request.unit == "hand"),
    ):
        if is_given:
            raise InputError(f"--live: expected none of what needs a recording with it, got {option}")
    check_output_folder(out_dir, resume=False, overwrite=request.overwrite)
    cameras = folder if request.camera is None else request.camera
    recording = LiveRecording(sources, cameras, unit=request.unit, max_frames=request.max_frames)
    try:
        return _track_views(recording, out_dir, request.causal(), say)
    finally:
        recording.close()


def _track_views(recording: RigRecording | LiveRecording, out_dir: Path, request: Request, say: Say) -> Track:
    _RigStart(recording, request, None).check()
    trial = None
    if isinstance(recording, RigRecording) and request.unit != "hand":
        trial = partial(_hands_of, recording, request)
    request = _with_side_before(request, out_dir).with_side(recording, say, trial)
    files, detectors = request.keypoint_tracks(recording.cameras), request.detectors(recording.cameras)
    for line in recording.notes:
        say(line)
    start = _RigStart(recording, request, files)
    with _writer(out_dir, recording, request, detectors) as writer:
        if writer.is_finished:
            _say_finished(writer, say)
            return load_track(writer.folder)
        with _keypoints(files, detectors, writer, recording, request.start, say) as keypoints:
            run = _track_all(start, keypoints, writer, say)
        track, shape = load_track(writer.folder), run.shape
        if isinstance(recording, RigRecording) and request.has_overlay and len(track) and shape is not None:
            kinematics, cameras = run.kinematics, Rig(recording.cameras).scaled(run.metres)
            write_views(writer.folder / OVERLAY_NAME, track, kinematics, cameras, shape, recording)
        _write_report(writer, track, request)
    return track


def _track_all(start: "_RigStart", keypoints: KeypointSource | None, writer: TrackWriter, say: Say) -> Run:
    """Track what is left of a recording of several cameras, in both passes."""
    recording, request = start.recording, start.request
    if writer.note is not None:
        say(writer.note)
    if isinstance(recording, LiveRecording):
        with start.at_once() as run:
            with contextlib.suppress(KeyboardInterrupt):
                _track_rest(run, keypoints, writer, 0, request, say)
            run.save_hand(writer.folder)  # fitted while the hand was followed
        return run
    if writer.resume_point is None:
        run, done = start.begun(recording, say), 0
        run.save_hand(writer.folder)
    else:
        saved = writer.resume_point.state
        metres = float(saved["metres"])
        run = Run(recording, start.tracker(metres), {}, metres=metres)
        run.go_on_from(saved)
        done = writer.resume_point.last_frame + 1 - request.start
    left = None if recording.count is None else recording.count - done
    with scenes_ahead(start.make(run.metres), run.tracker, left) as run.ahead:
        _track_rest(run, keypoints, writer, done, request, say)
    if not request.is_causal and not request.settings.smoothing_window_s:
        smooth_frames(run, writer, say, workers=request.workers)
    return run


def _track_rest(
    run: Run, keypoints: KeypointSource | None, writer: TrackWriter, done: int, request: Request, say: Say
) -> None:
    """The forward pass of several cameras over what is left."""
    run.keypoints = keypoints
    recording = run.recording
    has_masks = isinstance(recording, RigRecording) and recording.has_masks
    cameras = Rig(recording.cameras).scaled(run.metres)
    run.save_config(writer.folder, _asked(request) | {"masks_given": has_masks}, cameras)
    track_frames(run, writer, done, request.start, say, lambda frame, record: None)


def _say_finished(writer: TrackWriter, say: Say) -> None:
    say(f"{writer.out_dir}: is finished; nothing is left to do (--overwrite tracks anew)")


def _write_report(writer: TrackWriter, track: Track, request: Request) -> None:
    """report.html of a run that has found a hand, once its overlay is drawn; one of an earlier end goes."""
    if not request.has_report or not len(track) or not (writer.folder / HAND_NAME).is_file():
        writer.drop(REPORT_NAME)
        return
    _log.debug("frames and overlay done; the report")
    result = load_result(writer.folder, track=track, name=writer.out_dir.resolve().name)
    write_report(writer.folder / REPORT_NAME, [result if request.has_overlay else replace(result, overlay=None)])


def _hands_of(recording: RigRecording, request: Request, side: Side) -> Mapping[int, float]:
    """How well a hand of a side explains frames from all over a recording, as `HandsOfSide`."""
    return _RigStart(recording, replace(request, side=side), None).scores(recording, _SIDE_FRAMES)


class _RigStart:
    """How a hand is found before it is followed: in frames from all over the recording."""

    def __init__(self, recording: RigRecording | LiveRecording, request: Request, files: KeypointTracks | None) -> None:
        """files: of keypoints, which tell of the hand in any frame."""
        self._files = files
        self.recording, self.request, self.settings = recording, request, request.settings
        model = load_hand_model().to(device=request.device)
        self.hand = model.hand(side=request.known_side, dtype=torch.float64)
        self.known = _known_shape(request)
        self._times_s: dict[int, float] = {}  # of the frames in which the hand was looked for
        method, has_masks = self.settings.silhouette.method, recording.has_masks
        self.plates = rig_plates(recording.cameras, request.background, method, has_masks=has_masks)

    def check(self) -> None:
        """Raise InputError for cameras that cannot see a hand together."""
        if self.request.unit == "hand":
            return
        try:
            self.tracker(1.0)
        except ValueError as error:
            raise InputError(f"{error}; --unit tells what their places are measured in") from error

    def tracker(self, metres: float) -> Tracker:
        """metres: of one unit of the cameras' translations."""
        return self.make(metres)()

    def make(self, metres: float) -> Callable[[], Tracker]:
        """What makes that tracker, here or in another process."""
        cameras = Rig(self.recording.cameras).scaled(metres)
        return partial(Tracker, self.hand, cameras, self.settings, shape=self.known, plates=self.plates)

    @contextlib.contextmanager
    def at_once(self) -> Iterator[Run]:
        """A run that knows nothing: another process finds the hand and fits its proportions while the cameras go on."""
        method = "visual hulls of frames that were followed" if self.known is None else "given"
        with opened_tracker(self.make(1.0), waits=False) as (tracker, beside):
            yield Run(self.recording, tracker, {"method": method, "unit_m": 1.0}, beside=beside)

    def begun(self, recording: RigRecording, say: Say) -> Run:
        """A run that knows the hand's colours, its proportions and its pose in some frames.

        Raises InputError where the rig's unit is to be fitted and no hand is found.
        """
        with self._keypoints_of_samples() as keypoints:
            found = self._initialization(recording, keypoints, say)
        if self.request.unit == "hand":
            if found.metres is None:
                raise InputError(f"{recording.folder}: --unit hand: expected a hand in some views, found none")
            say(f"one unit of the rig is {1e3 * found.metres:.4g} mm, by the size of the hand")
        metres = found.metres or 1.0
        state = TrackerState(
            shape=found.hand.shape,
            appearance=tuple(found.skins) if any(found.skins) else (),
            keyframes=tuple(
                Keyframe(time_s=self._times_s[frame], pose=pose) for frame, pose in found.hand.poses.items()
            ),
        )
        provenance = self._provenance(found.hand) | {"unit_m": metres}
        return Run(recording, self.tracker(metres), provenance, state=state, metres=metres)

    def scores(self, recording: RigRecording, wanted: int) -> Mapping[int, float]:
        """How well a hand of the average's proportions explains some frames, by their indices, each searched by itself;
        frames in which none is found are missing."""
        silhouettes, frames = self._sample(recording, wanted, None)
        rough = replace(self.settings.rig, start=self.settings.rig.start.reduced())
        found = dict[int, float]()
        for frame in frames:
            here = initialize(
                self.hand, silhouettes, [frame], rough, self._proposer, shape=self.hand.kinematics.default_shape
            )
            found |= here.hand.scores
        return found

    def _sample(
        self, recording: RigRecording, wanted: int, keypoints: KeypointSource | None
    ) -> tuple[ViewSilhouettes, Iterator[tuple[int, tuple[View, ...]]]]:
        """What makes silhouettes, and frames from all over the recording as it takes them."""
        silhouettes = ViewSilhouettes(recording.cameras, self.settings.silhouette, plates=self.plates)
        given = recording.cameras
        working = WorkingViews(given, max(camera.width * camera.height for camera in given))

        def seen(frame: RecordedFrame) -> tuple[View, ...]:
            views = with_keypoints(frame, keypoints, None).views
            return tuple(working.of(view, index, silhouettes.cameras[index]) for index, view in enumerate(views))

        return silhouettes, ((self._noted(frame), seen(frame)) for frame in recording.sample(wanted))

    @contextlib.contextmanager
    def _keypoints_of_samples(self) -> Iterator[KeypointSource | None]:
        """Those of files, or of detectors that have seen no picture and see none of the run's."""
        detectors = self.request.detectors(self.recording.cameras)
        try:
            yield DetectedTracks(detectors, is_sample=True) if detectors else self._files
        finally:
            for detector in detectors:
                detector.close()

    def _initialization(self, recording: RigRecording, keypoints: KeypointSource | None, say: Say) -> Initialization:
        wanted = max(1, self.settings.rig.shape_frames)
        wanted += wanted // 2 if self.request.unit == "hand" else 0  # frames of a bare arm tell a wrong unit
        silhouettes, frames = self._sample(recording, wanted, keypoints)
        with tqdm(
            total=wanted,
            desc="initializing",
            unit="frame",
            dynamic_ncols=True,
            disable=not sys.stderr.isatty(),
        ) as bar:
            started, first = time.perf_counter(), list[float]()

            def done(is_found: bool) -> None:
                bar.update()
                first.extend([time.perf_counter() - started] if is_found and not first else [])

            found = initialize(
                self.hand,
                silhouettes,
                frames,
                self.settings.rig,
                self._proposer,
                shape=self.known,
                fits_unit=self.request.unit == "hand",
                done=done,
            )
        if first:
            total = time.perf_counter() - started
            told = f"its proportions and poses in {len(found.hand.poses)} frames after {total:.1f} s"
            say(f"a first hand was found after {first[0]:.1f} s, {told}")
        return found

    def _noted(self, frame: RecordedFrame) -> int:
        """Index of a frame, whose time is kept."""
        self._times_s[frame.index] = frame.time_s
        return frame.index

    @property
    def _proposer(self) -> HandProposer:
        s = self.settings
        return HandProposer(
            kinematics=self.hand.kinematics,
            cameras=self.recording.cameras,
            keypoints=s.keypoints,
            has_network=s.learned_proposals,
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
    if hand is None:
        return None
    return torch.tensor(list(hand.values.values()), dtype=torch.float64, device=request.device)


@contextlib.contextmanager
def _keypoints(
    files: KeypointTracks | None,
    detectors: Sequence[HandDetector],
    writer: TrackWriter,
    recording: OneCamera | RigRecording | LiveRecording,
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
    recording: OneCamera | RigRecording | LiveRecording,
    request: Request,
    detectors: Sequence[HandDetector],
) -> TrackWriter:
    made_with = {
        "input": _identity(recording),
        "hand": None if request.hand is None else request.hand.values,
        "keypoints": [*map(file_identity, request.keypoints)] or [detector.name for detector in detectors],
        "start_points": request.start_points,
        "background": None if request.background is None else file_identity(request.background),
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
        keep_checkpoint=request.keeps_checkpoint,
        end=None if request.max_frames is None else request.start + request.max_frames,
    )


def _identity(recording: OneCamera | RigRecording | LiveRecording) -> dict[str, Any]:
    """What tells the input from others of its name; nothing of live ones, which are never resumed."""
    if isinstance(recording, LiveRecording):
        return {}
    return input_identity(recording.folder if isinstance(recording, RigRecording) else recording.path)


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
        "device": str(request.device),
    }


def summary_of(name: str, track: Track, out_dir: Path) -> str:
    """One line about a finished run."""
    counts = ", ".join(f"{int((track.status == status).sum())} {status.replace('_', ' ')}" for status in STATUSES)
    parts = [f"{name}: {len(track)} frames ({counts})"]
    if len(track):
        parts.append(f"median {1e3 * float(np.median(track.seconds)):.1f} ms per frame")
    known = {name: track.measures.get(name, np.empty(0)) for name in ("overlap", "quality")}
    medians = {name: float(np.nanmedian(values)) for name, values in known.items() if np.isfinite(values).any()}
    parts += [f"median {name} {median:.2f}" for name, median in medians.items()]
    if medians.get("quality", 1.0) < DETERMINED:
        parts[-1] += ", so in most of them a fingertip is probably off by more than 20 mm"
    return f"{'; '.join(parts)}; saved in {out_dir}"


def resume_option(overwrite: bool) -> str:
    """The option with which a command that was stopped goes on."""
    return "--resume in place of --overwrite" if overwrite else "--resume"


def how_to_go_on(out_dir: Path, *, overwrite: bool) -> str:
    """What to tell who has stopped a run."""
    if (folder := unfinished_run(out_dir)) is None:
        return "stopped by Ctrl-C"
    return (
        f"stopped by Ctrl-C; what is tracked so far is in {folder}, and the same command with"
        f" {resume_option(overwrite)} goes on"
    )
