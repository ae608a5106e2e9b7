"""The unscented update (Stenger et al. 2001): predict, project, find edges along normals, correct; cameras stacked."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit import PosedHands, Stage
from torchhand.fit.keypoints import KeypointSettings, PostureKeypoints
from torchhand.geometry import Camera
from torchhand.hand import HandFrames, HandKinematics, HandPose
from torchhand.numerics import Gaussian, Measurement, observed_points, update
from torchhand.track.belief import FollowedHand, HandMotion, posture_prior
from torchhand.track.scene import (
    Candidate,
    Scene,
    SilhouetteComparison,
    detected_hand,
    parts_of,
    scene_keypoints,
    with_further_postures,
)
from torchhand.track.unscented.edges import ContourVisibility, EdgeMeasurement, EdgeSearch, Planes
from torchhand.track.unscented.observations import corrected_by
from torchhand.track.unscented.settings import UnscentedUpdateSettings
from torchhand.view import HandProjector, OutlineTable

_STARTING_UPDATES = 4  # measurement updates on the picture in which a hand was found
_KEYPOINTS = Stage(gross_m=0.004)
_OVERCONFIDENCE = 4.0
"""Contour points lie 3 mm apart, errors of the model's surface reach over more than a centimetre. Measured on the
recordings of another maker's hand: with it 93 to 99 % of the joints lie in their 95 % band, without it 85 to 95 %
(`torchhand track rom_back`, `rom_side`, `rom_palm` and `free` with keypoints, then `torchhand evaluate`)."""


@dataclass(frozen=True, kw_only=True)
class _Measured:
    """A hand after a measurement update, and how well the pictures bear it out."""

    hand: FollowedHand
    edges: float = 0.0
    """Share of the outer contour points in the pictures with an accepted edge."""
    in_view: float = 0.0
    """Share of the visible contour points in the pictures."""
    nis: float | None = 0.0
    visibility: tuple[ContourVisibility | None, ...] = ()
    """View by view, for a further pass over the same scene."""


class UnscentedUpdate:
    """Follows a hand by edges along its contour in every view, through sigma points (`UpdateRule`)."""

    def __init__(
        self,
        kinematics: HandKinematics,
        cameras: Sequence[Camera],
        motion: HandMotion,
        table: OutlineTable,
        settings: UnscentedUpdateSettings,
        keypoints: KeypointSettings,
        *,
        side_px: int,
    ) -> None:
        """side_px: of the reduced pictures in which silhouettes are compared."""
        self.kinematics, self.cameras, self.motion = kinematics, tuple(cameras), motion
        self.settings, self.keypoints, self._side_px = settings, keypoints, side_px
        self._search = EdgeSearch(settings=settings, table=table)
        self._prior = posture_prior(motion.space, settings.prior, has_tilt=len(self.cameras) == 1)
        self._parts_of_free = parts_of(motion.space.free_names, motion.space.basis.device)
        self._made: tuple[Tensor, list[HandProjector], SilhouetteComparison] | None = None

    @property
    def overconfidence(self) -> float:
        return _OVERCONFIDENCE

    def follow(
        self, hand: FollowedHand, predicted: FollowedHand, scene: Scene, shape: Float[Tensor, "shape"]
    ) -> Candidate | None:
        """The prediction corrected by detected keypoints, which tell which finger is where, by the scene's further
        observations, then in `passes` updates with fresh edges."""
        corrected = self._with_keypoints(predicted, scene, shape)
        measured = _Measured(hand=corrected_by(corrected, scene, self.motion, shape))
        for _ in range(self.settings.passes):
            measured = self._updated(measured, scene, shape)
        return self._candidate(measured, scene, shape)

    def begin(
        self,
        pose: HandPose,
        covariance: Float[Tensor, "free free"] | None,
        scene: Scene,
        shape: Float[Tensor, "shape"],
    ) -> Candidate | None:
        """Repeated updates on one scene: the fit of a start has more freedom and other weights, and a track that went
        on from it would begin with a slide."""
        hand = self.motion.started(pose)
        spread, share = hand.belief.covariance, 1 / self.settings.passes
        measured = _Measured(hand=hand)
        for _ in range(_STARTING_UPDATES):
            hand = replace(measured.hand, belief=Gaussian(measured.hand.belief.mean, spread))
            measured = _Measured(hand=corrected_by(hand, scene, self.motion, shape, weight=share))
            measured = self._updated(measured, scene, shape)
        # Innovations of repeated updates on one picture say nothing.
        return self._candidate(replace(measured, nis=None), scene, shape)

    def _candidate(self, measured: _Measured, scene: Scene, shape: Tensor) -> Candidate:
        pose, comparison = self.motion.pose(measured.hand), self._for(shape)[2]
        placed = comparison.placed(pose)
        return Candidate(
            hand=measured.hand,
            pose=pose,
            placed=placed,
            agreement=comparison(placed, scene),
            edges=measured.edges,
            in_view=measured.in_view,
            nis=measured.nis,
        )

    def _with_keypoints(self, hand: FollowedHand, scene: Scene, shape: Tensor) -> FollowedHand:
        """A hand corrected by all detected keypoints. Where a part of it is not credibly theirs, outliers among these
        are told by the hand that they themselves tell of: the one that is followed may be the wrong one."""
        where = (scene, self.cameras, self.kinematics, self.keypoints)
        seen = scene_keypoints(*where)
        if not seen.pictures:
            return hand
        s, count = self.settings, self.motion.space.size
        own = self.motion.pose(hand)
        is_lost = with_further_postures(seen, scene).contradicted(own, shape)
        if bool(is_lost.any()):
            detected = detected_hand(*where, shape)
            if detected is None:
                return hand
            # At once: a far finger is no linear matter, what bends towards the camera hardly moves at first.
            hand, own = self.motion.put(hand, detected, is_lost[self._parts_of_free]), detected
        candidates = observed_points(hand.belief, s.transform, count)
        poses = HandPose.of(self.motion.space.about(hand.base).dof(candidates), hand.reference)
        posed, stack = PosedHands(pose=poses, shape=shape), _Stack()
        for one in seen.observations:
            factor = one.associate(seen.hands(own, shape), _KEYPOINTS)
            stack.add(factor.predict(posed), *factor.measurement())
        predicted, measurement = stack.joined()
        result = update(hand.belief, lambda _: predicted, measurement, s.transform, observed=count)
        return self.motion.limited(replace(hand, belief=result.state))

    def _updated(self, before: _Measured, scene: Scene, shape: Tensor) -> _Measured:
        """One measurement update with fresh edges of all views and the weak posture prior.

        Where no view has enough of the contour in its picture, the hand comes back as it is with all shares 0.
        """
        s, count = self.settings, self.motion.space.size
        hand = before.hand
        # The centre of the sigma points is the reference hand: all are placed at once.
        candidates = observed_points(hand.belief, s.transform, count)
        poses = HandPose.of(self.motion.space.about(hand.base).dof(candidates), hand.reference)
        projectors = self._for(shape)[1]
        frames = projectors[0].frames(poses.dofs, hand.reference)
        edges = self._edges(before, frames, projectors, scene)
        if not any(edges):
            return _Measured(hand=hand)
        by_points = bool(scene_keypoints(scene, self.cameras, self.kinematics, self.keypoints).postures)
        prior = self._prior.value(hand.reference, hand.start_reference)
        stack = _Stack()
        for one in edges:
            if one is not None:
                variance = one.variance + one.surface_variance if by_points else one.variance
                stack.add(one.predicted, one.value, variance, one.is_found)
        is_believed = self._believed(scene, by_points=by_points)
        stack.add(candidates @ self._prior.matrix.T, prior, self._prior.variance, is_believed)
        predicted, measurement = stack.joined()
        measurement = replace(measurement, noise=measurement.noise * s.passes)  # every pass has its share of the weight
        result = update(hand.belief, lambda _: predicted, measurement, s.transform, gate=s.gate, observed=count)
        return self._judged(
            edges, result.used, replace(hand, belief=result.state), float(result.nis), int(result.count)
        )

    def _believed(self, scene: Scene, *, by_points: bool) -> Bool[Tensor, "rows"]:
        """Which beliefs of the weak posture prior count: all where edges alone tell the posture; no resting angles
        where the network tells them too; the ties alone where detected points do."""
        if by_points:
            return self._prior.is_tie
        is_learned = any(isinstance(one, PostureKeypoints) for one in scene.observations)
        return ~self._prior.is_rest if is_learned else torch.ones_like(self._prior.is_rest)

    def _judged(
        self,
        edges: list[EdgeMeasurement | None],
        used: Tensor,
        hand: FollowedHand,
        nis: float,
        count: int,
    ) -> _Measured:
        accepted = total = first = 0
        inside: list[float] = []
        for one in edges:
            if one is None:
                inside.append(0.0)
                continue
            own = used[first : first + len(one.value)]
            first += len(one.value)
            accepted += int((own & one.visibility.outer).sum())
            total += one.outer_in_picture
            inside.append(float(one.in_picture.float().mean()))
        return _Measured(
            hand=self.motion.limited(hand),
            edges=accepted / max(1, total),
            in_view=max(inside),
            nis=nis / max(1, count),
            visibility=tuple(None if one is None else one.visibility for one in edges),
        )

    def _edges(
        self, before: _Measured, frames: HandFrames, projectors: list[HandProjector], scene: Scene
    ) -> list[EdgeMeasurement | None]:
        """View by view; None where a view has no picture or not enough of the contour."""
        known = before.visibility or (None,) * len(projectors)
        found: list[EdgeMeasurement | None] = []
        for view, projector in enumerate(projectors):
            planes = self._planes(scene, view)
            found.append(
                None if planes is None else self._search(projector, frames, planes, before.hand.failures, known[view])
            )
        return found

    def _planes(self, scene: Scene, view: int) -> Planes | None:
        s, plane = self.settings, scene.plane(view)
        if plane is None:
            return None
        luminance = scene.grey(view) if s.edges_in == "grey" or s.inner_weight > 0 else None
        outer = luminance if s.edges_in == "grey" and luminance is not None else plane
        return Planes(outer=outer, inner=luminance if s.inner_weight > 0 else None)

    def _for(self, shape: Tensor) -> tuple[Tensor, list[HandProjector], SilhouetteComparison]:
        """What depends on the proportions, kept while they stay the same."""
        if self._made is None or self._made[0] is not shape:
            projectors = [HandProjector(self.kinematics, camera, shape) for camera in self.cameras]
            comparison = SilhouetteComparison(self.kinematics, self.cameras, shape, side_px=self._side_px)
            self._made = (shape, projectors, comparison)
        return self._made


class _Stack:
    """Measurements of all kinds, one after the other."""

    def __init__(self) -> None:
        self._parts: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []

    def add(self, predicted: Tensor, value: Tensor, variance: Tensor, valid: Tensor) -> None:
        """predicted: (sigma points, m); the others (m,)."""
        self._parts.append((predicted, value, variance, valid))

    def joined(self) -> tuple[Tensor, Measurement]:
        """All predictions, and what was measured in their place."""
        predicted, value, variance, valid = (torch.cat(parts, -1) for parts in zip(*self._parts, strict=True))
        return predicted, Measurement(value, variance, valid)
