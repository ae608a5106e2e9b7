"""The tracker of Ouhaddi and Horain 1998, section 7: registration on distance maps, and an extended Kalman filter.

Every picture is registered from the filter's prediction and from the last pose; the better one's limb segments are what
the filter observes (section 7.5). What the paper only announces is here: flexion and self-occlusion, noise that is
learned, and more starts where the motion was sudden.
"""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import ConstraintPrior, PosturePrior, PostureResiduals, Solutions, touching
from torchhand.fit.contour import PictureContours, hand_length_px, is_in_picture, pixels_per_metre
from torchhand.fit.detect import Start, StartPoints
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, HandPose, HandPrior, PoseConstraints
from torchhand.image import BackgroundPlate, channel_of, clean, fill_holes, largest_component
from torchhand.numerics import (
    Gaussian,
    adapted_variance,
    noise_density,
    process_covariance,
    update_extended,
    update_iterated,
    wrapped,
)
from torchhand.track import HandTracker, Measured, TrackerState, start_spread
from torchhand.track.extended.search import FrameSearch, priors_of
from torchhand.track.extended.segment_observation import SCALARS, SegmentObservation
from torchhand.track.extended.settings import DistanceTrackerSettings
from torchhand.view import Contours, MeshContours, PrimitiveContours

_HOLE = 3e-4  # largest hole of a silhouette that is filled, squares of the hand's length
_ROOT = 6
_FEWEST = 16  # points of the model's contour


