"""Whole evaluations of tracks made from a truth by known changes."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from torchhand.errors import InputError
from torchhand.evaluate.angles import flexion_deg
from torchhand.evaluate.evaluation import evaluate
from torchhand.evaluate.truth import Truth, load_truth
from torchhand.files import Track
from torchhand.hand import DOFS

FRAMES = 6


def truth(**changes: object) -> Truth:
    rng = np.random.default_rng(0)
    hand = rng.normal(scale=0.05, size=(21, 3))
    drift = np.arange(FRAMES)[:, None, None] * np.array([0.01, 0.0, 0.0])
    points = hand + drift + [0.0, 0.0, 0.5]
    complete = Truth(
        source=Path("truth.npz"),
        frames=FRAMES,
        keypoints3d=points,
        keypoints2d=400.0 * points[..., :2] / 0.5,
        flexion_deg=flexion_deg(points),
    )
    return replace(complete, **changes)  # type: ignore[arg-type]


def perfect(rows: list[int]) -> Track:
    """The truth's rows as if a tracker had found them."""
    known = truth()
    assert known.keypoints3d is not None
    assert known.keypoints2d is not None
    return Track(
        frame=np.array(rows, dtype=np.int64),
        status=np.array(["tracked"] * len(rows), dtype="<U16"),
        pose=np.zeros((len(rows), 36)),
        pose_std=np.ones((len(rows), 36)),
        keypoints3d=known.keypoints3d[rows],
        keypoints2d=known.keypoints2d[rows],
        keypoints3d_cov=np.tile(1e-6 * np.eye(3), (len(rows), 21, 1, 1)),
        seconds=np.array([0.5, *[0.010] * (len(rows) - 1)])[: len(rows)],
        dof_names=tuple(f"dof{number}" for number in range(36)),
        units="",
        convention="",
        header={},
    )


def test_the_truth_itself_has_no_error() -> None:
    figures = evaluate(perfect([0, 1, 2, 3, 4, 5]), truth())
    for kind in ("frame", "root_relative", "aligned"):
        assert figures["position_mm"][kind]["largest"] < 1e-10
    assert figures["position_2d_px"]["largest"] < 1e-10
    assert figures["planar_motion"]["displacement_largest_px"] < 1e-10
    assert figures["planar_motion"]["rotation_largest_deg"] < 1e-10
    assert figures["planar_motion"]["proximal_turn_largest_deg"] < 1e-10
    assert (figures["flexion_deg"]["mean"], figures["flexion_deg"]["raw_mean"]) == (0.0, 0.0)
    assert figures["tracking"]["followed"] == FRAMES
    assert figures["tracking"]["share_largest_error_below_20mm"] == 1.0
    assert figures["speed"] == {"median_ms_per_frame": 10.0, "largest_ms_per_frame": 500.0}
    assert figures["uncertainty"]["mean_per_dof"] == 0.0
    assert "silhouette" not in figures


