"""Simulated hands that close and open before cameras on all sides, and what a detector may see of them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector
from torchhand.hand import DOFS, JOINT_DOFS, POSTURES, HandKinematics, centre_spread, posture
from torchhand.numerics import ease
from torchhand.signs import load_signs
from torchhand.simulate import (
    SKIN_TONES,
    Motion,
    RenderedFrame,
    SceneSettings,
    facing,
    hand_length,
    render_rig,
    render_sequence,
    sample_shape,
)
from torchhand.track import HandKeypoints, View

WIDTH, HEIGHT = 640, 480
FPS = 30.0
_ROOT = len(DOFS) - len(JOINT_DOFS)
_NAMED = tuple(name for name in POSTURES if name != "open")
_BACKGROUNDS = ("plain", "dark", "wall", "room")
_SIZES = (0.45, 0.75)  # length of the hand, shares of the picture's height
_MIDDLE = 0.48  # of a hand, share of its length from the wrist
_SIDE_DEG = 60.0  # turn about the hand's own axis, to either side
_TILT_DEG, _TURN_DEG = 25.0, 40.0  # towards the camera, and in the picture
_UP_DEG, _RIGHT_DEG, _ROLL_DEG = (0.0, 45.0), (30.0, 90.0), 15.0  # of further cameras about the hand, either way
_SWAY_DEG = 15.0  # standard deviation about each axis
_SWAYS = 3  # turns in the course of a sequence
_PLAIN = 0.5  # share of the sequences in which a hand opens and closes before the camera
_PLAIN_TURN = 0.4  # of them: shares of the turns and tilts
_BEGINS_OPEN = 0.75  # share of the others
_MOVES, _RESTS = (5, 25), (0, 12)  # frames from one posture to the next, and in it
_WOBBLE = 0.12  # radians: standard deviation of known postures' angles
_PRIOR = 0.4  # share of the postures that comes from the prior; the others are named postures and signs

# A detector's errors: of points in all (offset and deviation) and of angles, about the means over joints of
# detector_errors.json (`torchhand measure_detector`).
_POINT_STD_M, _ANGLE_STD = 0.005, 0.31
_CONSTANT = 0.7  # share of their variance that a sequence has throughout
_UNEVEN = 0.7  # standard deviation of the logarithm of a finger's own factor: some fingers are seen wrongly


@dataclass(frozen=True, kw_only=True)
class SimulatedFrame:
    """The pictures of one time, with the truth."""

    views: tuple[View, ...]
    """One for each camera."""
    keypoints: Float[Tensor, "21 3"]
    """Metres, in the first camera's frame; as another hand model would place them under the same skin."""


@dataclass(frozen=True, kw_only=True)
class SimulatedSequence:
    """A hand in motion before one or several cameras."""

    cameras: tuple[Camera, ...]
    """The first one's frame is the world."""
    frames: tuple[SimulatedFrame, ...]


def sequence(
    generator: torch.Generator, frames: int, *, has_detector: bool = False, cameras: int = 1
) -> SimulatedSequence:
    """A right hand of a random person that goes from posture to posture and stays a while in each.

    has_detector: whether a detector's points come with the pictures. cameras: how many.
    """
    hand = load_hand_model().hand(side="right", dtype=torch.float64)
    kinematics = hand.kinematics
    camera = replace(assumed_camera(WIDTH, HEIGHT, horizontal_fov_deg=55.0), is_assumed=False)
    shape = sample_shape(kinematics.shape_space, generator)
    motion = _motion(kinematics, camera, hand_length(kinematics, shape), frames, generator)
    tones = list(SKIN_TONES)
    look = SceneSettings(
        background=_BACKGROUNDS[_choice(len(_BACKGROUNDS), generator)],
        skin=tones[_choice(len(tones), generator)],
        forearm=_choice(3, generator) > 0,
        surface="mesh",
        supersampling=1,
        blur_px=0.7,
    )
    rig, person = (camera,), {"shape": shape, "hand": hand}
    if cameras == 1:
        alone = render_sequence(kinematics, motion, camera, look, generator, **person)
        rendered = [(one,) for one in alone]
    else:
        lever = torch.tensor((0.0, _MIDDLE * hand_length(kinematics, shape), 0.0), dtype=torch.float64)
        middle = motion.poses[0, :3] + motion.root_reference @ lever
        rig = (camera, *(_beside(camera, middle, generator) for _ in range(cameras - 1)))
        rendered = list(render_rig(kinematics, motion, rig, look, generator, **person))
    seen = [(None,) * cameras] * frames
    if has_detector:
        seen = list(_detections(kinematics, motion, rig, shape, generator))
    drawn = torch.randn(21, 3, 1, generator=generator, dtype=torch.float64)
    return SimulatedSequence(
        cameras=rig,
        frames=tuple(
            SimulatedFrame(
                views=tuple(View(image=one.image, keypoints=own) for one, own in zip(views, points, strict=True)),
                keypoints=_by_another_maker(views[0], drawn),
            )
            for views, points in zip(rendered, seen, strict=True)
        ),
    )


