"""One recording of several cameras: from a rig to a whole result folder."""

import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

import torchhand
from torchhand.errors import InputError
from torchhand.files import (
    FrameRecord,
    RigFrame,
    Track,
    TrackHeader,
    TrackWriter,
    camera_entry,
    check_output_folder,
    load_hand_model,
    load_track,
    save_hand,
    save_settings,
)
from torchhand.files.results import CONFIG_NAME, HAND_NAME, JSONL_NAME, OVERLAY_NAME, STATUSES
from torchhand.geometry import Camera
from torchhand.hand import DOFS, Anthropometry
from torchhand.runs import CHECKPOINT_EVERY, PROBLEMS_SHOWN, Say
from torchhand.runs.multiview.overlay import write_views
from torchhand.runs.multiview.request import RigRequest
from torchhand.runs.multiview.source import RigRecording
from torchhand.track.multiview import (
    Hindsight,
    Introduction,
    Knowledge,
    Masks,
    MultiViewEstimate,
    MultiViewMemory,
    MultiViewTracker,
    SeenMoment,
    ViewSilhouettes,
    in_unit,
    introduce,
    restored,
    saved,
    score_of,
)

CONVENTION = (
    "world frame of the rig's cameras (X_cam = R X_world + t); cameras are OpenCV's: x right, y down, z forward; root"
    " rotation is a rotation vector of length pi at most, whose sign may change from frame to frame where it is pi;"
    " flexion is positive; keypoints: wrist, then thumb, index, middle, ring, little from base to tip"
)


