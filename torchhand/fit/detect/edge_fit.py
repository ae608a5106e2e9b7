"""Fits pose and proportions to one picture: maximum a posteriori on edges along the contour's normals.

The start of a track: Stenger et al. (2001) set the model's parameters by hand and name their estimation within the same
framework as future work (section 6.1); this is that.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.errors import require, require_positive
from torchhand.fit import (
    GaussianPrior,
    Problem,
    Schedule,
    ShapePrior,
    SharedSolution,
    SharedUnknowns,
    Stage,
    solve_shared,
)
from torchhand.fit.contour import EDGE_REACH, EDGES, EdgeObservation
from torchhand.hand import DOFS, HandKinematics, HandPose, pose_space
from torchhand.view import HandProjector, OutlineTable, PrimitiveContours

# Prior standard deviations of the pose about the start posture, by ending of the DOF's name: metres and radians.
# Flexion of a straight finger is hardly seen in one picture and trades against its length, so it stays close.
_POSE_STD = {
    "root_tx": 0.03,
    "root_ty": 0.03,
    "root_tz": 0.10,
    "root_rx": 0.10,
    "root_ry": 0.10,
    "root_rz": 0.30,
    "thumb_cmc_fe": 0.30,
    "thumb_cmc_aa": 0.30,
    "thumb_mcp_fe": 0.25,
    "thumb_ip_fe": 0.25,
    "mcp_aa": 0.20,
    "mcp_fe": 0.08,
    "pip_fe": 0.08,
    "dip_fe": 0.05,
}
_BENT = 0.3  # radians: a finger joint flexed more than this by the posture counts as bent
_BENT_STD = 0.25  # radians: prior standard deviation of the flexions of a finger that the posture bends
_FIRST_REACH, _LAST_REACH = 0.10, 0.035  # half lengths of the first and the last edge search, hand lengths


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    iterations: int = 14
    """Gauss-Newton steps; 1 or more."""
    edge_std_px: float = 1.5
    """Standard deviation of one edge; above 0."""

    def __post_init__(self) -> None:
        require_positive("fit.edge_std_px", self.edge_std_px)
        require(self.iterations >= 1, "fit.iterations", "1 or more", self.iterations)

    def schedule(self, length_m: float) -> Schedule:
        """One step after each search of edges, from coarse to fine, for a hand of some length."""
        finer = _LAST_REACH / _FIRST_REACH
        progress = (step / max(1, self.iterations - 1) for step in range(self.iterations))
        reaches = (length_m * _FIRST_REACH * finer**part for part in progress)
        return tuple(
            Stage(gross_m=reach / EDGE_REACH, rounds=1, iterations=1, method="gauss_newton") for reach in reaches
        )


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A hand fitted to one picture, in the camera's frame."""

    pose: Float[Tensor, "36"]
    """Metres and radians, with a zero rotation vector: the root's orientation is in root_reference."""
    root_reference: Float[Tensor, "3 3"]
    """Rotation cam_from_hand."""
    shape: Float[Tensor, "shape"]
    pose_std: Float[Tensor, "36"]
    """0 for DOFs that are held, and for those that lie at their limit."""
    shape_std: Float[Tensor, "shape"]
    """0 for parameters that are held, and for those that lie at their bound."""
    residual_px: float
    """Mean distance of the found edges from the contour, cut off where they are gross; infinite without edges."""
    found_fraction: float
    """Share of the visible outer contour points at which an edge was found."""

    @classmethod
    def of_start(
        cls, pose: Float[Tensor, "36"], root_reference: Float[Tensor, "3 3"], shape: Float[Tensor, "shape"]
    ) -> "Fit":
        """A placement that no edge has been compared with."""
        zero, nothing = torch.zeros_like(pose), float("inf")
        return cls(
            pose=pose,
            root_reference=root_reference,
            shape=shape,
            pose_std=zero,
            shape_std=torch.zeros_like(shape),
            residual_px=nothing,
            found_fraction=0.0,
        )

    @classmethod
    def of_solution(cls, found: SharedSolution, problem: Problem, row: int = 0) -> "Fit":
        """One of the hands of a problem about one picture, with edges among its observations."""
        pose, outline = found.pose[row], next(one for one in found.explained if one.name == EDGES)
        basis, (lower, upper) = problem.space.basis, problem.bounds
        values = problem.values_of(found.pose)[row]
        std = found.covariance[row].diagonal().clamp_min(0).sqrt()
        std = basis @ torch.where((values > lower) & (values < upper), std, 0.0)
        shape_std = found.shape_std
        if problem.shared is not None:
            lower, upper = problem.shared.lower.to(found.shape), problem.shared.upper.to(found.shape)
            at_bound = (found.shape <= lower) | (found.shape >= upper)
            shape_std = shape_std.masked_fill(at_bound, 0.0)
        return cls(
            pose=pose.dofs,
            root_reference=pose.reference,
            shape=found.shape,
            pose_std=std,
            shape_std=shape_std,
            residual_px=float(outline.distance[row]),
            found_fraction=float(outline.fraction[row]),
        )


