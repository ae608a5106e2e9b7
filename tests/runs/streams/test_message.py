"""What a stream tells: everything of the record, strict JSON, and OSC that reads back."""

import json
import struct
from typing import Any

import numpy as np
import pytest

from torchhand.files import FrameRecord
from torchhand.hand import DOFS, JOINT_DOFS
from torchhand.runs.streams.message import message_of, osc_bundle


def record(frame: int = 7) -> FrameRecord:
    rng = np.random.default_rng(frame)
    return FrameRecord(
        frame=frame,
        time_s=0.25,
        status="tracked",
        pose=rng.normal(size=36),
        pose_std=rng.uniform(0.01, 0.2, 36),
        keypoints3d=rng.normal(size=(21, 3)),
        keypoints2d=rng.uniform(0, 600, (21, 2)),
        keypoints3d_cov=np.tile(np.diag([1e-6, 4e-6, 4e-6]), (21, 1, 1)),
        seconds=0.03,
        finger_quality=np.array([0.1, 0.5, 0.9, np.nan, 1.0]),
        measures={"quality": 0.75},
        reason="",
    )


def test_a_message_holds_the_record() -> None:
    one = record()
    message = message_of(one, side="left")
    assert (message["frame"], message["time_s"], message["status"], message["side"]) == (7, 0.25, "tracked", "left")
    assert list(message["angles"]) == list(JOINT_DOFS)
    np.testing.assert_allclose(list(message["angles"].values()), one.pose[6:], atol=1e-6)
    np.testing.assert_allclose(list(message["angles_std"].values()), one.pose_std[6:], atol=1e-6)
    np.testing.assert_allclose([*message["wrist"]["position"], *message["wrist"]["rotation"]], one.pose[:6], atol=1e-6)
    np.testing.assert_allclose(message["keypoints"], one.keypoints3d, atol=1e-6)
    np.testing.assert_allclose(message["keypoints_std"], np.sqrt(3e-6), atol=1e-6)
    assert one.keypoints2d is not None
    np.testing.assert_allclose(message["keypoints_px"], one.keypoints2d, atol=1e-6)
    assert message["quality"] == 0.75
    assert message["finger_quality"] == [0.1, 0.5, 0.9, None, 1.0]
    assert len(json.dumps(message, allow_nan=False).encode()) < 8000  # far below what a datagram holds


def test_a_frame_without_a_hand_is_told_without_numbers() -> None:
    empty = FrameRecord.empty(3, "lost", dofs=len(DOFS), seconds=0.1, time_s=0.5, reason="out of view")
    message = message_of(empty, side="right")
    assert message["status"] == "lost"
    for name in ("wrist", "angles", "angles_std", "keypoints", "keypoints_std", "keypoints_px", "quality"):
        assert message[name] is None
    json.dumps(message, allow_nan=False)
    assert message["finger_quality"] is None
    assert [address for address, _ in read_osc(osc_bundle(message))] == ["/torchhand/frame"]


def test_an_osc_bundle_holds_the_message() -> None:
    message = message_of(record(), side="right")
    found = dict(read_osc(osc_bundle(message)))
    assert found["/torchhand/frame"] == [7, 0.25, "tracked", "right"]
    assert found["/torchhand/angles"] == pytest.approx(list(message["angles"].values()), abs=1e-6)
    assert found["/torchhand/angles_std"] == pytest.approx(list(message["angles_std"].values()), abs=1e-6)
    assert found["/torchhand/wrist"] == pytest.approx(
        [*message["wrist"]["position"], *message["wrist"]["rotation"]], abs=1e-6
    )
    assert np.reshape(found["/torchhand/keypoints"], (21, 3)) == pytest.approx(np.array(message["keypoints"]), abs=1e-6)
    assert np.isnan(found["/torchhand/finger_quality"][3])


def read_osc(data: bytes) -> list[tuple[str, list[Any]]]:
    """A reader written from the OSC 1.0 specification."""
    assert data[:8] == b"#bundle\0"
    assert len(data) % 4 == 0
    at, found = 16, []
    while at < len(data):
        (size,) = struct.unpack_from(">i", data, at)
        found.append(_read_message(data[at + 4 : at + 4 + size]))
        at += 4 + size
    assert at == len(data)
    return found


def _read_message(data: bytes) -> tuple[str, list[Any]]:
    def text(at: int) -> tuple[str, int]:
        end = data.index(b"\0", at)
        return data[at:end].decode("ascii"), at + 4 * ((end - at) // 4 + 1)

    address, at = text(0)
    tags, at = text(at)
    values: list[Any] = []
    assert tags[0] == ","
    for tag in tags[1:]:
        if tag == "s":
            value, at = text(at)
        else:
            (value,) = struct.unpack_from({"i": ">i", "f": ">f"}[tag], data, at)
            at += 4
        values.append(value)
    assert at == len(data)
    return address, values