@pytest.mark.parametrize(("std_deg", "share"), [(2.0, 1.0), (0.5, 0.0)])
def test_flexions_are_judged_by_their_own_standard_deviations(std_deg: float, share: float) -> None:
    """Errors of a degree that take turns, in joints whose offsets are 5 degrees."""
    known = truth()
    assert known.keypoints3d is not None
    true_deg = flexion_deg(known.keypoints3d)
    told = true_deg - 5.0 - np.array([1.0, -1.0] * (FRAMES // 2))[:, None, None]
    track = replace(perfect(list(range(FRAMES))), pose_std=np.full((FRAMES, 36), np.radians(std_deg)), dof_names=DOFS)
    figures = evaluate(track, replace(known, flexion_deg=told))["flexion_uncertainty"]
    assert figures["fraction_in_95_percent_band"] == share
    assert figures["mean_per_dof"] == pytest.approx(std_deg**-2)
    assert "flexion_uncertainty" not in evaluate(perfect([0, 1, 2]), known)  # whose DOFs have other names


def test_a_result_without_frames_yet_is_evaluated() -> None:
    """As that of a run that was killed before its first frame was done."""
    figures = evaluate(replace(perfect([]), dof_names=DOFS), truth())
    assert "flexion_uncertainty" not in figures
    assert figures["tracking"]["frames_of_truth"] == FRAMES


def test_a_finger_that_spreads_too_far_is_seen_in_its_proximal_phalanx() -> None:
    track = perfect([0, 1, 2])
    assert track.keypoints2d is not None
    points = track.keypoints2d.copy()
    c, s = np.cos(np.radians(6.0)), np.sin(np.radians(6.0))
    points[2, 6] = points[2, 5] + (points[2, 6] - points[2, 5]) @ np.array([[c, -s], [s, c]]).T
    motion = evaluate(replace(track, keypoints2d=points), truth())["planar_motion"]
    assert motion["proximal_turn_largest_deg"] == pytest.approx(6.0, abs=1e-9)
    assert motion["proximal_turn_mean_deg"] == pytest.approx(6.0 / 10, abs=1e-9)  # one of five fingers in two frames


def test_a_status_is_wrong_where_a_tip_is_elsewhere_in_the_picture_and_where_a_hand_is_given_up() -> None:
    """Along the line of sight of one camera a tip may be anywhere; frame 3 is lost."""
    track = perfect([0, 1, 2, 3, 4, 5])
    points = track.keypoints3d.copy()
    points[1] *= 1.4  # farther away, in the same place of the picture
    points[2, 8] += [0.0, 0.021, 0.0]
    points[4, 8] += [0.0, 0.019, 0.0]
    points[3] = np.nan
    wrong = evaluate(replace(track, keypoints3d=points), truth())["status"]
    assert wrong["fraction_tracked_with_a_tip_beyond_20mm"] == pytest.approx(1 / 5)
    assert wrong["fraction_with_a_hand_but_lost"] == pytest.approx(1 / 6)
    wrong = evaluate(replace(track, keypoints3d=points, keypoints2d=None), truth())["status"]
    assert wrong["fraction_tracked_with_a_tip_beyond_20mm"] == pytest.approx(2 / 5)


def test_the_range_of_motion_stands_beside_that_of_the_truth() -> None:
    known = truth()
    assert known.flexion_deg is not None
    angles = evaluate(perfect([0, 1, 2, 3, 4, 5]), known)["flexion_deg"]
    closed = known.flexion_deg[:, 1:].sum(-1).mean(-1)
    assert angles["range"] == pytest.approx([closed.min(), closed.max()])
    assert angles["true_range"] == angles["range"]


def test_joints_are_judged_one_by_one() -> None:
    track = perfect([0, 1, 2, 3, 4, 5])
    points = track.keypoints3d.copy()
    points[:3, 5] += [0.003, 0.0, 0.0]  # 3 mm at a standard deviation of 1 mm: outside of what holds 95 %
    points[:, 6] += [0.002, 0.0, 0.0]  # 2 mm: inside
    joints = evaluate(replace(track, keypoints3d=points), truth())["uncertainty"]["by_joint"]
    assert joints["index_mcp"]["fraction_in_95_percent_band"] == pytest.approx(0.5)
    assert joints["index_mcp"]["rms_along_an_axis_mm"] == pytest.approx(3 / np.sqrt(6))
    assert joints["index_pip"]["fraction_in_95_percent_band"] == 1
    assert joints["wrist"]["rms_along_an_axis_mm"] == pytest.approx(0, abs=1e-9)


def test_frames_are_matched_by_number() -> None:
    """Started at frame 2 with every second frame: still the truth itself; by row it would be 20 mm off."""
    figures = evaluate(perfect([2, 4]), truth())
    assert figures["position_mm"]["frame"]["largest"] < 1e-10
    assert figures["planar_motion"]["reference_frame"] == 2
    assert figures["tracking"]["frames_of_truth"] == FRAMES


def test_lost_frames_count_in_the_shares_and_not_in_the_means() -> None:
    track = perfect([0, 1, 2, 3, 4, 5])
    points = track.keypoints3d.copy()
    points[2:4] = np.nan
    points[5, 7] += [0.0, 0.0, 0.021]
    status = np.array(["tracked", "tracked", "lost", "lost", "recovered", "tracked"])
    figures = evaluate(replace(track, keypoints3d=points, status=status), truth())
    np.testing.assert_allclose(figures["position_mm"]["frame"]["mean"], 21.0 / (4 * 21), rtol=1e-9)
    np.testing.assert_allclose(figures["position_mm"]["frame"]["largest"], 21.0, rtol=1e-9)
    tracking = figures["tracking"]
    assert tracking["share_largest_error_below_20mm"] == 0.5
    assert tracking["frames_until_first_loss"] == 2
    assert tracking["frames_to_recover"] == (2,)
    np.testing.assert_allclose(figures["uncertainty"]["samples"], 4 * 21)


def test_a_hand_that_was_never_found() -> None:
    track = perfect([0, 1])
    nowhere = replace(
        track,
        status=np.array(["no_hand", "no_hand"]),
        keypoints3d=np.full((2, 21, 3), np.nan),
        keypoints2d=np.full((2, 21, 2), np.nan),
        keypoints3d_cov=np.full((2, 21, 3, 3), np.nan),
    )
    figures = evaluate(nowhere, truth())
    assert np.isnan(figures["position_mm"]["frame"]["mean"])
    assert np.isnan(figures["flexion_deg"]["mean"])
    assert figures["tracking"]["share_largest_error_below_20mm"] == 0.0
    assert "planar_motion" not in figures
    assert "uncertainty" not in figures


def test_sections_without_their_truth_are_missing() -> None:
    figures = evaluate(perfect([0, 1]), truth(keypoints2d=None, flexion_deg=None))
    of_keypoints = {"position_mm", "turn_in_space_deg", "status", "flexion_deg", "uncertainty"}
    assert set(figures) == {"tracking", *of_keypoints, "speed"}
    figures = evaluate(perfect([0]), truth(keypoints3d=None, keypoints2d=None))
    assert set(figures) == {"tracking", "flexion_deg", "speed"}


def test_single_pictures_are_matched_by_name() -> None:
    names = ("c.png", "a.png", "b.png", "d.png", "e.png", "f.png")
    named = replace(truth(), image=names)
    track = replace(perfect([0, 2]), image=np.array(["c.png", "b.png"]), frame=np.array([1, 0]))
    assert evaluate(track, named)["position_mm"]["frame"]["largest"] < 1e-6
    with pytest.raises(InputError, match=r"z\.png"):
        evaluate(replace(track, image=np.array(["c.png", "z.png"])), named)


def test_another_sequences_truth_is_refused() -> None:
    track = replace(perfect([0, 1]), frame=np.array([4, 6]))
    with pytest.raises(InputError, match=r"truth.npz: .* holds frames 0 to 5 and the result has frame 6"):
        evaluate(track, truth())


def test_the_trackers_own_overlap_is_its_median_over_the_followed_frames() -> None:
    track = perfect([0, 1, 2, 3])
    overlap = np.array([0.9, np.nan, 0.8, 0.7])
    figures = evaluate(replace(track, measures={"overlap": overlap}), truth())
    assert figures["overlap_with_own_segmentation"] == {"median": 0.8}
    for measures in ({}, {"overlap": np.full(4, np.nan)}):
        assert "overlap_with_own_segmentation" not in evaluate(replace(track, measures=measures), truth())


def test_masks_are_compared_in_front_of_the_wrist(tmp_path: Path) -> None:
    folder = tmp_path / "masks"
    folder.mkdir()
    arm = np.zeros((20, 40), dtype=np.uint8)
    arm[5:15, 0:30] = 255
    for number in (0, 1):
        cv2.imwrite(str(folder / f"{number:04d}.png"), arm)
    points = np.zeros((2, 21, 2))
    points[:, 0], points[:, 9] = [10.0, 10.0], [25.0, 10.0]
    np.savez(tmp_path / "truth.npz", keypoints2d=points)
    known = load_truth(tmp_path)
    hand = np.zeros((20, 40), dtype=bool)
    hand[5:15, 10:25] = True

    figures = evaluate(perfect([0, 1]), known, lambda number: hand if number == 1 else None)
    assert figures["silhouette"]["frames"] == 1
    np.testing.assert_allclose(figures["silhouette"]["median_iou"], 15.0 / 20.0)
    assert "silhouette" not in evaluate(perfect([0, 1]), known, lambda _: None)
    with pytest.raises(InputError, match=r"0000.png: expected a mask of 10x20 pixels, got 40x20"):
        evaluate(perfect([0, 1]), known, lambda _: hand[:, :10])


def test_qualities_are_judged_by_what_was_wrong() -> None:
    """The index is 50 mm off in frames 0 to 2; it was called undetermined in 0 and 1, and wrongly so in 3."""
    track = perfect([0, 1, 2, 3, 4, 5])
    points = track.keypoints3d.copy()
    points[:3, 8, 0] += 0.05
    quality = np.full((6, 5), 0.9)
    quality[[0, 1, 3], 1] = 0.2
    told = evaluate(replace(track, keypoints3d=points, finger_quality=quality), truth())["quality"]
    assert told["fingers"]["undetermined"] == 3
    assert told["fingers"]["fraction_of_undetermined_wrong"] == pytest.approx(2 / 3)
    assert told["fingers"]["determined"] == 27
    assert told["fingers"]["fraction_of_determined_wrong"] == pytest.approx(1 / 27)
    # Of the nine pairs of a right and a wrong index, four are in order and four are tied.
    assert told["each_finger"]["index"]["area_under_curve"] == pytest.approx((4 + 0.5 * 4) / 9)
    assert "quality" not in evaluate(track, truth())
