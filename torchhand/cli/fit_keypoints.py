"""Fit the hand to keypoints that a detector found: joint angles and one shape from MediaPipe or OpenPose files."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from tyro.conf import Positional, arg

from torchhand import __version__
from torchhand.cli.command import DONE, OnDevice, command, parse, threads
from torchhand.devices import device_named
from torchhand.errors import InputError
from torchhand.files import (
    Detections,
    FittedHand,
    camera_entry,
    load_hand_model,
    read_detections,
    save_cameras,
    save_hand,
)
from torchhand.files.detections import Units, read_rig_detections
from torchhand.files.disk import explained_errors, replacing
from torchhand.files.results import CONVENTION, FIT_NAME, HAND_NAME, REPORT_NAME
from torchhand.fit.keypoints import (
    KeypointFit,
    KeypointFitSettings,
    RefinedCameras,
    fit_keypoints,
    refine_cameras,
)
from torchhand.geometry import Camera
from torchhand.hand import DOFS, POSE_SPACES, Side, named_pose_space
from torchhand.report import load_result, write_report
from torchhand.runs import PALM_METRES, cameras_of_detections, known_hand, same_frames, seen_keypoints

_FORMAT = "torchhand keypoints fit 1"
_CAMERAS_NAME = "cameras.json"
_MAX_UNEXPLAINED = 0.4
"""Random points leave 0.7 to 0.9 (Gaussian, and uniform in a cube), what detectors see of hands 0.05 to 0.2."""
_OFFSET_STD = 0.005
_MIN_RECORDED = 30  # frames without names of pictures that are taken for a recording
_UNITS: dict[str, Units] = {"metres": "metres", "px": "px", "normalised": "normalised", "any": "metres"}


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Fit the hand to keypoints that a detector found: joint angles and one shape from MediaPipe or OpenPose files.

    INPUT is JSON of MediaPipe or OpenPose, a folder of OpenPose's *_keypoints.json, or arrays (frames, 21, 2 or 3) as
    .npy or .npz (points_px and world of MediaPipe, keypoints3d, keypoints2d ...; std_px or cov_px for the points'
    standard deviations or covariances in the picture), missing points NaN, (0, 0) or (-1, -1). Several INPUTs are those
    of several cameras, as is one array (cameras, frames, 21, 2). DIR gets keypoints_fit.npz (pose, pose_std,
    keypoints3d, residual, status ... per frame), hand.json (the shape) and report.html, which opens in a browser.
    Points in a picture need --camera, or --size for an assumed field of view; points in space beside them (MediaPipe's
    world landmarks) are used together with them. Points outside the pictures are left out (of one camera, where they
    are farther outside than the picture is large), and so are those of another hand than most cameras see. A recording
    is smoothed, short gaps in it are filled, and cameras may be late.

    Examples:
        torchhand fit_keypoints hands.json --out out/hands --side left --size 1280x720
        torchhand fit_keypoints points2d.npy --cameras calibration.toml --out out/rig --side right
    """

    input: Annotated[Positional[tuple[Path, ...]], arg(metavar="INPUT")]
    """File or folder of keypoints; one per camera, in the cameras' order."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for the results."""
    camera: Annotated[Path | None, arg(metavar="FILE", aliases=["--cameras"])] = None
    """Calibrated cameras of the pictures, one per INPUT or of the array, in their order: cameras.json, aniposelib's
    TOML, OpenCV's YAML, or another calibration that track_multiview reads; or an .npz with one K per picture."""
    views: Annotated[str | None, arg(metavar="NUMBERS")] = None
    """Cameras to use, by their places from 0 on, such as 0,2; all if not given."""
    unit: Annotated[str | None, arg(metavar="UNIT")] = None
    """Unit of the cameras' places: m, cm, mm, inch, or a number of metres. Metres if not given, or the unit that makes
    the hand a hand's size, which is then said."""
    size: Annotated[str | None, arg(metavar="WxH")] = None
    """Size of the pictures in px, such as 1280x720, where there is no --camera: a field of view is then assumed."""
    side: Literal["left", "right"] | None = None
    """Which hand; that of --hand or of the file if not given, and where neither tells, the one that fits better."""
    hand: Annotated[Path | None, arg(metavar="FILE")] = None
    """Known shape of the hand (hand.json), which is then not fitted."""
    space: Annotated[str, arg(metavar="NAME")] = "dof27"
    """Free joint angles: dof26, dof27, dof28, dof31 or dof36."""
    points: Literal["auto", "space", "picture"] = "auto"
    """Points of files with both kinds: those in space (MediaPipe's world landmarks) alone, or those in the picture
    alone; auto takes both with --camera or --size, else those in space."""
    units: Literal["auto", "metres", "px", "normalised", "any"] = "auto"
    """Unit of arrays; any: points in space in an unknown unit, whose scale is fitted at the default hand length."""
    mirrored: bool = False
    """The pictures were mirror images, so MediaPipe's left is left; without this its names are swapped."""
    fit_shape: bool = True
    """Fit one shape to all frames; else the default or that of --hand."""
    smooth: bool | None = None
    """Frames are those of a recording, at equal distances in time: poses are smoothed. If not given, points in pictures
    are where there are 30 frames or more that have no names of pictures."""
    fit_offsets: bool = False
    """Fit constant offsets (some 5 mm) of the detector's keypoints from ours too: makers place joints differently."""
    refine_cameras: bool = False
    """Correct turns and places of the cameras after the first, known to some 3 degrees and 50 mm, by the hand's points;
    refused where its motion does not tell them. Writes cameras.json too."""
    report: bool = True
    """Write report.html: one page with the hand in 3D, every angle over time and tables."""
    overwrite: bool = False
    """Replace older results in DIR."""
    threads: int = 1
    """Threads of the solver."""

    def __post_init__(self) -> None:
        if self.space not in POSE_SPACES or self.space.startswith("planar"):
            allowed = ", ".join(name for name in POSE_SPACES if not name.startswith("planar"))
            raise ValueError(f"--space: expected one of {allowed}, got {self.space!r}")
        if self.camera is not None and self.size is not None:
            raise ValueError("--size: expected it only without --camera, whose file tells the size")
        if not self.input:
            raise ValueError("INPUT: expected at least one file or folder of keypoints, got none")


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Fit one file or folder."""
    arguments = parse(Arguments, argv, name="fit_keypoints")
    device = device_named(arguments.device)
    _check_folder(arguments)
    hand = None if arguments.hand is None else known_hand(arguments.hand)
    detections = _all_detections(arguments, hand)
    cameras = _cameras(arguments, detections)
    detections, cameras = _chosen(arguments.views, detections, cameras)
    with threads(arguments.threads):
        refined = _refined(arguments, detections, cameras)
        cameras = cameras if refined is None else list(refined.cameras)
        side, fit, note = _fitted(arguments, hand, detections, cameras, device)
    if not bool(fit.is_fitted.any()):
        reasons = ", ".join(sorted(set(fit.status_names())))
        raise InputError(f"{arguments.input[0]}: expected a frame that can be fitted, got none ({reasons})")
    left = _unexplained(fit, cameras)
    if not left <= _MAX_UNEXPLAINED:
        raise InputError(
            f"{arguments.input[0]}: expected points of a hand, got others: the best hand leaves"
            f" {_mean(fit, bool(cameras))}, {left:.0%} of its own extent; check --side, and the points' order and units"
        )
    _save(arguments, hand, detections, cameras, side, fit)
    if refined is not None:
        save_cameras(cameras, arguments.out / _CAMERAS_NAME)
    print(_summary(fit, side, note, is_seen=bool(cameras)))
    saved = [arguments.out / FIT_NAME, arguments.out / HAND_NAME]
    if arguments.report:
        saved.append(arguments.out / REPORT_NAME)
        write_report(saved[-1], [load_result(saved[0], name=arguments.out.resolve().name)])
    else:
        (arguments.out / REPORT_NAME).unlink(missing_ok=True)  # of older results
    print(f"saved {', '.join(map(str, saved))}")
    return DONE


def _refined(
    arguments: Arguments, detections: Sequence[Detections], cameras: Sequence[Camera]
) -> RefinedCameras | None:
    """The cameras by the hand's points, and what they were off by; None where that was not asked for."""
    if not arguments.refine_cameras:
        return None
    if len(cameras) < 2 or any(camera.kind != "pinhole" or camera.intrinsics.ndim > 2 for camera in cameras):
        raise InputError(f"--refine-cameras: expected points of two pinhole cameras or more, got {len(cameras)}")
    try:
        found = refine_cameras(seen_keypoints(detections, cameras))
    except ValueError as error:
        raise InputError(f"--refine-cameras: {error}") from error
    std = found.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    told = []
    for camera, change, own in zip(cameras[1:], found.change, std, strict=True):
        turn, shift = change[:3].norm().rad2deg(), 1e3 * change[3:].norm()
        turn_std, shift_std = own[:3].max().rad2deg(), 1e3 * own[3:].max()
        told.append(f"{camera.name} {turn:.1f} ± {turn_std:.1f} degrees, {shift:.0f} ± {shift_std:.0f} mm")
    if not bool(found.is_determined.all()):
        raise InputError(
            f"{arguments.input[0]}: --refine-cameras: expected a hand whose motion tells where the cameras are,"
            f" got {'; '.join(told)}"
        )
    print(f"cameras off by: {'; '.join(told)} (standard deviations without what is wrong alike in all frames)")
    return found


