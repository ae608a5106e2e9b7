"""Measure a tracked sequence: against its truth, against another result, or by itself; print and save the figures."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from torchhand.cli.command import DONE, command, parse, threads
from torchhand.errors import InputError
from torchhand.evaluate import (
    JointRange,
    JointStability,
    MaskOfFrame,
    RecordingFacts,
    Stability,
    Truth,
    differences,
    evaluate,
    load_mask,
    load_truth,
    numbered_pictures,
    range_of_motion,
    stability,
    tracked_projector,
    tracked_silhouettes,
)
from torchhand.files import Detections, Track, load_track, read_detections
from torchhand.files.disk import write_text
from torchhand.files.results import (
    EVALUATION_NAME,
    FIT_NAME,
    HAND_NAME,
    JSONL_NAME,
    NPZ_NAME,
    RANGE_NAME,
    STABILITY_NAME,
)

TABLE = (
    ("position_mm", "frame", "joint position (camera or world frame)", "mm"),
    ("position_mm", "root_relative", "joint position (relative to the wrist)", "mm"),
    ("position_mm", "aligned", "joint position (similarity-aligned, PA)", "mm"),
)
"""Rows that have a mean, a median and a largest value."""


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Measure a tracked sequence, print the figures and save them.

    With a truth: the errors. With another result of the same recording: how far the joint angles differ, and how many
    by more than three of their combined standard deviations; how many lie in the first result's own 95 % band about the
    second's, and how far the first result's angles step from frame to frame. Without either: the range of motion, per
    joint the smallest and the largest angle of the tracked frames, each with its standard deviation.

    Examples:
        torchhand evaluate out/planar_open data/synthetic/planar_open
        torchhand evaluate out/clip out/clip_encoded_again
        torchhand evaluate out/clip
    """

    directory: Annotated[Positional[Path], arg(metavar="DIR")]
    """Result folder of `torchhand track`, `torchhand fit_pose` or `torchhand fit_keypoints`. The silhouettes judged are
    drawn from its track and hand.json; if it has masks/, one picture per frame number, these are judged instead."""
    truth: Annotated[Positional[Path | None], arg(metavar="TRUTH")] = None
    """Folder with truth.npz (keypoints3d, keypoints2d, flexion_deg; any may be missing) and masks/, or the file; or
    another result folder."""
    keypoints: Annotated[Path | None, arg(metavar="FILE")] = None
    """A detector's points in space, which are judged by themselves beside the result: a file that `torchhand track
    --keypoints` takes."""
    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """File for the figures; if not given, DIR/evaluation.json; DIR/stability.json for another result, and
    DIR/range_of_motion.json without a truth."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Judge one result folder."""
    arguments = parse(Arguments, argv, name="evaluate")
    if not arguments.directory.is_dir():
        raise InputError(f"{arguments.directory}: expected the result folder of `torchhand track`; there is none")
    track = load_track(arguments.directory)
    if arguments.truth is None:
        ranges = range_of_motion(track)
        print(range_table(ranges))
        name = RANGE_NAME
        figures: dict[str, Any] = {"range_of_motion_deg": {name: asdict(one) for name, one in ranges.items()}}
    elif _is_result(arguments.truth):
        other = load_track(arguments.truth)
        name, found = STABILITY_NAME, stability(track, other)
        print(stability_table(found))
        _note_differences(arguments, track, RecordingFacts.of_track(other))
        figures = {"stability": asdict(found)}
    else:
        name, truth = EVALUATION_NAME, load_truth(arguments.truth)
        with threads(1):
            masks = _silhouettes(arguments.directory, track, truth)
            figures = evaluate(track, truth, masks, _detections(arguments.keypoints, track))
        print(table(figures))
        told = RecordingFacts(side=truth.side, frames=None, sizes_px=truth.sizes_px)  # the table has the frames
        _note_differences(arguments, track, told)
    out = arguments.out or arguments.directory / name
    write_text(out, json.dumps(_without_nan(figures), indent=2) + "\n")
    print(f"saved {out}")
    return DONE


def _note_differences(arguments: Arguments, track: Track, other: RecordingFacts) -> None:
    found = differences(RecordingFacts.of_track(track), other)
    if found:
        print(f"note: {arguments.directory} and {arguments.truth} differ: {'; '.join(found)}")


def _is_result(folder: Path) -> bool:
    """Whether it holds a track in place of a truth."""
    names = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    return "truth.npz" not in names and not names.isdisjoint((NPZ_NAME, JSONL_NAME, FIT_NAME))


