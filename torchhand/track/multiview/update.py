"""The MAP update on silhouettes (Ueda et al. 2003): the skin fitted into the hull of all views, with the prediction."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import HandPose
from torchhand.track.belief import FollowedHand, HandMotion
from torchhand.track.multiview.fitting import Anchor, MomentFitter, Placed
from torchhand.track.multiview.hulls import Hull
from torchhand.track.scene import Agreement, Candidate, Health, Scene


class HullUpdate:
    """Follows a hand by least squares in the hull and on the edges of the silhouettes (`UpdateRule`)."""

    def __init__(self, fits: MomentFitter, motion: HandMotion, health: Health) -> None:
        """health: by which a view that disagrees is left out."""
        self.fits, self.motion, self._health = fits, motion, health

    def follow(
        self, hand: FollowedHand, predicted: FollowedHand, scene: Scene, shape: Float[Tensor, "shape"]
    ) -> Candidate | None:
        """The hand fitted from the prediction; where it fails, once more without the view that agrees least."""
        first = self._fitted(predicted, scene, shape)
        if first is None or not self._health.is_failing(first):
            return first
        hull = hull_about(self.fits, scene, self.motion.pose(predicted), shape)
        if len(hull.views) <= self.fits.settings.min_views:
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
        hull = hull_about(self.fits, scene, pose, shape)
        placed = self.fits.settled(hull, anchor_of(pose), shape, scene.masks)
        return None if placed is None else self.candidate(placed)

    def candidate(self, placed: Placed) -> Candidate | None:
        """A filter that starts at a fitted hand; None where the fit has no covariance."""
        fit = placed.fit
        if not bool(fit.covariance.isfinite().all()):
            return None
        pose = HandPose.of(fit.pose, fit.root_reference)
        begun = self.motion.started(pose, self.motion.space.constant)
        begun = self.motion.begun(begun, pose, fit.covariance)
        return _candidate(placed, begun, None)

    def _fitted(self, predicted: FollowedHand, scene: Scene, shape: Tensor) -> Candidate | None:
        own, prior = self.motion.pose(predicted), self.motion.prior(predicted)
        hull = hull_about(self.fits, scene, own, shape)
        starts = [anchor_of(own), *(anchor_of(guess) for guess in scene.guesses)]
        placed = self.fits.expected(hull, starts, prior.mean, prior.covariance, shape, scene.masks)
        if placed is None or not bool(placed.fit.covariance.isfinite().all()):
            return None
        if self.fits.settings.fitting == "torque":  # which knows no prediction: the fit alone
            found = self.candidate(placed)
            return None if found is None else replace(found, if_failing=predicted)
        pose = HandPose.of(placed.fit.pose, placed.fit.root_reference)
        return _candidate(placed, self.motion.corrected(predicted, pose, placed.fit.covariance), predicted)


def _candidate(placed: Placed, hand: FollowedHand, predicted: FollowedHand | None) -> Candidate:
    fit = placed.fit
    return Candidate(
        hand=hand,
        pose=HandPose.of(fit.pose, fit.root_reference),
        agreement=Agreement.of_overlaps(placed.overlaps),
        edges=fit.covered_share,
        inside=fit.inside_share,
        cost=float(fit.cost),
        is_sound=fit.is_good,
        if_failing=predicted,
    )


def anchor_of(pose: HandPose) -> Anchor:
    """As the fits of one frame are begun."""
    at = pose.normalized()
    return Anchor(pose=at.dofs, root_reference=at.reference)


def hull_about(fits: MomentFitter, scene: Scene, pose: HandPose, shape: Float[Tensor, "shape"]) -> Hull:
    """The hull about a hand; the first one asked for serves all that are near."""
    return scene.once("hull", lambda: fits.hull_about(anchor_of(pose), shape, scene.masks))


def hull_anywhere(fits: MomentFitter, scene: Scene, shape: Float[Tensor, "shape"]) -> Hull:
    """What may be a hand in all that the silhouettes show."""
    return scene.once("hull anywhere", lambda: fits.hull_anywhere(shape, scene.masks))
