"""Simulated pictures with a hand and without one, and their silhouettes by colour."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import Appearance, learn_appearance
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector
from torchhand.hand import POSTURES, HandKinematics, HandPose, posture
from torchhand.image import dilate, disc_kernel, intersection_over_union, touching
from torchhand.simulate import SKIN_TONES, Motion, SceneSettings, facing, hand_length, render_sequence, sample_shape
from torchhand.track.scene import Scene, View
from torchhand.view import HandProjector

WIDTH, HEIGHT = 256, 192
_BACKGROUNDS = ("plain", "dark", "wall", "clutter")
_MIDDLE = 0.48  # of a hand, share of its length from the wrist
_TILT_DEG = 35.0
_SHAPE_ERROR = 0.5  # of a fitted shape, shares of the spread of people
_SEPARABLE = 0.8  # intersection over union of the hand by colour and the hand itself


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A simulated hand before a camera."""

    kinematics: HandKinematics
    camera: Camera
    shape: Float[Tensor, "shape"]
    """Of the person."""
    believed_shape: Float[Tensor, "shape"]
    """As a tracker may have fitted it."""
    pose: HandPose
    image: UInt8[Tensor, "height width 3"]
    """RGB, with the forearm where there is one."""
    mask: Bool[Tensor, "height width"]
    """Of the hand without its forearm."""
    skin: Appearance
    """Colours of hand and arm against the rest, as a tracker learns them."""

    @property
    def keypoints_px(self) -> Float[Tensor, "21 2"]:
        return self.keypoints_of(self.pose)

    def keypoints_of(self, pose: HandPose) -> Float[Tensor, "21 2"]:
        """Of another pose of this hand, px."""
        frames = HandProjector(self.kinematics, self.camera, self.shape).frames(pose.dofs, pose.reference)
        return self.camera.project(frames.keypoints)

    @property
    def length_px(self) -> float:
        """Of the hand, held parallel to the picture."""
        depth = float(self.pose.dofs[2])
        return float(self.camera.intrinsics[0, 0]) * hand_length(self.kinematics, self.shape) / depth

    def scene(self, image: UInt8[Tensor, "height width 3"]) -> Scene:
        """A picture of this camera as the tracker sees it that has learned this hand's colours."""
        probability = self.skin.probability(image)
        return Scene(views=(View(image=image),), masks=(None,), probabilities=(probability,), time_s=0.0)


def picture(generator: torch.Generator) -> Picture | None:
    """A hand of a random person in one of the named postures, of primitives or with its skin, with or without a bare
    forearm, before one of the backgrounds; None where its colours do not tell it from these: such a silhouette is none
    of a hand."""
    hand = load_hand_model().hand(side="right", dtype=torch.float64)
    kinematics = hand.kinematics
    camera = replace(assumed_camera(WIDTH, HEIGHT, horizontal_fov_deg=50.0), is_assumed=False)
    shape = sample_shape(kinematics.shape_space, generator)
    believed = shape + _SHAPE_ERROR * (sample_shape(kinematics.shape_space, generator) - kinematics.default_shape)
    length = hand_length(kinematics, shape)
    pose = placed(camera, length, named_joints(generator), generator, size=_between(0.4, 0.65, generator))
    tones = list(SKIN_TONES)
    look = SceneSettings(
        background=_BACKGROUNDS[_choice(len(_BACKGROUNDS), generator)],
        skin=tones[_choice(len(tones), generator)],
        forearm=_choice(2, generator) == 1,
        surface="mesh" if _choice(2, generator) else "primitives",
        supersampling=1,
        blur_px=0.7,
    )
    motion = Motion(name="still", poses=pose.dofs[None], root_reference=pose.reference, fps=30.0)
    frame = next(iter(render_sequence(kinematics, motion, camera, look, generator, shape=shape, hand=hand)))
    around = dilate(frame.mask, disc_kernel(max(1, round(0.05 * HEIGHT))))
    wrist, knuckle = frame.keypoints_px[0], frame.keypoints_px[9]
    x, y = torch.arange(WIDTH), torch.arange(HEIGHT)[:, None]
    is_beyond = (x - wrist[0]) * (knuckle - wrist)[0] + (y - wrist[1]) * (knuckle - wrist)[1] < 0
    skin = learn_appearance(frame.image, frame.mask, ~around & ~is_beyond, 1)
    if skin is None:
        return None
    seen = touching(skin.probability(frame.image) > 0.5, frame.mask)
    if float(intersection_over_union(seen, frame.mask, ~is_beyond)) < _SEPARABLE:
        return None
    return Picture(
        kinematics=kinematics,
        camera=camera,
        shape=shape,
        believed_shape=believed.clamp(kinematics.shape_space.lower, kinematics.shape_space.upper),
        pose=pose,
        image=frame.image,
        mask=frame.mask,
        skin=skin,
    )


