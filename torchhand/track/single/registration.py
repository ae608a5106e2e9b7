"""Many hypotheses of one hand in one picture, registered in one batch, and what they leave open."""

from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import sent_to
from torchhand.fit import (
    ConstraintPrior,
    Observation,
    PostureResiduals,
    Problem,
    SharedUnknowns,
    Solutions,
    Stage,
    solve,
    solve_shared,
)
from torchhand.fit import PosturePrior as PostureDensity
from torchhand.fit.contour import CONTOUR, WHOLE_SEARCH, ContourObservation, ContourSettings, picture_contours
from torchhand.fit.keypoints import NaturalPrior, PostureKeypoints, natural_posture
from torchhand.geometry import Camera
from torchhand.hand import (
    DOFS,
    Anthropometry,
    HandKinematics,
    HandPose,
    HandPrior,
    PoseConstraints,
    PoseSpace,
    named_pose_space,
)
from torchhand.view import HandProjector, PrimitiveContours, outline_table

_SPACE = "dof27"
_FINALISTS = 4  # hypotheses that are registered to the end
_POINTS = (10, 12)  # of the outline, on each side of a cone and on each ellipsoid
_OUTLINE_WORTH = 20.0
"""Independent measurements that an outline is worth: a third of what it is to a tracker, whose proportions are the
person's. Beside a detector's points 60 lose what the points tell of bent fingers: on 30 stills of a hand the flexion
error is 7.6° with 60 and 7.0° with 20."""
_BY_KEYPOINTS = (Stage(gross_m=0.03, rounds=2, iterations=8), Stage(gross_m=0.01, rounds=1, iterations=8))
_ALTERNATIVE = 20.0  # nats: hands that explain keypoints worse by more cannot be saved by an outline
_OUTLINE_BESIDE_POSTURE = 0.5
"""What an outline is worth for the pose beside a detector's posture, as a share of what it is worth alone: proportions
from one picture are rough, and a strong outline then bends fingers away from what the points tell. Proportions are
still fitted to the outline with its whole worth."""
_SAME_RAD = 0.1  # largest difference of an angle with which two hypotheses are one
_SHOWN = ("hand_breadth", "thumb_proximal", "index_proximal", "middle_proximal", "ring_proximal", "little_proximal")
"""Proportions that one outline shows where it has to tell the posture too; the rest follows the mean of people."""
_NEVER_SHOWN = ("hand_length", "palm_thickness", "wrist_breadth")
"""Proportions that an outline does not show even where a detector tells the posture: the size, and what is in depth or
under a sleeve."""


@dataclass(frozen=True, kw_only=True)
class Registered:
    """A hand registered in a picture, with what other hypotheses leave open."""

    pose: HandPose
    """(), in the camera's frame."""
    shape: Float[Tensor, "shape"]
    covariance: Float[Tensor, "free free"]
    """Covariance of the free parameters, of the mixture of all hypotheses that explain the picture: each by its cost;
    the rotation is a left perturbation of the pose."""
    edges: float
    """Share of the picture's contour on which the hand's lies."""
    cost: float
    """Nats."""
    modes: int
    """Number of different hands that explain the picture, weighed by their likelihood (exponential of the entropy,
    rounded)."""


