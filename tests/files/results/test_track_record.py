"""Measures and reasons of frames: beside the estimates, in the lines and in the arrays."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

from torchhand.files.results.results import TrackWriter
from torchhand.files.results.track_file import load_track
from torchhand.files.results.track_record import STATUSES, FrameRecord, FrameStatus, TrackHeader, track_of
from torchhand.track import Estimate

HEADER = TrackHeader(dof_names=("a", "b"), source="wave.mp4", side="right", camera={})


def _record(frame: int, reason: str | None = None, **measures: float) -> FrameRecord:
    return FrameRecord.empty(frame, "lost", dofs=2, seconds=0.5, measures=measures, reason=reason)


@pytest.mark.parametrize("name", ["track.npz", "track.jsonl"])
def test_measures_and_reasons_come_back(tmp_path: Path, name: str) -> None:
    with TrackWriter(tmp_path / "out", HEADER) as writer:
        writer.append(_record(0, "", overlap=0.1 + 0.2, nis=math.nan))
        writer.append(_record(1, "edges on 3 %: ü", overlap=math.inf, nis=2.0))
    track = load_track(tmp_path / "out" / name)
    assert set(track.measures) == {"overlap", "nis"}
    np.testing.assert_array_equal(track.measures["overlap"], [0.1 + 0.2, math.nan])  # what is not finite is unknown
    np.testing.assert_array_equal(track.measures["nis"], [math.nan, 2.0])
    assert track.reason is not None
    assert track.reason.tolist() == ["", "edges on 3 %: ü"]
    with np.load(tmp_path / "out" / "track.npz", allow_pickle=False) as stored:
        assert stored["nis"].tolist()[1] == 2.0


def test_a_measure_that_comes_later_is_unknown_before() -> None:
    rows = [json.loads(record.as_json()) for record in (_record(0), _record(1, nis=1.0), _record(2))]
    track = track_of(HEADER.as_json(), rows)
    np.testing.assert_array_equal(track.measures["nis"], [math.nan, 1.0, math.nan])
    assert track.reason is None


def test_lines_without_measures_and_reasons_stay_as_they_were() -> None:
    assert list(json.loads(_record(0).as_json()))[:4] == ["frame", "status", "seconds", "pose"]
    track = track_of(HEADER.as_json(), [json.loads(_record(0).as_json())])
    assert not track.measures
    assert track.reason is None
    assert "reason" not in track.arrays()


@pytest.mark.parametrize("name", ["pose", "frame", "reason", "dof_names", "header"])
def test_a_measure_cannot_take_the_name_of_a_field(name: str) -> None:
    with pytest.raises(ValueError, match=f"measures: expected names that are not those of the record, got '{name}'"):
        replace(_record(0), measures={name: 1.0})


def test_a_tracker_says_what_a_record_takes() -> None:
    """One definition: the statuses of an estimate and of a record."""
    for result in (Estimate, FrameRecord):
        assert get_type_hints(result)["status"] is FrameStatus
    for status in get_args(FrameStatus):
        assert replace(_record(0), status=status).status == status
    assert get_args(FrameStatus) == STATUSES


@pytest.mark.parametrize("name", ["track.npz", "track.jsonl"])
def test_times_come_back_and_are_none_where_a_line_lacks_one(tmp_path: Path, name: str) -> None:
    times_s = [0.0, 0.1 + 0.2, 0.75]
    with TrackWriter(tmp_path / "out", HEADER) as writer:
        for frame, time_s in enumerate(times_s):
            writer.append(replace(_record(frame), time_s=time_s))
    track = load_track(tmp_path / "out" / name)
    assert track.time_s is not None
    assert track.time_s.tolist() == times_s  # to the last bit
    assert not track.measures
    rows = [json.loads(record.as_json()) for record in (replace(_record(0), time_s=0.0), _record(1))]
    assert track_of(HEADER.as_json(), rows).time_s is None
