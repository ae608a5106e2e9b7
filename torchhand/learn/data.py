"""Random hands before random cameras, and what a detector might say of them."""

import math
from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.geometry import rotation_from_vector
from torchhand.hand import BONES, FINGERS, KEYPOINTS, HandModel, HandPrior

# Columns: where the hand frame's x (dorsal), y (to the fingers) and z (to the thumb) point in the camera frame.
_BACK = ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0))
_PALM = ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0))
_NEAREST = 0.05  # metres: smallest depth of a keypoint

_JOINT_BONES = {
    "cmc": "metacarpal",
    "mcp": "proximal",
    "pip": "middle",
    "ip": "distal",
    "dip": "distal",
    "tip": "distal",
}


@dataclass(frozen=True, kw_only=True)
class SampleSettings:
    """What cameras and detectors there are. Ranges of hands are the prior's."""

    palm: float = 0.5
    """Share of hands whose palm faces the camera; the others show their back."""
    tilt_deg: float = 75.0
    """Largest turn of palm or back away from the camera, about any axis of the picture; about the line of sight the
    hand is turned anyhow."""
    distance: tuple[float, float] = (0.2, 1.5)
    """Distance from the camera to the middle of the hand, metres; uniform in its logarithm."""
    off_axis_deg: float = 30.0
    """Largest angle between the optical axis and the middle of the hand."""
    scale: float = 0.05
    """Standard deviation of a factor on the size of the hand beyond what the prior knows."""
    definition: float = 1.0
    """How far keypoints are from where this model has them, as other makers define them otherwise: a factor on
    deviations of 4 to 6 mm along each axis, 9 mm at the thumb's CMC, fixed to the bone."""
    noise: float = 0.03
    """Largest standard deviation of the noise in the picture, share of the hand's size there (root mean square)."""
    focal: float = 0.05
    """Standard deviation of the error of the focal length, share of it."""
    missing: float = 0.05
    """Probability of each point to be missing, and of all points of one finger beyond its base."""

    def __post_init__(self) -> None:
        ranges = {"palm": (0, 1), "tilt_deg": (0, 90), "off_axis_deg": (0, 60), "scale": (0, 0.5)}
        ranges |= {"definition": (0, 3), "noise": (0, 0.3), "focal": (0, 0.3), "missing": (0, 0.5)}
        for name, (low, high) in ranges.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: expected {low} to {high}, got {getattr(self, name)}")
        if not 0.1 <= self.distance[0] <= self.distance[1] <= 100:
            raise ValueError(f"distance: expected two numbers from 0.1 to 100, the smaller first, got {self.distance}")