class DistanceTracker(HandTracker[DistanceTrackerSettings]):
    """Follows one hand of a known side by registration on distance maps; see `HandTracker`."""

    def __init__(
        self,
        kinematics: HandKinematics,
        camera: Camera,
        frames_per_second: float,
        settings: DistanceTrackerSettings | None = None,
        *,
        shape: Float[Tensor, "shape"] | None = None,
        start_points: StartPoints | None = None,
        plate: BackgroundPlate | None = None,
    ) -> None:
        """As `HandTracker`."""
        s = settings or DistanceTrackerSettings()
        super().__init__(kinematics, camera, frames_per_second, s, shape=shape, start_points=start_points, plate=plate)
        skeleton = self.kinematics.skeleton
        postures = PostureResiduals.of(HandPrior(skeleton, self.kinematics.shape_space).postures)
        constraints = ConstraintPrior(constraints=PoseConstraints(skeleton), has_ties=False)
        self._priors = priors_of(self.space, constraints, PosturePrior(postures=postures))
        self._contours: Contours | None = None

    def _settle(self, state: TrackerState, start: Start, image: Tensor, probability: Tensor) -> Measured:
        shape, schedule = start.fit.shape, self.settings.search_schedule
        search = self._search(state, shape, image)
        picture = search.picture(self._silhouette(state, shape, probability), schedule)
        found = search.best(picture, HandPose.of(state.base[None], state.reference), schedule)
        if not bool(found.cost.isfinite()):
            return Measured(state=state)
        return self._judged(self._at(state, found), shape, picture)

    def _measure(self, state: TrackerState, shape: Tensor, image: Tensor, probability: Tensor) -> Measured:
        s, predicted = self.settings, replace(self._predicted(state), turn=state.turn + 1)
        search = self._search(state, shape, image)
        picture = search.picture(self._silhouette(predicted, shape, probability), s.schedule)
        starts = torch.stack((self._rebased.pose(predicted), search.hand.dofs))
        found = search.best(picture, HandPose.of(starts, state.reference), s.schedule)
        if s.hypotheses and self._priors:
            if search.normalized_residual(found) > 1:
                found, picture = search.reinitialized(found, picture, largest_component(clean(probability > 0.5)))
            else:
                found = search.with_other_fingers(found, picture, state.turn)
        if not bool(found.cost.isfinite()):
            return self._judged(self._rebased(predicted), shape, picture)
        following = self._filtered(predicted, shape, found) if s.filter == "extended" else self._at(predicted, found)
        return self._judged(following, shape, picture)

    def _search(self, state: TrackerState, shape: Tensor, image: Tensor) -> FrameSearch:
        return FrameSearch(
            settings=self.settings,
            space=self.space.about(state.base),
            contours=self._contours_of(shape),
            projector=self._projectors_of(shape)[0],
            priors=self._priors,
            image=image,
            hand=HandPose.of(self._rebased.pose(state), state.reference),
        )

    def _silhouette(self, state: TrackerState, shape: Tensor, probability: Tensor) -> Bool[Tensor, "height width"]:
        """The pieces of the picture's silhouette that the predicted hand touches."""
        projector, _ = self._projectors_of(shape)
        pose = self._rebased.pose(state)
        length_px = hand_length_px(self.camera, self.kinematics, pose, shape)
        mask = touching(clean(probability > 0.5), projector.silhouette(pose, state.reference))
        return fill_holes(mask, max(1, round(_HOLE * length_px**2)))

    def _contours_of(self, shape: Tensor) -> Contours:
        if self._contours is None or self._contours.shape is not shape:
            if self.settings.surface == "mesh":
                hand = load_hand_model().hand(side=self.kinematics.side, dtype=torch.float64)
                self._contours = MeshContours(hand, self.camera, shape)
            else:
                self._contours = PrimitiveContours(self._projectors_of(shape)[0], self.table)
        return self._contours

    # ------------------------------------------------------------------ filter

    def _free_of(self, state: TrackerState, found: Solutions) -> Float[Tensor, "free"]:
        """A registered hand in the parameters of the state's belief."""
        return self.space.about(state.base).own(found.pose.about(state.reference).dofs)

    def _at(self, state: TrackerState, found: Solutions) -> TrackerState:
        """A filter that starts at a registered hand."""
        free = self._free_of(state, found)
        spread = start_spread(self._kinds, self.settings.motion.order)
        covariance = spread.diag_embed()
        if bool(found.covariance.isfinite().all()):
            covariance[: len(free), : len(free)] = found.covariance
        mean = torch.cat((free, free.new_zeros(len(spread) - len(free))))
        return self._rebased(replace(state, belief=Gaussian(mean, covariance), density=None))

    def _filtered(self, predicted: TrackerState, shape: Tensor, found: Solutions) -> TrackerState:
        """The prediction corrected by the segments of the registered hand, and lightly by its parameters.

        Segments of few fingers leave much of the hand open, and many hands have the same; the parameters, with the
        registration's own covariance, keep the iteration near the hand that was registered.
        """
        s, count = self.settings, self.space.size
        projector, _ = self._projectors_of(shape)
        observe = SegmentObservation(projector, self.space.about(predicted.base), predicted.reference, s.segments)
        free = self._free_of(predicted, found)
        seen = observe.measure(free)
        value, jacobian = observe(predicted.belief.mean[:count])
        innovation = wrapped(seen.value - value, observe.period)
        how = {"gate": s.gate, "group": len(SCALARS)}
        used = update_extended(predicted.belief, innovation, jacobian, seen.noise, valid=seen.valid, **how).used
        if float(used.sum()) < s.restart_fraction * float(seen.valid.sum()):
            return self._at(predicted, found)
        belief = predicted.belief
        if s.pose_weight > 0 and bool(found.covariance.isfinite().all()):
            identity = torch.eye(count, dtype=free.dtype)
            noise = found.covariance / s.pose_weight
            belief = update_extended(belief, free - belief.mean[:count], identity, noise).state
        belief = update_iterated(
            belief, observe, seen.value, seen.noise, s.iterated, valid=used, period=observe.period, observed=count
        ).update.state
        density = predicted.density
        if s.is_adaptive:
            old = self._density if density is None else density
            sample = process_covariance(predicted.belief, belief, self._noise_of(old))
            density = adapted_variance(old, noise_density(sample, s.motion, self._dt_s), self._density, s.adaptive)
        return self._rebased(replace(predicted, belief=belief, density=density))

    def _judged(self, state: TrackerState, shape: Tensor, picture: PictureContours) -> Measured:
        """How well the picture bears a state out."""
        pose = self._rebased.pose(state)
        hand, contour = HandPose.of(pose[None], state.reference), self.settings.contour
        scale = pixels_per_metre(self.camera, hand)
        contours = self._contours_of(shape).visible(hand, probe_distance_px=1 + contour.probe_distance_m * scale)
        visible = (contours.outer | contours.inner)[0]
        in_picture = is_in_picture(contours.points_px[0], self.camera)
        inside = float((visible & in_picture).sum()) / max(1, int(visible.sum()))
        outer = contours.outer[0] & in_picture
        if picture.is_empty or int(outer.sum()) < _FEWEST:
            return Measured(state=state, inside=inside, nis=None)
        field, normals = picture.field(1), contours.normals[0][outer]
        apart, _ = field.sample(contours.points_px[0][outer], channel_of(normals, field.channels))
        near = apart.abs() <= contour.near_m * scale
        return Measured(state=state, found=float(near.double().mean()), inside=inside, nis=None)