def _unexplained(fit: KeypointFit, cameras: Sequence[Camera]) -> float:
    """Residual as a share of the fitted hand's extent (the root mean square of its keypoints about their mean), in the
    median of the frames."""
    points = fit.keypoints
    if cameras:
        points = cameras[0].project(points)
    extent = (points - points.mean(-2, keepdim=True)).square().sum(-1).mean(-1).sqrt()
    return float((fit.residual.nanmean(-1) / extent)[fit.is_fitted].nanmedian())


def _check_folder(arguments: Arguments) -> None:
    out = arguments.out
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: expected a folder for the results, got a file")
    names = (FIT_NAME, HAND_NAME, *([_CAMERAS_NAME] if arguments.refine_cameras else []))
    old = [name for name in names if (out / name).exists()]
    if old and not arguments.overwrite:
        raise InputError(f"{out}: holds {' and '.join(old)} already; give another folder, or --overwrite")


def _all_detections(arguments: Arguments, hand: FittedHand | None) -> list[Detections]:
    """What the files hold of one hand."""
    side: Side | None = arguments.side or (None if hand is None else "left" if hand.side == "left" else "right")
    units = None if arguments.units in ("auto", "any") else _UNITS[arguments.units]
    views = read_rig_detections(arguments.input[0], side=side, units=units, is_mirrored=arguments.mirrored)
    if views is not None:
        if len(arguments.input) > 1:
            raise InputError(f"{arguments.input[1]}: expected no INPUT beside an array of all cameras, got another")
        return views
    found = [_detections(arguments, arguments.input[0], side)]
    found += [_detections(arguments, path, side or found[0].side) for path in arguments.input[1:]]
    return same_frames(found)


