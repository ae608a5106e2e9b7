"""What a run over single pictures reads: the pictures, a camera for each, detected keypoints, silhouettes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

from jaxtyping import Bool, UInt8
from torch import Tensor

from torchhand.detect import Landmarker, MediaPipe, chosen_hand, hand_keypoints
from torchhand.errors import InputError
from torchhand.files import (
    Detections,
    HandDetection,
    camera_for,
    camera_per_picture,
    only_camera,
    read_detections,
    read_picture,
)
from torchhand.files.disk import expanded
from torchhand.files.pictures import PICTURE_SUFFIXES, natural_key
from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import Side
from torchhand.track import HandKeypoints

_MASK = "_mask"
_HANDS = 2  # that a detector looks for
_SIDES: tuple[Side, ...] = ("right", "left")

CameraOf = Callable[[int, int, int], Camera]
"""The camera of a picture: its number, its width and its height, px."""


def pictures_in(source: Path) -> list[Path]:
    """One picture, or those of a folder in natural order; NAME_mask beside a picture NAME is the silhouette of that.

    Raises InputError where there is none.
    """
    source = expanded(source)
    if not source.exists():
        raise InputError(f"{source}: no such file or folder (expected a picture or a folder of pictures)")
    if not source.is_dir():
        if source.suffix.lower() not in PICTURE_SUFFIXES:
            raise InputError(f"{source}: expected a picture ({', '.join(PICTURE_SUFFIXES)}) or a folder of pictures")
        return [source]
    try:
        found = sorted(source.iterdir(), key=natural_key)
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error.strerror or error})") from error
    found = [path for path in found if path.suffix.lower() in PICTURE_SUFFIXES and not path.name.startswith(".")]
    stems = {path.stem for path in found}
    pictures = [path for path in found if not is_mask_name(path.stem, stems) and path.is_file()]
    if not pictures:
        raise InputError(f"{source}: holds no pictures ({', '.join(PICTURE_SUFFIXES)})")
    return pictures


def is_mask_name(stem: str, stems: set[str]) -> bool:
    """Whether a name is that of another picture's silhouette."""
    return stem.endswith(_MASK) and stem.removesuffix(_MASK) in stems


def mask_of(picture: Path, folder: Path | None, size: tuple[int, int]) -> Bool[Tensor, "height width"] | None:
    """The silhouette of a picture in a folder: NAME_mask or NAME, bright inside; None without a folder.

    Raises InputError where it is missing, cannot be read, or is of another size (height, width) than the picture.
    """
    if folder is None:
        return None
    names = [f"{stem}{suffix}" for stem in (picture.stem + _MASK, picture.stem) for suffix in PICTURE_SUFFIXES]
    paths = [folder / name for name in names if (folder / name).is_file() and folder / name != picture]
    if not paths:
        raise InputError(f"{folder}: expected a silhouette {picture.stem}{_MASK}.png or {picture.stem}.png")
    mask = read_picture(paths[0]).amax(-1) > 127
    if tuple(mask.shape) != size:
        got = f"{mask.shape[1]}x{mask.shape[0]}"
        raise InputError(f"{paths[0]}: expected a silhouette of {size[1]}x{size[0]} px, the picture's, got {got}")
    return mask


def cameras_of(path: Path | None, names: Sequence[str]) -> CameraOf:
    """Cameras from a file: the only one of a cameras.json, or those of an npz with intrinsics K (pictures, 3, 3), by
    the pictures' names where it has them (`image`), else in their order. Without a file a field of view is assumed.

    Raises InputError for an npz that does not hold the intrinsics of these pictures, and for a file of several cameras.
    """
    if path is not None and path.suffix.lower() != ".npz":
        only_camera(path)
    if path is None or path.suffix.lower() != ".npz":
        return lambda number, width, height: camera_for(path, width, height)
    intrinsics = camera_per_picture(path, names, len(names)).intrinsics
    return lambda number, width, height: replace(
        assumed_camera(width, height), intrinsics=intrinsics[number], is_assumed=False
    )


def _frames_of_names(path: Path, found: Detections, pictures: Sequence[str]) -> dict[str, int] | None:
    """Numbers of the frames by the names of pictures; None where they are in the pictures' order."""
    if found.image is None:
        if len(found) != len(pictures):
            expected = f"expected one row for each of {len(pictures)} pictures, or their names"
            raise InputError(f"{path}: {expected}, got {len(found)} rows")
        return None
    if not set(found.image) & set(pictures):
        raise InputError(f"{path}: image: expected names of the pictures, such as {pictures[0]}, got {found.image[0]}")
    return {name: int(number) for name, number in zip(found.image, found.frame, strict=True)}