@dataclass(frozen=True, kw_only=True)
class HandPool:
    """Hands drawn from the prior, in their own frames."""

    joints: Float[Tensor, "hands 30"]
    shape: Float[Tensor, "hands shape"]
    keypoints: Float[Tensor, "hands 21 3"]
    bones: Float[Tensor, "hands 21 3 3"]
    """hand_from_bone of the bone that each keypoint belongs to."""

    def __len__(self) -> int:
        return len(self.joints)


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Hands before cameras, and the points that were seen."""

    points_plane: Float[Tensor, "hands 21 2"]
    """Points on the normalised image plane, with all errors."""
    seen: Bool[Tensor, "hands 21"]
    keypoints: Float[Tensor, "hands 21 3"]
    """Truth: metres, camera frame."""
    joints: Float[Tensor, "hands 30"]
    """True joint angles, radians."""

    def part(self, rows: slice) -> "Samples":
        """Some of them."""
        return Samples(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def hand_pool(prior: HandPrior, model: HandModel, count: int, generator: torch.Generator) -> HandPool:
    """Hands of the prior, float32."""
    pose, shape = prior.sample(count, generator)
    frames = model.kinematics(dtype=torch.float64)(pose.double(), shape.double())
    bones = frames.rotation[:, [_bone(name) for name in KEYPOINTS]]
    return HandPool(
        joints=pose[:, 6:].float(), shape=shape.float(), keypoints=frames.keypoints.float(), bones=bones.float()
    )


def draw_samples(
    pool: HandPool, rows: Int[Tensor, "hands"], settings: SampleSettings, generator: torch.Generator
) -> Samples:
    """Samples of hands, each before a camera of its own; everything follows from the generator."""

    def normal(*size: int) -> Tensor:
        return torch.randn(*size, generator=generator)

    def uniform(*size: int) -> Tensor:
        return torch.rand(*size, generator=generator)

    count = len(rows)
    scale = (settings.scale * normal(count, 1, 1)).exp()
    hand = scale * pool.keypoints[rows]
    shift = settings.definition * _definitions() * normal(count, 21, 3)
    other = hand + (pool.bones[rows] @ shift[..., None]).squeeze(-1)
    turn = _orientations(settings, uniform(count), uniform(count), uniform(count), uniform(count))
    low, high = (math.log(end) for end in settings.distance)
    distance = (low + (high - low) * uniform(count)).exp()
    towards = _directions(settings.off_axis_deg, uniform(count), uniform(count))
    middle = (turn @ hand.mean(1)[..., None]).squeeze(-1)
    place = (towards * distance[:, None] - middle)[:, None]
    keypoints, other = (points @ turn.mT + place for points in (hand, other))
    near = torch.minimum(keypoints[..., 2].amin(-1), other[..., 2].amin(-1))
    back = (_NEAREST - near).clamp_min(0)[:, None, None] * towards.new_tensor((0.0, 0.0, 1.0))
    keypoints, other = keypoints + back, other + back
    plane = other[..., :2] / other[..., 2:]
    size = (plane - plane.mean(1, keepdim=True)).square().sum(-1).mean(1).sqrt()[:, None, None]
    plane = plane + settings.noise * uniform(count, 1, 1) * size * normal(count, 21, 2)
    plane = plane * (settings.focal * normal(count, 1, 1)).exp()
    return Samples(
        points_plane=plane,
        seen=_seen(settings.missing, uniform(count, 21), uniform(count), uniform(count)),
        keypoints=keypoints,
        joints=pool.joints[rows],
    )


def _bone(keypoint: str) -> int:
    finger, _, joint = keypoint.partition("_")
    return BONES.index(f"{finger}_{_JOINT_BONES[joint]}") if joint else 0


def _definitions() -> Float[Tensor, "21 3"]:
    """Standard deviation of each keypoint's place along the axes of its bone (y along the bone), metres."""
    special = {"wrist": (6.0, 8.0, 6.0), "thumb_cmc": (9.0, 9.0, 9.0)}
    usual = (4.0, 6.0, 4.0)
    return 1e-3 * torch.tensor([special.get(name, usual) for name in KEYPOINTS])


def _orientations(
    settings: SampleSettings, side: Tensor, roll: Tensor, tilt: Tensor, about: Tensor
) -> Float[Tensor, "hands 3 3"]:
    """cam_from_hand: palm or back to the camera, tilted, then turned about the line of sight."""
    faces = torch.where((side < settings.palm)[:, None, None], torch.tensor(_PALM).T, torch.tensor(_BACK).T)
    angle, about = math.radians(settings.tilt_deg) * tilt, 2 * math.pi * about
    zero = torch.zeros_like(roll)
    tilted = rotation_from_vector(torch.stack((angle * about.cos(), angle * about.sin(), zero), -1))
    rolled = rotation_from_vector(torch.stack((zero, zero, math.pi * (2 * roll - 1)), -1))
    return rolled @ tilted @ faces


def _directions(largest_deg: float, fraction: Tensor, about: Tensor) -> Float[Tensor, "hands 3"]:
    """Unit vectors within a cone about the optical axis."""
    angle, about = math.radians(largest_deg) * fraction.sqrt(), 2 * math.pi * about
    return torch.stack((angle.sin() * about.cos(), angle.sin() * about.sin(), angle.cos()), -1)


def _seen(missing: float, alone: Tensor, whole: Tensor, which: Tensor) -> Bool[Tensor, "hands 21"]:
    """Points that are missing neither by themselves, of which there are five at most, nor with the rest of a finger."""
    order = alone.argsort(1).argsort(1)
    lost = (alone < missing) & (order < 5)
    finger = torch.tensor([-1] + [i for i in range(len(FINGERS)) for _ in range(4)])
    is_tail = torch.tensor([name not in ("wrist", "thumb_cmc") and not name.endswith("mcp") for name in KEYPOINTS])
    gone = (finger == (which * len(FINGERS)).long()[:, None]) & is_tail & (whole < missing)[:, None]
    return ~(lost | gone)
