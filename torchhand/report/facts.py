"""What a report tells in words and tables, as HTML that needs no script: counts, assumptions, ranges, citation."""

import math
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

import torchhand
from torchhand.errors import InputError
from torchhand.evaluate.without_truth import (
    JointRange,
    RecordingFacts,
    Stability,
    differences,
    range_of_motion,
    stability,
)
from torchhand.files.results import STATUSES
from torchhand.hand import FINGERS, JOINT_DOFS
from torchhand.report.content import ANGLE_STEP_DEG, frame_stride, free_angles
from torchhand.report.result import Result

_JOINTS = {"cmc": "CMC", "mcp": "MCP", "pip": "PIP", "dip": "DIP", "ip": "IP"}
_MOTIONS = {"fe": "flexion", "aa": "abduction", "tw": "twist"}
_METHODS = {
    "contour": "Stenger, B., Mendonça, P. R. S., Cipolla, R. (2001): Model-Based Hand Tracking Using an Unscented"
    " Kalman Filter. British Machine Vision Conference.",
    "distance": "Ouhaddi, H., Horain, P. (1998): Conception, ajustement et recalage d'un modèle 3D articulé pour le"
    " suivi de la main dans des séquences d'images.",
    "hull": "Ueda, E., Matsumoto, Y., Imai, M., Ogasawara, T. (2003): hand pose estimation from the silhouettes of"
    " several views (in Japanese).",
}
_SIDE_SOURCES = {
    "given": "as given",
    "inferred": "by a detector's labels",
    "tried": "by hands of both sides",
    "assumed": "assumed: nothing told it",
}


def angle_title(name: str) -> str:
    """`index_mcp_fe` as people read it."""
    finger, *rest = name.split("_")
    if rest == ["total", "flexion"]:
        return f"{finger} total flexion"
    return f"{finger} {_JOINTS[rest[0]]} {_MOTIONS[rest[1]]}"


def titles() -> dict[str, str]:
    """Of every joint angle."""
    return {name: angle_title(name) for name in JOINT_DOFS}


def summary(result: Result) -> str:
    """One sentence about the frames."""
    track = result.track
    counts = [f"{int((track.status == status).sum())} {status.replace('_', ' ')}" for status in STATUSES]
    return f"{result.side} hand, {len(track)} frames: {', '.join(counts)}"


def assumptions(result: Result, notes: Sequence[tuple[str, str]]) -> str:
    """A list of what was assumed and what was given. notes: names and sentences about the page itself."""
    told = [*_of_cameras(result), _of_size(result), _of_side(result), *_of_time(result), *notes]
    return "<dl>" + "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in told) + "</dl>"


def size_notes(result: Result) -> list[tuple[str, str]]:
    """How the page's numbers were made smaller than the track's."""
    stride = frame_stride(result)
    kept = f"Angles are rounded to {ANGLE_STEP_DEG:g}°"
    which = "" if stride == 1 else f", and one frame in {stride} is drawn and told here"
    return [("This page", f"{kept}{which}; track.npz has them all as they were estimated.")]


def range_table(results: Sequence[Result]) -> str:
    """The range of motion of every joint angle that was free, of one result or of two side by side."""
    found: list[dict[str, JointRange]] = []
    for result in results:
        try:
            ranges, held = range_of_motion(result.track), set(JOINT_DOFS) - free_angles(result)
            found.append({name: ranges[name] for name in ranges if name not in held})
        except InputError:
            found.append({})
    names = [name for name in _in_order() if any(name in ranges for ranges in found)]
    if not names:
        return "<p>No frame has a hand, or every joint angle was held: there is no range of motion.</p>"
    limits = _limits(results[0])
    both = _compared(results)
    head = ["Joint angle", "Limits"]
    for letter in _letters(results):
        head += [f"{letter}Smallest", f"{letter}Largest", f"{letter}Range"]
    head += ["Median difference", "Contradict each other"] if both else []
    rows = []
    for name in names:
        cells = [_degrees(*limits[name]) if name in limits else ""]
        for ranges in found:
            cells += _range_cells(ranges.get(name))
        if both:
            joint = both.joints.get(name)
            cells += ["", ""] if joint is None else [f"{joint.median_deg:.1f}°", f"{joint.fraction_apart:.0%}"]
        cells = [f"<td>{cell}</td>" for cell in cells]
        rows.append(f'<tr><th scope="row">{escape(angle_title(name))}</th>{"".join(cells)}</tr>')
    heads = "".join(f'<th scope="col">{cell}</th>' for cell in head)
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def doubts(results: Sequence[Result]) -> str | None:
    """One sentence where two results seem to be of two hands or recordings; else None."""
    if len(results) < 2:
        return None
    found = differences(*(RecordingFacts.of_track(result.track) for result in results))
    return f"A and B differ: {'; '.join(found)}" if found else None


