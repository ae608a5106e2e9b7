"""One run: a recording of one camera or several, tracked frame by frame into a result folder, resumable."""

import json
import logging
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

import torchhand
from torchhand.devices import HOST
from torchhand.files import (
    FrameRecord,
    Track,
    TrackHeader,
    TrackWriter,
    camera_entry,
    load_hand,
    load_track,
    save_hand,
    save_settings,
)
from torchhand.files.results import CONFIG_NAME, CONVENTION, HAND_NAME, JSONL_NAME, STATUSES
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandKinematics
from torchhand.runs.keypoint_tracks import KeypointSource, with_keypoints
from torchhand.runs.progress import progress
from torchhand.runs.recordings import RecordedFrame, Recording
from torchhand.runs.records import record_of
from torchhand.track import (
    Estimate,
    PastFrame,
    ScenesAhead,
    SearchBeside,
    Smoother,
    Tracker,
    TrackerSettings,
    TrackerState,
    View,
    restored_state,
    saved_state,
)

CHECKPOINT_EVERY = 30
"""Frames from one saved state of the tracker to the next."""
_PAST_FRAMES = 1000  # more than a smoothing window holds
PROBLEMS_SHOWN = 3
"""Unreadable pictures that are reported one by one; the others are counted."""
RIG_CONVENTION = CONVENTION.replace(
    "camera frame of OpenCV: x right", "world frame of the rig's cameras (X_cam = R X_world + t), OpenCV's: x right"
)

_log = logging.getLogger(__name__)

Say = Callable[[str], None]
"""Tells the user something on one line."""


@dataclass(frozen=True, kw_only=True)
class TrackedFrame:
    """A frame that was tracked."""

    record: Callable[[], FrameRecord]
    """Makes its record. Where another process works for the tracker, to be called after the next step, for else it
    waits for that one."""
    checkpoint: Callable[[], dict[str, Any]]
    """Makes the state after the frame, from which `Run.go_on_from` continues exactly."""
    corrected: list[FrameRecord]
    """Records of earlier frames that it corrects."""


