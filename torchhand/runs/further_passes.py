"""Further passes over a recording that was tracked, and one result from all: from the last frame to the first, and
where these differ forwards and back once more."""

import contextlib
import json
import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from torchhand.cluster import copies_for
from torchhand.devices import HOST, read_back, sent_to
from torchhand.files import FrameRecord, Track, TrackWriter, load_track
from torchhand.files.results import BACKWARD_NAME, JSONL_NAME, track_of
from torchhand.runs.keypoint_tracks import with_keypoints
from torchhand.runs.progress import progress
from torchhand.runs.recordings import RecordedFrame, Share, reversed_frames, shares_of
from torchhand.runs.records import (
    EVIDENCE,
    EVIDENCE_BEFORE,
    IS_NEW,
    IS_SURE,
    TwoPasses,
    joined_records,
    record_of,
    widened,
)
from torchhand.runs.run import Run, Say
from torchhand.track import (
    Alternatives,
    FittedShape,
    FollowedFrame,
    FurtherPass,
    TiltAlternatives,
    Tracker,
    can_tell_shape,
    frames_for_shape,
    recorded_shape,
    reshaped_poses,
)

_LOOKING_AGAIN = (("third", False), ("fourth", True))
"""Passes over frames in which the two before differ, and whether they go back; a fifth gains little (docs/tried.md)."""


def smooth_frames(run: Run, writer: TrackWriter, say: Say, *, workers: int) -> None:
    """Estimate the frames of a finished forward pass again, by those that come after them too.

    workers: processes that share a pass over many frames, at most; whatever their number, the results are the same.
    What another pass finds grows in a file of its own; the forward pass is kept beside the result, so that a run that
    is stopped here and resumed does the others anew and ends with the same.
    """
    forward = load_track(writer.folder / JSONL_NAME)
    state, before = run.state, None if run.state is None else run.state.shape
    if state is None or before is None or not forward.has_hand.any():
        return
    writer.keep_forward()
    fitted = _adopted_shape(run, forward, say)
    say("second pass: the hand is followed back from the last frame to the first (--causal does without)")
    with_hand = np.arange(len(forward)) <= np.flatnonzero(forward.has_hand)[-1]  # nothing is followed from a later one
    begun = partial(FurtherPass, run.tracker, state, fitted=fitted)
    second = _Pass(run=run, before=forward, is_wanted=with_hand, begun=begun)
    alternatives = _follow(second, writer, say, workers)
    if fitted is not None:
        forward = _reshaped(forward, run.tracker, before, fitted)
        state = replace(state, shape=fitted.shape, shape_keypoints_cov=fitted.keypoints_cov)
    passes = _passes(run, writer, forward)
    joined = _joined(run, passes)
    is_open = with_hand & (run.keypoints is None and TiltAlternatives.can_tilt(run.tracker))
    for name, is_backward in _LOOKING_AGAIN:
        if not (is_open := passes.is_open(is_open)).any():
            break
        say(f"{name} pass: {int(is_open.sum())} frames in and about which the last two differ")
        both = track_of(forward.header, (json.loads(record.as_json()) for record in joined))
        begun = partial(FurtherPass, run.tracker, state, is_backward=is_backward)
        again = _follow(
            _Pass(run=run, before=both, is_wanted=is_open, begun=begun, is_backward=is_backward, called="again"),
            writer,
            say,
            workers,
        )
        alternatives = {row: found for row, found in alternatives.items() if not is_open[row]} | again
        passes = _passes(run, writer, both)
        joined = _joined(run, passes)
    for record in widened(joined, alternatives):
        writer.correct(record)
    if fitted is not None:
        run.save_hand(writer.folder)
    writer.drop(BACKWARD_NAME)


def _passes(run: Run, writer: TrackWriter, before: Track) -> TwoPasses:
    """What a track was before the pass that was written last, and that pass."""
    return TwoPasses.of(before, load_track(writer.folder / BACKWARD_NAME), begins_at=run.begins_at)


def _joined(run: Run, passes: TwoPasses) -> list[FrameRecord]:
    cameras, shape = sent_to(run.tracker.own_cameras, HOST), run.shape
    assert shape is not None
    return list(joined_records(passes, run.kinematics, shape, cameras[0] if len(cameras) == 1 else None))


def _adopted_shape(run: Run, forward: Track, say: Say) -> FittedShape | None:
    """Proportions that well-spread frames tell, which the run adopts; None where frames that were held out contradict
    these, or none are fitted."""
    tracker, state, count = run.tracker, run.state, run.tracker.settings.shape_frames
    if state is None or not count or not can_tell_shape(tracker):
        return None
    overlap = np.where(forward.status == "tracked", forward.measures["overlap"], np.nan)
    rows = frames_for_shape(torch.from_numpy(forward.pose), torch.from_numpy(overlap), count)
    frames = "1 frame" if len(rows) == 1 else f"{len(rows)} frames"
    say(f"proportions: fitted over {frames} (--set shape_frames=0 keeps those of the first hand)")
    found = recorded_shape(tracker, state, _followed_frames(run, forward, rows))
    if found is None or found.is_contradicted:
        return None
    names = tracker.kinematics.shape_space.names
    run.adopt(
        found.shape,
        method="fit over frames of the recording",
        frames=[int(forward.frame[row]) for row in rows],
        std={name: std for name, std in zip(names, found.shape_std.tolist(), strict=True) if std > 0},
        held_out_nats_per_frame={"first_hand": float(found.costs_before.mean()), "this": float(found.costs.mean())},
    )
    return found


