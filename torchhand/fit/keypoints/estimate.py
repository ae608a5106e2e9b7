"""From measured keypoints to poses and what all frames share: starts, hypotheses, and the whole as one problem."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.fit import (
    GaussianPrior,
    Observation,
    PopulationPrior,
    Problem,
    SharedSolution,
    SharedUnknowns,
    Solutions,
    Stage,
    solve,
    solve_shared,
)
from torchhand.fit.keypoints.observation import PictureKeypoints
from torchhand.fit.keypoints.points import Detector
from torchhand.fit.keypoints.posture import PostureKeypoints
from torchhand.fit.keypoints.prior import NaturalPosture, NaturalPrior, limit_information, missing_fraction
from torchhand.fit.keypoints.recording import PosePath
from torchhand.fit.keypoints.relative import RelativeKeypoints
from torchhand.fit.keypoints.rig import ViewLag
from torchhand.fit.keypoints.settings import KeypointFitSettings
from torchhand.fit.keypoints.start import start_in_space
from torchhand.fit.keypoints.views import other_ways, placed_in_pictures, starts_in_picture
from torchhand.fit.keypoints.world import WorldKeypoints
from torchhand.hand import DOFS, Anthropometry, HandKinematics, HandPose, PoseSpace, moving_parameters
from torchhand.hand.limits import AnthropometrySettings, clamp_to_limits

MIN_POINTS = 5
"""Frames with fewer points, or with all of them in one place, are not fitted."""
_ROOT_STD = (1.0, math.pi / math.sqrt(3))  # of a root that points leave open: metres, radians
_LOG_SCALE_STD = 3.0  # as good as nothing known
_SOFTNESS = 0.05  # violation of an anthropometric constraint that costs ½, in its spread over people
_ROUGH = Stage(gross_m=1.0, rounds=1, iterations=25)  # points bring a loss of their own: no distance is gross
_FINE = Stage(gross_m=1.0, rounds=1, iterations=60)
_NEAR = Stage(gross_m=1.0, rounds=1, iterations=3)  # where the shape is known but for the last digits
_MIN_PLACED = 10  # frames that tell how a hand moves
_SHARED_FRAMES = 128  # frames of several cameras that tell what all have in common
_POSE_TOLERANCE, _SHARED_TOLERANCE = 1e-7, 1e-5
_AT_ONCE = 256
_KEPT = 3  # of the starts in a picture go on after the rough solution
_ROUNDS = 2  # how often pictures are begun anew with the shape found so far
_MAX_SHAPE_CHANGE = 0.2  # mean change of the shape, in its spread over people, after which pictures are not begun anew


@dataclass(frozen=True, kw_only=True)
class KeypointEstimate:
    """Where the estimate ended."""

    solution: SharedSolution
    detector: Detector
    """The detector as it was found to be."""
    measured: "Measured"
    """What was measured, with the lags of cameras as they were found to be."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Points in the world, or in the pictures of one camera or several; a row for each frame, with enough points."""

    observed: WorldKeypoints | tuple[PictureKeypoints, ...]
    """With the detector's properties where they are begun with."""
    coarse_std_px: tuple[Float[Tensor, "frames"], ...] = ()
    """Standard deviation of points in the pictures of every camera for telling starts apart: not so small that only the
    nearest of them can be followed."""
    relative: tuple[RelativeKeypoints, ...] = ()
    """Points in space along the axes of cameras, beside those in the pictures."""
    postures: tuple[PostureKeypoints, ...] = ()
    """Postures of these points; in the order of the cameras that have any."""
    triangulated: Float[Tensor, "frames 21 3"] | None = None
    """Points in space that several pictures show; NaN for others. None for one camera."""
    place: Int[Tensor, "frames"] | None = None
    """Number of every frame in the recording, at equal distances in time; None where they are no recording."""
    expected: GaussianPrior | None = None
    """What is expected of the poses beforehand; None for nothing."""

    @property
    def points(self) -> tuple[WorldKeypoints | PictureKeypoints, ...]:
        """Points whose place is known."""
        return (self.observed,) if isinstance(self.observed, WorldKeypoints) else self.observed

    @property
    def lags(self) -> tuple[ViewLag, ...]:
        """Of the cameras that may be late."""
        if isinstance(self.observed, WorldKeypoints):
            return ()
        return tuple(one.lag for one in self.observed if one.lag is not None)

    @property
    def synchronous(self) -> "Measured":
        """With cameras that are known not to be late."""
        if isinstance(self.observed, WorldKeypoints):
            return self
        return replace(self, observed=tuple(replace(one, lag=None) for one in self.observed))

    def at(self, extra: Float[Tensor, "extra"]) -> "Measured":
        """With other lags."""
        if isinstance(self.observed, WorldKeypoints):
            return self
        observed = (one if one.lag is None else replace(one, lag=one.lag.at(extra)) for one in self.observed)
        return replace(self, observed=tuple(observed))

    def rows(self, rows: Int[Tensor, "n"]) -> "Measured":
        """Of some of the frames."""
        observed = self.observed
        return Measured(
            observed=observed.rows(rows)
            if isinstance(observed, WorldKeypoints)
            else tuple(one.rows(rows) for one in observed),
            coarse_std_px=tuple(std[rows] for std in self.coarse_std_px),
            relative=tuple(one.rows(rows) for one in self.relative),
            postures=tuple(one.rows(rows) for one in self.postures),
            triangulated=None if self.triangulated is None else self.triangulated[rows],
            place=None if self.place is None else self.place[rows],
            expected=None if self.expected is None else self.expected.rows(rows),
        )

    def observations(self, detector: Detector) -> tuple[Observation, ...]:
        """All that was measured, by a detector of known properties."""
        placed = (replace(one, detector=detector) for one in (*self.points, *self.relative))
        return (*placed, *self.postures)


