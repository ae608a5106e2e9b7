"""Estimation of poses, and of one shape, that explain observations under priors: one problem and one solver.

To observe something new, write a class with `associate` (`Observation`) and the factor that it returns (`Factor`).
"""

from torchhand.fit.appearance import (
    Appearance,
    disc,
    grey,
    learn_appearance,
    mask_plane,
    relearned,
    unexplained_px,
)
from torchhand.fit.bounds import free_bounds
from torchhand.fit.frames import FrameFactor, FrameObservations
from torchhand.fit.limits import DynamicConstraints
from torchhand.fit.observation import Equations, Explained, Factor, Observation, OwnFactor, PosedHands
from torchhand.fit.posture import PostureResiduals
from torchhand.fit.priors import ConstraintPrior, GaussianPrior, PosturePrior
from torchhand.fit.problem import Linearization, Problem
from torchhand.fit.schedule import Schedule, Stage
from torchhand.fit.shared import PopulationPrior, ShapePrior, SharedPrior, SharedUnknowns
from torchhand.fit.solve import Solutions, SolveStatus, covariance_of, solve
from torchhand.fit.solve_shared import SharedSolution, solve_shared

__all__ = [
    "Appearance",
    "ConstraintPrior",
    "DynamicConstraints",
    "Equations",
    "Explained",
    "Factor",
    "FrameFactor",
    "FrameObservations",
    "GaussianPrior",
    "Linearization",
    "Observation",
    "OwnFactor",
    "PopulationPrior",
    "PosedHands",
    "PosturePrior",
    "PostureResiduals",
    "Problem",
    "Schedule",
    "ShapePrior",
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
    "learn_appearance",
    "mask_plane",
    "relearned",
    "solve",
    "solve_shared",
    "unexplained_px",
]
