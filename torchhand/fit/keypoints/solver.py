"""Poses and what all frames share, from measured keypoints: starts, solutions, covariances."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.keypoints.prior import NaturalPosture, limit_information, missing_share
from torchhand.fit.keypoints.residuals import Common, KeypointCost, Observations
from torchhand.fit.keypoints.settings import KeypointFitSettings
from torchhand.fit.keypoints.shape import CommonFit, CommonParameters, reduced
from torchhand.fit.keypoints.start import start_in_space
from torchhand.fit.keypoints.views import other_ways, starts_in_picture
from torchhand.hand import DOFS, Anthropometry, HandKinematics, PoseJacobian, PoseSpace, ShapeJacobian
from torchhand.numerics import LeastSquares, RobustLoss, Status, levenberg_marquardt

_ROOT_STD = (1.0, math.pi / math.sqrt(3))  # of a root that points leave open: metres, radians
_KEPT = 3  # of the starts in a picture go on after the first look
_SETTLED = 0.2  # mean change of the shape, in its spread over people, after which pictures are not begun anew


@dataclass(frozen=True, kw_only=True)
class KeypointSolution:
    """Where the solver ended."""

    cost: KeypointCost
    poses: LeastSquares
    common: Common
    parameters: CommonParameters


@dataclass(frozen=True, kw_only=True)
class KeypointSolver:
    """One fit's ingredients; every frame has enough points."""

    kinematics: HandKinematics
    space: PoseSpace
    lower: Float[Tensor, "free"]
    """Limits of the pose space's free parameters."""
    upper: Float[Tensor, "free"]
    observed: Observations
    posture: NaturalPosture
    columns: tuple[int, ...]
    """Shape parameters that are fitted, index into the shape space's names."""
    fit_scale: bool
    settings: KeypointFitSettings

    def solve(self, shape: Float[Tensor, "shape"]) -> KeypointSolution:
        """Begins with the given shape."""
        common = Common(shape=shape, log_scale=shape.new_zeros(()), offsets=shape.new_zeros(21, 3))
        if self.observed.camera is None:
            return self._solved_in_space(common)
        solution = self._solved_from(common, *self._starts(shape))
        # A better shape may tell ways of seeing the hand apart that were confused.
        for _ in range(self.settings.rounds - 1 if solution.parameters.size else 0):
            change = (solution.common.shape - common.shape) / self.kinematics.shape_space.std.to(shape)
            if float(change[list(self.columns)].abs().mean()) < _SETTLED:
                break
            common = solution.common
            solution = self._solved_from(common, *self._starts(common.shape))
        return solution

    def _starts(self, shape: Tensor) -> tuple[Tensor, Tensor]:
        return starts_in_picture(self.kinematics, self.observed, shape, self._natural, self.settings.starts)

    def _solved_in_space(self, common: Common) -> KeypointSolution:
        points, is_known = self.observed.points, self.observed.is_known
        pose, reference, size = start_in_space(self.kinematics, points, is_known, common.shape, self._natural)
        if len(points) and self.fit_scale:
            common = replace(common, log_scale=-_middle(size).log())
            scaled = common.log_scale.exp() * points
            pose, reference, _ = start_in_space(self.kinematics, scaled, is_known, common.shape, self._natural)
        elif len(points) and self.columns:
            common = replace(common, shape=self._sized(common.shape, float(_middle(size))))
        return self._solved_from(common, pose[:, None], reference[:, None])

    def _solved_from(self, common: Common, pose: Tensor, reference: Tensor) -> KeypointSolution:
        """pose: (frames, starts, 36), reference: (frames, starts, 3, 3)."""
        starts = pose.shape[1]
        free = self.space.free(pose.flatten(0, 1)).clamp(self.lower, self.upper)
        frames = torch.arange(len(pose), device=pose.device)
        cost = self._cost(frames.repeat_interleave(starts), reference.flatten(0, 1))
        if self.observed.camera is not None and len(pose):
            cost, free = self._best_way(cost, free, common)
        found = self._poses(cost, free, common)
        constraints = Anthropometry(self.kinematics.shape_space) if self.settings.is_typical else None
        parameters = CommonParameters.of(
            self.kinematics.shape_space,
            self.columns,
            common,
            has_scale=self.fit_scale,
            offset_std=self.settings.offset_std,
            constraints=constraints,
        )
        sound = (found.status != Status.FAILED).nonzero()[:, 0]
        if parameters.size and len(sound):
            fit = CommonFit(
                cost=cost.rows(sound),
                parameters=parameters,
                lower=self.lower,
                upper=self.upper,
                free=found.values[sound],
                pose_settings=self.settings.pose,
                constraints=constraints,
            )
            common, _ = fit.solve(common, self.settings.shape)
            found = self._poses(cost, found.values.index_copy(0, sound, fit.free), common)
        return KeypointSolution(cost=cost, poses=found, common=common, parameters=parameters)

    def covariances(
        self, solution: KeypointSolution
    ) -> tuple[Float[Tensor, "frames free free"], Float[Tensor, "common common"]]:
        """Of the poses and of the common parameters, from their joint normal equations with the limits' information.

        Frames that failed have NaN and tell nothing of the common parameters.
        """
        parameters = solution.parameters
        whole = solution.poses.values.new_full(
            (len(solution.poses.values), self.space.size, self.space.size), torch.nan
        )
        sound = (solution.poses.status != Status.FAILED).nonzero()[:, 0]
        if not len(sound):
            return whole, torch.diag(parameters.std**2)
        free = solution.poses.values[sound]
        known = limit_information(self.kinematics.skeleton).to(free)
        known[:3], known[3:6] = _ROOT_STD[0] ** -2, _ROOT_STD[1] ** -2
        believed = torch.diag((self.space.basis.square() * known[:, None]).sum(0))
        blocks = solution.cost.blocks(free, sound, solution.common)
        blocks = replace(blocks, pose=blocks.pose + believed)
        factor, info = torch.linalg.cholesky_ex(blocks.pose)
        own = torch.where((info == 0)[:, None, None], torch.cholesky_inverse(factor), torch.nan)
        if not parameters.size:
            return whole.index_copy(0, sound, own), own.new_zeros(0, 0)
        unbounded = torch.full_like(self.lower, torch.inf)
        eliminated = reduced(blocks, -unbounded, unbounded, free)
        shared = torch.linalg.inv(eliminated.equations.matrix + torch.diag(parameters.std**-2))
        own = own + eliminated.follow @ shared @ eliminated.follow.mT
        return whole.index_copy(0, sound, own), shared

    @property
    def _natural(self) -> Tensor:
        """The natural posture as far as the pose space knows it."""
        return self.space.dof(self.space.free(self.posture.mean).clamp(self.lower, self.upper))

    def _cost(self, rows: Tensor, reference: Tensor) -> KeypointCost:
        gross = self.settings.gross
        return KeypointCost(
            kinematics=self.kinematics,
            space=self.space,
            observed=self.observed.rows(rows),
            reference=reference,
            prior=self.posture,
            prior_share=self._prior_share()[rows],
            robust=RobustLoss(
                kind="huber" if math.isfinite(gross) else "squares",
                scale=gross if math.isfinite(gross) else 1.0,
                group=self.observed.points.shape[-1],
            ),
            pose_jacobian=PoseJacobian(self.kinematics, self.space.basis),
            shape_jacobian=ShapeJacobian(self.kinematics, self.columns),
            has_scale=self.fit_scale,
            has_offsets=self.settings.offset_std > 0,
            chunk=self.settings.chunk,
        )

    def _best_way(self, cost: KeypointCost, free: Tensor, common: Common) -> tuple[KeypointCost, Tensor]:
        """One pose per frame of the several that are begun with.

        First with points trusted little, so that far starts are drawn in; a few of the best go on as the noise is. In
        a picture, a digit bent towards the camera may look like one bent away: each is then tried the other way.
        """
        count = len(self.observed.points)
        coarse = replace(cost, observed=cost.observed.coarse())
        found = self._poses(coarse, free, common, iterations=self.settings.rough_iterations)
        ranked = found.cost.nan_to_num(torch.inf).reshape(count, -1)
        kept = ranked.topk(min(_KEPT, ranked.shape[1]), -1, largest=False).indices
        rows = (kept + ranked.shape[1] * torch.arange(count, device=free.device)[:, None]).flatten()
        cost, free = self._best_of(cost.rows(rows), found.values[rows], common)
        tries = other_ways(self.space, free).clamp(self.lower, self.upper)
        rows = torch.arange(count, device=free.device).repeat_interleave(tries.shape[1])
        return self._best_of(cost.rows(rows), tries.flatten(0, 1), common)

    def _best_of(self, cost: KeypointCost, free: Tensor, common: Common) -> tuple[KeypointCost, Tensor]:
        count = len(self.observed.points)
        found = self._poses(cost, free, common, iterations=self.settings.rough_iterations)
        ranked = found.cost.nan_to_num(torch.inf).reshape(count, -1)
        best = ranked.argmin(-1) + ranked.shape[1] * torch.arange(count, device=free.device)
        return cost.rows(best), found.values[best]

    def _poses(
        self, cost: KeypointCost, free: Tensor, common: Common, *, iterations: int | None = None
    ) -> LeastSquares:
        settings = self.settings.pose
        settings = settings if iterations is None else replace(settings, iterations=iterations)
        return levenberg_marquardt(
            lambda values, rows: cost.pose_equations(values, rows, common),
            free,
            lower=self.lower,
            upper=self.upper,
            settings=settings,
            takes_rows=True,
        )

    def _sized(self, shape: Tensor, size: float) -> Tensor:
        """The shape grown in length and breadth where these are free."""
        space = self.kinematics.shape_space
        sized = shape.clone()
        for column in (space.names.index(name) for name in ("hand_length", "hand_breadth")):
            if column in self.columns:
                low, high = float(space.lower[column]), float(space.upper[column])
                sized[column] = min(max(size * float(shape[column]), low), high)
        return sized

    def _prior_share(self) -> Tensor:
        mode = self.settings.prior
        if mode == "auto":
            mode = "where_missing" if self.observed.camera is None else "always"
        if mode == "where_missing":
            return missing_share(self.observed.confidence)
        share = 1.0 if mode == "always" else 0.0
        return self.observed.points.new_full((len(self.observed.points), len(DOFS)), share)


def _middle(size: Float[Tensor, "frames"]) -> Float[Tensor, ""]:
    """The median of the sizes that are any; 1 where none is."""
    size = size[(size > 0) & size.isfinite()]
    return size.median() if len(size) else size.new_ones(())
