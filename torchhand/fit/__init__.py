"""Estimation of poses, and of one shape, that explain observations under priors: one problem and one solver.

To observe something new, write a class with `associate` (`Observation`) and the factor that it returns (`Factor`).
"""

from torchhand.fit.appearance import (
    Agreement,
    Appearance,
    disc,
    grey,
    hand_region,
    learn_appearance,
    mask_plane,
    overlap,
    relearned,
    touching,
    unexplained_px,
)
from torchhand.fit.bounds import free_bounds
from torchhand.fit.equations import summed, weighted_equations
from torchhand.fit.frames import FrameFactor, FrameObservations
from torchhand.fit.limits import DynamicConstraints, limit_residual
from torchhand.fit.observation import Equations, Explained, Factor, Observation, PosedHands
from torchhand.fit.posture import PostureResiduals
from torchhand.fit.priors import ConstraintPrior, GaussianPrior, PosturePrior
from torchhand.fit.problem import Linearization, Problem
from torchhand.fit.registration_beliefs import Beliefs, HeldBeliefs
from torchhand.fit.schedule import Schedule, Stage
from torchhand.fit.shared import PopulationPrior, SharedPrior, SharedUnknowns
from torchhand.fit.smoothness import Expectation, smoothness_residual
from torchhand.fit.solve import Solutions, SolveStatus, covariance_of, solve
from torchhand.fit.solve_shared import SharedSolution, solve_shared

__all__ = [
    "Agreement",
    "Appearance",
    "Beliefs",
    "ConstraintPrior",
    "DynamicConstraints",
    "Equations",
    "Expectation",
    "Explained",
    "Factor",
    "FrameFactor",
    "FrameObservations",
    "GaussianPrior",
    "HeldBeliefs",
    "Linearization",
    "Observation",
    "PopulationPrior",
    "PosedHands",
    "PosturePrior",
    "PostureResiduals",
    "Problem",
    "Schedule",
    "SharedPrior",
    "SharedSolution",
    "SharedUnknowns",
    "Solutions",
    "SolveStatus",
    "Stage",
    "covariance_of",
    "disc",
    "free_bounds",
    "grey",
    "hand_region",
    "learn_appearance",
    "limit_residual",
    "mask_plane",
    "overlap",
    "relearned",
    "smoothness_residual",
    "solve",
    "solve_shared",
    "summed",
    "touching",
    "unexplained_px",
    "weighted_equations",
]