@dataclass(frozen=True, kw_only=True)
class KeypointEstimator:
    """One fit's ingredients; every frame has enough points."""

    measured: Measured
    space: PoseSpace
    posture: NaturalPosture
    columns: tuple[int, ...]
    """Shape parameters that are fitted, index into the shape space's names."""
    settings: KeypointFitSettings

    def estimate(self, shape: Float[Tensor, "shape"]) -> KeypointEstimate:
        """Begins with the given shape. Raises ValueError without frames."""
        observed = self.measured.observed
        detector = self.measured.points[0].detector or Detector.known(shape)
        if isinstance(observed, WorldKeypoints):
            return self._in_space(observed, shape, detector)
        found = self._in_picture(observed, shape, detector)
        # A better shape may tell ways of seeing the hand apart that were confused.
        is_alone = self.measured.triangulated is None
        for _ in range(_ROUNDS - 1 if is_alone and (self.columns or len(detector.extra)) else 0):
            change = (found.solution.shape - shape) / self._kinematics.shape_space.std.to(shape)
            if not self.columns or float(change[list(self.columns)].abs().mean()) < _MAX_SHAPE_CHANGE:
                break
            shape = found.solution.shape
            found = self._in_picture(observed, shape, found.detector)
        return found

    @property
    def _kinematics(self) -> HandKinematics:
        return self.measured.points[0].kinematics

    @property
    def _natural(self) -> Float[Tensor, "36"]:
        """The natural posture as far as the pose space knows it."""
        return clamp_to_limits(self.space.dof(self.space.free(self.posture.mean)), self._kinematics.skeleton)

    def _in_space(self, observed: WorldKeypoints, shape: Tensor, detector: Detector) -> KeypointEstimate:
        points, is_known = observed.points, observed.is_known
        pose, size = start_in_space(self._kinematics, points, is_known, shape, self._natural)
        if detector.has_unknown_scale:
            detector = replace(detector, log_scale=-_middle(size).log())
            scaled = detector.log_scale.exp() * points
            pose, _ = start_in_space(self._kinematics, scaled, is_known, shape, self._natural)
        elif self.columns:
            shape = self._sized(shape, float(_middle(size)))
        return self._whole(pose, shape, detector)

    def _in_picture(
        self, observed: tuple[PictureKeypoints, ...], shape: Tensor, detector: Detector
    ) -> KeypointEstimate:
        """Poses from the best of several starts for every frame.

        First with points trusted little, so that far starts are drawn in; a few of the best go on as the noise is. In
        a picture, a digit bent towards the camera may look like one bent away: each is then tried the other way.
        """
        if self.measured.triangulated is None:
            start = self._searched(observed, shape, detector)
            return self._settled(start, torch.zeros_like(start.dofs[:, 0], dtype=torch.bool), shape, detector)
        start = self._triangulated(self.measured.triangulated, shape)
        is_placed = start.dofs.isfinite().all(-1)
        rows, rest = is_placed.nonzero()[:, 0], (~is_placed).nonzero()[:, 0]
        again, stage = self, _FINE
        if len(rows) > _SHARED_FRAMES or (len(rest) and len(rows)):  # these tell what all frames have in common
            count = min(len(rows), _SHARED_FRAMES)
            rows = rows[torch.linspace(0, len(rows) - 1, count, device=rows.device).round().long()]
            first = replace(self, measured=self.measured.rows(rows))._whole(start[rows], shape, detector)
            shape, detector, stage = first.solution.shape, first.detector, _NEAR
            again = replace(self, measured=self.measured.at(first.solution.extra))
            start = self._triangulated(self.measured.triangulated, shape)
        if len(rest):
            start = again._completed(start, rest, shape, detector)
        return again._settled(start, ~is_placed, shape, detector, stage)

    def _settled(
        self,
        start: HandPose,
        is_open: Bool[Tensor, "frames"],
        shape: Tensor,
        detector: Detector,
        stage: Stage = _FINE,
    ) -> KeypointEstimate:
        """All frames from one pose each; in a recording those that are open, or leap, by what the others expect."""
        again = self._expecting(start, is_open, shape, detector)
        expected = again.measured.expected
        begin = start if expected is None else expected.pose
        if stage is _NEAR or expected is not None:
            begin = _best(_solved(again._problem(shape, detector), begin.reshape(-1, 1)), 1).reshape(-1)
        return again._whole(begin, shape, detector, stage)

    def _completed(self, start: HandPose, rest: Int[Tensor, "n"], shape: Tensor, detector: Detector) -> HandPose:
        """With poses of the remaining frames by what single pictures suggest."""
        part = replace(self, measured=self.measured.rows(rest))
        assert not isinstance(part.measured.observed, WorldKeypoints)
        found = part._searched(part.measured.observed, shape, detector)
        return HandPose(
            dofs=start.dofs.index_copy(0, rest, found.dofs),
            reference=start.reference.index_copy(0, rest, found.reference),
        )

    def _expecting(
        self, start: HandPose, is_open: Bool[Tensor, "frames"], shape: Tensor, detector: Detector
    ) -> "KeypointEstimator":
        """With an expectation of the poses that are open, and of those that leap, by the other frames of a recording
        and how the hand moves; itself where frames are no recording."""
        place = self.measured.place
        if place is None or int((~is_open).sum()) < _MIN_PLACED:
            return self
        found, count = _solved(self._problem(shape, detector), start.reshape(-1, 1)), int(place.max()) + 1
        own, covariance = found.pose.reshape(-1), found.covariance[:, 0]
        is_known = ~is_open & covariance.isfinite().all((-2, -1))

        def spread(part: Tensor) -> Tensor:
            return part.new_zeros(count, *part.shape[1:]).index_copy(0, place, part)

        pose = HandPose(dofs=spread(own.dofs), reference=spread(own.reference))
        path = PosePath.of(pose, spread(covariance), spread(is_known), self.space)
        leaps = path.leaps()
        path, is_open = path.without(leaps), is_open | leaps[place]
        told = path.smoothed(path.motion(), self._kinematics.skeleton)
        prior = GaussianPrior.of_covariance(told.pose[place], told.covariance[place], self.space)
        begin = HandPose(
            dofs=torch.where(is_open[:, None], prior.pose.dofs, own.dofs),
            reference=torch.where(is_open[:, None, None], prior.pose.reference, own.reference),
        )
        information = prior.information * is_open[:, None, None]
        if self.measured.triangulated is None:  # before one camera places go with the hand's size, which is open still
            information = _without_place(information)
        prior = replace(prior, pose=begin, information=information)
        return replace(self, measured=replace(self.measured, expected=prior))

    def _searched(self, observed: tuple[PictureKeypoints, ...], shape: Tensor, detector: Detector) -> HandPose:
        """The best of the poses (frames) that single pictures suggest."""
        fine = self._problem(shape, detector)
        coarse = replace(fine, observations=self._coarse(observed, detector))
        kept = _best(_solved(coarse, self._starts(observed, shape)), _KEPT)
        best = _best(_solved(fine, kept), 1).reshape(-1)
        return _best(_solved(fine, other_ways(best)), 1).reshape(-1)

    def _triangulated(self, points: Float[Tensor, "frames 21 3"], shape: Tensor) -> HandPose:
        """Poses (frames) by points in space; NaN where there are too few."""
        is_known = points.isfinite().all(-1)
        pose, _ = start_in_space(self._kinematics, points.nan_to_num(), is_known, shape, self._natural)
        is_placed = is_known.sum(-1) >= MIN_POINTS
        return HandPose(
            dofs=torch.where(is_placed[:, None], pose.dofs, torch.nan), reference=pose.reference.contiguous()
        )

    def _starts(self, observed: tuple[PictureKeypoints, ...], shape: Tensor) -> HandPose:
        """Poses (frames, starts): those that every picture by itself suggests, and the hands of the points in space."""
        found = [starts_in_picture(one, shape, self._natural, self.settings.starts) for one in observed]
        for one, told in zip(self.measured.relative, self.measured.postures, strict=True):
            turned = replace(told.pose, reference=one.cam_from_world.mT @ told.pose.reference)
            placed = placed_in_pictures(observed, turned, shape)
            found.append(HandPose(dofs=placed.dofs[:, None], reference=placed.reference[:, None]))
        dofs, references = torch.cat([one.dofs for one in found], 1), torch.cat([one.reference for one in found], 1)
        return HandPose(dofs=dofs, reference=references)

    def _coarse(self, observed: tuple[PictureKeypoints, ...], detector: Detector) -> tuple[Observation, ...]:
        """What was measured, with points in the pictures that are believed less."""
        pictures = [
            replace(one, std_px=std, cov_px=None)
            for one, std in zip(observed, self.measured.coarse_std_px, strict=True)
        ]
        return replace(self.measured, observed=tuple(pictures)).observations(detector)

    def _whole(self, pose: HandPose, shape: Tensor, detector: Detector, stage: Stage = _FINE) -> KeypointEstimate:
        """All frames with what they share, from one pose each. Lags of cameras that are not known yet are looked for
        from the start and from the best that synchronous cameras explain: costs have a minimum near most whole frames,
        for between frames errors average out."""
        found = self._together(pose, shape, detector, stage)
        if not self.measured.lags or stage is _NEAR:
            return found
        first = replace(self, measured=self.measured.synchronous)._together(pose, shape, detector, stage)
        other = self._together(first.solution.pose, first.solution.shape, first.detector, stage)
        return min(found, other, key=lambda one: one.solution.cost)

    def _together(self, pose: HandPose, shape: Tensor, detector: Detector, stage: Stage) -> KeypointEstimate:
        """All frames with what they share, from one pose each."""
        problem = replace(self._problem(shape, detector), shared=self._unknowns(detector))
        known = limit_information(self._kinematics.skeleton).to(shape)
        known[:3], known[3:6] = _ROOT_STD[0] ** -2, _ROOT_STD[1] ** -2
        solution = solve_shared(
            problem,
            pose,
            (stage,),
            cost_tolerance=_SHARED_TOLERANCE,
            pose_tolerance=_POSE_TOLERANCE,
            information=known,
        )
        extra = solution.extra
        return KeypointEstimate(solution=solution, detector=detector.at(extra), measured=self.measured.at(extra))

    def _problem(self, shape: Tensor, detector: Detector) -> Problem:
        """The problem of all frames, with what they share frozen."""
        fraction = self._prior_fraction()
        has_prior = not self.posture.is_empty and bool(fraction.any())
        natural = (NaturalPrior(posture=self.posture, fraction=fraction),) if has_prior else ()
        expected = () if self.measured.expected is None else (self.measured.expected,)
        return Problem(
            space=self.space,
            skeleton=self._kinematics.skeleton,
            shape=shape,
            observations=self.measured.observations(detector),
            priors=(*natural, *expected),
        )

    def _unknowns(self, detector: Detector) -> SharedUnknowns | None:
        own, lags = detector.extra, self.measured.lags
        if not self.columns and not len(own) and not lags:
            return None
        space = self._kinematics.shape_space
        population = Anthropometry(space, AnthropometrySettings(softness=_SOFTNESS))
        lower, upper = _box(population)
        scale, offsets = own.split([int(detector.has_unknown_scale), len(own) - int(detector.has_unknown_scale)])
        std = [torch.full_like(scale, _LOG_SCALE_STD), torch.full_like(offsets, self.settings.offset_std)]
        moving = moving_parameters(self._kinematics)
        return SharedUnknowns(
            columns=self.columns,
            prior=PopulationPrior(population=population),
            lower=lower,
            upper=upper,
            extra=torch.cat((own, *(one.lag[None] for one in lags))),
            extra_mean=torch.cat((scale, torch.zeros_like(offsets), own.new_zeros(len(lags)))),
            extra_std=torch.cat((*std, own.new_tensor([one.std for one in lags]))),
            population=population,
            pliable=tuple(i for i in range(len(space.names)) if i not in moving),
        )

    def _sized(self, shape: Tensor, size: float) -> Tensor:
        """The shape grown in length and breadth where these are free."""
        space = self._kinematics.shape_space
        sized = shape.clone()
        for column in (space.names.index(name) for name in ("hand_length", "hand_breadth")):
            if column in self.columns:
                low, high = float(space.lower[column]), float(space.upper[column])
                sized[column] = min(max(size * float(shape[column]), low), high)
        return sized

    def _prior_fraction(self) -> Float[Tensor, "frames 36"]:
        is_in_space, mode = isinstance(self.measured.observed, WorldKeypoints), self.settings.prior
        if mode == "auto":
            mode = "where_missing" if is_in_space else "always"
        confidence = self.space.basis.new_zeros(())
        for one in self.measured.points:
            known = one.is_known.to(self.space.basis)
            confidence = torch.maximum(confidence, known if one.confidence is None else known * one.confidence)
        if mode == "where_missing":
            return missing_fraction(confidence)
        return torch.full_like(confidence[:, :1], 1.0 if mode == "always" else 0.0).repeat(1, len(DOFS))


