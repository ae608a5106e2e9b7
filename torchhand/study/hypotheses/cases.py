"""The pictures of a hypothesis study and the hands in them: simulated, from a sequence with truth, or found."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from torchhand.errors import InputError
from torchhand.evaluate import load_mask, numbered_pictures
from torchhand.files import FittedHand, camera_for, load_hand_model, open_source, read_picture
from torchhand.fit.open_hand import fit_open_hand
from torchhand.geometry import Camera
from torchhand.hand import HandPose, Side
from torchhand.image import WORKING_PIXELS, NoRegions, PicturePart, bootstrap_skin, find_open_hand
from torchhand.simulate import hand_length
from torchhand.study.hypotheses.case_study import StudyCase
from torchhand.study.hypotheses.known_poses import KnownPoses, load_known_poses
from torchhand.study.hypotheses.settings import HypothesisStudySettings
from torchhand.study.hypotheses.simulated import simulated_case

FRAMES_NAME, MASKS_NAME, TRUTH_NAME, CAMERAS_NAME = "frames", "masks", "truth.npz", "cameras.json"

_MIN_OVERLAP = 0.7  # below, an open hand's fit does not explain the silhouette

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Given:
    """What the user says about the pictures."""

    source: Path | None
    """Source of the pictures; None: simulated pictures."""
    frames: tuple[int, ...] | None
    """Frames of the source; None: all that there are."""
    camera: Path | None = None
    hand: FittedHand | None = None
    side: Side | None = None
    mask: Path | None = None
    size: tuple[int, int] = (640, 480)
    """Size of simulated pictures, px."""


@dataclass(frozen=True, kw_only=True)
class Cases:
    """Pictures to register on."""

    cases: list[StudyCase]
    reference: str
    """How the reference poses are known, for the user."""
    is_final: bool = True
    """Whether the reference poses are final; else the best registration about each is to take its place."""


def cases_of(given: Given, settings: HypothesisStudySettings, seed: int) -> Cases:
    """The cases. Raises InputError where the input cannot be used."""
    if given.source is None:
        return _simulated(given, settings, seed)
    if not given.source.exists():
        raise InputError(f"{given.source}: no such file or folder (expected a sequence, a picture or a video)")
    if not (given.source / TRUTH_NAME).is_file():
        return _found(given, given.source)
    if given.mask is not None:
        raise InputError(f"--mask: expected a picture without truth with it, got the sequence {given.source}")
    return _sequence(given, given.source)


def frames_of(text: str) -> tuple[int, ...] | None:
    """Frame numbers of a text such as 0,10,20-29, increasing; None for all. Raises InputError for anything else."""
    if text.strip().lower() == "all":
        return None
    numbers: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,9})(?:-(\d{1,9}))?\s*", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, -1)
        if not first <= last < first + 100_000:
            raise InputError(f"--frames: expected numbers such as 0 or 0,10,20-29, or all; got {text!r}")
        numbers += range(first, last + 1)
    return tuple(sorted(set(numbers)))


# ------------------------------------------------------------------ simulated pictures


def _simulated(given: Given, settings: HypothesisStudySettings, seed: int) -> Cases:
    """Hands of the prior before a plain background, palm or back to the camera; each number is a picture of its own."""
    for name in ("camera", "mask"):
        if getattr(given, name) is not None:
            raise InputError(f"--{name}: expected INPUT with it; simulated pictures have their own")
    if given.frames is None:
        raise InputError("--frames: expected numbers for simulated pictures, which have no end; got all")
    prior, side, shape = load_hand_model().prior(dtype=torch.float64), _side_of(given) or "right", _shape_of(given.hand)
    cases = [
        simulated_case(number, prior, settings, seed, side=side, shape=shape, size=given.size)
        for number in given.frames
    ]
    return Cases(cases=cases, reference="exact, of simulated pictures")


# ------------------------------------------------------------------ sequences with truth


def _sequence(given: Given, folder: Path) -> Cases:
    known = load_known_poses(folder / TRUTH_NAME, side=given.side, hand=given.hand)
    numbers = tuple(range(len(known))) if given.frames is None else given.frames
    outside = next((number for number in numbers if number >= len(known)), None)
    if outside is not None:
        raise InputError(f"--frames: expected 0 to {len(known) - 1}, the frames of {folder}, got {outside}")
    unknown = next((number for number in numbers if not bool(known.pose[number].isfinite().all())), None)
    if unknown is not None:
        raise InputError(f"{folder / TRUTH_NAME}: frame {unknown}: expected a pose, or keypoints to fit, got none")
    pictures = _pictures(folder / FRAMES_NAME, numbers, given.camera or folder / CAMERAS_NAME)
    masks = numbered_pictures(folder / MASKS_NAME)
    return Cases(
        cases=[
            _known_case(known, number, image, _mask(folder, masks, number, image, pictures.part), pictures.camera)
            for number, image in zip(numbers, pictures.images, strict=True)
        ],
        reference=known.source,
    )


def _known_case(known: KnownPoses, number: int, image: Tensor, mask: Tensor, camera: Camera) -> StudyCase:
    return StudyCase(
        frame=number,
        image=image,
        mask=mask,
        camera=camera,
        side=known.side,
        shape=known.shape,
        pose=HandPose.of(known.pose[number], known.root_reference),
    )


def _mask(
    folder: Path, masks: dict[int, Path], number: int, image: Tensor, part: PicturePart
) -> Bool[Tensor, "height width"]:
    """Mask from masks/ where the folder has them, else by the skin's colour."""
    if not masks:
        start = bootstrap_skin(image)
        if not start.has_skin:
            raise InputError(f"{folder}: frame {number}: no hand by its colour ({start.reason}); give {MASKS_NAME}/")
        return start.mask
    if number not in masks:
        raise InputError(f"{folder / MASKS_NAME}: expected a mask of every frame, lacks number {number}")
    return _reduced_mask(masks[number], torch.from_numpy(load_mask(masks[number])), part)


