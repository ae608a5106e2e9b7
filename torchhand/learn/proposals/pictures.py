"""Pictures with true keypoints, to measure proposals on: sequences with cameras and masks, and folders of stills."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.errors import InputError
from torchhand.evaluate import load_mask, load_truth, numbered_pictures
from torchhand.files import load_cameras, read_picture
from torchhand.files.disk import opened_arrays
from torchhand.geometry import assumed_camera
from torchhand.image import bootstrap_skin
from torchhand.learn import load_stills
from torchhand.propose import Silhouette

_TRUTH, _FRAMES, _CAMERAS, _IMAGES = "truth.npz", "frames", "cameras.json", "images"


@dataclass(frozen=True, kw_only=True)
class PosedPicture:
    """A picture, its silhouette, and the keypoints of the hand."""

    silhouette: Silhouette
    keypoints: Float[Tensor, "21 3"]
    """Keypoints in the world of the camera, metres."""


def posed_pictures(folder: Path, *, every: int = 1) -> Iterator[PosedPicture]:
    """Every so many of a folder's pictures.

    The folder is a sequence of one camera with truth.npz, cameras.json and frames/, or holds stills with truth.npz
    (image names, K, keypoints3d) and images/.

    Silhouettes are those of masks/ where that is there, else what has the colours of skin; they may be empty. Raises
    InputError for a folder of another kind.
    """
    if not (folder / _TRUTH).is_file():
        raise InputError(f"{folder}: expected a folder with {_TRUTH}; there is none")
    with opened_arrays(folder / _TRUTH, complaint="is no truth that can be read") as stored:
        are_stills = "image" in list(stored)
    return _stills(folder, every) if are_stills else _sequence(folder, every)


def _sequence(folder: Path, every: int) -> Iterator[PosedPicture]:
    truth = load_truth(folder)
    cameras = load_cameras(folder / _CAMERAS)
    if truth.keypoints3d is None or len(cameras) != 1:
        raise InputError(f"{folder}: expected keypoints3d and one camera, got {len(cameras)} cameras")
    frames = numbered_pictures(folder / _FRAMES)
    for number in range(0, len(truth.keypoints3d), every):
        if number not in frames:
            raise InputError(f"{folder / _FRAMES}: expected a picture of every frame, lacks number {number}")
        image = read_picture(frames[number])
        file = truth.mask_files.get(number)
        mask = _skin(image) if file is None else torch.from_numpy(load_mask(file))
        points = torch.from_numpy(truth.keypoints3d[number])
        yield PosedPicture(silhouette=Silhouette(mask=mask, camera=cameras[0], image=image), keypoints=points)


def _stills(folder: Path, every: int) -> Iterator[PosedPicture]:
    stills = load_stills(folder)
    for index in range(0, len(stills.names), every):
        image = read_picture(folder / _IMAGES / stills.names[index])
        height, width = image.shape[:2]
        camera = replace(assumed_camera(width, height), intrinsics=stills.intrinsics[index], is_assumed=False)
        silhouette = Silhouette(mask=_skin(image), camera=camera, image=image)
        yield PosedPicture(silhouette=silhouette, keypoints=stills.keypoints[index])


def _skin(image: Tensor) -> Bool[Tensor, "height width"]:
    return bootstrap_skin(image).mask
