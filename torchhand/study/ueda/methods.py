"""Ways to fit a hand into what several cameras see, as one kind of function, for the study that compares them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit.hull import (
    SEARCH,
    HullFitter,
    HullTarget,
    HullTorqueSettings,
    JointPriors,
    SkinPoints,
    TorqueSteps,
    fit_by_torques,
)
from torchhand.geometry import Camera
from torchhand.hand import Hand, HandPose, PoseSpace
from torchhand.track.multiview import RigSettings


@dataclass(frozen=True, kw_only=True)
class FitProblem:
    """A hand of known shape seen by some cameras, and a guess of its pose."""

    cameras: Sequence[Camera]
    masks: Sequence[Bool[Tensor, "_height _width"]]
    target: HullTarget
    """Hull of the silhouettes, its surface in the middle of the GRAY shell, and the edges of the silhouettes."""
    hand: Hand
    shape: Float[Tensor, "shape"]
    space: PoseSpace
    joints: JointPriors
    guess: HandPose


Method = Callable[[FitProblem], HandPose]


def by_torques(problem: FitProblem, steps: TorqueSteps = "largest") -> HandPose:
    """The fit of Ueda et al. 2003, palm and fingers together."""
    skin, settings = SkinPoints(problem.hand, problem.shape), HullTorqueSettings(steps=steps)
    return fit_by_torques(problem.target.field, skin, problem.space, problem.guess, settings).pose


def by_least_squares(problem: FitProblem, *, contours: bool) -> HandPose:
    """Skin inside the hull, limits and prior, by Levenberg-Marquardt, as where the tracker finds a hand.

    contours: the edges of all silhouettes must touch the skin; without them the hull's surface must be on it.
    """
    target = problem.target if contours else replace(problem.target, rays=None)
    settings = RigSettings()
    fitter = HullFitter(
        hand=problem.hand,
        space=problem.space,
        shape=problem.shape,
        settings=settings.hull,
        schedule=SEARCH,
        joints=replace(problem.joints, weights=settings.joints),
    )
    return fitter(target, problem.guess).pose


def unmoved(problem: FitProblem) -> HandPose:
    """The guess itself: what the others have to improve."""
    return problem.guess


METHODS: Mapping[str, Method] = {
    "guess": unmoved,
    "torque": by_torques,
    "torque, proportional": lambda problem: by_torques(problem, "proportional"),
    "LM": lambda problem: by_least_squares(problem, contours=False),
    "LM, contours": lambda problem: by_least_squares(problem, contours=True),
}
"""By the name in tables and plots; each is given the same problems."""


def keypoints_of(problem: FitProblem, found: HandPose) -> Float[Tensor, "21 3"]:
    """Keypoints in the world, metres."""
    kinematics = problem.hand.kinematics
    like = kinematics.default_shape
    found = found.to(like)
    with torch.inference_mode():
        frames = kinematics(found.dofs, problem.shape.to(like), root_reference=found.reference)
    return frames.keypoints.double()