def _chosen(
    views: str | None, detections: list[Detections], cameras: list[Camera]
) -> tuple[list[Detections], list[Camera]]:
    """The views that are asked for, of all that there are."""
    if views is None:
        return detections, cameras
    places = [int(text) if text.strip().isdecimal() else -1 for text in views.split(",")]
    if len(set(places)) < len(places) or not all(0 <= place < len(cameras) for place in places):
        allowed = f"numbers from 0 to {len(cameras) - 1}, each once" if cameras else "none, for points in space"
        raise InputError(f"--views: expected {allowed}, separated by commas, got {views!r}")
    return [detections[place] for place in places], [cameras[place] for place in places]


def _detections(arguments: Arguments, path: Path, side: Side | None) -> Detections:
    found = read_detections(
        path,
        side=side,
        points=arguments.points,
        units=_UNITS.get(arguments.units),
        is_mirrored=arguments.mirrored,
    )
    if found.picture is not None and (arguments.camera is not None or arguments.size is not None):
        return found
    if found.space is not None:
        found = found.in_space()
    if found.units == "metres" and arguments.units != "any":
        palm = np.linalg.norm(found.keypoints[:, 9] - found.keypoints[:, 0], axis=-1)
        palm = palm[np.isfinite(palm)]
        if len(palm) and not PALM_METRES[0] <= np.median(palm) <= PALM_METRES[1]:
            raise InputError(
                f"{path}: expected metres ({PALM_METRES[0]:g} to {PALM_METRES[1]:g} from the wrist to the"
                f" middle knuckle), got {np.median(palm):.4g}; give --units any for another unit, or normalised"
            )
    return found