class MultiViewRun:
    """The pieces of one run that belong together."""

    def __init__(self, recording: RigRecording, request: RigRequest) -> None:
        self.recording, self.request = recording, request
        self.hand = load_hand_model().hand(side=request.side, dtype=torch.float64)
        given = request.hand
        self.known = None if given is None else torch.tensor(list(given.values.values()), dtype=torch.float64)
        self.silhouettes = ViewSilhouettes(
            recording.cameras, request.settings.silhouette, plates=recording.plates(request.settings.silhouette.method)
        )
        self.knowledge: Knowledge | None = None
        self.introduction: Introduction | None = None
        self._tracker: MultiViewTracker | None = None
        self._hindsight: Hindsight | None = None

    @property
    def cameras(self) -> list[Camera]:
        """In metres, as they took the pictures."""
        return in_unit(self.recording.cameras, 1.0 if self.knowledge is None else self.knowledge.metres)

    @property
    def tracker(self) -> MultiViewTracker:
        if self._tracker is None:
            assert self.knowledge is not None
            cameras = in_unit(self.silhouettes.cameras, self.knowledge.metres)
            self._tracker = MultiViewTracker(self.hand, cameras, self.recording.fps, self.request.settings)
        return self._tracker

    @property
    def hindsight(self) -> Hindsight:
        if self._hindsight is None:
            self._hindsight = Hindsight(self.tracker)
        return self._hindsight

    def header(self) -> TrackHeader:
        """What must be equal in a run that is to be resumed."""
        request, recording = self.request, self.recording
        made_with = {
            "torchhand": torchhand.__version__,
            "settings": asdict(request.settings),
            "hand": None if request.hand is None else request.hand.values,
            "unit": request.unit,
            "masks": recording.has_masks,
            "background": None if request.background is None else str(request.background),
            "offsets": dict(request.offsets),
            "start": request.start,
            "frames_per_second": recording.fps,
        }
        return TrackHeader(
            dof_names=DOFS,
            source=str(recording.folder),
            side=request.side,
            camera={"rig": json.loads(json.dumps([camera_entry(camera) for camera in recording.cameras]))},
            convention=CONVENTION,
            made_with=json.loads(json.dumps(made_with), parse_constant=str),
        )

    def meet(self, say: Say) -> None:
        """Get to know the hand before it is followed."""
        settings, recording = self.request.settings, self.recording
        frames = recording.sample(max(1, settings.shape_frames))
        with tqdm(
            total=len(frames), desc="first look", unit="frame", dynamic_ncols=True, disable=not sys.stderr.isatty()
        ) as bar:
            introduction = introduce(
                self.hand,
                self.silhouettes,
                [(frame.index, frame.images, frame.masks) for frame in frames],
                Anthropometry(self.hand.kinematics.shape_space),
                settings,
                shape=self.known,
                fits_unit=self.request.unit == "hand",
                done=bar.update,
            )
        if self.request.unit == "hand":
            if introduction.metres is None:
                raise InputError(f"{recording.folder}: --unit hand: expected a hand in some views, found none")
            say(f"one unit of the rig is {1e3 * introduction.metres:.4g} mm, by the size of the hand")
        self.introduction = introduction
        self.knowledge = Knowledge(
            state=None,
            memory=MultiViewMemory(shape=introduction.shape),
            skins=introduction.skins,
            anchors=introduction.anchors,
            metres=introduction.metres or 1.0,
        )

    def recall(self, track: Track, done: int) -> None:
        """Remember the last moments before those that are to be tracked, as they stand in an interrupted run."""
        first = max(0, done - self.tracker.moments_back)
        rows = {int(frame): row for row, frame in enumerate(track.frame)}
        with self.recording.opened(first) as frames:
            for frame in frames or ():
                if frame.index >= self.request.start + done:
                    break
                row = rows[frame.index]
                score = score_of(float(track.measures["overlap"][row]), float(track.measures["covered"][row]))
                is_lost = math.isnan(score)
                self.hindsight.remember(
                    SeenMoment.of(
                        frame.index,
                        self._masks(frame),
                        None if is_lost else torch.from_numpy(track.keypoints3d[row]),
                        0.0 if is_lost else score,
                        seconds=float(track.seconds[row]),
                    )
                )

    def step(self, frame: RigFrame) -> tuple[FrameRecord, list[FrameRecord]]:
        """Track one moment; its record, and those of earlier ones that it corrects."""
        assert self.knowledge is not None
        known, started, names = self.knowledge, time.perf_counter(), self.recording.names
        with torch.inference_mode():
            masks = self._masks(frame)
            state, memory, estimate = self.tracker.step(known.state, known.memory, masks, known.anchors, frame.index)
            better = self.hindsight.look_back(frame.index, state, memory, estimate)
        seconds = time.perf_counter() - started
        self.hindsight.remember(SeenMoment.of(frame.index, masks, estimate.keypoints, estimate.score, seconds=seconds))
        self.knowledge = replace(known, state=state, memory=memory)
        problems = "; ".join(problem for problem in frame.problems if problem is not None)
        corrected = [record_of(seen.moment, earlier, names, seconds=seen.seconds) for seen, earlier in better]
        return record_of(frame.index, estimate, names, seconds=seconds, problems=problems), corrected

    def _masks(self, frame: RigFrame) -> Masks:
        assert self.knowledge is not None
        with torch.inference_mode():
            if frame.masks is not None:
                return self.silhouettes.undistorted(frame.masks)
            return self.silhouettes(frame.images, self.knowledge.skins)

    def save_hand(self, folder: Path) -> None:
        assert self.knowledge is not None
        space, shape = self.hand.kinematics.shape_space, self.knowledge.memory.shape
        introduction = self.introduction
        provenance: dict[str, Any] = {
            "source": str(self.recording.folder),
            "method": "given" if self.known is not None else "visual hulls",
            "frames": [] if introduction is None else list(introduction.learned_from),
            "unit_m": self.knowledge.metres,
        }
        if introduction is not None and introduction.shape_std is not None:
            provenance["std"] = dict(zip(space.names, introduction.shape_std.tolist(), strict=True))
        side = self.hand.kinematics.side
        save_hand(folder / HAND_NAME, space.names, shape.tolist(), side, provenance, units=space.units)

    def save_config(self, folder: Path) -> None:
        request = self.request
        extra = {
            "input": str(self.recording.folder),
            "config": request.config,
            "side": request.side,
            "cameras_used": [camera_entry(camera) for camera in self.cameras],
            "unit": request.unit,
            "silhouettes": "given" if self.recording.has_masks else request.settings.silhouette.method,
            "hand_given": None if request.hand is None else request.hand.values,
            "background": request.background,
            "offsets": dict(request.offsets),
            "start": request.start,
            "max_frames": request.max_frames,
            "frames_per_second": self.recording.fps,
        }
        save_settings(request.settings, folder / CONFIG_NAME, extra)


