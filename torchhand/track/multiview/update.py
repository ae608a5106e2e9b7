"""The MAP update on silhouettes (Ueda et al. 2003): the skin fitted into the hull of all views, with the prediction."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import HandPose
from torchhand.track.belief import FollowedHand, HandMotion
from torchhand.track.multiview.fitting import FrameFitter, HullFit
from torchhand.track.multiview.hulls import Hull, is_served
from torchhand.track.scene import Agreement, Candidate, Health, Scene

HULL = "hull"
"""Under which a scene keeps the hull about its hand."""
EXPECTED_HULL = "expected hull"
"""Under which a scene keeps the hull about where its hand was expected before, where that was carved early."""


class HullUpdate:
    """Follows a hand by least squares in the hull and on the edges of the silhouettes (`UpdateRule`)."""

    def __init__(self, fitter: FrameFitter, motion: HandMotion, health: Health) -> None:
        """health: by which a view that disagrees is left out."""
        self.fitter, self.motion, self._health = fitter, motion, health

    @property
    def overconfidence(self) -> float:
        """1: the errors that it states are those of the joint centres and little else."""
        return 1.0

    def follow(
        self, hand: FollowedHand, predicted: FollowedHand, scene: Scene, shape: Float[Tensor, "shape"]
    ) -> Candidate | None:
        """The hand fitted from the prediction; where it fails, once more without the view that agrees least."""
        first = self._fitted(predicted, scene, shape)
        if first is None or not self._health.is_failing(first):
            return first
        hull = hull_about(self.fitter, scene, self.motion.pose(predicted), shape)
        if len(hull.views) <= self.fitter.settings.min_views:
            return first
        worst = int(first.agreement.overlaps.nan_to_num(torch.inf).argmin())
        return self._health.better(first, self._fitted(predicted, scene.without(worst), shape), None)

    def begin(
        self,
        pose: HandPose,
        covariance: Float[Tensor, "free free"] | None,
        scene: Scene,
        shape: Float[Tensor, "shape"],
    ) -> Candidate | None:
        """The hand fitted from where it was found, with larger steps."""
        hull = hull_about(self.fitter, scene, pose, shape)
        fit = self.fitter.refine(hull, pose.normalized(), shape, scene.masks)
        return None if fit is None else self.candidate(fit)

    def candidate(self, fit: HullFit) -> Candidate | None:
        """A filter that starts at a fitted hand; None where the fit has no covariance."""
        if not bool(fit.covariance.isfinite().all()):
            return None
        begun = self.motion.started(fit.pose, self.motion.space.constant)
        return _candidate(fit, self.motion.begun(begun, fit.pose, fit.covariance), None)

    def _fitted(self, predicted: FollowedHand, scene: Scene, shape: Tensor) -> Candidate | None:
        own, prior = self.motion.pose(predicted), self.motion.prior(predicted)
        hull = hull_about(self.fitter, scene, own, shape)
        starts = [own.normalized(), *(guess.normalized() for guess in scene.guesses)]
        fit = self.fitter.fit_predicted(hull, starts, prior.mean, prior.covariance, shape, scene.masks)
        if fit is None or not bool(fit.covariance.isfinite().all()):
            return None
        if self.fitter.settings.fitting == "torque":  # which knows no prediction: the fit alone
            found = self.candidate(fit)
            return None if found is None else replace(found, if_failing=predicted)
        return _candidate(fit, self.motion.corrected(predicted, fit.pose, fit.covariance), predicted)


def _candidate(fit: HullFit, hand: FollowedHand, predicted: FollowedHand | None) -> Candidate:
    return Candidate(
        hand=hand,
        pose=fit.pose,
        placed=fit.placed,
        agreement=Agreement.of_overlaps(fit.overlaps),
        edges=fit.covered_fraction,
        inside=fit.inside_fraction,
        cost=float(fit.cost),
        is_sound=fit.is_good,
        if_failing=predicted,
    )


def hull_about(fitter: FrameFitter, scene: Scene, pose: HandPose, shape: Float[Tensor, "shape"]) -> Hull:
    """The hull about a hand; the one last asked for serves all that are near, as does the one about the place where the
    hand was expected before."""
    pose = pose.normalized()
    place = fitter.place_of(pose, shape)
    kept: Hull | None = scene.kept.get(HULL)
    if kept is not None and kept.serves(place):
        return kept
    if kept is None and scene.expected is not None and is_served(scene.expected, place):
        made = expected_hull(fitter, scene)
    else:
        made = fitter.hulls.near(scene.masks, place)
    scene.kept[HULL] = made = made.with_observations(scene.observations)
    return made


def expected_hull(fitter: FrameFitter, scene: Scene) -> Hull:
    """The hull about where the hand was expected before."""
    place = scene.expected
    assert place is not None
    return scene.once(EXPECTED_HULL, lambda: fitter.hulls.near(scene.masks, place))


def hull_anywhere(fitter: FrameFitter, scene: Scene, shape: Float[Tensor, "shape"]) -> Hull:
    """What may be a hand in all that the silhouettes show."""
    return scene.once("hull anywhere", lambda: fitter.hull_anywhere(shape, scene.masks))