class Run:
    """The state of one run, and how it is kept on disk."""

    def __init__(
        self,
        recording: Recording,
        tracker: Tracker,
        provenance: Mapping[str, Any],
        *,
        state: TrackerState | None = None,
        metres: float = 1.0,
        keypoints: KeypointSource | None = None,
        beside: SearchBeside | None = None,
    ) -> None:
        """provenance: of the proportions, for hand.json. state: with which to begin. metres: of the recording's
        unit. keypoints: what gives those of its frames. beside: what searches for the tracker where pictures do not
        wait."""
        self.recording, self.tracker, self.metres = recording, tracker, metres
        self.keypoints = keypoints
        self._step = tracker.step if beside is None else beside.step
        self.ahead: ScenesAhead | None = None  # what makes the next frame's scene, while there is such a process
        self._followed_px: Float[Tensor, "views 21 2"] | None = None
        self.state, self._first_provenance, self._provenance = state, provenance, dict(provenance)
        self._smoother = Smoother(tracker, tracker.settings.smoothing_window_s)
        self._names = tuple(camera.name for camera in recording.cameras)
        self._past: dict[float, tuple[int, float]] = {}
        """Of the last frames, by their times: index, and seconds of computing."""
        self._recorded_shape: Float[Tensor, "shape"] | None = None
        self.begins_at = 0
        """Number of the frame from which on a hand is looked for; into those before it is followed back later."""

    @property
    def shape(self) -> Float[Tensor, "shape"] | None:
        """The proportions, where they are known."""
        known = self._recorded_shape
        if known is None:
            known = self.tracker.known_shape if self.state is None else self.state.shape
        return None if known is None else known.to(HOST)

    @cached_property
    def kinematics(self) -> HandKinematics:
        """The tracker's hand, wherever that computes, for what is drawn and written."""
        return self.tracker.kinematics.on(HOST)

    def step(self, frame: RecordedFrame, following: RecordedFrame | None = None) -> TrackedFrame:
        """Track one frame. following: the one after it, where it is known."""
        started = time.perf_counter()
        frame = with_keypoints(frame, self.keypoints, self._followed_px)
        if frame.index < self.begins_at:
            state, nothing = self.tracker.step(self.state, [View()] * len(frame.views), frame.time_s)
            estimate = replace(nothing, reason=f"a hand is looked for from frame {self.begins_at} on")
            whole = partial(_itself, estimate)
        elif self.ahead is None:
            state, estimate = self._step(self.state, frame.views, frame.time_s)
            whole = partial(_itself, estimate)
        else:
            after = None if following is None else (following.views, following.time_s)
            state, estimate, whole = self.ahead.step(self.state, frame.views, frame.time_s, after)
        if self.state is None or self.state.picture_scale != state.picture_scale:
            self._smoother = self._new_smoother(state)
        better = self._smoother.corrections(state, estimate)
        seconds = time.perf_counter() - started
        if self.tracker.settings.smoothing_window_s > 0:
            scene = self.tracker.scene(state, frame.views, frame.time_s)
            self._smoother.remember(PastFrame.of(scene, estimate.keypoints, estimate.score, estimate.pose))
        self._keep_past(frame, seconds)
        self.state = state
        if estimate.keypoints_px is not None:
            self._followed_px = estimate.keypoints_px
        corrected = []
        for earlier in better:
            index, spent = self._past[earlier.time_s]
            corrected.append(record_of(index, earlier, self._names, seconds=spent))
        return TrackedFrame(
            record=partial(self._record, frame, whole, seconds),
            checkpoint=partial(self._checkpoint, state, self._followed_px),
            corrected=corrected,
        )

    def _record(self, frame: RecordedFrame, whole: Callable[[], Estimate], seconds: float) -> FrameRecord:
        started = time.perf_counter()
        estimate = whole()
        seconds += time.perf_counter() - started
        problems = "; ".join(problem for problem in frame.problems if problem is not None)
        return record_of(frame.index, estimate, self._names, seconds=seconds, problems=problems)

    def recall(self, track: Track, done: int, first: int) -> None:
        """Remember the last frames before those that are to be tracked, as they stand in an interrupted run.

        done: frames that are tracked. first: number of the first one.
        """
        window_s = self.tracker.settings.smoothing_window_s
        if window_s <= 0 or self.state is None or self.state.time_s is None or track.time_s is None:
            return
        begin = int(np.searchsorted(track.time_s, self.state.time_s - window_s)) - 1  # one more than are used
        rows = {int(frame): row for row, frame in enumerate(track.frame)}
        self._smoother = self._new_smoother(self.state)
        of_this_scale = 0 if self.state.picture_scale == 1 else int(track.has_hand.argmax())
        with self.recording.opened(min(done, max(0, begin))) as frames:
            for frame in frames:
                if frame.index >= first + done:
                    break
                row = rows[frame.index]
                if row < of_this_scale:
                    continue
                frame = with_keypoints(frame, self.keypoints, self._followed_px)
                points, pose = torch.from_numpy(track.keypoints3d[row]), torch.from_numpy(track.pose[row])
                is_lost = not bool(points.isfinite().all())
                scene = self.tracker.scene(self.state, frame.views, frame.time_s)
                score = 0.0 if is_lost else float(track.measures["score"][row])
                past = PastFrame.of(scene, None if is_lost else points, score, None if is_lost else pose)
                self._smoother.remember(past)
                self._keep_past(frame, float(track.seconds[row]))

    def _new_smoother(self, state: TrackerState) -> Smoother:
        """One that knows nothing of frames of another size."""
        return Smoother(self.tracker.at(state), self.tracker.settings.smoothing_window_s)

    def restart(self) -> None:
        """Forget the hand, its colours and its proportions; it is found anew in the frames that come."""
        self.state, self._followed_px, self._provenance = None, None, dict(self._first_provenance)

    def _checkpoint(self, state: TrackerState, followed_px: Float[Tensor, "views 21 2"] | None) -> dict[str, Any]:
        return {
            "state": saved_state(state),
            "provenance": json.dumps(self._provenance),
            "metres": self.metres,
            "followed_px": followed_px,
        }

    def go_on_from(self, saved: Mapping[str, Any]) -> None:
        """Continue an interrupted run."""
        self.state = restored_state(saved["state"], self.tracker.device)
        self._provenance = json.loads(saved["provenance"])
        self._followed_px = saved.get("followed_px")

    def adopt(self, shape: Float[Tensor, "shape"], **provenance: Any) -> None:
        """Put proportions that were fitted over the recording in the place of those of the first hand; `save_hand`
        tells of them."""
        self._recorded_shape = shape
        self._provenance |= provenance

    def recall_shape(self, folder: Path) -> None:
        """Take the proportions from the result of a finished run."""
        if (folder / HAND_NAME).exists():
            hand = load_hand(folder / HAND_NAME, self.tracker.kinematics.shape_space.names)
            self._recorded_shape = torch.tensor(list(hand.values.values()), dtype=torch.float64)

    def save_hand(self, folder: Path, **provenance: Any) -> None:
        """The proportions, once they are known."""
        self._provenance |= provenance
        if self.shape is None:
            return
        space = self.tracker.kinematics.shape_space
        side = self.tracker.kinematics.side
        content = {"source": self.recording.source, **self._provenance}
        save_hand(folder / HAND_NAME, space.names, self.shape.tolist(), side, content, units=space.units)

    def save_config(self, folder: Path, extra: Mapping[str, Any], cameras: Sequence[Camera]) -> None:
        """Everything that is resolved."""
        used = [camera_entry(camera) for camera in cameras]
        content = {
            "input": self.recording.source,
            "side": self.tracker.kinematics.side,
            "cameras_used": used,
            "frames_per_second": self.recording.fps,
            **extra,
        }
        save_settings(self.tracker.settings, folder / CONFIG_NAME, content)

    def _keep_past(self, frame: RecordedFrame, seconds: float) -> None:
        self._past[frame.time_s] = frame.index, seconds
        if len(self._past) > _PAST_FRAMES:
            self._past.pop(next(iter(self._past)))


