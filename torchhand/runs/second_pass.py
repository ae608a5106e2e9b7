"""The second pass over a recording that was tracked: from the last frame to the first, then one result from both."""

import sys
import time

import numpy as np
import torch
from tqdm import tqdm

from torchhand.files import Track, TrackWriter, load_track
from torchhand.files.results import BACKWARD_NAME, JSONL_NAME
from torchhand.runs.keypoint_tracks import with_keypoints
from torchhand.runs.recording import reversed_frames
from torchhand.runs.records import (
    EVIDENCE,
    EVIDENCE_BEFORE,
    IS_NEW,
    IS_SURE,
    TwoPasses,
    joined_records,
    record_of,
)
from torchhand.runs.run import Run, Say
from torchhand.track import BackwardPass


def smooth_frames(run: Run, writer: TrackWriter, say: Say) -> None:
    """Estimate the frames of a finished forward pass again, by those that come after them too.

    What the second pass finds grows in a file of its own; the forward pass is kept beside the result, so that a run
    that is stopped here and resumed does the second pass anew and ends with the same.
    """
    forward = load_track(writer.folder / JSONL_NAME)
    if run.state is None or run.shape is None or not forward.has_hand.any():
        return
    writer.keep_forward()
    say("second pass: the hand is followed back from the last frame to the first (--causal does without)")
    _follow_back(run, writer, forward)
    passes = TwoPasses.of(forward, load_track(writer.folder / BACKWARD_NAME))
    cameras = run.tracker.own_cameras
    camera = cameras[0] if len(cameras) == 1 else None
    for record in joined_records(passes, run.tracker.kinematics, run.shape, camera):
        writer.correct(record)
    writer.drop(BACKWARD_NAME)


def _follow_back(run: Run, writer: TrackWriter, forward: Track) -> None:
    assert run.state is not None
    recording, follower = run.recording, BackwardPass(run.tracker, run.state)
    names = [camera.name for camera in recording.cameras]
    rows = {int(frame): row for row, frame in enumerate(forward.frame)}
    has_hand = forward.has_hand
    count = int(np.flatnonzero(has_hand)[-1]) + 1  # nothing is followed back from a later frame
    if run.keypoints is not None:
        run.keypoints.rewind()
    with (
        writer.lines_beside(BACKWARD_NAME) as lines,
        tqdm(
            total=count,
            desc=f"{recording.name}, backwards",
            unit="frame",
            dynamic_ncols=True,
            disable=not sys.stderr.isatty(),
        ) as bar,
    ):
        for frame in reversed_frames(recording, count):
            started, row = time.perf_counter(), rows[frame.index]
            views = with_keypoints(frame, run.keypoints, None).views
            pose = torch.from_numpy(forward.pose[row]) if has_hand[row] else None
            second = follower.step(views, frame.time_s, pose)
            seconds = time.perf_counter() - started
            record = record_of(frame.index, second.estimate, names, seconds=seconds)
            own = {
                EVIDENCE: second.evidence,
                EVIDENCE_BEFORE: second.evidence_before,
                IS_NEW: second.estimate.is_new,
                IS_SURE: run.tracker.is_sure(second.estimate),
            }
            lines.append(record.with_measures(own).as_json())
            bar.update()