@dataclass(frozen=True, kw_only=True)
class PictureProblem:
    """One picture's silhouette and what else is known of the hand in it."""

    kinematics: HandKinematics
    camera: Camera
    observations: tuple[Observation, ...] = ()
    """Detected keypoints, where there are any."""

    @property
    def space(self) -> PoseSpace:
        return named_pose_space(_SPACE).to(device=self.kinematics.default_shape.device)

    @property
    def _is_told(self) -> bool:
        """Whether a detector tells the posture."""
        return any(isinstance(one, PostureKeypoints) for one in self.observations)

    @property
    def _priors(self) -> tuple[Observation, ...]:
        """What is believed of postures: next to nothing where a detector tells the posture of this hand."""
        constraints = ConstraintPrior(constraints=PoseConstraints(self.kinematics.skeleton), has_ties=self._is_told)
        if not self._is_told:
            return (constraints, PostureDensity(postures=_postures(self.kinematics)))
        like = self.kinematics.default_shape
        natural = natural_posture(dtype=like.dtype, device=like.device)
        return (constraints, NaturalPrior(posture=natural, fraction=like.new_ones(1, len(DOFS))))

    def of_keypoints(self, starts: HandPose, shape: Float[Tensor, "shape"]) -> HandPose:
        """The distinct hands (k) that the observations alone lead to from some starts, the best first: those that
        explain them nearly as well as the best. At most as many as are registered to the end."""
        problem = Problem(
            space=self.space,
            skeleton=self.kinematics.skeleton,
            shape=shape,
            observations=self.observations,
            priors=self._priors,
        )
        found = solve(problem, starts, _BY_KEYPOINTS)
        kept = [i for i in _distinct(found).tolist() if float(found.cost[i] - found.cost.min()) < _ALTERNATIVE]
        return found.pose[torch.tensor(kept[:_FINALISTS], dtype=torch.long)]

    def registered(
        self,
        starts: HandPose,
        mask: Bool[Tensor, "height width"],
        image: Tensor | None,
        shape: Float[Tensor, "shape"],
        *,
        is_shape_known: bool,
    ) -> Registered | None:
        """The best of the hands that are reached from some starts (k); None where the silhouette has no outline, and
        where none of them is in sight."""
        worth = _OUTLINE_BESIDE_POSTURE if self._is_told else 1.0
        problem = self._problem(mask, image, shape, worth)
        if problem.observations[0].is_empty:
            return None
        if len(starts) > _FINALISTS:
            rough = solve(problem, starts, WHOLE_SEARCH[:1])
            starts = rough.pose[rough.cost.argsort()[:_FINALISTS]]
        found = solve(problem, starts, WHOLE_SEARCH)
        if not bool(found.is_sound.any()):
            return None
        best, covariance, modes = mixture(found, self.space)
        result = Registered(
            pose=best.pose,
            shape=shape,
            covariance=covariance,
            edges=float(best.explained_by(CONTOUR).fraction),
            cost=float(best.cost),
            modes=modes,
        )
        if is_shape_known:
            return result
        shaped = self._with_shape(self._problem(mask, image, shape, 1.0), result, best.covariance)
        if worth == 1.0 or shaped is result:
            return shaped
        problem = self._problem(mask, image, shaped.shape, worth)
        return self._posed(problem, shaped, result.covariance - best.covariance)

    def _problem(self, mask: Tensor, image: Tensor | None, shape: Tensor, worth: float) -> Problem:
        """worth: factor on what the outline counts. Beside a detector's posture it counts by its length, so that the
        crowded points of fingertips and knuckles do not contradict the detector more than the rest."""
        settings = ContourSettings(
            contour_std_fraction=0.25,
            contour_weight=worth * _OUTLINE_WORTH,
            coverage_weight=worth * _OUTLINE_WORTH,
            by_length=self._is_told,
        )
        table = sent_to(outline_table(*_POINTS, without=("palm_wrist",)), shape.device)
        contour = ContourObservation(
            picture=picture_contours(mask, WHOLE_SEARCH, settings, image=image),
            contours=PrimitiveContours(HandProjector(self.kinematics, self.camera, shape), table),
            settings=settings,
        )
        return Problem(
            space=self.space,
            skeleton=self.kinematics.skeleton,
            shape=shape,
            observations=(contour, *self.observations),
            priors=self._priors,
        )

    def _with_shape(self, problem: Problem, result: Registered, own: Float[Tensor, "free free"]) -> Registered:
        """The same hand with the proportions that its outline shows; what the hypotheses leave open stays open."""
        names, population = self.kinematics.shape_space.names, _population(self.kinematics)
        is_shown = [name not in _NEVER_SHOWN if self._is_told else name in _SHOWN for name in names]
        unknown = SharedUnknowns.of_shape(population, tuple(i for i, shown in enumerate(is_shown) if shown))
        stage = replace(WHOLE_SEARCH[-1], rounds=1)
        found = solve_shared(replace(problem, shared=unknown), result.pose.reshape(1), (stage,))
        contour = next(one for one in found.explained if one.name == CONTOUR)
        if not bool(found.covariance[0].isfinite().all()):
            return result
        return replace(
            result,
            pose=found.pose[0],
            shape=found.shape,
            covariance=found.covariance[0] + result.covariance - own,
            edges=float(contour.fraction),
        )

    def _posed(self, problem: Problem, result: Registered, left_open: Float[Tensor, "free free"]) -> Registered:
        """The hand with its proportions, its pose as the problem has it. left_open: covariance of other hypotheses."""
        found = solve(problem, result.pose.reshape(1), WHOLE_SEARCH[-1:]).select(0)
        if not bool(found.is_sound) or not bool(found.covariance.isfinite().all()):
            return result
        edges = float(found.explained_by(CONTOUR).fraction)
        return replace(result, pose=found.pose, covariance=found.covariance + left_open, edges=edges)


def mixture(found: Solutions, space: PoseSpace) -> tuple[Solutions, Float[Tensor, "free free"], int]:
    """The best hypothesis, the covariance of all of them about it, and how many different ones there are.

    Hypotheses that ended at the same hand count once. Each has the weight exp(-cost), and adds its own covariance and
    the square of its way from the best.
    """
    kept = _distinct(found)
    weight = torch.softmax(-found.cost[kept], 0)
    best = found.select(int(kept[0]))
    steps = torch.stack([best.pose.step_to(found.pose[int(i)]) for i in kept])
    free = steps[:, [i for i, _ in _columns(space)]] / steps.new_tensor([factor for _, factor in _columns(space)])
    own = found.covariance[kept]
    is_known = own.isfinite().flatten(1).all(-1)
    spread = torch.where(is_known[:, None, None], own, best.covariance) + free[:, :, None] * free[:, None, :]
    covariance = (weight[:, None, None] * spread).sum(0)
    entropy = -(weight * weight.clamp_min(1e-12).log()).sum()
    return best, covariance, round(float(entropy.exp()))


def _distinct(found: Solutions) -> Int[Tensor, "kept"]:
    """Hypotheses that differ, the best first."""
    kept: list[int] = []
    for i in found.cost.argsort().tolist():
        is_new = all(float(found.pose[i].step_to(found.pose[j])[3:].abs().max()) > _SAME_RAD for j in kept)
        if bool(found.cost[i].isfinite()) and is_new:
            kept.append(i)
    return torch.tensor(kept)


def _columns(space: PoseSpace) -> list[tuple[int, float]]:
    """DOF that each free parameter is named after, and its factor."""
    rows = [DOFS.index(name) for name in space.free_names]
    return [(row, float(space.basis[row, column])) for column, row in enumerate(rows)]


@lru_cache(maxsize=4)
def _postures(kinematics: HandKinematics) -> PostureResiduals:
    prior = HandPrior(kinematics.skeleton, kinematics.shape_space).to(kinematics.default_shape.device)
    return PostureResiduals.of(prior.postures)


@lru_cache(maxsize=4)
def _population(kinematics: HandKinematics) -> Anthropometry:
    return Anthropometry(kinematics.shape_space)
