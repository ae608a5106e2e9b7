"""All errors of one tracked sequence, as plain numbers ready for a file or a table."""

import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from torchhand.errors import InputError
from torchhand.evaluate.angles import (
    FLEXIONS_OF_FINGERS,
    flexion_deg,
    proximal_turns_deg,
    proximal_turns_in_space_deg,
    without_offset,
    wrapped_deg,
)
from torchhand.evaluate.continuity import continuity
from torchhand.evaluate.finite import is_finite_set, max_finite, mean_finite, median_finite, rms_finite
from torchhand.evaluate.nees import area_under_curve, consistency, fraction_in_band
from torchhand.evaluate.planar_motion import planar_motion_errors
from torchhand.evaluate.positions import (
    MIDDLE_MCP,
    WRIST,
    aligned_errors,
    fingertip_distances,
    fingertip_errors,
    joint_errors,
    root_relative_errors,
)
from torchhand.evaluate.tracked_silhouettes import MaskOfFrame
from torchhand.evaluate.truth import Truth, load_mask
from torchhand.files import Detections, Track
from torchhand.files.results import DETERMINED
from torchhand.hand import FINGERS, KEYPOINTS, TIPS, bone_directions
from torchhand.image import hand_region, intersection_over_union

GOOD_FRAME_MM = 20.0
MM_PER_M = 1000.0

Figures = dict[str, Any]


def evaluate(
    track: Track, truth: Truth, predicted_mask: MaskOfFrame | None = None, detections: Detections | None = None
) -> Figures:
    """Judge a sequence; frames are matched by number, single pictures by name where both sides have names.

    A section that the inputs do not allow is missing. `predicted_mask` gives the hand's silhouette of a frame number
    (None where there is none). `detections`: points in space of a detector, which are judged by themselves on the same
    frames. Figures of nothing (all frames lost) are NaN.

    Raises:
        InputError: a frame number that the truth does not have: this is another sequence's truth.
    """
    track = _matched(track, truth)
    rows = track.frame
    if truth.frames is not None and rows.size and not (rows.min() >= 0 and rows.max() < truth.frames):
        outside = int(rows.max()) if rows.max() >= truth.frames else int(rows.min())
        raise InputError(
            f"{truth.source}: expected the truth of the tracked sequence, but it holds frames 0 to {truth.frames - 1} "
            f"and the result has frame {outside}"
        )
    figures: Figures = {"tracking": _tracking(track, truth)}
    if truth.keypoints3d is not None:
        figures["position_mm"] = _positions(track, truth.keypoints3d[rows])
        turns = _turns_in_space(track, truth.keypoints3d[rows])
        if turns is not None:
            figures["turn_in_space_deg"] = turns
    if truth.keypoints2d is not None and track.keypoints2d is not None:
        true_px = truth.keypoints2d[rows]
        figures["position_2d_px"] = _summary(joint_errors(track.keypoints2d, true_px))
        motion = _planar_motion(track, true_px)
        if motion is not None:
            figures["planar_motion"] = motion
    if truth.keypoints3d is not None:
        if track.finger_quality is not None:
            figures["quality"] = _quality(track, track.finger_quality, truth.keypoints3d[rows])
        figures["status"] = _status(track, truth.keypoints3d[rows], is_one_camera=track.keypoints2d is not None)
    true_flexion = truth.flexion_deg
    if true_flexion is None and truth.keypoints3d is not None:
        true_flexion = flexion_deg(truth.keypoints3d)
    if true_flexion is not None:
        figures["flexion_deg"] = _flexion(track.keypoints3d, true_flexion[rows])
        honesty = _flexion_uncertainty(track, true_flexion[rows])
        if honesty is not None:
            figures["flexion_uncertainty"] = honesty
    if detections is not None and truth.keypoints3d is not None and true_flexion is not None:
        figures["detector"] = _detector(track, detections, truth.keypoints3d[rows], true_flexion[rows])
    if truth.mask_files and predicted_mask is not None:
        overlap = _silhouettes(track, truth, predicted_mask)
        if overlap["frames"]:
            figures["silhouette"] = overlap
    own_overlap = track.measures.get("overlap", np.empty(0))
    if np.isfinite(own_overlap).any():
        figures["overlap_with_own_segmentation"] = {"median": median_finite(own_overlap)}
    if truth.keypoints3d is not None:
        missed = track.keypoints3d - truth.keypoints3d[rows]
        honesty = consistency(missed, track.keypoints3d_cov)
        if honesty is not None:
            figures["uncertainty"] = {**asdict(honesty), "by_joint": _by_joint(missed, track)}
    ms = 1e3 * track.seconds
    figures["speed"] = {"median_ms_per_frame": median_finite(ms), "largest_ms_per_frame": max_finite(ms)}
    return figures