def track_rig(folder: Path, out_dir: Path, request: RigRequest, say: Say) -> Track:
    """Track one recording into a result folder.

    Raises InputError before anything is touched where rig, pictures, options or folder are wrong, and on the way where
    the disk refuses; what is tracked by then stays.
    """
    check_output_folder(out_dir, resume=request.resume, overwrite=request.overwrite)
    recording = RigRecording(folder, request)
    for line in recording.notes:
        say(line)
    run = MultiViewRun(recording, request)
    writer = TrackWriter(
        out_dir,
        run.header(),
        resume=request.resume,
        overwrite=request.overwrite,
        checkpoint_every=CHECKPOINT_EVERY,
    )
    with writer:
        done = 0
        if writer.resume_point is not None:
            run.knowledge = restored(writer.resume_point.state)
            done = writer.resume_point.last_frame + 1 - request.start
        else:
            run.meet(say)
            run.save_hand(writer.folder)
        run.save_config(writer.folder)
        _track_moments(run, done, writer, say)
        track = load_track(writer.folder)
        if request.has_overlay and len(track):
            assert run.knowledge is not None
            shape = run.knowledge.memory.shape
            write_views(writer.folder / OVERLAY_NAME, track, run.hand.kinematics, run.cameras, shape, recording)
    return track


def _track_moments(run: MultiViewRun, done: int, writer: TrackWriter, say: Say) -> None:
    counts = dict.fromkeys(STATUSES, 0)
    shown: set[str] = set()
    with (
        run.recording.opened(done) as frames,
        tqdm(
            total=None if frames is None else frames.count,
            desc=run.recording.folder.name,
            unit="frame",
            dynamic_ncols=True,
            disable=not sys.stderr.isatty(),
        ) as bar,
    ):
        if frames is not None and done:
            run.recall(load_track(writer.folder / JSONL_NAME), done)
        for frame in frames or ():
            record, corrected = run.step(frame)
            for earlier in corrected:
                writer.correct(earlier)
            writer.append(record, lambda: saved(run.knowledge))  # pyright: ignore[reportArgumentType]
            for problem in frame.problems:
                if problem is not None and problem not in shown and len(shown) < PROBLEMS_SHOWN:
                    say(f"frame {frame.index}: {problem}")
                    shown.add(problem)
            counts[record.status] += 1
            bar.set_postfix({name: count for name, count in counts.items() if count}, refresh=False)
            bar.update()
        for line in [] if frames is None else frames.warnings[run.recording.said :]:
            say(line)


def record_of(
    index: int, estimate: MultiViewEstimate, names: Sequence[str], *, seconds: float, problems: str = ""
) -> FrameRecord:
    """The record of one estimate; NaN where it holds nothing."""
    overlaps = [math.nan] * len(names) if estimate.overlaps is None else estimate.overlaps.tolist()
    measures = {
        "overlap": math.nan if estimate.overlap is None else estimate.overlap,
        "inside": math.nan if estimate.inside_share is None else estimate.inside_share,
        "covered": math.nan if estimate.covered_share is None else estimate.covered_share,
        "views": float(estimate.views),
        **{f"overlap_{name}": overlap for name, overlap in zip(names, overlaps, strict=True)},
    }
    arrays = (estimate.pose, estimate.pose_std, estimate.keypoints, estimate.keypoints_cov)
    if any(array is None for array in arrays):
        reason = "; ".join(text for text in (estimate.reason, problems) if text)
        return FrameRecord.empty(
            index,
            estimate.status,
            dofs=len(DOFS),
            seconds=seconds,
            has_keypoints2d=False,
            measures=measures,
            reason=reason,
        )
    pose, pose_std, keypoints, covariance = (np.asarray(array) for array in arrays)
    return FrameRecord(
        frame=index,
        status=estimate.status,
        pose=pose,
        pose_std=pose_std,
        keypoints3d=keypoints,
        keypoints2d=None,
        keypoints3d_cov=covariance,
        seconds=seconds,
        measures=measures,
        reason="",
    )
