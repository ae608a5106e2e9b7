"""Ways to fit a hand into what several cameras see, as one kind of function, for the study that compares them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit import PostureResiduals
from torchhand.fit.hull import HullFitter, HullTarget, HullTorqueSettings, TorqueSteps, fit_by_torques
from torchhand.geometry import Camera
from torchhand.hand import Hand, PoseConstraints, PoseSpace
from torchhand.track.multiview import MultiViewSettings


@dataclass(frozen=True, kw_only=True)
class FitProblem:
    """A hand of known shape seen by some cameras, and a guess of its pose."""

    cameras: Sequence[Camera]
    masks: Sequence[Bool[Tensor, "_height _width"]]
    target: HullTarget
    """Their hull, its surface in the middle of the GRAY shell, and the edges of the silhouettes."""
    hand: Hand
    shape: Float[Tensor, "shape"]
    space: PoseSpace
    constraints: PoseConstraints
    prior: PostureResiduals
    pose: Float[Tensor, "36"]
    root_reference: Float[Tensor, "3 3"]


@dataclass(frozen=True, kw_only=True)
class FoundHand:
    pose: Float[Tensor, "36"]
    root_reference: Float[Tensor, "3 3"]


Method = Callable[[FitProblem], FoundHand]


def by_torques(problem: FitProblem, steps: TorqueSteps = "largest") -> FoundHand:
    """Paper 002's fit, palm and fingers together."""
    found = fit_by_torques(
        problem.target.field,
        problem.hand,
        problem.space,
        problem.pose,
        problem.root_reference,
        HullTorqueSettings(steps=steps),
        shape=problem.shape,
    )
    return FoundHand(pose=found.pose, root_reference=found.root_reference)


def by_least_squares(problem: FitProblem, *, contours: bool) -> FoundHand:
    """Skin inside the hull, limits and prior, by Levenberg-Marquardt, as where the tracker finds a hand.

    contours: the edges of all silhouettes must touch the skin; without them the hull's surface must be on it.
    """
    target = problem.target if contours else replace(problem.target, rims=None)
    fitter = HullFitter(
        problem.hand,
        problem.space,
        MultiViewSettings().start_fit,
        shape=problem.shape,
        constraints=problem.constraints,
        prior=problem.prior,
    )
    found = fitter(target, problem.pose[None], problem.root_reference[None]).select(0)
    return FoundHand(pose=found.pose, root_reference=found.root_reference)


def unmoved(problem: FitProblem) -> FoundHand:
    """The guess itself: what the others have to improve."""
    return FoundHand(pose=problem.pose, root_reference=problem.root_reference)


METHODS: Mapping[str, Method] = {
    "guess": unmoved,
    "torque": by_torques,
    "torque, proportional": lambda problem: by_torques(problem, "proportional"),
    "LM": lambda problem: by_least_squares(problem, contours=False),
    "LM, contours": lambda problem: by_least_squares(problem, contours=True),
}
"""By the name in tables and plots; each is given the same problems."""


def keypoints_of(problem: FitProblem, found: FoundHand) -> Float[Tensor, "21 3"]:
    """In the world, metres."""
    kinematics = problem.hand.kinematics
    like = kinematics.default_shape
    with torch.inference_mode():
        frames = kinematics(found.pose.to(like), problem.shape.to(like), root_reference=found.root_reference.to(like))
    return frames.keypoints.double()