def _reduced_mask(path: Path, mask: Bool[Tensor, "height width"], part: PicturePart) -> Bool[Tensor, "_height _width"]:
    if tuple(mask.shape[::-1]) != part.part:
        expected, got = (f"{size[0]}x{size[1]}" for size in (part.part, mask.shape[::-1]))
        raise InputError(f"{path}: expected a mask of {expected} px, the size of the picture, got {got}")
    return part.mask(mask)


# ------------------------------------------------------------------ pictures without truth


def _found(given: Given, source: Path) -> Cases:
    numbers = given.frames
    pictures = _pictures(source, numbers, given.camera)
    if given.mask is not None and len(pictures.images) != 1:
        raise InputError(f"--mask: expected one picture with it, got {len(pictures.images)}")
    numbers = tuple(range(len(pictures.images))) if numbers is None else numbers
    place = {"rotation": torch.eye(3).double(), "translation": torch.zeros(3).double()}
    cases = [
        _found_case(source, number, image, replace(pictures, camera=replace(pictures.camera, **place)), given)
        for number, image in zip(numbers, pictures.images, strict=True)
    ]
    return Cases(cases=cases, reference="the best registration about the fit of an open hand", is_final=False)


def _found_case(source: Path, number: int, image: Tensor, pictures: "_Pictures", given: Given) -> StudyCase:
    camera = pictures.camera
    side: Side = _side_of(given) or "right"
    where = source if source.is_file() else f"{source}: frame {number}"
    if given.mask is None:
        mask = find_open_hand(image).mask
    else:
        mask = _reduced_mask(given.mask, read_picture(given.mask).amax(-1) > 127, pictures.part)
    if not bool(mask.any()):
        raise InputError(f"{where}: no hand: nothing of a hand's size stands out by colour or brightness; give --mask")
    kinematics = load_hand_model().kinematics(side, dtype=torch.float64)
    hand = fit_open_hand(mask, kinematics, camera)
    if isinstance(hand, NoRegions):
        raise InputError(f"{where}: {hand.reason}")
    if hand.overlap < _MIN_OVERLAP:
        raise InputError(
            f"{where}: no hand fits the silhouette (overlap {hand.overlap:.2f}, expected {_MIN_OVERLAP:g} or more)"
        )
    shape, pose = hand.fit.shape, hand.fit.pose
    given_shape = _shape_of(given.hand)
    if given_shape is not None:  # the same in the picture, as far away as its size wants it
        scale = hand_length(kinematics, given_shape) / hand_length(kinematics, shape)
        pose, shape = torch.cat((scale * pose[:3], pose[3:])), given_shape
    return StudyCase(
        frame=number,
        image=image,
        mask=mask,
        camera=camera,
        side=side,
        shape=shape,
        pose=HandPose.of(pose, hand.fit.root_reference),
    )


# ------------------------------------------------------------------ what they share


@dataclass(frozen=True, kw_only=True)
class _Pictures:
    """Pictures of one camera, reduced where they are large."""

    images: Sequence[UInt8[Tensor, "height width 3"]]
    camera: Camera
    part: PicturePart
    """How the pictures were reduced."""


def _pictures(source: Path, numbers: Sequence[int] | None, camera: Path | None) -> _Pictures:
    """The pictures of the given numbers, or all."""
    images: list[Tensor] = []
    part: PicturePart | None = None
    spans = [(0, None)] if numbers is None else [(number, 1) for number in numbers]
    size = (0, 0)
    for start, count in spans:
        with open_source(source, start=start, max_frames=count) as frames:
            size = (frames.width, frames.height)
            before = len(images)
            for frame in frames:
                if frame.image is None:
                    raise InputError(f"{frame.problem}")
                part = part or PicturePart.of((0, 0), size, WORKING_PIXELS)
                images.append(part.image(frame.image))
            if len(images) == before:
                raise InputError(f"--frames: {source} has no frame {start}")
    assert part is not None  # there is a picture
    used = camera_for(camera, *size)
    used = used if part.size == part.part else used.of_part(part.corner, part.part, part.size)
    return _Pictures(images=images, camera=used, part=part)


def _side_of(given: Given) -> Side | None:
    if given.side is not None or given.hand is None:
        return given.side
    return "left" if given.hand.side == "left" else "right"


def _shape_of(hand: FittedHand | None) -> Tensor | None:
    return None if hand is None else torch.tensor(list(hand.values.values()), dtype=torch.float64)
