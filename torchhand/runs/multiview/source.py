"""A recording of several cameras as a tracking run needs it: cameras, sampled moments, pictures from anywhere on."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from torchhand.errors import InputError
from torchhand.files import RigFrame, RigSource, load_rig, open_rig, read_picture, rig_notes
from torchhand.files.pictures import PICTURE_SUFFIXES
from torchhand.files.rigs import mask_paths
from torchhand.image import BackgroundPlate, learn_background
from torchhand.runs.multiview.request import RigRequest
from torchhand.track.multiview import moments_of

_UNKNOWN_LENGTH = 300  # moments among which samples are taken where nobody knows how many there are


class RigRecording:
    """The folder, checked: raises InputError for wrong cameras, missing pictures, options that do not fit."""

    def __init__(self, folder: Path, request: RigRequest) -> None:
        self.folder, self._request = folder.expanduser(), request
        place = self.folder if request.cameras is None else request.cameras
        if not self.folder.is_dir():
            raise InputError(f"{folder}: expected a folder with cameras and pictures, found none")
        fits_unit = request.unit == "hand"
        self.cameras = load_rig(place, unit=1.0 if fits_unit else request.unit)  # 1: what a unit is, is not known yet
        if len(self.cameras) < 2:
            raise InputError(f"{place}: expected two cameras or more, got {len(self.cameras)}")
        self.names = tuple(camera.name for camera in self.cameras)
        has_masks = any(mask_paths(self.folder, len(self.cameras)))
        self.has_masks = has_masks if request.masks is None else request.masks
        with self._open(0) as source:
            self.fps, self.count = source.fps, source.count
            self.notes = [*([] if fits_unit else rig_notes(self.cameras)), *source.warnings]
            self.said = len(source.warnings)
            """Warnings that every later reading repeats."""
            if sum(width > 0 for width, _ in source.sizes[: len(self.cameras)]) < 2:
                raise InputError(f"{self.folder}: expected pictures of two cameras or more; {'; '.join(self.notes)}")
        if self.has_masks:
            self.notes.append("the silhouettes are those in masks_0, masks_1, ...")

    def plates(self, method: str) -> list[BackgroundPlate] | None:
        """The empty scene in every view where the method asks for it. Raises InputError where it is missing."""
        folder = self._request.background
        if self.has_masks or method != "background":
            if folder is not None:
                raise InputError(f"--background: expected --silhouettes background with it, got {method!r}")
            return None
        if folder is None:
            raise InputError("silhouettes background: expected --background with pictures of the empty scene, got none")
        plates = []
        for view, camera in enumerate(self.cameras):
            names = [f"{stem}{suffix}" for stem in (camera.name, f"view_{view}") for suffix in PICTURE_SUFFIXES]
            path = next((folder / name for name in names if (folder / name).is_file()), None)
            if path is None:
                raise InputError(f"{folder}: expected {camera.name}.png or view_{view}.png, found neither")
            image = read_picture(path)
            if image.shape[:2] != (camera.height, camera.width):
                raise InputError(
                    f"{path}: expected {camera.width}x{camera.height} px as camera {camera.name}, got"
                    f" {image.shape[1]}x{image.shape[0]}"
                )
            plates.append(learn_background(image[None]))
        return plates

    def sample(self, frames: int) -> list[RigFrame]:
        """At most so many moments, evenly over the part that is tracked."""
        chosen = {self._request.start + moment for moment in moments_of(self.count or _UNKNOWN_LENGTH, frames)}
        found = []
        with self._open(0) as source:
            for frame in source:
                if frame.index in chosen:
                    found.append(frame)
                    if len(found) == len(chosen):
                        break
        return found

    @contextlib.contextmanager
    def opened(self, done: int) -> Iterator[RigSource | None]:
        """The moments after the first `done`; None where none are left."""
        limit = self._request.max_frames
        total = self.count if limit is None else limit if self.count is None else min(limit, self.count)
        if total is not None and done >= total:
            yield None
            return
        with self._open(done) as source:
            yield source

    def _open(self, done: int) -> RigSource:
        request = self._request
        return open_rig(
            self.folder,
            self.cameras,
            offsets=request.offsets,
            start=request.start + done,
            max_frames=None if request.max_frames is None else request.max_frames - done,
            masks=self.has_masks,
        )