def _beside(camera: Camera, middle: Float[Tensor, "3"], generator: torch.Generator) -> Camera:
    """Another camera as far from a place, which it shows where the first one does."""
    degrees = (
        _between(*_UP_DEG, generator) * (2 * _choice(2, generator) - 1),
        _between(*_RIGHT_DEG, generator) * (2 * _choice(2, generator) - 1),
        _between(-_ROLL_DEG, _ROLL_DEG, generator),
    )
    up, right, roll = (
        rotation_from_vector(math.radians(angle) * axis)
        for angle, axis in zip(degrees, torch.eye(3, dtype=torch.float64), strict=True)
    )
    rotation = roll @ up @ right
    return replace(camera, rotation=rotation, translation=middle - rotation @ middle)


def _by_another_maker(one: RenderedFrame, drawn: Float[Tensor, "21 3 1"]) -> Float[Tensor, "21 3"]:
    """Keypoints where another hand model has them, as far along its bones and across them in every frame."""
    return one.keypoints_cam + (centre_spread(one.keypoints_cam) @ drawn)[..., 0]


def _motion(
    kinematics: HandKinematics, camera: Camera, length: float, frames: int, generator: torch.Generator
) -> Motion:
    is_plain = _between(0.0, 1.0, generator) < _PLAIN
    most = _PLAIN_TURN if is_plain else 1.0
    turn, tilt, side = (
        most * math.radians(angle) * _between(-1.0, 1.0, generator) for angle in (_TURN_DEG, _TILT_DEG, _SIDE_DEG)
    )
    in_picture = rotation_from_vector(torch.tensor((0.0, 0.0, turn), dtype=torch.float64))
    towards = rotation_from_vector(torch.tensor((tilt, 0.0, 0.0), dtype=torch.float64))
    about = rotation_from_vector(torch.tensor((0.0, side, 0.0), dtype=torch.float64))
    reference = in_picture @ towards @ about @ facing("palm" if _choice(2, generator) else "back")
    joints = _postures(kinematics, frames, generator, is_plain=is_plain)
    turns = _sway(frames, generator)
    size = _between(*_SIZES, generator)
    focal = float(camera.intrinsics[0, 0])
    ahead = focal * length / (size * camera.height)
    aside = 0.08 * ahead * camera.height / focal * torch.randn(2, generator=generator, dtype=torch.float64).clamp(-1, 1)
    middle = torch.cat((aside, aside.new_tensor((ahead,))))
    lever = reference @ torch.tensor((0.0, _MIDDLE * length, 0.0), dtype=torch.float64)
    root = middle - (rotation_from_vector(turns) @ lever[:, None]).squeeze(-1)
    poses = torch.cat((root, turns, joints), -1)
    return Motion(name="postures", poses=poses, root_reference=reference, fps=FPS)


def _postures(
    kinematics: HandKinematics, frames: int, generator: torch.Generator, *, is_plain: bool
) -> Float[Tensor, "frames 30"]:
    """Joint angles on the way from posture to posture, most often from an open hand on. is_plain: between every two
    named postures the hand opens."""
    opened = posture("open", dtype=torch.float64)[_ROOT:]
    begins_open = frames > 1 and (is_plain or _between(0.0, 1.0, generator) < _BEGINS_OPEN)
    here, is_open = (opened, True) if begins_open else (_drawn_posture(kinematics, generator), False)
    shown = [here]
    while len(shown) < frames:
        is_open = is_plain and not is_open
        named = opened if is_open else posture(_NAMED[_choice(len(_NAMED), generator)], dtype=torch.float64)[_ROOT:]
        there = _wobbled(named, generator) if is_plain else _drawn_posture(kinematics, generator)
        moves, rests = (low + _choice(high - low, generator) for low, high in (_MOVES, _RESTS))
        along = ease(torch.linspace(0, 1, moves + 1, dtype=torch.float64))[1:, None]
        shown += [*torch.lerp(here, there, along), *[there] * rests]
        here = there
    return kinematics.skeleton.within_limits(torch.stack(shown[:frames]))


