"""Measure of `torchhand benchmark` on fitting a hand: bone lengths of simulated people, each from one picture."""

import statistics
from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.cli.benchmarks.figures import Figure
from torchhand.files import load_hand_model
from torchhand.fit.open_hand import fit_open_hand, known_length, sized
from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import HandKinematics
from torchhand.image import NoRegions, find_open_hand
from torchhand.simulate import SceneSettings, Staging, render_sequence, sample_shape, scripted_motion
from torchhand.simulate.scene import BackgroundKind
from torchhand.view import HandProjector

SIZE_PX, FOV_DEG = (640, 480), 48.0
PEOPLE, FIRST_SEED = 50, 1000
BONES = tuple((4 * finger + 1 + k, 4 * finger + 2 + k) for finger in range(5) for k in range(3)) + tuple(
    (0, 4 * finger + 1) for finger in range(1, 5)
)
"""Keypoints at the ends of the thumb's metacarpal, the fourteen phalanges, and from the wrist to four knuckles."""
MEDIAN_MUST, MEDIAN_AIM, MUST, AIM = 3.0, 2.0, 6.0, 4.0
"""Per cent of a bone's length: median, and 95th percentile."""
_JPEG_QUALITY = 95  # of `torchhand simulate`
_BACKGROUNDS: tuple[BackgroundKind, ...] = ("dark", "wall", "clutter", "plain")  # of every fifth picture


@dataclass(frozen=True, kw_only=True)
class Picture:
    """One person's open hand, as `torchhand simulate --random-hand` draws it."""

    image: UInt8[Tensor, "height width 3"]
    kinematics: HandKinematics
    camera: Camera
    hand_length: float
    bones: Float[Tensor, "bones"]
    """Lengths, metres."""


def pictures(count: int) -> Iterator[Picture]:
    """Pictures of both hands, both sides, with a forearm and without, after up to sixteen frames of two motions."""
    model = load_hand_model()
    camera = assumed_camera(*SIZE_PX, horizontal_fov_deg=FOV_DEG)
    for index in range(count):
        generator = torch.Generator().manual_seed(FIRST_SEED + index)
        kinematics = model.kinematics("left" if index % 2 else "right", dtype=torch.float64)
        shape = sample_shape(model.shape_space, generator)
        view: Literal["back", "palm"] = "palm" if index // 2 % 2 else "back"
        motion = scripted_motion(
            "abduction" if index // 4 % 2 else "planar",
            1 + 5 * (index % 4),
            kinematics,
            camera,
            generator,
            shape=shape,
            staging=Staging(view=view),
        )
        motion = replace(motion, poses=motion.poses[-1:])
        background = _BACKGROUNDS[index // 5 % 4] if index % 5 == 0 else "plain"
        scene = SceneSettings(background=background, forearm=index // 8 % 2 == 0)
        frame = next(iter(render_sequence(kinematics, motion, camera, scene, generator, shape=shape)))
        frames = HandProjector(kinematics, camera, shape).frames(motion.poses[0], motion.root_reference)
        yield Picture(
            image=_as_jpeg(frame.image),
            kinematics=kinematics,
            camera=camera,
            hand_length=float(model.shape_space.metric(shape)["hand_length"]),
            bones=bone_lengths(frames.keypoints),
        )


def bone_lengths(keypoints: Float[Tensor, "21 3"]) -> Float[Tensor, "bones"]:
    """Metres, in the order of BONES."""
    first, second = torch.tensor(BONES).unbind(1)
    return (keypoints[first] - keypoints[second]).norm(dim=-1)


def fit_hand_bones(name: str, repeats: int | None) -> Figure:
    """95th percentile of the error of bone lengths over sampled people, their hands' lengths given."""
    count = repeats or PEOPLE
    errors: list[float] = []
    spent: list[float] = []
    for picture in pictures(count):
        start = perf_counter()
        mask = find_open_hand(picture.image).mask
        hand = fit_open_hand(mask, picture.kinematics, picture.camera)
        spent.append(1e3 * (perf_counter() - start))
        if isinstance(hand, NoRegions):
            continue
        fit = sized(hand.fit, picture.kinematics.shape_space, known_length(picture.hand_length))
        found = picture.kinematics(fit.pose, fit.shape, root_reference=fit.root_reference).keypoints
        errors += (100 * (bone_lengths(found) / picture.bones - 1).abs()).tolist()
    fitted = len(errors) // len(BONES)
    middle, upper = np.percentile(errors, (50, 95)).tolist() if errors else (None, None)
    note = f"{fitted} of {count} people fitted, the others refused"
    if middle is not None:
        verdict = "" if middle < MEDIAN_MUST else " NOT MET"
        note = f"median {middle:.3g} % (must < {MEDIAN_MUST:g} %, aim {MEDIAN_AIM:g} %){verdict}; {note}"
    return Figure(
        name=name,
        value=upper,
        unit="%",
        must=MUST,
        aim=AIM,
        ours_ms=statistics.median(spent),
        repeats=count,
        note=note,
        details={"median": middle, "people": count, "fitted": fitted, "slowest_ms": max(spent)},
    )


def _as_jpeg(image: UInt8[Tensor, "height width 3"]) -> UInt8[Tensor, "height width 3"]:
    bgr = cv2.cvtColor(image.numpy(), cv2.COLOR_RGB2BGR)
    _, packed = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    decoded = cv2.imdecode(packed, cv2.IMREAD_COLOR)
    if decoded is None:
        raise RuntimeError("OpenCV cannot read its own JPEG")
    return torch.from_numpy(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB))
