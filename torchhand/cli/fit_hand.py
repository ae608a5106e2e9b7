"""Fit the hand to one picture of an open hand: its own proportions, with a standard deviation for each."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor
from tyro.conf import Positional, arg

from torchhand.cli.command import DONE, OnDevice, command, parse, threads
from torchhand.devices import device_named
from torchhand.draw import draw_overlay
from torchhand.errors import InputError
from torchhand.files import camera_entry, camera_for, load_hand_model, read_picture, save_hand
from torchhand.files.disk import explained_errors, replacing
from torchhand.files.pictures import MAX_MEGAPIXELS, pixel_limit
from torchhand.fit.detect import Fit
from torchhand.fit.open_hand import (
    Facing,
    HandInPicture,
    HandSize,
    OpenHand,
    facing_of,
    fit_open_hand,
    hand_in_picture,
    known_length,
    length_at_distance,
    population_length,
    sized,
)
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandKinematics, HandPose, Side
from torchhand.image import NoRegions, PicturePart
from torchhand.image.fingers import HandSilhouette
from torchhand.view import HandProjector

_MIN_OVERLAP = 0.7  # below, the fitted hand does not explain the silhouette
_GOOD_OVERLAP, _GOOD_FOUND = 0.85, 0.85  # below, the fit is called doubtful
_MAX_OVERLAY_PX = 4_000_000
_HAND_LENGTHS = (0.14, 0.24)  # metres: the bounds of the shape space


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Fit the hand to one picture of an open hand: its own proportions, with a standard deviation for each.

    IMAGE shows one open hand, fingers spread and apart, flat and square to the camera, with a bare forearm or none.
    It is found by itself; --mask gives its silhouette instead. The result, hand.json, is what `torchhand track --hand`
    takes. One picture shows proportions only: size comes from --hand-length, from --camera with --distance, or is that
    of the mean person, and the file says which.

    Example:
        torchhand fit_hand open.jpg --out hand.json --side left --hand-length 0.182 --overlay open_fitted.png
    """

    image: Annotated[Positional[Path], arg(metavar="IMAGE")]
    """Picture of the open hand."""
    out: Annotated[Path, arg(metavar="FILE")]
    """hand.json to write."""
    mask: Annotated[Path | None, arg(metavar="FILE")] = None
    """Silhouette of hand and forearm as a picture of the same size, bright inside."""
    side: Literal["left", "right"] | None = None
    """Which hand; else told by --facing and the thumb's place, and right where neither tells."""
    facing: Literal["palm", "back"] | None = None
    """Side of the hand that the camera sees; else told by --side and the thumb's place."""
    camera: Annotated[Path | None, arg(metavar="FILE")] = None
    """Calibrated camera (cameras.json with one entry); without it a field of view is assumed."""
    distance: Annotated[float | None, arg(metavar="METRES")] = None
    """Distance of the palm from the camera, along its optical axis; needs --camera."""
    hand_length: Annotated[float | None, arg(metavar="METRES")] = None
    """Length of the hand, from the wrist's crease to the tip of the middle finger, such as 0.187."""
    overlay: Annotated[Path | None, arg(metavar="FILE")] = None
    """Picture of the fitted hand over the photograph (png or jpg)."""
    overwrite: bool = False
    """Replace older results."""
    threads: int = 1
    """Threads of the fit; its tensors are small."""
    max_megapixels: float = MAX_MEGAPIXELS
    """Largest picture that is read; what is larger by its header is refused before it is decoded."""

    def __post_init__(self) -> None:
        low, high = _HAND_LENGTHS
        if self.hand_length is not None and not low <= self.hand_length <= high:
            raise ValueError(f"--hand-length: expected {low:g} to {high:g} metres, got {self.hand_length:g}")
        if self.distance is not None and not 0 < self.distance < 100:
            raise ValueError(f"--distance: expected metres above 0, below 100, got {self.distance:g}")
        if self.distance is not None and self.camera is None:
            raise ValueError("--distance: expected --camera with it: an assumed field of view tells no size")
        if self.distance is not None and self.hand_length is not None:
            raise ValueError("--distance: expected either it or --hand-length, got both")


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Fit one picture."""
    arguments = parse(Arguments, argv, name="fit_hand")
    _check_outputs(arguments)
    device_named(arguments.device)  # a mistake is told before the work
    with pixel_limit(arguments.max_megapixels):
        return _fit(arguments)


def _fit(arguments: Arguments) -> int:
    image = read_picture(arguments.image)
    height, width = image.shape[:2]
    camera = camera_for(arguments.camera, width, height)
    if arguments.distance is not None and camera.kind != "pinhole":
        raise InputError(f"{arguments.camera}: expected a pinhole camera with --distance, got an {camera.kind} one")
    camera = replace(camera, rotation=torch.eye(3).double(), translation=torch.zeros(3).double())
    with threads(arguments.threads):
        seen = _silhouette(arguments, image)
        hand, side, notes = _fitted(arguments, seen.silhouette.mask, seen.camera(camera))
        kinematics = load_hand_model().kinematics(side, dtype=torch.float64)
        size = _size(arguments, hand.fit, kinematics, camera)
        fit = sized(hand.fit, kinematics.shape_space, size)
        if arguments.overlay is not None:
            _draw(arguments.overlay, image, kinematics, camera, fit, hand.overlap)
    _save(arguments, hand, fit, side, size, camera, seen, notes)
    print(_summary(hand, fit, side, size, kinematics))
    for note in notes:
        print(f"note: {note}")
    print(f"saved {arguments.out}" + (f" and {arguments.overlay}" if arguments.overlay is not None else ""))
    return DONE


def _check_outputs(arguments: Arguments) -> None:
    for name, path in (("--out", arguments.out), ("--overlay", arguments.overlay)):
        if path is None:
            continue
        if path.is_dir():
            raise InputError(f"{name}: expected a file, got the folder {path}")
        if not path.parent.is_dir():
            raise InputError(f"{name}: expected a file in an existing folder, got {path}")
        if path.exists() and not arguments.overwrite:
            raise InputError(f"{path}: exists already; give another name, or --overwrite")
    overlay = arguments.overlay
    if overlay is not None and overlay.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InputError(f"--overlay: expected a name that ends in .png or .jpg, got {overlay}")


def _silhouette(arguments: Arguments, image: UInt8[Tensor, "height width 3"]) -> HandInPicture:
    if arguments.mask is not None:
        given = read_picture(arguments.mask)
        if given.shape != image.shape:
            expected, got = (f"{picture.shape[1]}x{picture.shape[0]}" for picture in (image, given))
            raise InputError(f"{arguments.mask}: expected a mask of {expected} px, the size of the picture, got {got}")
        return hand_in_picture(image, given.amax(-1) > 127)
    seen = hand_in_picture(image)
    _check_found(arguments.image, seen.silhouette)
    return seen


def _check_found(path: Path, found: HandSilhouette) -> None:
    if not bool(found.mask.any()):
        raise InputError(f"{path}: no hand: nothing of a hand's size stands out by colour or brightness; give --mask")
    if found.odd_digits and found.search is not None and found.search.order is not None:
        odd, right = found.odd_digits, [name for name in found.search.order.fingers if name not in found.odd_digits]
        raise InputError(
            f"{path}: what looks like {', '.join(odd)} has another colour than the palm (a shadow, or something behind"
            f" the hand); found {', '.join(right) or 'no finger'} otherwise; give --mask"
        )


def _fitted(
    arguments: Arguments, mask: Bool[Tensor, "height width"], camera: Camera
) -> tuple[OpenHand, Side, list[str]]:
    """The fit, the side, and what the user should know about them."""
    side: Side = arguments.side or "right"
    model = load_hand_model().to(device=device_named(arguments.device))
    hand = fit_open_hand(mask, model.kinematics(side, dtype=torch.float64), camera)
    if isinstance(hand, NoRegions):
        raise InputError(f"{arguments.image}: {hand.reason}")
    notes: list[str] = []
    seen: Facing = facing_of(side, hand.regions.is_mirrored)
    if arguments.side is None and arguments.facing is None:
        other = facing_of("left", hand.regions.is_mirrored)
        notes.append(
            f"the thumb's place fits a right hand's {seen} or a left hand's {other}; taken for right"
            " (the same proportions; give --side or --facing)"
        )
    elif arguments.facing is not None and arguments.facing != seen:
        if arguments.side is not None:
            raise InputError(
                f"{arguments.image}: the thumb lies where a {side} hand's {seen} has it, not its {arguments.facing};"
                " check --side and --facing, or whether the picture is mirrored"
            )
        side = "left"
        mirrored = fit_open_hand(mask, model.kinematics(side, dtype=torch.float64), camera)
        if isinstance(mirrored, NoRegions):
            raise InputError(f"{arguments.image}: {mirrored.reason}")
        hand = mirrored
    if hand.overlap < _MIN_OVERLAP:
        raise InputError(
            f"{arguments.image}: five fingers stand out, but no hand fits the silhouette (overlap {hand.overlap:.2f},"
            f" expected {_MIN_OVERLAP:g} or more); give a better picture, or --mask"
        )
    if _quality(hand) == "doubtful":
        notes.append(
            f"the fit is doubtful: overlap {hand.overlap:.2f}, edges on {hand.fit.found_fraction:.0%} of the outline;"
            " look at --overlay"
        )
    if hand.corrected:
        notes.append(f"moved into the range of people's hands: {', '.join(hand.corrected)}")
    return hand, side, notes


def _quality(hand: OpenHand) -> str:
    is_good = hand.overlap >= _GOOD_OVERLAP and hand.fit.found_fraction >= _GOOD_FOUND
    return "good" if is_good else "doubtful"


def _size(arguments: Arguments, fit: Fit, kinematics: HandKinematics, camera: Camera) -> HandSize:
    if arguments.hand_length is not None:
        return known_length(arguments.hand_length)
    if arguments.distance is None:
        return population_length(kinematics.shape_space)
    size = length_at_distance(fit, kinematics, camera, arguments.distance)
    if not _HAND_LENGTHS[0] <= size.length <= _HAND_LENGTHS[1]:
        raise InputError(
            f"--distance: at {arguments.distance:g} m the hand would be {size.length:.3f} m long, expected"
            f" {_HAND_LENGTHS[0]:g} to {_HAND_LENGTHS[1]:g}; check it and --camera"
        )
    return size


def _draw(path: Path, image: Tensor, kinematics: HandKinematics, camera: Camera, fit: Fit, overlap: float) -> None:
    part = PicturePart.of((0, 0), (camera.width, camera.height), _MAX_OVERLAY_PX)
    image, camera = part.image(image), camera.of_part(part.corner, part.part, part.size)
    projector = HandProjector(kinematics, camera, fit.shape)
    keypoints = camera.project(projector.frames(fit.pose, fit.root_reference).keypoints)
    picture = draw_overlay(
        image,
        projector,
        HandPose.of(fit.pose, fit.root_reference),
        status="tracked",
        frame=0,
        keypoints_px=keypoints,
        iou=overlap,
    )
    with replacing(path) as temporary:
        if not cv2.imwrite(str(temporary), cv2.cvtColor(picture.numpy(), cv2.COLOR_RGB2BGR)):
            raise InputError(f"{path}: cannot be written")


def _save(
    arguments: Arguments,
    hand: OpenHand,
    fit: Fit,
    side: Side,
    size: HandSize,
    camera: Camera,
    seen: HandInPicture,
    notes: list[str],
) -> None:
    space = load_hand_model().shape_space
    regions, part = hand.regions, seen.part
    provenance: dict[str, Any] = {
        "method": "open hand",
        "source": str(arguments.image),
        "silhouette": seen.silhouette.source if arguments.mask is None else str(arguments.mask),
        "metric_source": size.source,
        "facing": hand.facing,
        "side_given": arguments.side is not None or arguments.facing is not None,
        "quality": _quality(hand),
        "overlap": hand.overlap,
        "mean_residual_px": fit.residual_px / part.scale,
        "edges_found": fit.found_fraction,
        "corrected": list(hand.corrected),
        "notes": notes,
        "std": dict(zip(space.names, fit.shape_std.tolist(), strict=True)),
        "pose": dict(zip(DOFS, fit.pose.tolist(), strict=True)),
        "pose_std": dict(zip(DOFS, fit.pose_std.tolist(), strict=True)),
        "cam_from_hand": fit.root_reference.tolist(),
        "camera": camera_entry(camera) | {"is_assumed": camera.is_assumed},
        "digits_px": {
            digit.name: {
                "tip": part.whole_px(digit.tip).tolist(),
                "base": part.whole_px(digit.base).tolist(),
                "radius": digit.radius / part.scale,
            }
            for digit in regions.digits
        },
        "wrist_px": part.whole_px(regions.wrist).tolist(),
    }
    with explained_errors(arguments.out):
        save_hand(arguments.out, space.names, fit.shape.tolist(), side, provenance, units=space.units)


def _summary(hand: OpenHand, fit: Fit, side: Side, size: HandSize, kinematics: HandKinematics) -> str:
    metric = kinematics.shape_space.metric(fit.shape)
    bones = ", ".join(f"{1000 * float(metric[f'middle_{bone}']):.0f}" for bone in ("proximal", "middle", "distal"))
    return (
        f"{side} hand, {hand.facing} seen; {1000 * size.length:.0f} ± {1000 * size.std:.0f} mm long (from"
        f" {size.source}), {1000 * float(metric['hand_breadth']):.0f} mm broad, middle finger {bones} mm;"
        f" overlap {hand.overlap:.2f}"
    )
