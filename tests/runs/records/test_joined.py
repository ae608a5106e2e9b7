"""One track from two passes: what fills a loss, what does not, and the statuses afterwards."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from torchhand.files import Track, load_hand_model
from torchhand.hand import DOFS, HandKinematics
from torchhand.runs.records import TwoPasses, joined_records

FRAMES = 8
BEND = DOFS.index("middle_pip_fe")


@pytest.fixture(scope="module")
def kinematics() -> HandKinematics:
    return load_hand_model().kinematics(dtype=torch.float64)


def _track(kinematics: HandKinematics, bend: float, lost: tuple[int, ...] = (), **measures: float) -> Track:
    """A hand that does not move, in all frames but those that are lost."""
    pose = torch.zeros(FRAMES, 36, dtype=torch.float64)
    pose[:, 2], pose[:, BEND] = 0.5, bend
    points = kinematics(pose, kinematics.default_shape).keypoints.numpy()
    is_lost = np.isin(np.arange(FRAMES), lost)
    status = np.where(is_lost, "lost", "tracked").astype("<U16")
    for row in range(1, FRAMES):
        if is_lost[row - 1] and not is_lost[row]:
            status[row] = "recovered"
    arrays = {
        "pose": pose.numpy(),
        "pose_std": np.full((FRAMES, 36), 0.1),
        "keypoints3d": points,
        "keypoints3d_cov": np.tile(1e-6 * np.eye(3), (FRAMES, 21, 1, 1)),
    }
    for array in arrays.values():
        array[is_lost] = np.nan
    return Track(
        frame=np.arange(10, 10 + FRAMES),
        status=status,
        keypoints2d=None,
        seconds=np.full(FRAMES, 0.5),
        dof_names=DOFS,
        units="",
        convention="",
        header={},
        measures={name: np.full(FRAMES, value) for name, value in measures.items()},
        reason=np.where(is_lost, "gone", ""),
        **arrays,
    )


def _second(kinematics: HandKinematics, bend: float, lost: tuple[int, ...] = (), evidence: float = 0.0) -> Track:
    told = {"score": 0.9, "overlap": 0.9, "evidence": evidence, "evidence_before": 0.0}
    return _track(kinematics, bend, lost, **told, is_new=0.0, is_sure=1.0, nis=0.3)


def _joined(kinematics: HandKinematics, forward: Track, backward: Track) -> list:
    return list(joined_records(TwoPasses.of(forward, backward), kinematics, kinematics.default_shape, None))


def test_frames_in_which_the_passes_differ_and_those_about_them_are_open(
    kinematics: HandKinematics, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torchhand.runs.records.joined._AROUND", 1)
    forward, other = _track(kinematics, 0.2, lost=(0,)), _track(kinematics, 1.6)
    second = _second(kinematics, 0.2, lost=(0, 6))
    second.keypoints3d[3] = other.keypoints3d[3]
    second.keypoints3d[1] += (0.0, 0.0, 0.02)  # a hand that is farther off is no other one
    passes, everywhere = TwoPasses.of(forward, second), np.ones(FRAMES, dtype=bool)
    assert np.flatnonzero(passes.is_open(everywhere)).tolist() == [2, 3, 4, 5, 6, 7]
    assert np.flatnonzero(passes.is_open(np.arange(FRAMES) >= 4)).tolist() == [5, 6, 7]
    assert not TwoPasses.of(forward, _second(kinematics, 0.2, lost=(0,))).is_open(everywhere).any()


def test_the_pass_that_the_views_bear_out_is_believed(kinematics: HandKinematics) -> None:
    forward = _track(kinematics, 0.2, score=0.8, nis=0.1)
    for evidence, expected in ((5.0, 1.6), (-5.0, 0.2)):
        records = _joined(kinematics, forward, _second(kinematics, 1.6, evidence=evidence))
        assert [record.pose[BEND] for record in records] == pytest.approx([expected] * FRAMES, abs=0.02)
    assert records[0].seconds == 1.0
    assert set(records[0].measures) == {"score", "nis"}


def test_frames_that_tell_nothing_are_the_mean_of_both(kinematics: HandKinematics) -> None:
    forward = _track(kinematics, 0.2, score=0.8, nis=0.1)
    records = _joined(kinematics, forward, _second(kinematics, 0.3))
    assert [record.pose[BEND] for record in records] == pytest.approx([0.25] * FRAMES)
    assert [record.measures["score"] for record in records] == pytest.approx([0.85] * FRAMES)
    assert records[0].keypoints3d_cov[0, 0, 0] >= 1e-6


def test_a_short_loss_is_filled_by_the_hand_that_is_followed_back(kinematics: HandKinematics) -> None:
    forward = _track(kinematics, 0.2, lost=(3, 4), score=0.9, nis=0.1)
    records = _joined(kinematics, forward, _second(kinematics, 0.2))
    assert [record.status for record in records] == ["tracked"] * FRAMES
    assert np.isfinite([record.pose for record in records]).all()
    assert records[3].reason == ""


def test_frames_before_a_late_start_are_filled(kinematics: HandKinematics) -> None:
    forward = _track(kinematics, 0.2, lost=(0, 1), score=0.9, nis=0.1)
    forward = replace(forward, status=np.where(forward.status == "lost", "no_hand", "tracked"))
    records = _joined(kinematics, forward, _second(kinematics, 0.2, lost=(0,)))
    assert [record.status for record in records] == ["no_hand", *["tracked"] * (FRAMES - 1)]


def test_a_followed_hand_that_is_seen_otherwise_in_its_place_fills_a_loss(kinematics: HandKinematics) -> None:
    forward = _track(kinematics, 0.2, lost=(3, 4, 5), score=0.9, nis=0.1)
    second = _second(kinematics, 0.2)
    second.measures["is_new"][4] = 1.0
    second.pose[4, 3] += 1.0
    tilted = kinematics(torch.from_numpy(second.pose[4]), kinematics.default_shape).keypoints.numpy()
    assert np.linalg.norm(tilted - second.keypoints3d[5], axis=-1).max() > 0.1
    second.keypoints3d[4] = tilted
    records = _joined(kinematics, forward, second)
    assert [record.status for record in records] == ["tracked"] * FRAMES


def test_what_is_found_elsewhere_in_a_loss_fills_nothing(kinematics: HandKinematics) -> None:
    forward = _track(kinematics, 0.2, lost=(3, 4, 5), score=0.9, nis=0.1)
    second = _second(kinematics, 0.2)
    second.measures["is_new"][4] = 1.0
    second.keypoints3d[:5, :, 0] += 0.11
    records = _joined(kinematics, forward, second)
    assert [record.status for record in records[2:7]] == ["tracked", "lost", "lost", "recovered", "tracked"]


NOT_BORNE_OUT = pytest.mark.parametrize(
    ("name", "value"),
    [("is_sure", 0.0), ("overlap", 0.5)],
    ids=["explains too little", "worse than after the loss"],
)


@NOT_BORNE_OUT
def test_what_is_not_borne_out_for_long_fills_nothing(kinematics: HandKinematics, name: str, value: float) -> None:
    forward = _track(kinematics, 0.2, lost=(0, 1, 2, 3, 4, 5), score=0.9, nis=0.1)
    second = _second(kinematics, 0.2)
    second.measures[name][1:5] = value  # so that the frame before is not connected either
    records = _joined(kinematics, forward, second)
    assert [record.status for record in records] == ["lost"] * 5 + ["tracked"] * 3
    assert np.isnan(records[3].keypoints3d).all()
    assert records[3].reason == "gone"


@NOT_BORNE_OUT
def test_a_few_frames_in_which_a_hand_is_borne_out_less_are_bridged(
    kinematics: HandKinematics, name: str, value: float
) -> None:
    forward = _track(kinematics, 0.2, lost=(0, 1, 2, 3, 4, 5), score=0.9, nis=0.1)
    second = _second(kinematics, 0.2)
    second.measures[name][2:5] = value
    second.measures[name][0] = value
    records = _joined(kinematics, forward, second)
    assert [record.status for record in records] == ["lost"] + ["tracked"] * 7


def test_before_the_frame_from_which_on_a_hand_was_looked_for_the_overlap_decides(kinematics: HandKinematics) -> None:
    forward = _track(kinematics, 0.2, lost=(0, 1, 2, 3, 4, 5), score=0.9, nis=0.1)
    second = _second(kinematics, 0.2)
    second.measures["is_sure"][:] = 0.0
    second.measures["overlap"][0] = 0.5
    passes = TwoPasses.of(forward, second, begins_at=int(forward.frame[6]))
    records = list(joined_records(passes, kinematics, kinematics.default_shape, None))
    assert [record.status for record in records] == ["lost"] + ["tracked"] * 7


def test_a_blurred_frame_between_others_is_filled(kinematics: HandKinematics) -> None:
    forward = _track(kinematics, 0.2, lost=(2, 4, 5, 6), score=0.9, nis=0.1)
    second = _second(kinematics, 0.2)
    second.measures["is_sure"][2] = 0.0
    second.measures["is_sure"][4:7] = 0.0
    second.measures["overlap"][5] = 0.5
    records = _joined(kinematics, forward, second)
    assert [record.status for record in records] == [*["tracked"] * 5, "lost", "recovered", "tracked"]


def test_a_hand_that_is_not_the_one_after_the_loss_fills_nothing(kinematics: HandKinematics) -> None:
    forward = _track(kinematics, 0.2, lost=(3, 4), score=0.9, nis=0.1)
    second = _second(kinematics, 0.2, evidence=-50.0)
    second.keypoints3d[:] += 0.1
    records = _joined(kinematics, forward, second)
    assert [record.status for record in records[2:6]] == ["tracked", "lost", "lost", "recovered"]


def test_frames_that_the_second_pass_did_not_look_at_stay_as_they_are(kinematics: HandKinematics) -> None:
    forward = _track(kinematics, 0.2, lost=(6, 7), score=0.9, nis=0.1)
    whole = _second(kinematics, 0.2)
    rows = slice(2, 6)
    arrays = {name: getattr(whole, name)[rows] for name in ("frame", "status", "pose", "pose_std", "seconds", "reason")}
    arrays |= {name: getattr(whole, name)[rows] for name in ("keypoints3d", "keypoints3d_cov")}
    part = replace(whole, **arrays, measures={name: values[rows] for name, values in whole.measures.items()})
    records = _joined(kinematics, forward, part)
    assert [record.frame for record in records] == list(range(10, 10 + FRAMES))
    assert [record.seconds for record in records] == [0.5, 0.5, 1.0, 1.0, 1.0, 1.0, 0.5, 0.5]
    np.testing.assert_array_equal(records[0].pose, forward.pose[0])
    assert [record.status for record in records[5:]] == ["tracked", "lost", "lost"]


def test_qualities_of_fingers_are_means_as_the_passes_are_believed(kinematics: HandKinematics) -> None:
    forward, backward = (
        replace(track, finger_quality=np.full((FRAMES, 5), quality))
        for track, quality in ((_track(kinematics, 0.1), 0.2), (_second(kinematics, 0.1), 0.6))
    )
    weights = TwoPasses.of(forward, backward).weights()
    for record, weight in zip(_joined(kinematics, forward, backward), weights, strict=True):
        np.testing.assert_allclose(record.finger_quality, np.full(5, float(0.2 * weight[0] + 0.6 * weight[1])))
    lost = replace(_second(kinematics, 0.1, tuple(range(FRAMES))), finger_quality=np.full((FRAMES, 5), np.nan))
    for record in _joined(kinematics, forward, lost):
        np.testing.assert_array_equal(record.finger_quality, np.full(5, 0.2))


def test_frames_of_the_second_pass_are_told_by_their_numbers(kinematics: HandKinematics) -> None:
    """It need not have looked at all frames."""
    forward = replace(_track(kinematics, 0.1), finger_quality=np.full((FRAMES, 5), 0.2))
    qualities = np.linspace(0.3, 0.9, FRAMES)
    whole = replace(_second(kinematics, 0.1), finger_quality=qualities[:, None] * np.ones(5))
    rows = np.arange(3, FRAMES)
    arrays = ("frame", "status", "pose", "pose_std", "keypoints3d", "keypoints3d_cov", "seconds", "finger_quality")
    later = replace(
        whole,
        **{name: getattr(whole, name)[rows] for name in (*arrays, "reason")},
        measures={name: values[rows] for name, values in whole.measures.items()},
    )
    weights = TwoPasses.of(forward, later).weights()
    for row, record in enumerate(_joined(kinematics, forward, later)):
        expected = 0.2 if row < 3 else float(0.2 * weights[row, 0] + qualities[row] * weights[row, 1])
        np.testing.assert_allclose(record.finger_quality, np.full(5, expected))
