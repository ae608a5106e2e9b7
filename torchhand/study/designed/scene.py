"""What the cameras of a trial see of a simulated hand, with all that is wrong about it."""

import math
from dataclasses import dataclass, replace

import cv2
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import HandPose, HandPrior, Side, named_pose_space
from torchhand.simulate import Motion, SceneSettings, noisy_mask, render_sequence, sample_shape
from torchhand.study import seed_of
from torchhand.study.designed.trial import Trial
from torchhand.study.hypotheses import SimulatedHand, simulated_hand

SIDE: Side = "right"
_SIZE = (640, 480)
_APART_DEG = 45.0
_OCCLUDER = 128  # grey level


@dataclass(frozen=True, kw_only=True)
class SeenView:
    """What one camera sees, as a registration is told it."""

    image: UInt8[Tensor, "height width 3"]
    mask: Bool[Tensor, "height width"]
    points_px: Float[Tensor, "21 2"]
    """Detected points; NaN where there is none."""
    camera: Camera
    """The camera as it is believed to be."""


@dataclass(frozen=True, kw_only=True)
class SeenHand:
    """A hand and the views of it."""

    number: int
    pose: HandPose
    """True pose, () float64."""
    views: tuple[SeenView, ...]
    """Views that are not missing."""


@dataclass(frozen=True, kw_only=True)
class RenderedView:
    """What one camera really sees."""

    image: UInt8[Tensor, "height width 3"]
    mask: Bool[Tensor, "height width"]
    points_px: Float[Tensor, "21 2"]
    depth: Float[Tensor, "21"]
    """Depths of the keypoints, metres."""
    camera: Camera


@dataclass(frozen=True, kw_only=True)
class RenderedHand:
    """Pictures of one hand."""

    number: int
    pose: HandPose
    views: tuple[RenderedView, ...]


def rendered_hand(number: int, trial: Trial, space: str, prior: HandPrior, seed: int) -> RenderedHand:
    """The hand of that number as the trial's cameras really see it; the same hand whatever the trial.

    A wrong shape is the hand's, the one of the registration is the default.
    """
    model = load_hand_model()
    kinematics = model.kinematics(SIDE, dtype=torch.float64)
    person = torch.Generator().manual_seed(seed_of(seed, "person", number))
    other = sample_shape(model.shape_space, person).double() - kinematics.default_shape
    shape = kinematics.default_shape + trial.shape_spread * other
    shape = shape.clamp(model.shape_space.lower.double(), model.shape_space.upper.double())
    generator = torch.Generator().manual_seed(seed_of(seed, "picture", number))
    made = simulated_hand(
        prior, named_pose_space(space), generator, side=SIDE, shape=kinematics.default_shape, size=_SIZE
    )
    scene = SceneSettings(
        noise=trial.noise, blur_px=trial.blur_px, skin=trial.skin, ambient=trial.ambient, supersampling=2
    )
    motion = Motion(name="still", poses=made.pose[None], root_reference=made.reference, fps=30.0)
    views = []
    for index, camera in enumerate(cameras_around(made, trial.cameras)):
        grain = torch.Generator().manual_seed(seed_of(seed, "view", number, index))
        frame = next(iter(render_sequence(kinematics, motion, camera, scene, grain, shape=shape)))
        views.append(
            RenderedView(
                image=frame.image,
                mask=frame.mask,
                points_px=frame.keypoints_px,
                depth=frame.keypoints_cam[:, 2],
                camera=camera,
            )
        )
    return RenderedHand(number=number, pose=HandPose.of(made.pose, made.reference), views=tuple(views))


def cameras_around(made: SimulatedHand, count: int) -> list[Camera]:
    """The hand's own camera and others on a circle about the middle of the hand."""
    found = []
    for index in range(count):
        turn = rotation_from_vector(torch.tensor((0.0, math.radians(_APART_DEG * index), 0.0), dtype=torch.float64))
        found.append(replace(made.camera, rotation=turn, translation=made.middle - turn @ made.middle))
    return found


def seen_hand(rendered: RenderedHand, trial: Trial, generator: torch.Generator) -> SeenHand:
    """What a registration is told of a hand: with noise, what is hidden or missed, and wrong calibrations."""
    views = [_seen(view, trial, index, generator) for index, view in enumerate(rendered.views)]
    is_there = (torch.rand(len(views), generator=generator) >= trial.missing_views).tolist()
    kept = tuple(view for view, is_kept in zip(views, is_there, strict=True) if is_kept)
    return SeenHand(number=rendered.number, pose=rendered.pose, views=kept)


def _seen(view: RenderedView, trial: Trial, index: int, generator: torch.Generator) -> SeenView:
    mask = noisy_mask(_blurred(view.mask, trial.blur_px), trial.mask_noise_px, generator)
    hidden = _hidden(mask, trial.occlusion, generator)
    focal = 0.5 * float(view.camera.intrinsics[0, 0] + view.camera.intrinsics[1, 1])
    noise = torch.randn(21, 2, generator=generator, dtype=torch.float64)
    points = view.points_px + noise * (1e-3 * trial.point_std_mm * focal / view.depth)[:, None]
    is_missed = torch.rand(21, generator=generator) < trial.dropout
    x, y = view.points_px.round().long().unbind(-1)
    height, width = mask.shape
    is_inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    is_hidden = is_inside & hidden[y.clamp(0, height - 1), x.clamp(0, width - 1)]
    return SeenView(
        image=torch.where(hidden[..., None], _OCCLUDER, view.image),
        mask=mask & ~hidden,
        points_px=torch.where((is_missed | is_hidden)[:, None], torch.nan, points),
        camera=_believed(view.camera, trial, index, generator),
    )


def _blurred(mask: Bool[Tensor, "height width"], blur_px: float) -> Bool[Tensor, "height width"]:
    if blur_px == 0:
        return mask
    return torch.from_numpy(cv2.GaussianBlur(mask.float().numpy(), (0, 0), blur_px)) > 0.5


def _hidden(
    mask: Bool[Tensor, "height width"], share: float, generator: torch.Generator
) -> Bool[Tensor, "height width"]:
    """A disc about a random pixel of the silhouette that hides the given share of it."""
    pixels = mask.nonzero()
    place = torch.rand((), generator=generator)
    count = round(share * len(pixels))
    if count == 0:
        return torch.zeros_like(mask)
    centre = pixels[int(place * len(pixels))]
    distance = (pixels - centre).double().norm(dim=-1)
    radius = distance.kthvalue(count).values
    rows, columns = (torch.arange(size, dtype=torch.float64) for size in mask.shape)
    return torch.hypot(rows[:, None] - centre[0], columns - centre[1]) <= radius


def _believed(camera: Camera, trial: Trial, index: int, generator: torch.Generator) -> Camera:
    """The camera as a wrong calibration has it."""
    intrinsics = camera.intrinsics.clone()
    intrinsics[[0, 1], [0, 1]] *= 1 + trial.focal_error
    intrinsics[0, 2] += trial.centre_error_px
    wrong = math.radians(trial.camera_turn_deg) * torch.randn(3, generator=generator, dtype=torch.float64)
    turn = rotation_from_vector(wrong if index else torch.zeros_like(wrong))
    rotation, translation = turn @ camera.rotation.double(), turn @ camera.translation.double()
    return replace(camera, intrinsics=intrinsics, rotation=rotation, translation=translation)
