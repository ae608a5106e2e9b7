"""Many small pictures in one."""

from collections.abc import Sequence

import torch
from jaxtyping import UInt8
from torch import Tensor


def contact_sheet(
    frames: Sequence[UInt8[Tensor, "height width 3"]], columns: int, *, gap_px: int = 4, gap_level: int = 255
) -> UInt8[Tensor, "sheet_height sheet_width 3"]:
    """Pictures of one size side by side, row by row; gaps and the end of a short last row are of grey `gap_level`."""
    if not frames:
        raise ValueError("frames: expected at least one picture")
    if columns < 1:
        raise ValueError(f"columns: expected 1 or more, got {columns}")
    height, width = frames[0].shape[:2]
    columns = min(columns, len(frames))
    rows = -(-len(frames) // columns)
    size = (rows * (height + gap_px) - gap_px, columns * (width + gap_px) - gap_px, 3)
    sheet = torch.full(size, gap_level, dtype=torch.uint8)
    for i, frame in enumerate(frames):
        if frame.shape != frames[0].shape:
            raise ValueError(f"frames: expected pictures of {width}x{height} px, got {frame.shape[1]}x{frame.shape[0]}")
        top, left = (i // columns) * (height + gap_px), (i % columns) * (width + gap_px)
        sheet[top : top + height, left : left + width] = frame.cpu()
    return sheet