def _sway(frames: int, generator: torch.Generator) -> Float[Tensor, "frames 3"]:
    """Turns away from the direction of the first picture: eased from one drawn turn to the next."""
    knots = math.radians(_SWAY_DEG) * torch.randn(_SWAYS + 1, 3, generator=generator, dtype=torch.float64)
    at = torch.linspace(0, _SWAYS, frames, dtype=torch.float64)
    before = at.long().clamp(max=_SWAYS - 1)
    return torch.lerp(knots[before], knots[before + 1], ease(at - before)[:, None]) - knots[0]


def _drawn_posture(kinematics: HandKinematics, generator: torch.Generator) -> Float[Tensor, "30"]:
    """Joint angles of the prior, or near those of a named posture or a sign; not yet within the limits."""
    if _between(0.0, 1.0, generator) < _PRIOR:
        drawn, _ = load_hand_model().prior(dtype=torch.float64).sample(1, generator)
        return drawn[0, _ROOT:].double()
    known = [*(posture(name, dtype=torch.float64)[_ROOT:] for name in POSTURES), *load_signs().values()]
    return _wobbled(known[_choice(len(known), generator)].double(), generator)


def _wobbled(joints: Float[Tensor, "30"], generator: torch.Generator) -> Float[Tensor, "30"]:
    return joints + _WOBBLE * torch.randn(len(joints), generator=generator, dtype=torch.float64)


def _detections(
    kinematics: HandKinematics,
    motion: Motion,
    cameras: Sequence[Camera],
    shape: Float[Tensor, "shape"],
    generator: torch.Generator,
) -> Iterator[tuple[HandKeypoints, ...]]:
    """What a detector sees in every picture: points in it, and points in space of a hand whose joints are bent
    otherwise; fingers that it sees wrongly are those in all of them."""

    def errors(*size: int) -> Tensor:
        """Standard normal, most of it the same in all frames."""
        constant, changing = (
            torch.randn(*parts, generator=generator, dtype=torch.float64)
            for parts in (size, (len(motion.poses), *size))
        )
        return math.sqrt(_CONSTANT) * constant + math.sqrt(1 - _CONSTANT) * changing

    factor = (_UNEVEN * torch.randn(5, generator=generator, dtype=torch.float64)).exp()
    of_points = torch.cat((factor.new_ones(1), factor.repeat_interleave(4)))
    of_joints = factor.repeat_interleave(len(JOINT_DOFS) // 5)
    drawn = [
        (_ANGLE_STD * errors(len(JOINT_DOFS)) * of_joints, _POINT_STD_M * errors(21, 2) * of_points[:, None])
        for _ in cameras
    ]
    for frame, pose in enumerate(motion.poses):
        true = kinematics(pose, shape, root_reference=motion.root_reference).keypoints
        found = []
        for camera, (bent, shifted) in zip(cameras, drawn, strict=True):
            joints = kinematics.skeleton.within_limits(pose[_ROOT:] + bent[frame])
            other = torch.cat((pose[:_ROOT], joints))
            space = camera.cam_from_world(kinematics(other, shape, root_reference=motion.root_reference).keypoints)
            depth, focal = camera.cam_from_world(pose[:3])[2], camera.intrinsics[0, 0]
            points_px = camera.project(true) + focal / depth * shifted[frame]
            found.append(HandKeypoints(points_px=points_px, points=space - space[:1]))
        yield tuple(found)


def _choice(count: int, generator: torch.Generator) -> int:
    return int(torch.randint(0, count, (), generator=generator))


def _between(low: float, high: float, generator: torch.Generator) -> float:
    return low + (high - low) * float(torch.rand((), generator=generator, dtype=torch.float64))