def stability_table(found: Stability) -> str:
    """The differences as text, one line per joint, all together last."""
    title = "joint angle (degrees)"
    rows: dict[str, JointStability] = {**found.joints, "all": found.whole}
    width = max(map(len, (*rows, title)))
    heads = ("over 3 std", "in own band", "   RMS", "median", "95th percentile", "largest step", "steps over 15")
    lines = [f"{title:<{width}}  {'  '.join(heads)}"]
    for name, one in rows.items():
        texts = (
            f"{one.fraction_apart:.1%}",
            f"{one.fraction_in_own_band:.1%}",
            *(f"{value:.1f}" for value in (one.rms_deg, one.median_deg, one.percentile95_deg, one.largest_step_deg)),
            f"{one.large_steps}",
        )
        cells = (f"{text:>{max(len(head), 6)}}" for text, head in zip(texts, heads, strict=True))
        lines.append(f"{name:<{width}}  {'  '.join(cells)}")
    lines.append(f"{found.frames} frames with a hand in both results, {found.frames_in_one} in one alone")
    return "\n".join(lines)


def _detections(path: Path | None, track: Track) -> Detections | None:
    """Raises InputError for a file without points in space."""
    if path is None:
        return None
    found = read_detections(path)
    if found.space is None:
        raise InputError(f"--keypoints: expected points in space, such as MediaPipe's world landmarks; {path} has none")
    return found


def _silhouettes(directory: Path, track: Track, truth: Truth) -> MaskOfFrame | None:
    """The silhouettes of a result folder, None where they need not or cannot be known."""
    masks = numbered_pictures(directory / "masks")
    if masks:
        return lambda number: load_mask(masks[number]) if number in masks else None
    hand_file = directory / HAND_NAME
    if not truth.mask_files or not hand_file.is_file():
        return None
    return tracked_silhouettes(track, tracked_projector(track, hand_file))


def range_table(ranges: Mapping[str, JointRange]) -> str:
    """The ranges as text, one line per joint."""
    title = "joint angle (degrees)"
    width = max(map(len, (*ranges, title)))
    lines = [f"{title:<{width}}  {'smallest':>15}  {'frame':>6}  {'largest':>15}  {'frame':>6}  {'range':>6}"]
    for name, one in ranges.items():
        low = f"{one.smallest_deg:.1f} ± {one.smallest_std_deg:.1f}"
        high = f"{one.largest_deg:.1f} ± {one.largest_std_deg:.1f}"
        ends = f"{low:>15}  {one.smallest_frame:>6}  {high:>15}  {one.largest_frame:>6}"
        lines.append(f"{name:<{width}}  {ends}  {one.range_deg:>6.1f}")
    return "\n".join(lines)


def table(figures: dict[str, Any]) -> str:
    """The figures as text, one line each; what could not be judged is missing."""
    lines = _tracking_lines(figures["tracking"])
    for section, key, label, unit in TABLE:
        if section in figures:
            lines.append((label, _three(figures[section][key], unit)))
    if "position_2d_px" in figures:
        lines.append(("joint position in the picture", _three(figures["position_2d_px"], "px")))
    if "planar_motion" in figures:
        lines += _planar_lines(figures["planar_motion"])
    if "turn_in_space_deg" in figures:
        turns = figures["turn_in_space_deg"]
        worst = ", ".join(f"{finger} {largest:.1f}" for finger, largest in turns["largest"].items())
        since = f"turn of the proximal phalanges in space since frame {turns['reference_frame']}"
        lines.append((since, f"mean error {turns['mean']:.2f}°, largest {worst}°"))
    if "flexion_deg" in figures:
        angles = figures["flexion_deg"]
        lines.append(
            ("flexion, each joint's offset removed", f"mean {angles['mean']:.2f}°, raw {angles['raw_mean']:.2f}°")
        )
        (low, high), (true_low, true_high) = angles["range"], angles["true_range"]
        text = f"{low:.0f}° to {high:.0f}° (truth {true_low:.0f}° to {true_high:.0f}°)"
        lines.append(("flexion of a finger over MCP, PIP and DIP", text))
    if "flexion_uncertainty" in figures:
        honesty = figures["flexion_uncertainty"]
        share, squared = honesty["fraction_in_95_percent_band"], honesty["mean_per_dof"]
        text = f"{share:.0%} (95 % or more: not too sure); squared errors {squared:.2f} of what was expected"
        lines.append(("flexions of fingers inside their 95 % band", text))
    if "detector" in figures:
        alone = figures["detector"]
        angles, (low, high) = alone["flexion_deg"], alone["flexion_deg"]["range"]
        text = f"flexion mean {angles['mean']:.2f}°, {low:.0f}° to {high:.0f}°, PA {alone['aligned_mm']['mean']:.2f} mm"
        lines.append((f"the detector alone, in {alone['frames']} frames", text))
    if "status" in figures:
        wrong = figures["status"]
        lines.append(
            ("tracked, but a tip over 20 mm off", f"{wrong['fraction_tracked_with_a_tip_beyond_20mm']:.1%} of frames")
        )
        lines.append(("lost, but there is a hand", f"{wrong['fraction_with_a_hand_but_lost']:.1%} of frames"))
    if "quality" in figures:
        lines += _quality_lines(figures["quality"])
    if "silhouette" in figures:
        overlap = figures["silhouette"]
        text = f"median {overlap['median_iou']:.3f}, smallest {overlap['smallest_iou']:.3f}"
        lines.append((f"silhouette IoU in {overlap['frames']} frames", text))
    if "overlap_with_own_segmentation" in figures:
        median = figures["overlap_with_own_segmentation"]["median"]
        lines.append(("overlap with the tracker's own segmentation", f"median {median:.3f}"))
    if "uncertainty" in figures:
        honesty = figures["uncertainty"]
        text = f"{honesty['mean_per_dof']:.2f} (1: honest, less: cautious, more: too sure)"
        lines.append(("squared errors, as a share of what was expected", text))
        lines.append(("joints inside their 95 % region", _by_joint(honesty["by_joint"])))
    if "speed" in figures:
        lines.append(("compute time per frame", f"median {figures['speed']['median_ms_per_frame']:.2f} ms"))
    width = max(len(label) for label, _ in lines)
    return "\n".join(f"{label:<{width}}  {text}" for label, text in lines)


