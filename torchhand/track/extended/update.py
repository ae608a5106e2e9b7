"""The extended update (Ouhaddi and Horain 1998, section 7): registration on distance maps, steadied by a filter.

Every scene is registered from the filter's prediction and from the last pose; the better one's limb segments are what
the filter observes (section 7.5). What Ouhaddi and Horain announce is here too: flexion and self-occlusion, noise that
is learned, more starts where the prediction was far off; and several cameras, whose contours and segments are stacked.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit import ConstraintPrior, Observation, PostureResiduals, Solutions
from torchhand.fit import PosturePrior as PostureDensity
from torchhand.fit.contour import NEAR_M, WHOLE_SEARCH, PictureContours, is_in_picture
from torchhand.fit.keypoints import KeypointSettings
from torchhand.geometry import Camera
from torchhand.hand import Hand, HandPose, HandPrior, PoseConstraints
from torchhand.image import channel_of, clean, fill_holes, largest_component, touching
from torchhand.numerics import (
    IteratedSettings,
    Measurement,
    adapted_variance,
    noise_density,
    process_covariance,
    update_extended,
    update_iterated,
    wrapped,
)
from torchhand.track.belief import FollowedHand, HandMotion
from torchhand.track.extended.registration import SCHEDULE, Pictures, SceneRegistration
from torchhand.track.extended.segment_observation import SCALARS, SegmentObservation, StackedSegments
from torchhand.track.extended.settings import ExtendedUpdateSettings
from torchhand.track.scene import Candidate, Scene, SilhouetteComparison, detected_hand, scene_keypoints
from torchhand.view import Contours, HandProjector, MeshContours, OutlineTable, PrimitiveContours

_HOLE = 3e-4  # largest hole of a silhouette that is filled, squares of the hand's length
_ROOT = 6
_MIN_POINTS = 16  # of the model's contour
_ITERATIONS = IteratedSettings(iterations=4)
_TRUSTED = 0.5  # share of the visible segments that must pass the gate, or else the filter starts afresh
_OVERCONFIDENCE = 4.0  # as of the contour update: the registered contours have the same surface

Masks = tuple[Bool[Tensor, "_height _width"] | None, ...]


class ExtendedUpdate:
    """Follows a hand by registration on distance maps (`UpdateRule`)."""

    def __init__(
        self,
        hand: Hand,
        cameras: Sequence[Camera],
        motion: HandMotion,
        table: OutlineTable,
        settings: ExtendedUpdateSettings,
        keypoints: KeypointSettings,
        *,
        side_px: int,
    ) -> None:
        """hand: float64; its mesh is what `surface: mesh` registers. side_px: of the reduced pictures in which
        silhouettes are compared."""
        self.hand, self.kinematics, self.cameras, self.motion = hand, hand.kinematics, tuple(cameras), motion
        self.settings, self.keypoints, self._table, self._side_px = settings, keypoints, table, side_px
        skeleton = hand.kinematics.skeleton
        self._priors: tuple[Observation, ...] = ()
        moves_joints = bool(motion.space.basis[_ROOT:].any())
        if moves_joints and settings.constraint_weight > 0:
            has_ties = settings.prior_weight <= 0  # the posture prior, where there is one, holds the ties already
            constraints = PoseConstraints(skeleton)
            weight = settings.constraint_weight
            self._priors += (ConstraintPrior(constraints=constraints, weight=weight, has_ties=has_ties),)
        if moves_joints and settings.prior_weight > 0:
            postures = PostureResiduals.of(HandPrior(skeleton, hand.kinematics.shape_space).postures)
            self._priors += (PostureDensity(postures=postures, weight=settings.prior_weight),)
        self._made: _Made | None = None

    @property
    def overconfidence(self) -> float:
        return _OVERCONFIDENCE

    def follow(
        self, hand: FollowedHand, predicted: FollowedHand, scene: Scene, shape: Float[Tensor, "shape"]
    ) -> Candidate | None:
        """The prediction corrected by the registered hand."""
        s, made = self.settings, self._for(shape)
        expected, last = self.motion.pose(predicted), self.motion.pose(hand)
        registration = self._registration(hand, last, scene, shape)
        pictures = registration.pictures(self._silhouettes(expected, scene, made), SCHEDULE)
        starts = [expected.about(last.reference), last]
        where = (self.cameras, self.kinematics, self.keypoints, shape)
        if (detected := detected_hand(scene, *where)) is not None:
            starts.append(detected)

        found = registration.best(pictures, HandPose.stack(starts), SCHEDULE)
        if s.hypotheses and bool(self.motion.space.basis[_ROOT:].any()):
            if registration.normalized_residual(found) > 1:
                found, pictures = registration.reinitialized(found, pictures, _foreground(scene))
            else:
                found = registration.with_other_fingers(found, pictures, hand.frames)
        if not bool(found.cost.isfinite()):
            return self._candidate(self.motion.limited(predicted), scene, shape, pictures)
        if s.filter == "extended":
            following = self._filtered(predicted, found, made)
        else:
            following = self.motion.begun(predicted, found.pose, found.covariance)
        return self._candidate(following, scene, shape, pictures)

    def begin(
        self,
        pose: HandPose,
        covariance: Float[Tensor, "free free"] | None,
        scene: Scene,
        shape: Float[Tensor, "shape"],
    ) -> Candidate | None:
        """Registered from coarse to fine."""
        hand, made = self.motion.started(pose), self._for(shape)
        registration = self._registration(hand, pose.normalized(), scene, shape)
        pictures = registration.pictures(self._silhouettes(pose, scene, made), WHOLE_SEARCH)
        found = registration.best(pictures, HandPose.stack([pose.normalized()]), WHOLE_SEARCH)
        if bool(found.cost.isfinite()):
            hand = self.motion.begun(hand, found.pose, found.covariance)
        return self._candidate(hand, scene, shape, pictures)

    def _registration(self, hand: FollowedHand, last: HandPose, scene: Scene, shape: Tensor) -> SceneRegistration:
        made = self._for(shape)
        return SceneRegistration(
            settings=self.settings,
            space=self.motion.space.about(hand.base),
            shape=shape,
            contours=made.contours,
            projectors=made.projectors,
            keypoints=scene_keypoints(scene, self.cameras, self.kinematics, self.keypoints).observations,
            priors=self._priors,
            scene=scene,
            pose=last,
        )

    def _silhouettes(self, pose: HandPose, scene: Scene, made: "_Made") -> Masks:
        """The pieces of every view's silhouette that the expected hand touches."""
        found: list[Tensor | None] = []
        for view, projector in enumerate(made.projectors):
            plane = scene.plane(view)
            if plane is None:
                found.append(None)
                continue
            length_px = self._length_px(projector, pose)
            mask = touching(clean(plane > 0.5), projector.silhouette(pose.dofs, pose.reference))
            found.append(fill_holes(mask, max(1, round(_HOLE * length_px**2))))
        return tuple(found)

    def _length_px(self, projector: HandProjector, pose: HandPose) -> float:
        """Length of a hand held parallel to the picture."""
        camera = projector.camera
        focal = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
        length = float(projector.shape[self.kinematics.shape_space.names.index("hand_length")])
        depth = float(camera.cam_from_world(pose.dofs[:3])[2]) if camera.kind == "pinhole" else 1.0
        return focal * length / max(depth, 1e-3)

    # ------------------------------------------------------------------ filter

    def _filtered(self, predicted: FollowedHand, found: Solutions, made: "_Made") -> FollowedHand:
        """The prediction corrected by the segments of the registered hand, and lightly by its parameters.

        Segments of few fingers leave much of the hand open, and many hands have the same; the parameters, with the
        registration's own covariance, keep the iteration near the hand that was registered.
        """
        s, count = self.settings, self.motion.space.size
        space = self.motion.space.about(predicted.base)
        views = [SegmentObservation(own, space, predicted.reference, s.segments) for own in made.projectors]
        observe = StackedSegments(views)
        free = self.motion.free_of(predicted, found.pose)
        seen = observe.measure(free)
        value, jacobian = observe(predicted.belief.mean[:count])
        innovation = wrapped(seen.value - value, observe.period)
        how = {"gate": s.gate, "group": len(SCALARS)}
        used = update_extended(predicted.belief, innovation, jacobian, seen.noise, valid=seen.valid, **how).used
        if float(used.sum()) < _TRUSTED * float(seen.valid.sum()):
            return self.motion.begun(predicted, found.pose, found.covariance)
        belief = predicted.belief
        if s.pose_weight > 0 and bool(found.covariance.isfinite().all()):
            identity = torch.eye(count, dtype=free.dtype, device=free.device)
            noise = found.covariance / s.pose_weight
            belief = update_extended(belief, free - belief.mean[:count], identity, noise).state
        belief = update_iterated(
            belief,
            observe,
            Measurement(seen.value, seen.noise, used),
            _ITERATIONS,
            period=observe.period,
            observed=count,
        ).update.state
        density = self._learned_density(predicted, replace(predicted, belief=belief))
        return self.motion.limited(replace(predicted, belief=belief, density=density))

    def _learned_density(self, predicted: FollowedHand, updated: FollowedHand) -> Float[Tensor, "free"]:
        """The process noise after one more correction."""
        nominal, model, dt_s = self.motion.density, self.motion.model, predicted.dt_s
        old = nominal if predicted.density is None else predicted.density
        sample = process_covariance(predicted.belief, updated.belief, self.motion.process_noise(dt_s, old))
        return adapted_variance(old, noise_density(sample, model, dt_s), nominal)

    # ------------------------------------------------------------------ what it made of the scene

    def _candidate(self, hand: FollowedHand, scene: Scene, shape: Tensor, pictures: Pictures) -> Candidate:
        """How well the pictures bear a hand out."""
        made, pose = self._for(shape), self.motion.pose(hand)
        near, in_view = [], []
        for picture, contours, projector in zip(pictures, made.contours, made.projectors, strict=True):
            fraction, inside = self._contour_fraction(picture, contours, projector, pose)
            in_view.append(inside)
            if picture is not None:
                near.append(fraction)
        placed = made.comparison.placed(pose)
        return Candidate(
            hand=hand,
            pose=pose,
            placed=placed,
            agreement=made.comparison(placed, scene),
            edges=sum(near) / max(1, len(near)),
            in_view=max(in_view),
        )

    def _contour_fraction(
        self, picture: PictureContours | None, contours: Contours, projector: HandProjector, pose: HandPose
    ) -> tuple[float, float]:
        """Share of the outer contour near the picture's, and share of the visible contour in the picture."""
        length_px = self._length_px(projector, pose)
        px_per_m = length_px / float(projector.shape[self.kinematics.shape_space.names.index("hand_length")])
        probe_px = 1 + self.settings.contour.probe_distance_m * px_per_m
        seen = contours.visible(HandPose.stack([pose]), probe_distance_px=probe_px)
        visible = (seen.outer | seen.inner)[0]
        in_picture = is_in_picture(seen.points_px[0], projector.camera)
        inside = float((visible & in_picture).sum()) / max(1, int(visible.sum()))
        outer = seen.outer[0] & in_picture
        if picture is None or picture.is_empty or int(outer.sum()) < _MIN_POINTS:
            return 0.0, inside
        field, normals = picture.field(1), seen.normals[0][outer]
        distance, _ = field.sample(seen.points_px[0][outer], channel_of(normals, field.channels))
        near = distance.abs() <= NEAR_M * px_per_m
        return float(near.double().mean()), inside

    def _for(self, shape: Tensor) -> "_Made":
        """What depends on the proportions, kept while they stay the same."""
        if self._made is None or self._made.shape is not shape:
            self._made = _Made(self, shape)
        return self._made


class _Made:
    """What depends on the proportions."""

    def __init__(self, update: ExtendedUpdate, shape: Tensor) -> None:
        self.shape = shape
        self.projectors = tuple(HandProjector(update.kinematics, camera, shape) for camera in update.cameras)
        self.contours = tuple(self._contours(update, projector) for projector in self.projectors)
        side_px = update._side_px
        self.comparison = SilhouetteComparison(update.kinematics, update.cameras, shape, side_px=side_px)

    def _contours(self, update: ExtendedUpdate, projector: HandProjector) -> Contours:
        if update.settings.surface == "mesh":
            return MeshContours(update.hand, projector.camera, shape=self.shape)
        return PrimitiveContours(projector, update._table)


def _foreground(scene: Scene) -> Masks:
    """Where the pictures have the hand's colours, wherever the hand was expected."""
    planes = [scene.plane(view) for view in range(len(scene.views))]
    return tuple(None if plane is None else largest_component(clean(plane > 0.5)) for plane in planes)