def _matched(track: Track, truth: Truth) -> Track:
    """The track with its frames numbered as the truth's rows."""
    if track.image is None or truth.image is None:
        return track
    numbers = {name: row for row, name in enumerate(truth.image)}
    missing = [str(name) for name in track.image if str(name) not in numbers]
    if missing:
        raise InputError(f"{truth.source}: image: expected the names of all pictures, {missing[0]} is not among them")
    return replace(track, frame=np.array([numbers[str(name)] for name in track.image], dtype=np.int64))


def _tracking(track: Track, truth: Truth) -> Figures:
    figures: Figures = {"frames_of_truth": truth.frames, **asdict(continuity(track.status.tolist()))}
    if truth.keypoints3d is not None and len(track.frame):
        true = truth.keypoints3d[track.frame]
        for name, errors in (
            ("share_largest_error_below_20mm", joint_errors(track.keypoints3d, true)),
            ("share_largest_root_relative_error_below_20mm", root_relative_errors(track.keypoints3d, true)),
        ):
            largest = MM_PER_M * errors.max(axis=-1)  # NaN where any joint is unknown: such a frame is not below
            figures[name] = float(np.mean(largest < GOOD_FRAME_MM))
    return figures


def _status(track: Track, true: Float[np.ndarray, "frames 21 3"], *, is_one_camera: bool) -> Figures:
    """How often the status is wrong: frames with an estimate whose worst fingertip is more than 20 mm from the truth,
    for one camera across the line of sight; and frames with a hand that were given up."""
    distance = MM_PER_M * fingertip_distances(track.keypoints3d, true, is_one_camera=is_one_camera)
    has_hand, has_estimate = (np.asarray(np.isfinite(one).all(axis=1)) for one in (true[:, list(TIPS), 0], distance))
    off = distance[has_estimate].max(1) > GOOD_FRAME_MM
    return {
        "fraction_tracked_with_a_tip_beyond_20mm": float(off.mean()) if off.size else math.nan,
        "fraction_with_a_hand_but_lost": float((~has_estimate[has_hand]).mean()) if has_hand.any() else math.nan,
    }


def _quality(track: Track, quality: Float[np.ndarray, "frames 5"], true: Float[np.ndarray, "frames 21 3"]) -> Figures:
    """How often fingers that were called determined were wrong, and those that were not; a finger is wrong whose tip is
    more than 20 mm off once the hands are laid over one another. The same of frames by their quality, wrong as
    `_status` has it."""
    fingers = MM_PER_M * fingertip_errors(track.keypoints3d, true)
    is_one_camera = track.keypoints2d is not None
    hands = MM_PER_M * fingertip_distances(track.keypoints3d, true, is_one_camera=is_one_camera).max(-1)
    whole = track.measures.get("quality", np.full(len(track), np.nan))
    return {
        "fingers": _told_apart(quality, fingers > GOOD_FRAME_MM, np.isfinite(fingers)),
        "each_finger": {
            name: _told_apart(quality[:, i], fingers[:, i] > GOOD_FRAME_MM, np.isfinite(fingers[:, i]))
            for i, name in enumerate(FINGERS)
        },
        "frames": _told_apart(whole, hands > GOOD_FRAME_MM, np.isfinite(hands)),
    }