def _tracking_lines(tracking: dict[str, Any]) -> list[tuple[str, str]]:
    lines: list[tuple[str, str]] = []
    of_truth = "" if tracking["frames_of_truth"] is None else f" (the truth has {tracking['frames_of_truth']})"
    lines.append(("frames followed", f"{tracking['followed']} of {tracking['frames']}{of_truth}"))
    until_loss = tracking["frames_until_first_loss"]
    lines.append(("frames until first loss", "never lost" if until_loss is None else f"{until_loss}"))
    if tracking["losses"]:
        recovered = tracking["frames_to_recover"]
        lengths = ", ".join(str(length) for length in recovered) or "none recovered"
        lines.append(("losses, frames to recover", f"{tracking['losses']}: {lengths}"))
    if "share_largest_error_below_20mm" in tracking:
        lines.append(("frames with every joint within 20 mm", f"{tracking['share_largest_error_below_20mm']:.1%}"))
        fraction = tracking["share_largest_root_relative_error_below_20mm"]
        lines.append(("the same, relative to the wrist", f"{fraction:.1%}"))
    return lines


def _quality_lines(quality: dict[str, Any]) -> list[tuple[str, str]]:
    lines = []
    for key, label, unit in (("fingers", "fingers", "a tip over 20 mm off"), ("frames", "frames", "any tip")):
        one = quality[key]
        kinds = [kind for kind in ("determined", "undetermined") if one[kind]]
        parts = [f"{one[f'fraction_of_{kind}_wrong']:.1%} of {one[kind]} {kind}" for kind in kinds]
        area = one["area_under_curve"]
        told = "" if math.isnan(area) else f"; told apart {area:.2f} (chance 0.5)"
        lines.append((f"{label} by their quality, {unit}", ", ".join(parts) + told))
    return lines


def _by_joint(joints: dict[str, dict[str, float]]) -> str:
    """The mean over the joints, and the least of them."""
    shares = {name: one["fraction_in_95_percent_band"] for name, one in joints.items()}
    known = {name: share for name, share in shares.items() if math.isfinite(share)}
    if not known:
        return "unknown"
    low = min(known, key=known.__getitem__)
    mean = sum(known.values()) / len(known)
    least = "" if known[low] == mean else f"; least {low}, {known[low]:.0%}"
    return f"{mean:.1%}{least} (95 % or more: not too sure)"


def _planar_lines(motion: dict[str, Any]) -> list[tuple[str, str]]:
    since = f"since frame {motion['reference_frame']}"
    rotation = f"RMS {motion['rotation_rms_deg']:.3f}°, largest {motion['rotation_largest_deg']:.3f}°"
    displacement = f"RMS {motion['displacement_rms_px']:.3f} px, largest {motion['displacement_largest_px']:.3f} px"
    with_scale = (
        f"displacement RMS {motion['displacement_with_scale_rms_px']:.3f} px, "
        f"scale RMS {motion['scale_rms_percent']:.2f} % "
        f"(the truth scales by up to {motion['true_scale_largest_change_percent']:.1f} %)"
    )
    turns = f"mean {motion['proximal_turn_mean_deg']:.2f}°, largest {motion['proximal_turn_largest_deg']:.2f}°"
    return [
        (f"turn of the proximal phalanges {since}", turns),
        (f"planar rotation {since}", rotation),
        (f"planar displacement {since}", displacement),
        ("the same as a similarity", with_scale),
    ]


def _three(summary: dict[str, float], unit: str) -> str:
    return f"mean {summary['mean']:.2f}, median {summary['median']:.2f}, largest {summary['largest']:.2f} {unit}"


def _without_nan(value: Any) -> Any:
    """JSON has no NaN: null."""
    if isinstance(value, dict):
        return {key: _without_nan(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
