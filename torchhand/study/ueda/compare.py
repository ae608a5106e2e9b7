"""The ways of fitting compared, over people and numbers of cameras."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.evaluate import flexion_deg
from torchhand.fit import PostureResiduals
from torchhand.fit.hull import target_of, with_rims
from torchhand.geometry import Camera
from torchhand.hand import Hand, PoseConstraints, PoseSpace
from torchhand.study.ueda.methods import FitProblem, FoundHand, Method, keypoints_of
from torchhand.volume import CarvingSettings, RootCube, carve, hull_field


@dataclass(frozen=True, kw_only=True)
class Sitter:
    """A person's hand seen by all cameras of a rig, its true pose and a guess of it."""

    cameras: Sequence[Camera]
    masks: Sequence[Bool[Tensor, "_height _width"]]
    root: RootCube
    hand: Hand
    shape: Float[Tensor, "shape"]
    space: PoseSpace
    constraints: PoseConstraints
    prior: PostureResiduals
    truth: FoundHand
    guess: FoundHand


@dataclass(frozen=True, kw_only=True)
class FitError:
    """Of one fit."""

    joint_mm: float
    """Mean distance of the 21 keypoints in the world."""
    flexion_deg: float
    """Mean error of the 15 angles between successive bones."""
    milliseconds: float


def fit_errors(sitter: Sitter, cameras: int, level: int, methods: Mapping[str, Method]) -> dict[str, FitError]:
    """Each method on the hull of the first so many cameras; the time is that of the fit alone."""
    views = slice(cameras)
    octree = carve(
        sitter.masks[views], sitter.cameras[views], sitter.root, CarvingSettings(level=level, least_views=cameras)
    )
    problem = FitProblem(
        cameras=sitter.cameras[views],
        masks=sitter.masks[views],
        target=with_rims(target_of(hull_field(octree, surface="middle")), sitter.cameras[views], sitter.masks[views]),
        hand=sitter.hand,
        shape=sitter.shape,
        space=sitter.space,
        constraints=sitter.constraints,
        prior=sitter.prior,
        pose=sitter.guess.pose,
        root_reference=sitter.guess.root_reference,
    )
    truth = keypoints_of(problem, sitter.truth)
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