def _cameras(arguments: Arguments, detections: Sequence[Detections]) -> list[Camera]:
    """The cameras of the pictures; none for points in space alone."""
    if any(found.picture is None for found in detections):
        for name in ("camera", "size"):
            if getattr(arguments, name) is not None:
                raise InputError(f"--{name}: expected points of a picture with it, got points in space alone")
        if len(detections) > 1:
            raise InputError(f"{arguments.input[1]}: expected one INPUT of points in space, got {len(detections)}")
        return []
    if arguments.units == "any":
        raise InputError("--units any: expected points in space alone, got those of a picture")
    if arguments.camera is not None:
        return cameras_of_detections(arguments.camera, None, detections, unit=arguments.unit, say=print)
    if arguments.size is None:
        raise InputError(f"{arguments.input[0]}: holds points of a picture: expected --camera or --size, got neither")
    if len(detections) > 1:
        raise InputError("--size: expected --camera for several cameras, whose places nobody can assume")
    width, _, height = arguments.size.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise InputError(f"--size: expected WIDTHxHEIGHT in px such as 1280x720, got {arguments.size!r}")
    return cameras_of_detections(None, (int(width), int(height)), detections)


def _fitted(
    arguments: Arguments,
    hand: FittedHand | None,
    detections: Sequence[Detections],
    cameras: Sequence[Camera],
    device: torch.device,
) -> tuple[Side, KeypointFit, str]:
    """Side, fit, which was computed on the device, and how the side was decided where nobody named it."""
    model = load_hand_model().to(device=device)
    shape = None
    if hand is not None:
        values = [hand.values[name] for name in model.shape_space.names]
        shape = torch.tensor(values, dtype=torch.float64, device=device)
    named: Side | None = arguments.side or detections[0].side
    if named is None and hand is not None:
        named = "left" if hand.side == "left" else "right"
    sides: tuple[Side, ...] = ("left", "right") if named is None else (named,)
    points = torch.from_numpy(detections[0].keypoints).to(device)
    if cameras:
        points = [one.to(device) for one in seen_keypoints(detections, cameras)]
    fits = [
        fit_keypoints(
            model.kinematics(side, dtype=torch.float64),
            points,
            confidence=None if cameras else torch.from_numpy(detections[0].confidence).to(device),
            space=named_pose_space(arguments.space).to(device=device),
            shape=shape,
            fit_shape=arguments.fit_shape and hand is None,
            settings=_settings(arguments, detections),
        ).to(torch.device("cpu"))
        for side in sides
    ]
    if len(sides) == 1:
        return sides[0], fits[0], ""
    errors = [float(fit.residual.square().nanmean()) if bool(fit.is_fitted.any()) else np.inf for fit in fits]
    best = int(np.argmin(errors))
    here, other = (_distance(np.sqrt(errors[which]), bool(cameras)) for which in (best, 1 - best))
    return sides[best], fits[best], f", the better fit ({here} in root mean square, else {other})"


def _settings(arguments: Arguments, detections: Sequence[Detections]) -> KeypointFitSettings:
    first, is_recording = detections[0], arguments.smooth
    if is_recording is None:
        is_recording = first.picture is not None and first.image is None and len(first) >= _MIN_RECORDED
    return KeypointFitSettings(
        offset_std=_OFFSET_STD if arguments.fit_offsets else 0.0,
        fit_scale=arguments.units == "any",
        is_recording=is_recording,
    )


