"""From a motion script to one pose per frame of a given hand before a given camera."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.detect import facing_rotation
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import HandKinematics, posture
from torchhand.simulate.motion.scripts import SCRIPTS, Course, Stage

View = Literal["back", "palm"]
VIEWS: tuple[View, ...] = ("back", "palm")

_HAND_IN_PICTURE = (0.62, 0.58)  # largest length of the hand, shares of the picture's width and height
_ORTHOGRAPHIC_DISTANCE = 0.5  # metres; any will do
_MIDDLE = 0.48  # middle of the hand, share of its length from the wrist: what the hand turns about


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A hand in motion: one pose per frame, in the world frame of the camera that it was planned for."""

    name: str
    poses: Float[Tensor, "frames 36"]
    """Metres and radians in the order of DOFS; the rotation vectors turn the root reference."""
    root_reference: Float[Tensor, "3 3"]
    """world_from_hand where the rotation vector is zero."""
    fps: float
    """Frames per second."""


@dataclass(frozen=True, kw_only=True)
class Staging:
    """How a motion is shown."""

    view: View = "back"
    """Side of the hand that faces the camera at first."""
    fps: float = 30.0
    """Frames per second; above 0."""
    pace: float = 1.0
    """Factor on speeds; 0 or more."""


def scripted_motion(
    name: str,
    frames: int,
    kinematics: HandKinematics,
    camera: Camera,
    generator: torch.Generator,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    staging: Staging | None = None,
) -> Motion:
    """The script of that name (SCRIPTS) for a hand and a camera; float64.

    The hand starts from rest, upright, in the middle of the picture and as far away as makes it fill the picture well.
    Joint angles stay inside the skeleton's limits. The pace multiplies speeds of the scripts that run by the clock;
    "flexion" and "leave" spread their events over the sequence. Raises ValueError for a name, frames, fps or pace that
    cannot be.
    """
    if name not in SCRIPTS:
        raise ValueError(f"motion: expected one of {', '.join(SCRIPTS)}, got {name!r}")
    length, staging = hand_length(kinematics, shape), staging or Staging()
    stage = stage_before(camera, frames, generator, hand_length=length, staging=staging)
    course = SCRIPTS[name](stage)
    joints = posture(course.posture, dtype=torch.float64)[6:].expand(frames, -1)
    joints = joints if course.joints is None else joints + course.joints
    return perform(
        name,
        course,
        kinematics.skeleton.within_limits(joints),
        camera,
        hand_length=length,
        stage=stage,
        staging=staging,
    )


def hand_length(kinematics: HandKinematics, shape: Float[Tensor, "shape"] | None = None) -> float:
    """Length of the hand in metres."""
    values = kinematics.default_shape if shape is None else shape
    return float(values[kinematics.shape_space.names.index("hand_length")])


def stage_before(
    camera: Camera, frames: int, generator: torch.Generator, *, hand_length: float, staging: Staging
) -> Stage:
    """The clock of a sequence, and the room before the camera where a hand of that length fills the picture well."""
    if frames < 1:
        raise ValueError(f"frames: expected 1 or more, got {frames}")
    fps, pace = staging.fps, staging.pace
    if not (math.isfinite(fps) and fps > 0):
        raise ValueError(f"fps: expected a positive number of frames per second, got {fps}")
    if not (math.isfinite(pace) and pace >= 0):
        raise ValueError(f"pace: expected 0 or more, got {pace}")
    focal = [float(f) for f in camera.intrinsics.diagonal()[:2]]
    size = (camera.width, camera.height)
    distance = filling_distance(camera, hand_length)
    scale = 1.0 if camera.kind == "orthographic" else distance
    index = torch.arange(frames, dtype=torch.float64)
    return Stage(
        seconds=index / fps,
        progress=index / max(1, frames - 1),
        pace=pace,
        generator=generator,
        width=scale * size[0] / focal[0],
        height=scale * size[1] / focal[1],
        distance=distance,
    )


def filling_distance(camera: Camera, hand_length: float) -> float:
    """Distance from the camera, metres, at which a hand of that length fills the picture well; any one if
    orthographic."""
    if camera.kind == "orthographic":
        return _ORTHOGRAPHIC_DISTANCE
    focal = [float(f) for f in camera.intrinsics.diagonal()[:2]]
    size = (camera.width, camera.height)
    return max(hand_length * f / (fraction * px) for f, fraction, px in zip(focal, _HAND_IN_PICTURE, size, strict=True))


def facing(view: View) -> Float[Tensor, "3 3"]:
    """cam_from_hand of an upright hand, left or right, that shows its back or its palm to the camera."""
    if view not in VIEWS:
        raise ValueError(f"view: expected one of {', '.join(VIEWS)}, got {view!r}")
    return facing_rotation(view)


def perform(
    name: str,
    course: Course,
    joints: Float[Tensor, "frames 30"],
    camera: Camera,
    *,
    hand_length: float,
    stage: Stage,
    staging: Staging,
) -> Motion:
    """Places the course before the camera: the hand turns about its middle, which starts in the picture's middle."""
    tilt = rotation_from_vector(torch.deg2rad(torch.tensor(course.tilt_deg, dtype=torch.float64)))
    cam_from_hand = tilt @ facing(staging.view)
    middle_px = torch.tensor(((camera.width - 1) / 2, (camera.height - 1) / 2), dtype=torch.float64)
    plane = camera.to(dtype=torch.float64, device="cpu").plane_from_pixels(middle_px)
    depth = torch.tensor([stage.distance], dtype=torch.float64)
    start = torch.cat((plane if camera.kind == "orthographic" else plane * depth, depth))
    lever = cam_from_hand @ torch.tensor((0.0, _MIDDLE * hand_length, 0.0), dtype=torch.float64)
    wrist = start + course.centre - (rotation_from_vector(course.turn) @ lever[:, None]).squeeze(-1)
    world_from_cam = camera.rotation.double().cpu().T
    wrist_world = (wrist - camera.translation.double().cpu()) @ world_from_cam.T
    poses = torch.cat((wrist_world, course.turn @ world_from_cam.T, joints), -1)
    return Motion(name=name, poses=poses, root_reference=world_from_cam @ cam_from_hand, fps=staging.fps)
