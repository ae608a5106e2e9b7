"""Simulated pictures for the hypothesis study: our own hand, whose shape and pose are then known exactly."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector
from torchhand.hand import HandPose, HandPrior, PoseSpace, Side, named_pose_space
from torchhand.hand.limits import clamp_to_limits
from torchhand.simulate import Motion, SceneSettings, facing, hand_length, render_sequence
from torchhand.study import seed_of
from torchhand.study.hypotheses.case_study import StudyCase
from torchhand.study.hypotheses.settings import HypothesisStudySettings

_FOV_DEG = 55.0
_TILT_DEG = 40.0
_HAND_FRACTION = 0.6  # length of the hand, of the picture's height
_MIDDLE = 0.48  # of a hand, share of its length from the wrist


@dataclass(frozen=True, kw_only=True)
class SimulatedHand:
    """A hand before a camera that stands in the world's origin."""

    camera: Camera
    pose: Float[Tensor, "36"]
    reference: Float[Tensor, "3 3"]
    """Reference of the pose's rotation vector, which is zero."""
    middle: Float[Tensor, "3"]
    """About the middle of the hand."""


def simulated_hand(
    prior: HandPrior,
    space: PoseSpace,
    generator: torch.Generator,
    *,
    side: Side,
    shape: Float[Tensor, "shape"],
    size: tuple[int, int],
) -> SimulatedHand:
    """A hand of the prior's postures within the space, palm or back to the camera, tilted up to 40 degrees."""
    model, (width, height) = load_hand_model(), size
    camera = replace(assumed_camera(width, height, horizontal_fov_deg=_FOV_DEG), is_assumed=False)
    drawn, _ = prior.sample(1, generator)
    pose = clamp_to_limits(space.dof(space.free(drawn[0].double())), model.skeleton)
    tilt = torch.randn(3, generator=generator, dtype=torch.float64)
    amount, view = torch.rand(2, generator=generator, dtype=torch.float64).tolist()
    tilt = torch.nn.functional.normalize(tilt, dim=-1) * math.radians(_TILT_DEG * amount)
    reference = rotation_from_vector(tilt) @ facing("palm" if view < 0.5 else "back")
    length = hand_length(model.kinematics(side, dtype=torch.float64), shape)
    ahead = float(camera.intrinsics[0, 0]) * length / (_HAND_FRACTION * height)
    middle = torch.tensor((0.0, 0.0, ahead), dtype=torch.float64)
    pose[:3] = middle - reference @ torch.tensor((0.0, _MIDDLE * length, 0.0), dtype=torch.float64)
    pose[3:6] = 0
    return SimulatedHand(camera=camera, pose=pose, reference=reference, middle=middle)


def simulated_case(
    number: int,
    prior: HandPrior,
    settings: HypothesisStudySettings,
    seed: int,
    *,
    side: Side = "right",
    shape: Float[Tensor, "shape"] | None = None,
    size: tuple[int, int] = (640, 480),
) -> StudyCase:
    """The picture of that number: a hand of the prior's postures, palm or back to the camera, tilted up to 40 degrees.

    Its surface is the one that is registered, its pose lies in the pose space, and its mask is exact. The same seed and
    number give the same picture.
    """
    model = load_hand_model()
    kinematics = model.kinematics(side, dtype=torch.float64)
    shape = kinematics.default_shape if shape is None else shape
    generator = torch.Generator().manual_seed(seed_of(seed, "picture", number))
    made = simulated_hand(prior, named_pose_space(settings.space), generator, side=side, shape=shape, size=size)
    scene = SceneSettings(surface=settings.surface, supersampling=2)
    motion = Motion(name="still", poses=made.pose[None], root_reference=made.reference, fps=30.0)
    hand = model.hand(side=side, dtype=torch.float64) if settings.surface == "mesh" else None
    frame = next(iter(render_sequence(kinematics, motion, made.camera, scene, generator, shape=shape, hand=hand)))
    return StudyCase(
        frame=number,
        image=frame.image,
        mask=frame.mask,
        camera=made.camera,
        side=side,
        shape=shape,
        pose=HandPose.of(made.pose, made.reference),
    )