def _told_apart(quality: np.ndarray, is_wrong: np.ndarray, is_known: np.ndarray) -> Figures:
    """Numbers of those of high and low quality, the shares of these that are wrong, the mean quality of all, and the
    probability that a right one has a higher quality than a wrong one (area under the ROC curve)."""
    known = is_known & np.isfinite(quality)
    told, wrong = torch.from_numpy(quality[known]), torch.from_numpy(is_wrong[known])
    is_high = told >= DETERMINED
    return {
        "determined": int(is_high.sum()),
        "fraction_of_determined_wrong": float(wrong[is_high].double().mean()),
        "undetermined": int((~is_high).sum()),
        "fraction_of_undetermined_wrong": float(wrong[~is_high].double().mean()),
        "mean_quality": float(told.mean()) if len(told) else math.nan,
        "fraction_right": float((~wrong).double().mean()),
        "area_under_curve": area_under_curve(told, ~wrong),
    }


def _by_joint(missed: Float[np.ndarray, "frames 21 3"], track: Track) -> dict[str, Figures]:
    """What is known of every joint by itself: share of its frames inside its 95 % region, and its root mean square
    error along an axis, along its bone, and along an axis across that."""
    inside, weight = fraction_in_band(missed, track.keypoints3d_cov)
    counted = weight.sum(0)
    axis = bone_directions(torch.from_numpy(track.keypoints3d)).numpy()
    along = (missed * axis).sum(-1, keepdims=True)
    across = np.linalg.norm(missed - along * axis, axis=-1) / math.sqrt(2)
    return {
        name: {
            "fraction_in_95_percent_band": float(inside[:, i].sum() / counted[i]) if counted[i] else math.nan,
            "rms_along_an_axis_mm": MM_PER_M * rms_finite(missed[:, i]),
            "rms_along_its_bone_mm": MM_PER_M * rms_finite(along[:, i]),
            "rms_across_its_bone_mm": MM_PER_M * rms_finite(across[:, i]),
        }
        for i, name in enumerate(KEYPOINTS)
    }


def _positions(track: Track, true: Float[np.ndarray, "frames 21 3"]) -> Figures:
    errors = {
        "frame": joint_errors(track.keypoints3d, true),
        "root_relative": root_relative_errors(track.keypoints3d, true),
        "aligned": aligned_errors(track.keypoints3d, true),
    }
    return {name: _summary(MM_PER_M * values) for name, values in errors.items()}


def _summary(errors: Float[np.ndarray, "frames joints"]) -> Figures:
    return {"mean": mean_finite(errors), "median": median_finite(errors), "largest": max_finite(errors)}


def _planar_motion(track: Track, true_px: Float[np.ndarray, "frames 21 2"]) -> Figures | None:
    assert track.keypoints2d is not None
    motion = planar_motion_errors(track.keypoints2d, true_px)
    if motion is None:
        return None
    turns = [proximal_turns_deg(points, motion.reference) for points in (track.keypoints2d, true_px)]
    spreading = np.delete(np.abs(wrapped_deg(turns[0] - turns[1])), motion.reference, axis=0)
    return {
        "proximal_turn_mean_deg": mean_finite(spreading),
        "proximal_turn_largest_deg": max_finite(spreading),
        "reference_frame": int(track.frame[motion.reference]),
        "frames": int(is_finite_set(track.keypoints2d).sum()),
        "rotation_rms_deg": rms_finite(motion.rotation_deg),
        "rotation_largest_deg": max_finite(motion.rotation_deg),
        "displacement_rms_px": rms_finite(motion.displacement_px),
        "displacement_largest_px": max_finite(motion.displacement_px),
        "displacement_with_scale_rms_px": rms_finite(motion.displacement_with_scale_px),
        "displacement_with_scale_largest_px": max_finite(motion.displacement_with_scale_px),
        "scale_rms_percent": rms_finite(motion.scale_percent),
        "true_scale_largest_change_percent": max_finite(100.0 * (motion.true_scale - 1.0)),
    }


def _turns_in_space(track: Track, true: Float[np.ndarray, "frames 21 3"]) -> Figures | None:
    """Turns of the proximal phalanges since the first frame that is known; None with fewer than two such frames."""
    known = np.flatnonzero(is_finite_set(track.keypoints3d) & is_finite_set(true))
    if len(known) < 2:
        return None
    reference = int(known[0])
    turns = [proximal_turns_in_space_deg(points, reference) for points in (track.keypoints3d, true)]
    errors = np.delete(np.abs(turns[0] - turns[1]), reference, axis=0)
    return {
        "reference_frame": int(track.frame[reference]),
        "mean": mean_finite(errors),
        "largest": {finger: max_finite(errors[:, i]) for i, finger in enumerate(FINGERS)},
    }


