"""The report of a calibration: a picture per camera and a text."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import torch

from torchhand.calibration import RigCalibration
from torchhand.draw.reprojection import draw_reprojection
from torchhand.files.disk import explained_errors, replacing, write_text


def write_report(folder: Path, found: RigCalibration, table: str, lacks: Sequence[str]) -> None:
    """report.txt and NAME.png of every camera. Raises InputError where the disk refuses."""
    with explained_errors(folder):
        folder.mkdir(exist_ok=True)
    for camera, view in zip(found.cameras, found.views, strict=True):
        frames = [frame for name, frame in found.residuals_px if name == camera.name]
        picture = draw_reprojection(
            camera.name,
            torch.cat([view.corners[frame].points_px for frame in frames]),
            torch.cat([found.residuals_px[camera.name, frame] for frame in frames]),
            camera.width,
            camera.height,
        )
        _, encoded = cv2.imencode(".png", cv2.cvtColor(picture.numpy(), cv2.COLOR_RGB2BGR))
        with replacing(folder / f"{camera.name}.png") as temporary:
            temporary.write_bytes(encoded.tobytes())
    write_text(folder / "report.txt", "\n".join([table, *(f"warning: {line}" for line in lacks)]) + "\n")
