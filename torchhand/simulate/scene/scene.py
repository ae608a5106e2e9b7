"""Pictures of a moving hand with exact truth: ray-cast, antialiased, blurred and noisy as a camera's are."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, get_args

import cv2
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import Hand, HandFrames, HandKinematics, place_primitives, posed_mesh
from torchhand.simulate.motion import Motion
from torchhand.simulate.scene.backgrounds import BACKGROUNDS, BackgroundKind, background_picture
from torchhand.simulate.scene.forearm import cast_forearm, forearm_corners, pixel_box
from torchhand.view import HandProjector, Raycast, Surface, cast, shade

SurfaceKind = Literal["primitives", "mesh"]
SkinTone = Literal["light", "medium", "brown", "dark"]
SKIN_TONES: dict[SkinTone, tuple[float, float, float]] = {
    "light": (0.92, 0.71, 0.60),
    "medium": (0.82, 0.59, 0.46),
    "brown": (0.61, 0.41, 0.30),
    "dark": (0.40, 0.26, 0.19),
}
"""RGB reflectances."""

_REACH = 0.25  # no point of the hand is further from the box of the keypoints, share of hand length


@dataclass(frozen=True, kw_only=True)
class SceneSettings:
    """How the pictures look."""

    surface: SurfaceKind = "primitives"
    """primitives (the 37 quadrics) or mesh (the skinned one)"""
    background: BackgroundKind = "plain"
    """plain, dark, wall, clutter, blue or room"""
    skin: SkinTone = "light"
    """light, medium, brown or dark"""
    noise: float = 2.0
    """Standard deviation of the sensor's noise, grey levels of 255."""
    blur_px: float = 0.0
    """Standard deviation of the lens's blur, px."""
    shutter: float = 0.0
    """Share of the time between two frames in which the shutter is open: motion blur."""
    shutter_samples: int = 5
    """Number of pictures that are averaged over the time the shutter is open."""
    supersampling: int = 3
    """Rays per pixel along each axis."""
    light: tuple[float, float, float] = (-0.4, -0.6, -0.7)
    """Direction towards the light, camera axes."""
    ambient: float = 0.45
    """Share of the light that comes from everywhere."""
    forearm: bool = False
    """A bare forearm of the same colour goes on from the wrist."""

    def __post_init__(self) -> None:
        choices = (("surface", get_args(SurfaceKind)), ("background", tuple(BACKGROUNDS)), ("skin", tuple(SKIN_TONES)))
        for name, allowed in choices:
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name}: expected one of {', '.join(allowed)}, got {getattr(self, name)!r}")
        ranges = {"noise": (0, 100), "blur_px": (0, 50), "shutter": (0, 1), "ambient": (0, 1)}
        ranges |= {"shutter_samples": (2, 64), "supersampling": (1, 8)}
        for name, (low, high) in ranges.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: expected {low} to {high}, got {getattr(self, name)}")
        if not (all(map(math.isfinite, self.light)) and any(self.light)):
            raise ValueError(f"light: expected a direction, got {self.light}")


@dataclass(frozen=True, kw_only=True)
class RenderedFrame:
    """One picture and its truth."""

    index: int
    image: UInt8[Tensor, "height width 3"]
    """The picture, RGB."""
    mask: Bool[Tensor, "height width"]
    """Pixels whose centre sees the hand; not its forearm."""
    keypoints_cam: Float[Tensor, "21 3"]
    """Keypoints in metres, camera frame."""
    keypoints_px: Float[Tensor, "21 2"]


def render_sequence(
    kinematics: HandKinematics,
    motion: Motion,
    camera: Camera,
    scene: SceneSettings,
    generator: torch.Generator,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    hand: Hand | None = None,
) -> Iterator[RenderedFrame]:
    """The frames of a motion, one after the other; computed in the dtype of the kinematics (float64 for an exact mask).

    The picture integrates light over each pixel's area (supersampling), then over the shutter's time; then come the
    lens's blur and the sensor's noise. Mask and keypoints belong to the middle of the exposure. The same seed gives the
    same sequence bit for bit; a frame's noise depends on the frames before it.

    hand: of the same side and dtype as the kinematics, for a scene whose surface is the mesh; it gets `shape`.
    """
    if scene.surface == "mesh" and (hand is None or hand.side != kinematics.side):
        got = "none" if hand is None else f"a {hand.side} one"
        raise ValueError(f"hand: expected the {kinematics.side} hand whose mesh is to be drawn, got {got}")
    dtype = kinematics.default_shape.dtype
    camera = camera.to(dtype=dtype)
    behind = background_picture(scene.background, camera.width, camera.height, generator)
    behind = behind.to(kinematics.default_shape.device)
    projector = HandProjector(kinematics, camera, None if shape is None else shape.to(dtype))
    reference = motion.root_reference.to(dtype)
    drawn = hand if scene.surface == "mesh" else None
    for index in range(len(motion.poses)):
        poses = _poses_while_open(motion.poses, index, scene)
        exposed = [_exposed(projector, _posed(projector, drawn, pose, reference), behind, scene) for pose in poses]
        posed = _posed(projector, drawn, motion.poses[index], reference)
        yield RenderedFrame(
            index=index,
            image=_developed(torch.stack(exposed).mean(0), scene, generator),
            mask=_cast(projector, posed, camera, scene).part >= 0,
            keypoints_cam=camera.cam_from_world(posed.frames.keypoints),
            keypoints_px=camera.project(posed.frames.keypoints),
        )