def pose_prior_std(pose: Float[Tensor, "36"]) -> Float[Tensor, "36"]:
    """Standard deviation of every DOF about a start posture, metres and radians; 0 for DOFs that are held."""
    std = torch.zeros(len(DOFS), dtype=pose.dtype)
    for i, dof in enumerate(DOFS):
        std[i] = next((value for ending, value in _POSE_STD.items() if dof.endswith(ending)), 0.0)
        if dof.endswith(("pip_fe", "mcp_fe")) and abs(float(pose[i])) > _BENT:
            std[i] = _BENT_STD
    return std


def fit_contour(
    plane: Float[Tensor, "height width"],
    projector: HandProjector,
    table: OutlineTable,
    pose: HandPose,
    settings: FitSettings | None = None,
    *,
    fit_shape: bool = True,
) -> Fit:
    """Moves pose and shape from a rough start until the outer contour lies on the edges of `plane` (hand bright, 0..1).

    Maximum a posteriori: edges along the contour's normals, and the distance to the start in units of its prior spread,
    of the shape space's over people and a fixed one of the posture. Hand length stays: one picture cannot tell it from
    depth. The camera's frame is the world; projector: with the shape to start from. Where the contour finds no edges,
    the start comes back with `found_fraction` 0.
    """
    return _fitted(plane, projector, table, pose.reshape(1), settings or FitSettings(), fit_shape=fit_shape)[0]


def fit_contours(
    plane: Float[Tensor, "height width"],
    projector: HandProjector,
    table: OutlineTable,
    poses: HandPose,
    settings: FitSettings | None = None,
) -> list[Fit]:
    """`fit_contour` from several starts (k) at once, the shape known. The starts are placements of one posture: what is
    held of the joints, and which fingers are bent, is as in the first of them."""
    return _fitted(plane, projector, table, poses, settings or FitSettings(), fit_shape=False)


def _fitted(
    plane: Float[Tensor, "height width"],
    projector: HandProjector,
    table: OutlineTable,
    poses: HandPose,
    settings: FitSettings,
    *,
    fit_shape: bool,
) -> list[Fit]:
    start, kinematics = poses.normalized(), projector.kinematics
    shape, names = projector.shape, kinematics.shape_space.names
    edges = EdgeObservation(plane=plane, contours=PrimitiveContours(projector, table), std_px=settings.edge_std_px)
    if edges.is_empty:
        return [Fit.of_start(own, reference, shape) for own, reference in zip(start.dofs, start.reference, strict=True)]
    pose_std = pose_prior_std(start.dofs[0])
    space = pose_space("start", tuple(dof for dof, std in zip(DOFS, pose_std.tolist(), strict=True) if std > 0))
    space = space.about(start.dofs[0])
    problem = Problem(
        space=space,
        skeleton=kinematics.skeleton,
        shape=shape,
        observations=(edges,),
        priors=(GaussianPrior.of_std(start, pose_std[pose_std > 0], space),),
        shared=_shape_about(shape, kinematics) if fit_shape else None,
    )
    found = solve_shared(problem, start, settings.schedule(float(shape[names.index("hand_length")])))
    return [Fit.of_solution(found, problem, row) for row in range(len(start))]


def _shape_about(shape: Float[Tensor, "shape"], kinematics: HandKinematics) -> SharedUnknowns:
    """All proportions but the hand's length, expected as they are with the spread over people."""
    space = kinematics.shape_space
    std = space.std.to(shape).clone()
    std[space.names.index("hand_length")] = 0.0
    nothing = shape.new_zeros(0)
    return SharedUnknowns(
        columns=tuple(std.nonzero()[:, 0].tolist()),
        prior=ShapePrior(mean=shape, std=std),
        lower=space.lower,
        upper=space.upper,
        extra=nothing,
        extra_std=nothing,
    )
