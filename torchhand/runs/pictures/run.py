"""A run over single pictures: each by itself into one result folder, refusals told, resumable."""

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor
from tqdm import tqdm

import torchhand
from torchhand.cluster import Copies, copies_for
from torchhand.devices import HOST
from torchhand.draw import draw_overlay
from torchhand.errors import InputError
from torchhand.files import FittedHand, Track, TrackHeader, load_hand_model, load_track, read_picture
from torchhand.files.disk import expanded, replacing
from torchhand.files.pictures import file_identity, input_identity, unique_names
from torchhand.files.results import CONVENTION, POSES_NAME, PictureRecord, PosesWriter
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandPose, Side
from torchhand.runs import record_of, undetermined_fingers
from torchhand.runs.pictures.bounded import BoundedView
from torchhand.runs.pictures.inputs import (
    CameraOf,
    KeypointsFile,
    KeypointsOfPictures,
    PictureDetector,
    PictureHand,
    cameras_of,
    mask_of,
    pictures_in,
)
from torchhand.runs.pictures.sources import pose_sources
from torchhand.runs.recordings import ASSUMED_CAMERA
from torchhand.track import Estimate, View
from torchhand.track.single import SinglePose, SinglePoseFitter, SinglePoseSettings
from torchhand.view import HandProjector

Say = Callable[[str], None]
"""Tells the user something on one line."""


@dataclass(frozen=True, kw_only=True)
class PicturesRequest:
    """What is asked for."""

    source: Path
    """A picture, or a folder of pictures."""
    settings: SinglePoseSettings
    side: Side | None = None
    """Which hand; None for what the detector says, and right where nothing tells."""
    hand: FittedHand | None = None
    """Known proportions; None for those that each picture shows."""
    camera: Path | None = None
    keypoints: tuple[Path, ...] = ()
    """The file of detected keypoints, where there is one."""
    has_detector: bool = False
    """Whether MediaPipe looks at the pictures, in place of a file."""
    hand_model: Path | None = None
    """MediaPipe's hand_landmarker.task; its own models where none is given."""
    masks: Path | None = None
    """Folder of silhouettes."""
    resume: bool = False
    overwrite: bool = False
    has_overlays: bool = True
    device: torch.device = HOST
    """Device of the fit; reading and drawing are the processor's."""


class _Pictures:
    """The inputs of a run, picture by picture."""

    def __init__(self, request: PicturesRequest) -> None:
        self.request, self.paths = request, pictures_in(request.source)
        self.overlay_names = unique_names(self.paths)
        names = [path.name for path in self.paths]
        self.camera: CameraOf = cameras_of(request.camera, names)
        self._stored: KeypointsOfPictures | None = None
        if request.keypoints and not request.has_detector:
            self._stored = KeypointsFile(request.keypoints[0], side=request.side, pictures=names)
        if request.masks is not None and not request.masks.is_dir():
            raise InputError(f"--masks: expected a folder of silhouettes, got {request.masks}")

    @cached_property
    def _detector(self) -> PictureDetector:
        """Made where it is used: no copy of a process in which MediaPipe has run can run it."""
        return PictureDetector(side=self.request.side, hand_model=self.request.hand_model)

    @property
    def keypoints(self) -> KeypointsOfPictures | None:
        return self._detector if self.request.has_detector else self._stored

    def detector_name(self, copies: Copies | None) -> str | None:
        """The detector's program, version and model, told by a copy where there are to be some; None where none runs.

        Raises InputError where MediaPipe is not installed or cannot read the model.
        """
        if not self.request.has_detector:
            return None
        if copies is None:
            return self._detector.name
        [(_, name)] = Copies(1).done(lambda: lambda number: self._detector.name, [0])
        return name

    def view(self, number: int) -> tuple[View, Camera, Side]:
        """One picture with what is known of it. Raises InputError where it cannot be read."""
        path, request = self.paths[number], self.request
        image = read_picture(path)
        height, width = int(image.shape[0]), int(image.shape[1])
        mask = mask_of(path, request.masks, (height, width))
        side: Side = request.side or "right"
        found = PictureHand() if self.keypoints is None else self.keypoints.hand(number, path.name, image)
        if found.keypoints is not None and request.side is None:
            side = found.side or side
        view = View(image=image, mask=mask, keypoints=found.keypoints, is_detector_silent=found.is_silent)
        return view, self.camera(number, width, height), side


@lru_cache(maxsize=2)
def single_pose_fitter(side: Side, settings: SinglePoseSettings, device: torch.device = HOST) -> SinglePoseFitter:
    """The fitter of a side, on a device, with all sources of first poses that there are."""
    kinematics = load_hand_model().to(device=device).kinematics(side, dtype=torch.float64)
    return SinglePoseFitter(kinematics, settings, sources=pose_sources(kinematics))