def header_of(
    recording: Recording, settings: TrackerSettings, made_with: Mapping[str, Any], *, side: str
) -> TrackHeader:
    """What must be equal in a run that is to be resumed. made_with: what changes the result besides the settings."""
    cameras = recording.cameras
    is_rig = len(cameras) > 1
    camera: dict[str, Any] = (
        {"rig": [camera_entry(one) for one in cameras]}
        if is_rig
        else {**camera_entry(cameras[0]), "is_assumed": cameras[0].is_assumed}
    )
    whole = {
        "torchhand": torchhand.__version__,
        "settings": asdict(settings),
        "frames_per_second": recording.fps,
        **made_with,
    }
    return TrackHeader(
        dof_names=DOFS,
        source=recording.source,
        side=side,
        camera=json.loads(json.dumps(camera)),
        convention=RIG_CONVENTION if is_rig else CONVENTION,
        made_with=json.loads(json.dumps(whole, default=str), parse_constant=str),  # JSON knows no infinity
    )


def _itself(estimate: Estimate) -> Estimate:
    return estimate


def _with_following(
    frames: Iterable[RecordedFrame], *, is_wanted: bool
) -> Iterator[tuple[RecordedFrame, RecordedFrame | None]]:
    """Every frame with the one after it, None at the end and where it is not wanted: then no frame waits for it."""
    if not is_wanted:
        yield from ((frame, None) for frame in frames)
        return
    before: RecordedFrame | None = None
    for frame in frames:
        if before is not None:
            yield before, frame
        before = frame
    if before is not None:
        yield before, None


def _tracked(
    run: Run, frames: Iterable[RecordedFrame], writer: TrackWriter
) -> Iterator[tuple[RecordedFrame, TrackedFrame]]:
    """Frames as they are tracked, what they correct of earlier ones being written; where another process works for the
    tracker, each after the next one is, and the last also where the user ends it all."""
    waiting: tuple[RecordedFrame, TrackedFrame] | None = None
    try:
        for frame, following in _with_following(frames, is_wanted=run.ahead is not None):
            before = run.shape
            tracked, shape = run.step(frame, following), run.shape
            if shape is not None and (before is None or not torch.equal(shape, before)):
                told = {} if before is None else {"method": "fit to frames while the hand was followed"}
                run.save_hand(writer.folder, frame=frame.index, **told)
            if waiting is not None:
                ready, waiting = waiting, None
                yield ready
            for earlier in tracked.corrected:
                writer.correct(earlier)
            if run.ahead is None:
                yield frame, tracked
            else:
                waiting = frame, tracked
    except KeyboardInterrupt:
        if waiting is not None:
            yield waiting
        raise
    if waiting is not None:
        yield waiting


def track_frames(run: Run, writer: TrackWriter, done: int, first: int, say: Say, draw: Callable[..., None]) -> None:
    """Track what is left of a recording into its result folder. draw: called with every frame and its record."""
    counts = dict.fromkeys(STATUSES, 0)
    shown: set[str] = set()
    unread = 0
    recording = run.recording
    if done:
        run.recall(load_track(writer.folder / JSONL_NAME), done, first)
    left = None if recording.count is None else max(0, recording.count - done)
    with (
        recording.opened(done) as frames,
        progress(recording.name, left, say) as bar,
    ):
        for frame, tracked in _tracked(run, frames, writer):
            record = tracked.record()
            writer.append(record, tracked.checkpoint)
            draw(frame, record)
            for problem in frame.problems:
                unread += problem is not None
                if problem is not None and problem not in shown and len(shown) < PROBLEMS_SHOWN:
                    say(f"frame {frame.index}: {problem}")
                    shown.add(problem)
            counts[record.status] += 1
            _log.debug("frame %d: %s, %.0f ms", frame.index, record.status, 1e3 * record.seconds)
            bar.update(counts)
    if unread > len(shown):
        say(f"{recording.name}: {unread - len(shown)} more pictures are missing or unreadable")
    for line in recording.warnings():
        say(line)