def _mean(fit: KeypointFit, is_seen: bool) -> str:
    return _distance(float(fit.residual.nanmean()), is_seen)


def _distance(value: float, is_seen: bool) -> str:
    return f"{value:.2f} px" if is_seen else f"{1000 * value:.2f} mm"


def _summary(fit: KeypointFit, side: Side, note: str, *, is_seen: bool) -> str:
    names = fit.status_names()
    left_out = {name: names.count(name) for name in sorted(set(names) - {"fitted"})}
    text = "".join(f", {count} {name}" for name, count in left_out.items())
    late = ", ".join(f"{round(lag, 1) + 0.0:.1f}" for lag in fit.lags)  # no -0.0
    note += f"; cameras after the first are late by {late} frames" if late else ""
    scale = "" if fit.scale == 1.0 else f", {fit.scale:.5g} m per unit"
    return (
        f"{names.count('fitted')} of {len(names)} frames fitted{text}; {side} hand{note};"
        f" mean residual {_mean(fit, is_seen)}{scale}"
    )


def _save(
    arguments: Arguments,
    hand: FittedHand | None,
    detections: Sequence[Detections],
    cameras: Sequence[Camera],
    side: Side,
    fit: KeypointFit,
) -> None:
    out, space = arguments.out, load_hand_model().shape_space
    with explained_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    provenance = {
        "method": "keypoints",
        "source": ", ".join(map(str, arguments.input)),
        "frames": int(fit.is_fitted.sum()),
        "mean_residual": float(fit.residual.nanmean()),
        "residual_unit": "px" if cameras else "m",
        "shape_fitted": arguments.fit_shape and hand is None,
        "std": dict(zip(space.names, fit.shape_std.tolist(), strict=True)),
    }
    header = {
        "format": _FORMAT,
        "torchhand": __version__,
        "source": ", ".join(map(str, arguments.input)),
        "side": side,
        "pose_space": arguments.space,
        "camera": _entry(arguments, cameras),
        "settings": asdict(_settings(arguments, detections)),
    }
    arrays: dict[str, Any] = {
        "frame": detections[0].frame,
        "status": np.array(fit.status_names()),
        "pose": fit.pose.numpy(),
        "pose_std": fit.pose_std.numpy(),
        "keypoints3d": fit.keypoints.numpy(),
        "keypoints3d_cov": fit.joints_covariance(cameras[0] if len(cameras) == 1 else None).numpy(),
        "residual": fit.residual.numpy(),
        "shape": fit.shape.numpy(),
        "shape_std": fit.shape_std.numpy(),
        "shape_names": np.array(space.names),
        "offsets": fit.offsets.numpy(),
        "scale": np.array(fit.scale),
        "lags": np.array(fit.lags),
        "dof_names": np.array(DOFS),
        "units": np.array(f"metres, radians; residual {'px' if cameras else 'metres'}"),
        "convention": np.array(CONVENTION if cameras else _in_own_frame(CONVENTION)),
        "header": np.array(json.dumps(header)),
    }
    if detections[0].image is not None:
        arrays["image"] = np.array(detections[0].image)
    if len(cameras) == 1:
        arrays["keypoints2d"] = cameras[0].project(fit.keypoints).numpy()
    with replacing(out / FIT_NAME) as temporary:
        np.savez_compressed(temporary, **arrays)
    save_hand(out / HAND_NAME, space.names, fit.shape.tolist(), side, provenance, units=space.units)


def _entry(arguments: Arguments, cameras: Sequence[Camera]) -> Any:
    """What tells the cameras: an entry, a list of these, or the file of one K per picture."""
    if not cameras:
        return None
    if cameras[0].intrinsics.ndim > 2:
        return {"file": str(arguments.camera)}
    entries = [camera_entry(camera) | {"is_assumed": camera.is_assumed} for camera in cameras]
    return entries[0] if len(entries) == 1 else entries


def _in_own_frame(convention: str) -> str:
    """The same angles and keypoints in whatever frame the points have."""
    return f"frame of the points; {convention[convention.index('root rotation') :]}"