@dataclass(frozen=True, kw_only=True)
class _OfSide:
    """What a file tells of one hand."""

    found: Detections
    frames: dict[str, int] | None
    """Numbers of the frames by the pictures' names."""

    def holds(self, number: int, name: str) -> bool:
        """Whether the detector looked at a picture."""
        return bool((self.found.frame == number).any()) if self.frames is None else name in self.frames

    def hand(self, number: int, name: str, width: int, height: int) -> HandDetection | None:
        """The hand of a picture of that size, px; None where there is none."""
        frame = number if self.frames is None else self.frames.get(name)
        if frame is None:
            return None
        seen = self.found.at_frame(frame)
        in_picture = self.found.in_pixels(width, height).at_frame(frame)
        return None if seen is None or in_picture is None else replace(in_picture, space=seen.space)


@dataclass(frozen=True, kw_only=True)
class PictureHand:
    """What a detector found in a picture."""

    keypoints: HandKeypoints | None = None
    """Of a hand of the wanted side; None where there is none."""
    side: Side | None = None
    """Which hand they are of, where that is told."""
    is_silent: bool = False
    """Whether no hand was found, of either side."""


@runtime_checkable
class KeypointsOfPictures(Protocol):
    """Detected keypoints of single pictures, and which hand they are of."""

    def hand(self, number: int, name: str, image: UInt8[Tensor, "height width 3"]) -> PictureHand:
        """What is found in a picture: its number, and its file's name."""
        ...


class PictureDetector:
    """MediaPipe on every picture by itself."""

    def __init__(self, *, side: Side | None, hand_model: Path | None, landmarker: Landmarker | None = None) -> None:
        """side: of the hands; None takes that of which MediaPipe is surest. landmarker: another program in its place.

        Raises InputError where MediaPipe is not installed or cannot read the model.
        """
        self._side: Side | None = side
        self._landmarker = landmarker or MediaPipe(hand_model)
        self.name = self._landmarker.name
        """Program, version and model: the same name gives the same numbers."""

    def hand(self, number: int, name: str, image: UInt8[Tensor, "height width 3"]) -> PictureHand:
        landmarks = self._landmarker.open(_HANDS)  # anew: what it finds depends on the pictures before
        hands = landmarks.detect(image)
        landmarks.close()
        if self._side is not None:
            chosen = chosen_hand(hands, self._side)
        else:
            chosen = max(hands, key=lambda hand: hand.score, default=None)
        side = None if chosen is None else chosen.label
        return PictureHand(keypoints=hand_keypoints(chosen), side=side, is_silent=not hands)


class KeypointsFile:
    """Keypoints from a file, as `KeypointsOfPictures`."""

    def __init__(self, path: Path, *, side: Side | None, pictures: Sequence[str]) -> None:
        """side: of the hands; those of the other hand are left out. None takes what the detector says. pictures: their
        names.

        Raises InputError for a file that cannot be read, holds no points in the pictures, names none of them, or tells
        of another number of pictures and not of their names.
        """
        self._of_sides: dict[Side, _OfSide] = {}
        self._wanted = _SIDES if side is None else (side,)
        problem: InputError | None = None
        for own in _SIDES:
            try:
                found = read_detections(path, side=own)
            except InputError as error:
                problem = error if own in self._wanted else problem
                continue
            if found.picture is None:
                raise InputError(f"{path}: expected points in the picture, got points in space alone")
            self._of_sides[own] = _OfSide(found=found, frames=_frames_of_names(path, found, pictures))
        if problem is not None and not any(own in self._of_sides for own in self._wanted):
            raise problem

    def hand(self, number: int, name: str, image: UInt8[Tensor, "height width 3"]) -> PictureHand:
        height, width = int(image.shape[0]), int(image.shape[1])
        is_silent = any(own.holds(number, name) for own in self._of_sides.values())
        for side, own in self._of_sides.items():
            seen = own.hand(number, name, width, height)
            keypoints = hand_keypoints(seen)
            is_silent &= keypoints is None
            if seen is not None and keypoints is not None and side in self._wanted:
                return PictureHand(keypoints=keypoints, side=seen.label)
        return PictureHand(is_silent=is_silent)
