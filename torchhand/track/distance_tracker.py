"""The tracker of paper 000, section 7: registration on distance maps, steadied by an extended Kalman filter.

Every picture is registered from the filter's prediction and from the last pose; the better one's limb segments are what
the filter observes (section 7.5). What the paper only announces is here: flexion and self-occlusion, noise that is
learned, and more starts where the motion was sudden.
"""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera, vector_from_rotation
from torchhand.hand import Hand, HandKinematics, HandPrior, PoseConstraints
from torchhand.image import BackgroundPlate, clean, fill_holes, largest_component, touching
from torchhand.image.distance_fields import channel_of
from torchhand.numerics import (
    Gaussian,
    adapted_variance,
    noise_density,
    process_covariance,
    update_extended,
    update_iterated,
    wrapped,
)
from torchhand.residuals import PostureResiduals
from torchhand.track.contour_points import hand_length_px, is_in_picture
from torchhand.track.distance_search import FrameSearch
from torchhand.track.distance_settings import DistanceTrackerSettings
from torchhand.track.measured import Measured
from torchhand.track.picture_contours import PictureContours, picture_contours
from torchhand.track.registration import Registration
from torchhand.track.segment_observation import SCALARS, SegmentObservation
from torchhand.track.start import Start, StartPoints
from torchhand.track.state import TrackerState
from torchhand.track.tracker import HandTracker, start_spread
from torchhand.view.contours import Contours, PrimitiveContours
from torchhand.view.mesh_contours import MeshContours

_HOLE = 3e-4  # largest hole of a silhouette that is filled, squares of the hand's length
_ROOT = 6
_FEWEST = 16  # points of the model's contour


class DistanceTracker(HandTracker[DistanceTrackerSettings]):
    """Follows one hand of a known side by registration on distance maps; see `HandTracker`."""

    def __init__(
        self,
        hand: Hand | HandKinematics,
        camera: Camera,
        frames_per_second: float,
        settings: DistanceTrackerSettings | None = None,
        *,
        shape: Float[Tensor, "shape"] | None = None,
        start_points: StartPoints | None = None,
        plate: BackgroundPlate | None = None,
    ) -> None:
        """As `HandTracker`. Raises ValueError too where the skin is to be registered and `hand` has none."""
        s = settings or DistanceTrackerSettings()
        if s.surface == "mesh" and not isinstance(hand, Hand):
            raise ValueError("surface: 'mesh' needs a Hand, whose skin is registered, got HandKinematics")
        super().__init__(hand, camera, frames_per_second, s, shape=shape, start_points=start_points, plate=plate)
        skeleton = self.kinematics.skeleton
        self._constraints = PoseConstraints(skeleton)
        self._prior = PostureResiduals.of(HandPrior(skeleton, self.kinematics.shape_space).postures)
        self._contours: Contours | None = None

    def _settle(self, state: TrackerState, start: Start, image: Tensor, probability: Tensor) -> Measured:
        shape, settings = start.fit.shape, self.settings.search
        picture = picture_contours(self._silhouette(state, shape, probability), settings, image=image)
        found = self._search(state, shape, image).best(picture, state.base[None], settings)
        if not bool(found.cost.isfinite()):
            return Measured(state=state)
        return self._judged(self._at(state, found), shape, picture)

    def _measure(self, state: TrackerState, shape: Tensor, image: Tensor, probability: Tensor) -> Measured:
        s, predicted = self.settings, replace(self._predicted(state), turn=state.turn + 1)
        picture = picture_contours(self._silhouette(predicted, shape, probability), s.registration, image=image)
        search = self._search(state, shape, image)
        found = search.best(picture, torch.stack((self._rebased.pose(predicted), search.pose)), s.registration)
        if s.hypotheses and bool(self.space.basis[_ROOT:].any()):
            if search.badness(found) > 1:
                found, picture = search.mended(found, picture, largest_component(clean(probability > 0.5)))
            else:
                found = search.reconsidered(found, picture, state.turn)
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
            constraints=self._constraints,
            prior=self._prior,
            image=image,
            pose=self._rebased.pose(state),
            reference=state.reference,
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
            if self.settings.surface == "mesh" and self.hand is not None:
                self._contours = MeshContours(self.hand, self.camera, self.space.basis, shape)
            else:
                self._contours = PrimitiveContours(self._projectors_of(shape)[0], self.table, self.space.basis)
        return self._contours

    # ------------------------------------------------------------------ filter

    def _free_of(self, state: TrackerState, found: Registration) -> Float[Tensor, "free"]:
        """A registered hand in the parameters of the state's belief."""
        vector = vector_from_rotation(found.root_reference @ state.reference.T)
        return self.space.about(state.base).own(torch.cat((found.pose[:3], vector, found.pose[6:])))

    def _at(self, state: TrackerState, found: Registration) -> TrackerState:
        """A filter that starts at a registered hand."""
        free = self._free_of(state, found)
        spread = start_spread(self._kinds, self.settings.motion.order)
        covariance = spread.diag_embed()
        if bool(found.covariance.isfinite().all()):
            covariance[: len(free), : len(free)] = found.covariance
        mean = torch.cat((free, free.new_zeros(len(spread) - len(free))))
        return self._rebased(replace(state, belief=Gaussian(mean, covariance), density=None))

    def _filtered(self, predicted: TrackerState, shape: Tensor, found: Registration) -> TrackerState:
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
        if float(used.sum()) < s.sudden_share * float(seen.valid.sum()):
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
        length_px = hand_length_px(self.camera, self.kinematics, pose, shape)
        beyond_px = 1 + self.settings.registration.beyond_share * length_px
        look = self._contours_of(shape).look(pose[None], state.reference[None], beyond_px=beyond_px)
        visible = (look.outer | look.inner)[0]
        in_picture = is_in_picture(look.points_px[0], self.camera)
        inside = float((visible & in_picture).sum()) / max(1, int(visible.sum()))
        outer = look.outer[0] & in_picture
        if picture.is_empty or int(outer.sum()) < _FEWEST:
            return Measured(state=state, inside=inside, nis=None)
        field, normals = picture.fields[-1], look.normals[0][outer]
        apart, _ = field.sample(look.points_px[0][outer], channel_of(normals, field.channels))
        near = apart.abs() <= self.settings.near_share * length_px
        return Measured(state=state, found=float(near.double().mean()), inside=inside, nis=None)
