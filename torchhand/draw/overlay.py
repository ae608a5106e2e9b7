"""What the tracker saw, in one picture: the model's contour over the frame, the pose from a second view beside it."""

from collections.abc import Collection
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.draw.second_view import PAPER, draw_second_view
from torchhand.hand import CONE_NAMES, ELLIPSOID_NAMES, KEYPOINTS, HandPose
from torchhand.view import HandProjector, OutlineTable, outline_table

STATUS_COLOURS = {
    "tracked": (70, 215, 90),
    "recovered": (80, 160, 255),
    "lost": (255, 80, 70),
    "no_hand": (190, 190, 190),
}
"""RGB of the word."""
CONTOUR_COLOUR = (40, 255, 60)
KEYPOINT_COLOUR = (255, 220, 40)
UNDETERMINED_COLOUR = (200, 200, 200)
"""Of the dashed contour and the hollow dots of a finger that is not determined."""

_PER_GENERATOR = 12
_PER_ARC = 25
_SHIFT = 4  # fractional bits of OpenCV's coordinates
_PANEL_FRACTION = 0.75  # side of the second view, share of the picture's height
_SMALLEST_PANEL = 64  # px
_LARGEST_CAST = 240  # px; a larger panel shows the same rays enlarged


def overlay_size(width: int, height: int) -> tuple[int, int]:
    """Width and height of the overlay of a picture of that size; both even, as video codecs want them."""
    side = _panel_side(height)
    total_width, total_height = width + side, max(height, side)
    return total_width + total_width % 2, total_height + total_height % 2


def draw_overlay(
    image: UInt8[Tensor, "height width 3"],
    projector: HandProjector,
    pose: HandPose | None,
    *,
    status: str,
    frame: int,
    keypoints_px: Float[Tensor, "21 2"] | None = None,
    iou: float | None = None,
    undetermined: Collection[str] = (),
) -> UInt8[Tensor, "overlay_height overlay_width 3"]:
    """One frame of the overlay video, RGB, of `overlay_size`.

    Left the picture with the visible contours of the model, and its keypoints as dots where they are given; right the
    hand from a second view. Without a pose (lost, no hand): the picture and the status only. `status` is one of
    STATUS_COLOURS; `iou` is written beside it. The pose is in the projector's dtype. undetermined: names of FINGERS;
    these are dashed and grey, their keypoints hollow, and a line below tells so.
    """
    if status not in STATUS_COLOURS:
        raise ValueError(f"status: expected one of {', '.join(STATUS_COLOURS)}, got {status!r}")
    height, width = image.shape[:2]
    total_width, total_height = overlay_size(width, height)
    canvas = np.empty((total_height, total_width, 3), dtype=np.uint8)
    canvas[:, width:] = canvas[height:] = PAPER
    picture = canvas[:height, :width]
    picture[:] = image.cpu().numpy()
    if pose is not None:
        draw_contour(picture, projector, pose.dofs, pose.reference, undetermined)
        side = _panel_side(height)
        view = draw_second_view(projector, pose.dofs, pose.reference, min(side, _LARGEST_CAST)).cpu().numpy()
        view = cv2.resize(view, (side, side), interpolation=cv2.INTER_CUBIC)
        top = (total_height - side) // 2
        canvas[top : top + side, width : width + side] = view
    if keypoints_px is not None:
        _draw_dots(picture, keypoints_px, undetermined)
    write_line(picture, frame, status, iou)
    if undetermined and pose is not None:
        write_undetermined(picture, undetermined)
    return torch.from_numpy(canvas)


def _panel_side(height: int) -> int:
    return max(_SMALLEST_PANEL, round(_PANEL_FRACTION * height))


@lru_cache(maxsize=4)
def _line_table(dtype: torch.dtype) -> OutlineTable:
    """Points in runs, each a line to draw: two generators of every cone, one arc of every ellipsoid, ends included."""
    table = outline_table(_PER_GENERATOR, _PER_ARC, dtype=dtype)
    along, around = torch.linspace(0, 1, _PER_GENERATOR, dtype=dtype), torch.linspace(0, 1, _PER_ARC, dtype=dtype)
    return replace(
        table,
        cone_fraction=along.repeat(2 * len(CONE_NAMES)),
        ellipsoid_fraction=around.repeat(len(ELLIPSOID_NAMES)),
    )