def _followed_frames(run: Run, track: Track, rows: Sequence[int]) -> Iterator[FollowedFrame]:
    """Frames of a recording in their order, with what a detector found in them."""
    if run.keypoints is not None:
        run.keypoints.rewind()
    wanted = {int(track.frame[row]): row for row in rows}
    with run.recording.opened(0) as frames:
        for frame in frames:
            if (row := wanted.pop(frame.index, None)) is not None:
                views = with_keypoints(frame, run.keypoints, None).views
                yield FollowedFrame(views=views, time_s=frame.time_s, pose=torch.from_numpy(track.pose[row]))
            if not wanted:
                return


def _reshaped(track: Track, tracker: Tracker, before: Tensor, fitted: FittedShape) -> Track:
    """A track of one camera with the hands of another shape in the place of its own."""
    kinematics, [camera], rows = tracker.kinematics, tracker.own_cameras, np.flatnonzero(track.has_hand)
    pose, keypoints = track.pose.copy(), track.keypoints3d.copy()
    poses = torch.from_numpy(pose[rows]).to(tracker.device)
    moved = reshaped_poses(poses, tracker.parts.motion, kinematics, before, fitted.shape)
    pose[rows], keypoints[rows] = read_back(moved), read_back(kinematics(moved, fitted.shape).keypoints)
    in_picture = camera.to(device=HOST).project(torch.from_numpy(keypoints)).numpy()
    covariance = track.keypoints3d_cov + read_back(fitted.keypoints_cov)
    return replace(track, pose=pose, keypoints3d=keypoints, keypoints2d=in_picture, keypoints3d_cov=covariance)


@dataclass(frozen=True, kw_only=True)
class _Step:
    """One frame of another pass."""

    row: int
    line: str
    """Its record."""
    alternatives: Alternatives | None
    """Hands that explain the picture about as well, where others were looked for."""


@dataclass(frozen=True, kw_only=True)
class _Pass:
    """Another pass over some frames, begun anew wherever frames are left out."""

    run: Run
    before: Track
    """By the passes before."""
    is_wanted: Bool[np.ndarray, " t"]
    begun: Callable[[], FurtherPass]
    is_backward: bool = True
    called: str = "backwards"

    @property
    def shares(self) -> tuple[Share, ...]:
        """What can be worked on side by side."""
        overlap = np.where(self.before.has_hand, self.before.measures["overlap"], np.nan)
        return shares_of(overlap, self.is_wanted, is_backward=self.is_backward)

    def steps(self, share: Share) -> Iterator[_Step]:
        """A share, frame by frame as they are done."""
        follower = None
        for frame in _frames(self.run, share.followed, is_backward=self.is_backward):
            row = int(np.searchsorted(self.before.frame, frame.index))
            if not self.is_wanted[row]:
                follower = None
                continue
            follower = follower or self.begun()
            step = self._step(follower, frame, row)
            if row in share.told:
                yield step

    def _step(self, follower: FurtherPass, frame: RecordedFrame, row: int) -> _Step:
        started, run = time.perf_counter(), self.run
        pose = torch.from_numpy(self.before.pose[row])
        second = follower.step(frame.views, frame.time_s, pose if bool(pose.isfinite().all()) else None)
        names = [camera.name for camera in run.recording.cameras]
        record = record_of(frame.index, second.estimate, names, seconds=time.perf_counter() - started)
        own = {
            EVIDENCE: second.evidence,
            EVIDENCE_BEFORE: second.evidence_before,
            IS_NEW: second.estimate.is_new,
            IS_SURE: run.tracker.is_sure(second.estimate),
        }
        others = None if second.alternatives is None else sent_to(second.alternatives, HOST)
        return _Step(row=row, line=record.with_measures(own).as_json(), alternatives=others)


def _follow(one: _Pass, writer: TrackWriter, say: Say, workers: int) -> dict[int, Alternatives]:
    """Writes another pass; hands that explain the pictures about as well, by rows, where others were looked for."""
    if one.run.keypoints is not None:
        one.run.keypoints.rewind()
    alternatives = dict[int, Alternatives]()
    with (
        writer.lines_beside(BACKWARD_NAME) as lines,
        progress(f"{one.run.recording.name}, {one.called}", int(one.is_wanted.sum()), say) as bar,
    ):
        for steps in _all_steps(one, workers):
            for step in steps:
                lines.append(step.line)
                if step.alternatives is not None:
                    alternatives[step.row] = step.alternatives
            bar.update(frames=len(steps))
    return alternatives


def _all_steps(one: _Pass, workers: int) -> Iterator[Sequence[_Step]]:
    """Those of all shares as they are done: one by one; where copies of this process can be made, which work on shares,
    a share's at a time, in no order."""
    shares = one.shares
    copies = copies_for(len(shares), workers, one.run.tracker.device)
    if copies is None:
        for share in shares:
            yield from ([step] for step in one.steps(share))
        return

    def work(share: Share) -> bytes:
        return pickle.dumps(list(one.steps(share)), pickle.HIGHEST_PROTOCOL)  # tensors by their values

    for _, found in copies.done(lambda: work, shares):
        yield pickle.loads(found)


def _frames(run: Run, rows: range, *, is_backward: bool) -> Iterator[RecordedFrame]:
    """Frames of a recording by their places in it, with what a detector found in them."""
    with contextlib.ExitStack() as stack:
        frames = (
            reversed_frames(run.recording, rows)
            if is_backward
            else islice(stack.enter_context(run.recording.opened(rows.start)), len(rows))
        )
        for frame in frames:
            yield with_keypoints(frame, run.keypoints, None)