@dataclass(frozen=True, kw_only=True)
class _Posed:
    """A hand at one time, in the world."""

    frames: HandFrames
    surface: Surface


def _posed(projector: HandProjector, hand: Hand | None, pose: Float[Tensor, "36"], reference: Tensor) -> _Posed:
    """The posed hand, with its mesh where a `hand` is given, else with its primitives."""
    pose = pose.to(reference)
    if hand is not None:
        state = hand(pose, projector.shape, root_reference=reference)
        return _Posed(frames=state.frames, surface=posed_mesh(hand, state))
    frames = projector.frames(pose, reference)
    is_left = projector.kinematics.side == "left"
    return _Posed(frames=frames, surface=place_primitives(frames, projector.sizes, is_left=is_left))


def _poses_while_open(poses: Float[Tensor, "frames 36"], index: int, scene: SceneSettings) -> list[Float[Tensor, "36"]]:
    """Poses at evenly spread times around the frame's own, between the neighbouring frames' poses."""
    if scene.shutter == 0 or len(poses) < 2:
        return [poses[index]]
    offsets = scene.shutter * ((torch.arange(scene.shutter_samples) + 0.5) / scene.shutter_samples - 0.5)
    before, after = poses[max(index - 1, 0)], poses[min(index + 1, len(poses) - 1)]
    backward, forward = poses[index] - before, after - poses[index]
    return [poses[index] + float(offset) * (forward if offset > 0 else backward) for offset in offsets]


_FOREARM = -2  # in the part labels, where nothing is -1


def _cast(projector: HandProjector, posed: _Posed, camera: Camera, scene: SceneSettings) -> Raycast:
    """The hand, with its forearm where it has one."""
    hand = cast(posed.surface, camera)
    if not scene.forearm:
        return hand
    arm = cast_forearm(posed.frames, projector.kinematics.shape_space, projector.shape, camera)
    in_front = arm.depth < hand.depth
    return Raycast(
        depth=torch.where(in_front, arm.depth, hand.depth),
        part=torch.where(in_front, torch.full_like(hand.part, _FOREARM), hand.part),
        normal=torch.where(in_front[..., None], arm.normal, hand.normal),
    )


def _exposed(
    projector: HandProjector, posed: _Posed, behind: UInt8[Tensor, "height width 3"], scene: SceneSettings
) -> Float[Tensor, "height width 3"]:
    """Light of one time, averaged over every pixel's area; grey levels. Only the hand's window is cast and shaded."""
    image = behind.double()
    left, top, right, bottom = _window(projector, posed.frames, scene)
    if right <= left or bottom <= top:
        return image
    shift = projector.camera.intrinsics.new_tensor((left, top))
    intrinsics = projector.camera.intrinsics.clone()
    intrinsics[:2, 2] -= shift
    camera = replace(projector.camera, intrinsics=intrinsics, width=right - left, height=bottom - top)
    side = scene.supersampling
    seen = _cast(projector, posed, camera.resized(float(side)), scene)
    around = behind[top:bottom, left:right].repeat_interleave(side, 0).repeat_interleave(side, 1)
    lit = replace(seen, part=torch.where(seen.part == _FOREARM, 0, seen.part))
    picture = shade(lit, skin=SKIN_TONES[scene.skin], background=around, light=scene.light, ambient=scene.ambient)
    averaged = torch.nn.functional.avg_pool2d(picture.permute(2, 0, 1).float(), side)
    image[top:bottom, left:right] = averaged.permute(1, 2, 0).double()
    return image


def _window(projector: HandProjector, frames: HandFrames, scene: SceneSettings) -> tuple[int, int, int, int]:
    """Pixels x0, y0, x1, y1 (exclusive) that hold all of the hand and its forearm; the whole picture where that is not
    certain."""
    camera = projector.camera
    space = projector.kinematics.shape_space
    reach = _REACH * space.metric(projector.shape)["hand_length"]
    points = camera.cam_from_world(frames.keypoints)
    offsets = points.new_tensor([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = (points[:, None] + reach * offsets).reshape(-1, 3)
    if scene.forearm:
        corners = torch.cat((corners, camera.cam_from_world(forearm_corners(frames, space, projector.shape))))
    return pixel_box(corners, camera)


def _developed(image: Tensor, scene: SceneSettings, generator: torch.Generator) -> UInt8[Tensor, "height width 3"]:
    """Lens blur, sensor noise and rounding."""
    if scene.blur_px > 0:
        blurred = cv2.GaussianBlur(image.contiguous().cpu().numpy(), (0, 0), scene.blur_px)
        image = torch.from_numpy(blurred).to(image.device)
    if scene.noise > 0:
        noise = torch.randn(image.shape, generator=generator, dtype=image.dtype)
        image = image + scene.noise * noise.to(image.device)
    return image.round().clamp(0, 255).to(torch.uint8)