def fit_pictures(request: PicturesRequest, out_dir: Path, say: Say, *, workers: int = 1) -> Track:
    """The hands of all pictures, written into a folder; those that are refused are told with the reason.

    workers: copies of this process that share the pictures, at most, where it can be copied; the results are the same.
    Raises InputError for inputs that are wrong, among them a single picture that cannot be read.
    """
    pictures = _Pictures(request)
    if not expanded(request.source).is_dir():
        pictures.view(0)  # its mistakes are the user's
    model, copies = load_hand_model(), copies_for(len(pictures.paths), workers, request.device)
    header = _header(request, pictures.detector_name(copies))
    if request.camera is None:
        say(ASSUMED_CAMERA)
    paths = pictures.paths
    with PosesWriter(
        out_dir, header, model.shape_space.names, resume=request.resume, overwrite=request.overwrite
    ) as writer:
        left = [number for number, path in enumerate(paths) if path.name not in writer.done]
        fit = partial(_fitted, pictures, writer.overlays if request.has_overlays else None)
        hidden, before = not sys.stderr.isatty(), len(paths) - len(left)
        with tqdm(total=len(paths), initial=before, desc="pictures", unit="picture", disable=hidden) as bar:
            for number, record in _in_order(left, fit, copies):
                writer.append(record)
                if record.hand.status != "tracked":
                    say(f"{paths[number].name}: no hand: {record.hand.reason}")
                bar.update()
    return load_track(out_dir / POSES_NAME)


def _in_order(
    numbers: Sequence[int], fit: Callable[[int], PictureRecord], copies: Copies | None
) -> Iterator[tuple[int, PictureRecord]]:
    """Pictures with their records, in their order."""
    if copies is None:
        yield from ((number, fit(number)) for number in numbers)
        return
    records, done = dict[int, PictureRecord](), copies.done(lambda: fit, numbers)
    for number in numbers:
        while number not in records:
            other, record = next(done)
            records[other] = record
        yield number, records.pop(number)


def _fitted(pictures: _Pictures, overlays: Path | None, number: int) -> PictureRecord:
    """The record of one picture, and its overlay."""
    request, path, started = pictures.request, pictures.paths[number], time.perf_counter()
    try:
        view, camera, side = pictures.view(number)
    except InputError as error:
        estimate = Estimate(status="no_hand", time_s=0.0, reason=str(error))
        return _record(number, path, estimate, None, None, request.side or "right", started)
    shape = None
    if request.hand is not None:
        shape = torch.tensor(list(request.hand.values.values()), dtype=torch.float64)
    bounded = BoundedView.of(view, camera)
    found = bounded.fitted(single_pose_fitter(side, request.settings, request.device), shape)
    record = _record(number, path, found.estimate, found, camera, side, started)
    if overlays is not None and bounded.view.image is not None:
        _save_overlay(
            overlays / f"{pictures.overlay_names[number]}.png", bounded.view.image, found, bounded.camera, side, number
        )
    return record


def _record(
    number: int,
    path: Path,
    estimate: Estimate,
    found: SinglePose | None,
    camera: Camera | None,
    side: Side,
    started: float,
) -> PictureRecord:
    hand = record_of(number, estimate, ("picture",), seconds=time.perf_counter() - started)
    modes = math.nan if found is None or not found.modes else float(found.modes)
    names = load_hand_model().shape_space.names
    has_hand = found is not None and estimate.pose is not None
    return PictureRecord(
        image=path.name,
        hand=replace(hand, measures={**hand.measures, "modes": modes}),
        side=side,
        shape=found.shape.numpy() if found is not None and has_hand else np.full(len(names), math.nan),
        intrinsics=np.full((3, 3), math.nan) if camera is None else camera.intrinsics.double().numpy(),
    )


def _save_overlay(
    path: Path, image: UInt8[Tensor, "height width 3"], found: SinglePose, camera: Camera, side: Side, number: int
) -> None:
    kinematics = load_hand_model().kinematics(side, dtype=torch.float64)
    eye, zero = torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    here = replace(camera.to(dtype=torch.float64), rotation=eye, translation=zero)
    estimate = found.estimate
    pose = None if estimate.pose is None else HandPose.of(estimate.pose).normalized()
    picture = draw_overlay(
        image,
        HandProjector(kinematics, here, found.shape),
        pose,
        status=estimate.status,
        frame=number,
        keypoints_px=None if estimate.keypoints is None else here.project(estimate.keypoints.double()),
        iou=estimate.overlap,
        undetermined=undetermined_fingers(None if estimate.finger_quality is None else estimate.finger_quality.numpy()),
    )
    with replacing(path) as temporary:
        if not cv2.imwrite(str(temporary), cv2.cvtColor(picture.numpy(), cv2.COLOR_RGB2BGR)):
            raise InputError(f"{path}: cannot be written")


def _header(request: PicturesRequest, detector: str | None) -> TrackHeader:
    """What must be equal in a run that is to be resumed."""

    def identity(path: Path | None) -> dict[str, Any] | None:
        return None if path is None else file_identity(path)

    made_with: Mapping[str, Any] = {
        "torchhand": torchhand.__version__,
        "input": input_identity(expanded(request.source)),
        "settings": asdict(request.settings),
        "keypoints": [*map(identity, request.keypoints)] if detector is None else detector,
        "masks": identity(request.masks),
        "hand": None if request.hand is None else dict(request.hand.values),
    }
    return TrackHeader(
        dof_names=DOFS,
        source=str(request.source),
        side=request.side or "each picture's own",
        camera={"file": identity(request.camera), "is_assumed": request.camera is None},
        convention=CONVENTION,
        made_with=json.loads(json.dumps(made_with, default=str), parse_constant=str),  # JSON knows no infinity
    )
