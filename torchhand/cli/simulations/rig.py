"""What `torchhand simulate` makes of --rig: its cameras, and what the user should know of the pictures."""

from collections.abc import Sequence
from dataclasses import replace

import torch

from torchhand.errors import InputError
from torchhand.files import load_rig
from torchhand.files.disk import expanded
from torchhand.files.pictures import size_problem
from torchhand.geometry import Camera
from torchhand.simulate import RenderedFrame, RigRecord, named_rig, noisy_mask
from torchhand.simulate.rigs import FOV_DEG, SIZE_PX


def rig_cameras(text: str, *, size: tuple[int, int] | None = None, fov_deg: float | None = None) -> list[Camera]:
    """Cameras of a name, or of a file or folder that holds some.

    size (px), fov_deg: of the cameras of a named rig, where the user wants others. Raises InputError naming what is
    wrong.
    """
    path = expanded(text)
    if not path.exists() and path.name == text and not path.suffix:
        return named_rig(text, size=size or SIZE_PX, fov_deg=fov_deg or FOV_DEG)
    for option, value in (("--size", size), ("--fov-deg", fov_deg)):
        if value is not None:
            raise InputError(f"{option}: expected a named rig with it; the cameras of {path} have their own")
    cameras = load_rig(path)
    for camera in cameras:
        if problem := size_problem(camera.width, camera.height):
            raise InputError(f"{path}: {camera.name}: {problem}")
    return list(cameras)


def with_mask_noise(frame: RenderedFrame, std_px: float, generator: torch.Generator) -> RenderedFrame:
    """The same picture with a mask as a segmentation might give it."""
    return replace(frame, mask=noisy_mask(frame.mask, std_px, generator))


def rig_complaints(record: RigRecord, cameras: Sequence[Camera]) -> list[str]:
    """A line for each camera that does not see the whole hand in every frame."""
    lines = []
    count = len(record.in_view)
    for column, camera in enumerate(cameras):
        unseen = int((~record.in_view[:, column]).sum())
        cut = int(record.is_cut[:, column].sum())
        if unseen:
            lines.append(f"{camera.name}: the hand is out of the picture in {unseen} of {count} frames")
        if cut:
            lines.append(f"{camera.name}: the hand is cut by the picture's edge in {cut} of {count} frames")
    return lines