def named_joints(generator: torch.Generator) -> Float[Tensor, "36"]:
    """One of the named postures with every joint off by some degrees."""
    pose = posture(list(POSTURES)[_choice(len(POSTURES), generator)], dtype=torch.float64)
    pose[6:] += math.radians(5.0) * torch.randn(30, generator=generator, dtype=torch.float64)
    skeleton = load_hand_model().skeleton
    pose[6:] = skeleton.within_limits(pose[6:])
    return pose


def placed(
    camera: Camera, length: float, pose: Float[Tensor, "36"], generator: torch.Generator, *, size: float
) -> HandPose:
    """Palm or back to the camera, turned and tilted, near the middle; `size`: its length, share of the height."""
    tilt = torch.nn.functional.normalize(torch.randn(3, generator=generator, dtype=torch.float64), dim=-1)
    tilt = tilt * math.radians(_TILT_DEG) * _between(0.0, 1.0, generator)
    reference = rotation_from_vector(tilt) @ facing("palm" if _choice(2, generator) else "back")
    ahead = float(camera.intrinsics[0, 0]) * length / (size * camera.height)
    aside = 0.12 * ahead * torch.randn(2, generator=generator, dtype=torch.float64).clamp(-1, 1)
    middle = torch.cat((aside * camera.height / float(camera.intrinsics[0, 0]), torch.tensor((ahead,)).double()))
    dofs = pose.clone()
    dofs[:3] = middle - reference @ torch.tensor((0.0, _MIDDLE * length, 0.0), dtype=torch.float64)
    dofs[3:6] = 0
    return HandPose.of(dofs, reference)


def without_hand(own: Picture, generator: torch.Generator) -> UInt8[Tensor, "height width 3"]:
    """The picture with things of the hand's colours in its place: a face, blobs, a bar, angular scraps, or the forearm
    alone where there is one."""
    image = own.image.numpy().copy()
    cover = dilate(own.mask, disc_kernel(3))
    colours = own.image[own.mask].double()
    colour = colours.median(0).values.numpy()
    behind = own.image[~dilate(own.mask, disc_kernel(max(1, HEIGHT // 10)))].double().median(0).values.numpy()
    image[cover.numpy()] = behind
    thing = np.zeros((HEIGHT, WIDTH), np.uint8)
    kind = _choice(5, generator)
    chance = np.random.default_rng(int(torch.randint(0, 2**31 - 1, (), generator=generator)))
    middle = np.array((WIDTH / 2, HEIGHT / 2)) + chance.normal(0, 0.08 * HEIGHT, 2)
    if kind == 0:  # a face
        axes = HEIGHT * chance.uniform(0.14, 0.3) * np.array((chance.uniform(0.65, 0.85), 1.0))
        _ellipse(thing, middle, axes, chance.uniform(-20, 20))
    elif kind == 1:  # blobs
        for _ in range(int(chance.integers(2, 7))):
            _ellipse(
                thing,
                middle + chance.normal(0, 0.12 * HEIGHT, 2),
                HEIGHT * chance.uniform(0.03, 0.16, 2),
                chance.uniform(0, 180),
            )
    elif kind == 2:  # a bar, such as an arm
        turn, half = chance.uniform(0, np.pi), HEIGHT * chance.uniform(0.05, 0.12)
        reach = HEIGHT * chance.uniform(0.2, 0.9) * np.array((np.cos(turn), np.sin(turn)))
        ends = [tuple(np.round(middle + s * reach).astype(int).tolist()) for s in (-0.5, 1.0)]
        cv2.line(thing, ends[0], ends[1], 255, max(1, round(2 * half)))
    elif kind == 3:  # scraps
        for _ in range(int(chance.integers(2, 9))):
            corners = middle + chance.normal(0, 0.13 * HEIGHT, 2) + chance.normal(0, 0.1 * HEIGHT, (4, 2))
            cv2.fillPoly(thing, [np.round(corners).astype(np.int32)], 255)
    light = 1 + 0.15 * cv2.GaussianBlur(chance.normal(0, 1, (HEIGHT, WIDTH)), (0, 0), 12) * 12
    painted = np.clip(colour * light[..., None] + chance.normal(0, 3, (HEIGHT, WIDTH, 3)), 0, 255)
    image = np.where(thing[..., None] > 0, painted, image)
    return torch.from_numpy(np.round(image).astype(np.uint8))


def _ellipse(thing: np.ndarray, middle: np.ndarray, axes: np.ndarray, turn_deg: float) -> None:
    centre, half = (tuple(np.maximum(np.round(v), 1).astype(int).tolist()) for v in (middle, axes))
    cv2.ellipse(thing, centre, half, float(turn_deg), 0, 360, 255, -1)


def _choice(count: int, generator: torch.Generator) -> int:
    return int(torch.randint(0, count, (), generator=generator))


def _between(low: float, high: float, generator: torch.Generator) -> float:
    return low + (high - low) * float(torch.rand((), generator=generator, dtype=torch.float64))