def comparison(results: Sequence[Result]) -> str:
    """What two results say of each other."""
    if len(results) < 2:
        return ""
    doubt = doubts(results)
    told = "" if doubt is None else f"<p>{escape(doubt)}.</p>"
    both = _compared(results)
    if both is None:
        if not free_angles(results[0]) & free_angles(results[1]):
            return f"{told}<p>No joint angle was free in both results: none is compared.</p>"
        return f"{told}<p>The two results have no frame in which both have a hand: nothing is compared.</p>"
    whole = both.whole
    return told + (
        f"<p>In {both.frames} frames both have a hand, in {both.frames_in_one} only one of them. Over all joint angles"
        f" that were free the median difference is {whole.median_deg:.1f}°, the 95th percentile"
        f" {whole.percentile95_deg:.1f}°; {whole.fraction_apart:.1%} of the angles differ by more than three of their"
        f" combined standard deviations, and {whole.fraction_in_own_band:.1%} of B's lie inside A's own 95 % band.</p>"
    )


def citation(results: Sequence[Result]) -> str:
    """How to cite the program, and the method of each result."""
    lines = [
        f"torchhand {torchhand.__version__}: the open, anatomical, differentiable hand, and the trackers that fit it to"
        " video. Apache-2.0."
    ]
    for result in results:
        name = str(result.run.get("config", ""))
        line = next((text for method, text in _METHODS.items() if name.startswith(method)), None)
        if line is not None and (line := f"Method {name}: {line}") not in lines:
            lines.append(line)
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def _of_cameras(result: Result) -> list[tuple[str, str]]:
    if not result.track.cameras:
        return [("Camera", "none: the points were given in space, in a frame of their own.")]
    if len(result.track.cameras) > 1:
        names = ", ".join(str(camera.get("name", "?")) for camera in result.track.cameras)
        unit = result.provenance.get("unit_m")
        scale = f" One unit of the rig was found to be {1e3 * unit:.4g} mm." if isinstance(unit, float) else ""
        return [("Cameras", f"calibrated, {len(result.track.cameras)}: {names}.{scale if unit != 1.0 else ''}")]
    camera = result.track.cameras[0]
    size = f"{camera.get('width')}×{camera.get('height')} px"
    if not camera.get("is_assumed"):
        return [("Camera", f"calibrated, {size}.")]
    matrix = np.asarray(camera["K"], dtype=np.float64)
    field = math.degrees(2 * math.atan(0.5 * float(camera.get("width", 0)) / float(matrix[0, 0])))
    text = f"not calibrated, {size}: a horizontal field of view of {field:.0f}° is assumed."
    return [("Camera", f"{text} Distances are metric only up to that assumption; angles hardly depend on it.")]


def _of_size(result: Result) -> tuple[str, str]:
    names = result.model.shape_space.names
    length = float(result.shape[names.index("hand_length")])
    method = str(result.provenance.get("method", "unknown"))
    std = result.provenance.get("std")
    has_own = isinstance(std, dict) and float(std.get("hand_length", 0.0) or 0.0) > 0
    if method == "given":
        return "Size", f"the hand's proportions were given; it is {1e3 * length:.0f} mm long."
    told = "was fitted" if has_own else "is assumed, for pictures of one camera do not tell it"
    return "Size", f"proportions: {method}. The hand's length of {1e3 * length:.0f} mm {told}."


def _of_side(result: Result) -> tuple[str, str]:
    source = result.run.get("side_is")
    how = f" ({_SIDE_SOURCES.get(source, source)})" if isinstance(source, str) else ""
    return "Side", f"{result.side} hand{how}."


def _of_time(result: Result) -> list[tuple[str, str]]:
    if result.has_assumed_fps:
        return [("Time", f"the result tells no rate; {result.fps:g} frames a second are assumed.")]
    return [("Time", f"{result.fps:g} frames a second.")]


def _letters(results: Sequence[Result]) -> list[str]:
    return [""] if len(results) == 1 else ["A: ", "B: "]


def _in_order() -> list[str]:
    """Joint angles finger by finger, each finger's total flexion at its end."""
    return [
        name
        for finger in FINGERS
        for name in (*(own for own in JOINT_DOFS if own.startswith(f"{finger}_")), f"{finger}_total_flexion")
    ]


def _limits(result: Result) -> dict[str, tuple[float, float]]:
    skeleton = result.model.skeleton
    ends = zip(np.rad2deg(skeleton.lower.numpy()), np.rad2deg(skeleton.upper.numpy()), strict=True)
    return {name: (float(low), float(high)) for name, (low, high) in zip(JOINT_DOFS, ends, strict=True)}


def _degrees(low: float, high: float) -> str:
    return f"{low:.0f}° to {high:.0f}°"


def _range_cells(found: JointRange | None) -> list[Any]:
    if found is None:
        return ["", "", ""]
    return [
        f"{found.smallest_deg:.1f}° ± {found.smallest_std_deg:.1f}°",
        f"{found.largest_deg:.1f}° ± {found.largest_std_deg:.1f}°",
        f"{found.range_deg:.1f}°",
    ]


def _compared(results: Sequence[Result]) -> Stability | None:
    if len(results) < 2:
        return None
    try:
        return stability(results[0].track, results[1].track)
    except InputError:
        return None