def _solved(problem: Problem, starts: HandPose) -> Solutions:
    """Every start (frames, starts) of every frame by itself."""
    count, each = starts.batch_shape
    rows = torch.arange(count, device=starts.dofs.device).repeat_interleave(each)
    return solve(problem.rows(rows), starts, (_ROUGH,), at_once=_AT_ONCE)


def _without_place(information: Float[Tensor, "frames free free"]) -> Float[Tensor, "frames free free"]:
    """The information of all but the root's place, of which nothing is known any more."""
    place, rest = information[:, :3, :3], information[:, 3:, :3]
    is_told = information.diagonal(dim1=-2, dim2=-1)[:, :3, None] > 0
    taken = torch.linalg.solve(torch.where(is_told, place, torch.eye(3).to(place)), rest.mT)
    left = information[:, 3:, 3:] - rest @ taken
    return torch.nn.functional.pad(left, (3, 0, 3, 0))


def _best(found: Solutions, count: int) -> HandPose:
    """The cheapest poses of every frame (frames, count)."""
    kept = found.cost.nan_to_num(torch.inf).topk(min(count, found.cost.shape[1]), -1, largest=False).indices
    frames = torch.arange(len(kept), device=kept.device)[:, None]
    return HandPose(dofs=found.pose.dofs[frames, kept], reference=found.pose.reference[frames, kept])


def _middle(size: Float[Tensor, "frames"]) -> Float[Tensor, ""]:
    """The median of the sizes that are any; 1 where none is."""
    size = size[(size > 0) & size.isfinite()]
    return size.median() if len(size) else size.new_ones(())


def _box(population: Anthropometry) -> tuple[Float[Tensor, "shape"], Float[Tensor, "shape"]]:
    """The tightest bounds among the inequalities matrix · shape <= bound that concern one parameter."""
    lower, upper = population.space.lower.clone(), population.space.upper.clone()
    for row, bound in zip(population.matrix, population.bound, strict=True):
        (places,) = row.nonzero(as_tuple=True)
        if len(places) == 1:
            limit, place = bound / row[places[0]], places[0]
            if row[place] > 0:
                upper[place] = torch.minimum(upper[place], limit)
            else:
                lower[place] = torch.maximum(lower[place], limit)
    return lower, upper
