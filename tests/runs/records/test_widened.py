"""Covariances of records with what the pictures leave open."""

import numpy as np
import pytest
import torch

from torchhand.files import FrameRecord, load_hand_model
from torchhand.hand import DOFS, KEYPOINTS, HandKinematics, HandPose
from torchhand.runs.records import widened
from torchhand.track import Alternatives

BEND, TIP = DOFS.index("middle_pip_fe"), KEYPOINTS.index("middle_tip")
BENT_RAD = 1.2
FRAMES = 7


@pytest.fixture(scope="module")
def kinematics() -> HandKinematics:
    return load_hand_model().kinematics(dtype=torch.float64)


def _pose(bend: float) -> HandPose:
    dofs = torch.zeros(len(DOFS), dtype=torch.float64)
    dofs[2], dofs[BEND] = 0.5, bend
    return HandPose.of(dofs).normalized()


def _keypoints(kinematics: HandKinematics, pose: HandPose) -> torch.Tensor:
    return kinematics(pose.dofs, kinematics.default_shape, root_reference=pose.reference).keypoints


@pytest.fixture(scope="module")
def records(kinematics: HandKinematics) -> list[FrameRecord]:
    """A hand with straight fingers that does not move; there is none in the last frame."""
    pose = _pose(0.0)
    hands = [
        FrameRecord(
            frame=frame,
            status="tracked",
            pose=pose.vector.numpy(),
            pose_std=np.where(np.arange(len(DOFS)) == BEND, 0.1, 0.0),
            keypoints3d=_keypoints(kinematics, pose).numpy(),
            keypoints2d=None,
            keypoints3d_cov=np.tile(1e-6 * np.eye(3), (len(KEYPOINTS), 1, 1)),
            seconds=0.0,
            finger_quality=np.full(5, 0.9),
            measures={"quality": 0.8},
        )
        for frame in range(FRAMES - 1)
    ]
    return [*hands, FrameRecord.empty(FRAMES - 1, "lost", dofs=len(DOFS), seconds=0.0, has_keypoints2d=False)]


def _alternatives(kinematics: HandKinematics, *nats: float) -> Alternatives:
    """The hand itself and, where a second cost is given, one whose middle finger is bent."""
    poses = [_pose(bend) for bend in (0.0, BENT_RAD)[: len(nats)]]
    cost = torch.tensor(nats, dtype=torch.float64)
    return Alternatives(
        pose=HandPose.stack(poses),
        keypoints=torch.stack([_keypoints(kinematics, pose) for pose in poses]),
        cost=cost,
        correlated_cost=cost,
        row=(0,),
    )


def _spread(record: FrameRecord) -> float:
    """Square metres of the middle fingertip beyond the covariance before."""
    return float(np.trace(record.keypoints3d_cov[TIP])) - 3e-6


def test_two_hands_that_explain_a_picture_alike_are_both_in_the_covariance(
    kinematics: HandKinematics, records: list[FrameRecord]
) -> None:
    found = widened(records, {row: _alternatives(kinematics, 0.0, 0.0) for row in (1, 4)})[1]
    away = _keypoints(kinematics, _pose(BENT_RAD)) - _keypoints(kinematics, _pose(0.0))
    assert _spread(found) == pytest.approx(0.5 * float(away[TIP].square().sum()), rel=1e-6)
    assert found.pose_std[BEND] == pytest.approx(np.hypot(0.1, BENT_RAD * np.sqrt(0.5)))
    assert found.measures == records[1].measures  # qualities are measured as they are
    assert found.finger_quality == pytest.approx(0.9)
    wrist = KEYPOINTS.index("wrist")
    assert found.keypoints3d_cov[wrist] == pytest.approx(records[1].keypoints3d_cov[wrist])
    assert (found.pose_std[records[1].pose_std == 0] == 0).all()  # what is held stays held
    assert (found.keypoints3d == records[1].keypoints3d).all()


def test_between_two_pictures_what_is_open_is_interpolated(
    kinematics: HandKinematics, records: list[FrameRecord]
) -> None:
    found = widened(records, {1: _alternatives(kinematics, 0.0, 0.0), 5: _alternatives(kinematics, 0.0)})
    assert _spread(found[1]) > 1e-4
    assert _spread(found[0]) == pytest.approx(_spread(found[1]))
    assert _spread(found[2]) == pytest.approx(0.75 * _spread(found[1]))
    assert _spread(found[5]) == pytest.approx(0.0, abs=1e-12)


def test_neighbouring_pictures_tell_what_one_of_them_leaves_open(
    kinematics: HandKinematics, records: list[FrameRecord]
) -> None:
    alone = widened(records, {1: _alternatives(kinematics, 0.0, 0.0)})
    told = widened(records, {1: _alternatives(kinematics, 0.0, 0.0), 4: _alternatives(kinematics, 0.0, 30.0)})
    assert _spread(told[1]) < 0.9 * _spread(alone[1])  # 0.83: a finger that moves costs 0.35 nats


def test_a_hand_that_is_less_likely_by_far_leaves_nothing_open(
    kinematics: HandKinematics, records: list[FrameRecord]
) -> None:
    found = widened(records, {2: _alternatives(kinematics, 0.0, 30.0)})
    assert _spread(found[2]) == pytest.approx(0.0, abs=1e-9)


def test_frames_without_a_hand_and_tracks_without_alternatives_stay(
    kinematics: HandKinematics, records: list[FrameRecord]
) -> None:
    found = {1: _alternatives(kinematics, 0.0, 0.0), FRAMES - 1: _alternatives(kinematics, 0.0, 0.0)}
    assert widened(records, found)[-1] is records[-1]
    assert widened(records, {}) == records