def _detector(
    track: Track,
    detections: Detections,
    true: Float[np.ndarray, "frames 21 3"],
    true_deg: Float[np.ndarray, "frames 5 3"],
) -> Figures:
    """A detector's points in space by themselves, in the frames of a track: what does not depend on where they are."""
    unknown = np.full((len(KEYPOINTS), 3), np.nan)
    if track.image is not None and detections.image is not None:
        found = [detections.in_picture(str(name)) for name in track.image]
    else:
        found = [detections.at_frame(int(number)) for number in track.frame]
    points = np.stack([unknown if one is None or one.space is None else one.space for one in found])
    return {
        "frames": int(is_finite_set(points).sum()),
        "aligned_mm": _summary(MM_PER_M * aligned_errors(points, true)),
        "flexion_deg": _flexion(points, true_deg),
    }


def _flexion(points: Float[np.ndarray, "frames 21 3"], true_deg: Float[np.ndarray, "frames 5 3"]) -> Figures:
    own_deg = flexion_deg(points)
    errors = own_deg - true_deg
    return {
        "mean": mean_finite(np.abs(without_offset(errors))),
        "raw_mean": mean_finite(np.abs(errors)),
        "range": _closing(own_deg),
        "true_range": _closing(true_deg),
    }


def _flexion_uncertainty(track: Track, true_deg: Float[np.ndarray, "frames 5 3"]) -> Figures | None:
    """How honest the standard deviations of the fingers' flexions are, each joint's offset removed; None where none is
    told. Without the thumb, whose angles are about axes of their own."""
    names = [name for finger in FLEXIONS_OF_FINGERS for name in finger]
    if not set(names) <= set(track.dof_names):
        return None
    errors = without_offset(flexion_deg(track.keypoints3d) - true_deg)[:, 1:].reshape(len(track), len(names), 1)
    std = np.degrees(track.pose_std[:, [track.dof_names.index(name) for name in names]])
    variance = np.square(std)[..., None, None]
    honesty, (inside, weight) = consistency(errors, variance), fraction_in_band(errors, variance)
    if honesty is None:
        return None
    return {"mean_per_dof": honesty.mean_per_dof, "fraction_in_95_percent_band": float(inside.sum() / weight.sum())}


def _closing(flexion: Float[np.ndarray, "frames 5 3"]) -> list[float]:
    """Smallest and largest flexion of the recording, summed over MCP, PIP and DIP, mean of the four fingers."""
    closed = flexion[:, 1:].sum(-1).mean(-1)
    closed = closed[np.isfinite(closed)]
    return [float(closed.min()), float(closed.max())] if closed.size else [math.nan, math.nan]


def _silhouettes(track: Track, truth: Truth, predicted_mask: MaskOfFrame) -> Figures:
    overlaps = []
    for number in track.frame.tolist():
        predicted = predicted_mask(number) if number in truth.mask_files else None
        if predicted is None:
            continue
        true = load_mask(truth.mask_files[number])
        if true.shape != predicted.shape:
            raise InputError(
                f"{truth.mask_files[number]}: expected a mask of {predicted.shape[1]}x{predicted.shape[0]} pixels, "
                f"got {true.shape[1]}x{true.shape[0]}"
            )
        region = None
        if truth.keypoints2d is not None:
            wrist, middle = torch.from_numpy(truth.keypoints2d[number, [WRIST, MIDDLE_MCP]])
            region = hand_region((true.shape[0], true.shape[1]), wrist, middle)
        overlap = intersection_over_union(torch.from_numpy(true), torch.from_numpy(predicted), region)
        overlaps.append(float(overlap))
    values = np.asarray(overlaps, dtype=np.float64)
    known = values[np.isfinite(values)]
    return {
        "frames": len(overlaps),
        "median_iou": median_finite(values),
        "mean_iou": mean_finite(values),
        "smallest_iou": float(known.min()) if known.size else float("nan"),
    }