def draw_contour(
    picture: np.ndarray,
    projector: HandProjector,
    pose: Float[Tensor, "36"],
    root_reference: Float[Tensor, "3 3"],
    undetermined: Collection[str] = (),
) -> None:
    """Draws a line between neighbouring points of a run that are both visible, in place; every other one, in grey, for
    the fingers that are named."""
    contour = projector.contour(pose, root_reference, _line_table(pose.dtype))
    far = 4.0 * max(picture.shape[:2])
    points = contour.points_px.nan_to_num(0.0).clamp(-far, far)
    split = 2 * len(CONE_NAMES) * _PER_GENERATOR
    lines: dict[bool, list[Tensor]] = {False: [], True: []}
    cones, balls = [name for name in CONE_NAMES for _ in range(2)], list(ELLIPSOID_NAMES)
    for names, run, length in ((cones, slice(None, split), _PER_GENERATOR), (balls, slice(split, None), _PER_ARC)):
        along, visible = points[run].unflatten(0, (-1, length)), contour.visible[run].unflatten(0, (-1, length))
        both = visible[:, 1:] & visible[:, :-1]
        is_open = torch.tensor([name.split("_")[0] in undetermined for name in names])
        is_dash = torch.arange(both.shape[1]) // 2 % 2 == 0
        for is_dashed, drawn in ((False, both & ~is_open[:, None]), (True, both & is_open[:, None] & is_dash)):
            lines[is_dashed].append(torch.stack((along[:, :-1][drawn], along[:, 1:][drawn]), 1))
    thickness = 1 + picture.shape[0] // 700
    for is_dashed, colour in ((False, CONTOUR_COLOUR), (True, UNDETERMINED_COLOUR)):
        corners = _fixed_point(torch.cat(lines[is_dashed]))
        cv2.polylines(picture, list(corners), False, colour, thickness, cv2.LINE_AA, _SHIFT)


def _draw_dots(picture: np.ndarray, keypoints_px: Tensor, undetermined: Collection[str]) -> None:
    radius = max(1, round(picture.shape[0] / 240)) << _SHIFT
    is_known = keypoints_px.isfinite().all(-1).tolist()
    places = _fixed_point(keypoints_px.nan_to_num().clamp(-1e4, 1e4)).tolist()
    for name, known, (x, y) in zip(KEYPOINTS, is_known, places, strict=True):
        if known:
            is_open = name.split("_")[0] in undetermined
            colour, inside = (UNDETERMINED_COLOUR, 1) if is_open else (KEYPOINT_COLOUR, -1)
            cv2.circle(picture, (x, y), radius + (is_open << _SHIFT), colour, inside, cv2.LINE_AA, _SHIFT)


def _fixed_point(points_px: Tensor) -> np.ndarray:
    """OpenCV's integers with _SHIFT fractional bits; both count from the centre of the first pixel."""
    return (points_px.detach().cpu() * (1 << _SHIFT)).round().to(torch.int32).numpy()


def write_line(picture: np.ndarray, frame: int, status: str, iou: float | None) -> None:
    """The frame's number, its status and its overlap on a dark strip at the upper left."""
    height = picture.shape[0]
    words = [(f"frame {frame}", (235, 235, 235)), (status.replace("_", " "), STATUS_COLOURS[status])]
    if iou is not None:
        words.append((f"IoU {iou:.2f}", (235, 235, 235)))
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, max(0.35, height / 800)
    sizes = [cv2.getTextSize(word, font, scale, 1)[0] for word, _ in words]
    gap = round(18 * scale)
    strip = picture[: sizes[0][1] + 2 * gap - gap // 2, : sum(size[0] + gap for size in sizes) + gap]
    strip[:] = strip // 4
    x, baseline = gap, sizes[0][1] + gap - gap // 4
    for (word, colour), (length, _) in zip(words, sizes, strict=True):
        cv2.putText(picture, word, (x, baseline), font, scale, colour, 1, cv2.LINE_AA)
        x += length + gap


def write_undetermined(picture: np.ndarray, fingers: Collection[str]) -> None:
    """The legend of dashed fingers, on a dark strip at the lower left."""
    height, words = picture.shape[0], f"dashed: {', '.join(fingers)} not determined"
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, max(0.35, height / 1000)
    (length, high), gap = cv2.getTextSize(words, font, scale, 1)[0], round(12 * scale)
    strip = picture[height - high - 2 * gap :, : length + 2 * gap]
    strip[:] = strip // 4
    cv2.putText(picture, words, (gap, height - gap), font, scale, UNDETERMINED_COLOUR, 1, cv2.LINE_AA)
