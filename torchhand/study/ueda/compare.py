"""The ways of fitting compared, over people and numbers of cameras."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.evaluate import flexion_deg
from torchhand.fit.hull import JointPriors, target_of, with_rays
from torchhand.geometry import Camera
from torchhand.hand import Hand, HandPose, PoseSpace
from torchhand.study.ueda.methods import FitProblem, Method, keypoints_of
from torchhand.volume import CarvingSettings, RootCube, carve, hull_field


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A person's hand seen by all cameras of a rig, its true pose and a guess of it."""

    cameras: Sequence[Camera]
    masks: Sequence[Bool[Tensor, "_height _width"]]
    root: RootCube
    hand: Hand
    shape: Float[Tensor, "shape"]
    space: PoseSpace
    joints: JointPriors
    truth: HandPose
    guess: HandPose


@dataclass(frozen=True, kw_only=True)
class FitError:
    """Error of one fit."""

    joint_mm: float
    """Mean distance of the 21 keypoints in the world."""
    flexion_deg: float
    """Mean error of the 15 angles between successive bones."""
    milliseconds: float


def fit_errors(subject: Subject, cameras: int, level: int, methods: Mapping[str, Method]) -> dict[str, FitError]:
    """Errors of each method on the hull of the first so many cameras; the time is that of the fit alone."""
    views = slice(cameras)
    octree = carve(
        subject.masks[views], subject.cameras[views], subject.root, CarvingSettings(level=level, min_views=cameras)
    )
    problem = FitProblem(
        cameras=subject.cameras[views],
        masks=subject.masks[views],
        target=with_rays(target_of(hull_field(octree, surface="middle")), subject.cameras[views], subject.masks[views]),
        hand=subject.hand,
        shape=subject.shape,
        space=subject.space,
        joints=subject.joints,
        guess=subject.guess,
    )
    truth = keypoints_of(problem, subject.truth)
    errors = {}
    for name, method in methods.items():
        begun = time.perf_counter()
        found = method(problem)
        seconds = time.perf_counter() - begun
        errors[name] = _error(keypoints_of(problem, found), truth, 1e3 * seconds)
    return errors


def _error(found: Float[Tensor, "21 3"], truth: Float[Tensor, "21 3"], milliseconds: float) -> FitError:
    flexion = flexion_deg(torch.stack((found, truth)).numpy())
    return FitError(
        joint_mm=1e3 * float((found - truth).norm(dim=-1).mean()),
        flexion_deg=float(np.abs(flexion[0] - flexion[1]).mean()),
        milliseconds=milliseconds,
    )
