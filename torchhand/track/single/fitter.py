"""The hand in a single picture, in any posture: silhouettes, hypotheses, registration, and whether it is one at all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.devices import HOST, sent_to
from torchhand.fit.keypoints import PostureKeypoints, RelativeKeypoints, starts_in_picture
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, HandPose, scale_covariance
from torchhand.image import GREY, is_grey
from torchhand.numerics import single_threaded
from torchhand.track.belief import posed_gaussian, unknown_scale_std
from torchhand.track.knowledge import Estimate
from torchhand.track.quality import FingerEvidence, Told, qualities
from torchhand.track.scene import (
    MIN_KEYPOINTS,
    Agreement,
    HandKeypoints,
    Scene,
    SceneKeypoints,
    SilhouetteComparison,
    View,
    detected_hand,
    learned_observations,
    scene_keypoints,
    seen_posture,
)
from torchhand.track.single.evidence import SILENCE, evidence_for, hand_odds, supported
from torchhand.track.single.registration import PictureProblem, Registered
from torchhand.track.single.settings import SinglePoseSettings
from torchhand.track.single.silhouette import cut_at, oval_overlap, silhouette_at, silhouettes_by_skin

_CHECK_SIDE_PX = 320  # of the reduced pictures in which silhouettes are compared
_OVAL = 0.93  # intersection over union with an ellipse, beyond which an outline alone shows nothing of a hand
_TURNED = 6  # sides from which keypoints are taken to be seen
_NETWORK_WORTH = 0.1
"""Share of the information that the network's angles have on pictures of rendered hands, beside a detector's on
photographs: of 27 signs by six people 81 % are named by the nearest neighbour over the angles of both with it, 79 % by
the detector's alone and 43 % by the network's alone."""
_ROUNDS = 2  # of colours learned at the hand and registration on what has them
_HOPELESS = 3.0  # log odds that a hand may be short of belief for its silhouette to be looked for once more

Picture = UInt8[Tensor, "height width 3"]
PoseSource = Callable[[Bool[Tensor, "height width"], Picture | None, Camera, Float[Tensor, "shape"]], HandPose]
"""First poses (k), in the camera's frame, of a hand of a shape whose silhouette, perhaps with a forearm, is given."""


@dataclass(frozen=True, kw_only=True)
class SinglePose:
    """What one picture tells of the hand in it."""

    estimate: Estimate
    """`tracked`, or `no_hand` with the reason; in the camera's frame."""
    shape: Float[Tensor, "shape"]
    """Proportions: those given, or as the picture shows them."""
    modes: int = 0
    """Number of different hands that explain the picture about as well; 0 without a hand."""


@dataclass(frozen=True, kw_only=True)
class _Judged:
    """A registered hand, and how it agrees with the silhouette that it was registered on."""

    hand: Registered
    mask: Bool[Tensor, "height width"]
    agreement: Agreement
    objection: str
    """Why it is no hand; empty where it is one."""

    @property
    def score(self) -> float:
        """For hands that detected keypoints tell of and others, whose costs are not comparable."""
        return self.agreement.overlap * self.hand.edges - float(bool(self.objection))


@dataclass(frozen=True, kw_only=True)
class HandHypothesis:
    """A hand on one of the silhouettes that a picture may show, and what speaks for it."""

    judged: _Judged
    evidence: Float[Tensor, "evidence"]
    """In the order of `EVIDENCE`."""
    odds: float
    """Logarithm of the odds that it is the right one."""

    @property
    def hand(self) -> Registered:
        return self.judged.hand


class SinglePoseFitter:
    """Estimates the hand of a known side in single pictures, each by itself.

    Computes in float64 on the device of the kinematics, on the calling thread alone; what a call returns is on the
    processor.
    """

    def __init__(
        self,
        kinematics: HandKinematics,
        settings: SinglePoseSettings | None = None,
        *,
        sources: Sequence[PoseSource] = (),
    ) -> None:
        """kinematics: float64. sources: of first poses where detected keypoints do not tell or are wrong."""
        self.kinematics, self.settings, self._sources = kinematics, settings or SinglePoseSettings(), tuple(sources)
        self.device = kinematics.default_shape.device

    @torch.inference_mode()
    @single_threaded()
    def __call__(self, view: View, camera: Camera, *, shape: Float[Tensor, "shape"] | None = None) -> SinglePose:
        """The hand in a view: a picture or a silhouette, and detected keypoints where there are some.

        shape: proportions where they are known. A hand that the picture does not bear out is refused.
        Raises ValueError for a view without picture and silhouette, or of another size than the camera's, and for a
        shape outside its bounds.
        """
        if shape is not None:
            self.kinematics.shape_space.check_one(shape)
        found = self._found(view, camera.to(device=self.device), None if shape is None else shape.to(self.device))
        return sent_to(found, HOST)

    def _found(self, view: View, camera: Camera, shape: Float[Tensor, "shape"] | None) -> SinglePose:
        work = _Work.of(view, camera, self.settings.max_side_px)
        known = self.kinematics.default_shape if shape is None else shape.double()
        if work.speaks_against and hand_odds().most < self._needed_odds(work):
            return _refused("the detector finds no hand, which nothing else in a picture outweighs", known)
        best = self._with_keypoints(work, known, shape is not None)
        if best is None or best.objection:
            best = self._better(best, self._alone(work, known, shape is not None))
        if best is None:
            colourless = work.mask is None and work.image is not None and is_grey(work.image)
            nothing = "nothing in the picture has the colours of skin and a believable size"
            return _refused(GREY if colourless else nothing, known)
        if best.objection:
            return _refused(best.objection, known)
        return self._result(best, work, view, camera.to(dtype=torch.float64), is_shape_known=shape is not None)

    @torch.inference_mode()
    @single_threaded()
    def hypotheses(self, view: View, camera: Camera) -> tuple[list[HandHypothesis], Camera]:
        """All hands that are weighed in a view without detected keypoints, and the camera, perhaps of a reduced
        picture, in which they were registered. Raises ValueError as a call does."""
        work = _Work.of(view, camera.to(device=self.device), self.settings.max_side_px)
        return self._hypotheses(work, self.kinematics.default_shape, is_shape_known=False), work.camera

    def _with_keypoints(self, work: "_Work", shape: Tensor, is_shape_known: bool) -> _Judged | None:
        """The hand that detected keypoints tell of, which the outline chooses among those that explain them."""
        starts = work.by_keypoints(self.kinematics, self.settings, shape)
        if starts is None:
            return None
        found = self._problem(work).of_keypoints(starts, shape)
        return self._refined(work, found, shape, is_shape_known) if len(found) else None

    def _alone(self, work: "_Work", shape: Tensor, is_shape_known: bool) -> _Judged | None:
        """The likeliest hand of all silhouettes that the picture may show, and of those that it gives itself."""
        found = self._hypotheses(work, shape, is_shape_known)
        if not found:
            return None
        best, needed = max(found, key=lambda one: one.odds), self._needed_odds(work)
        if best.judged.objection or best.odds >= needed:
            return best.judged
        told = f"log odds {best.odds:.1f}, {needed:.3g} or more expected"
        told += ", as the detector finds no hand" if work.speaks_against else ""
        return replace(
            best.judged, objection=f"what has its colours is more likely something else than a hand ({told})"
        )

    def _needed_odds(self, work: "_Work") -> float:
        """Logarithm of the odds with which a hand is believed that no detected keypoints tell of."""
        return self.settings.alone_odds - (SILENCE if work.speaks_against else 0.0)

    def _hypotheses(self, work: "_Work", shape: Tensor, is_shape_known: bool) -> list[HandHypothesis]:
        """A hand on every silhouette, and those on the silhouettes that the likeliest of them gives."""
        given = [work.mask] if work.mask is not None else [] if work.image is None else silhouettes_by_skin(work.image)
        found = [self._proposed(work, mask, shape, is_shape_known=True) for mask in given]
        first = [one for one in found if one is not None]
        told = [self._weighed(work, one, [other for other in first if other is not one]) for one in first]
        best = max(told, key=lambda one: one.odds, default=None)
        if best is None or work.mask is not None or best.odds < self._needed_odds(work) - _HOPELESS:
            return told
        others = [one for one in first if one is not best.judged]
        again = self._recut(work, best.judged, shape, is_shape_known)
        return told + [self._weighed(work, one, others) for one in again]

    def _proposed(self, work: "_Work", mask: Tensor, shape: Tensor, *, is_shape_known: bool) -> _Judged | None:
        """The hand that the sources of first poses lead to in a silhouette."""
        parts = [source(mask, work.image, work.camera, shape) for source in self._sources]
        starts = HandPose.cat(parts) if parts else None
        if starts is None or not len(starts):
            return None
        return self._registered(work, mask, starts, shape, is_shape_known=is_shape_known)

    def _recut(self, work: "_Work", best: _Judged, shape: Tensor, is_shape_known: bool) -> list[_Judged]:
        """Hands on the silhouettes that a hand gives where it is placed: by a graph cut, and by its colours."""
        if work.image is None:
            return []
        where = (best.hand.pose, self.kinematics, work.camera, shape)
        masks = (cut_at(work.image, best.mask, *where), silhouette_at(work.image, *where))
        found = []
        for mask in masks:
            if mask is None or not bool(mask.any()):
                continue
            parts = [source(mask, work.image, work.camera, shape) for source in self._sources]
            starts = HandPose.cat((best.hand.pose.reshape(1), *parts))
            found.append(self._registered(work, mask, starts, shape, is_shape_known=is_shape_known))
        return [one for one in found if one is not None]

    def _weighed(self, work: "_Work", one: _Judged, others: Sequence[_Judged]) -> HandHypothesis:
        """A hand with the evidence for it, beside those on other silhouettes."""
        hand, scene = one.hand, work.scene(one.mask)
        told = {"overlap": one.agreement.overlap, "edges": hand.edges}
        evidence = evidence_for(hand.pose, hand.shape, scene, work.camera, self.kinematics, **told)
        if work.mask is None:
            rest = [other.hand for other in others]
            evidence = supported(evidence, one.hand, rest, work.camera, self.kinematics)
        return HandHypothesis(judged=one, evidence=evidence, odds=hand_odds()(evidence))

    def _refined(self, work: "_Work", starts: HandPose, shape: Tensor, is_shape_known: bool) -> _Judged | None:
        """A hand registered on what has the colours that it has where it is placed, over and over; the first of the
        starts (k) tells where."""
        best: _Judged | None = None
        pose = starts[0]
        for turn in range(_ROUNDS):
            mask = work.mask
            if mask is None and work.image is not None:
                mask = silhouette_at(work.image, pose, self.kinematics, work.camera, shape)
            if mask is None or not bool(mask.any()):
                break
            is_last = turn == _ROUNDS - 1 or work.mask is not None
            found = self._registered(work, mask, starts, shape, is_shape_known=is_shape_known or not is_last)
            best = found or best
            if found is None or is_last:
                break
            pose = found.hand.pose
            starts = HandPose.cat((pose.reshape(1), starts))
        return best

    def _registered(
        self, work: "_Work", mask: Tensor, starts: HandPose, shape: Tensor, *, is_shape_known: bool
    ) -> _Judged | None:
        further = self._by_network(work, mask, starts[0].normalized(), shape)
        problem = self._problem(work, further)
        hand = problem.registered(starts, mask, work.image, shape, is_shape_known=is_shape_known)
        if hand is None:
            return None
        compare = SilhouetteComparison(self.kinematics, (work.camera,), hand.shape, side_px=_CHECK_SIDE_PX)
        agreement = compare(hand.pose, work.scene(mask))
        by_keypoints = work.seen(self.kinematics, self.settings).agreement(hand.pose, hand.shape)
        is_detected = by_keypoints is not None and by_keypoints >= MIN_KEYPOINTS
        objection = self._objection(hand, agreement, is_detected=is_detected)
        if not objection and not is_detected and oval_overlap(mask) > _OVAL:
            objection = "what has its colours is a plain oval, which a face may be as well"
        return _Judged(hand=hand, mask=mask, agreement=agreement, objection=objection)

    def _by_network(self, work: "_Work", mask: Tensor, near: HandPose, shape: Tensor) -> tuple[PostureKeypoints, ...]:
        """Beside a detector's posture: that which the network sees in the silhouette of the hand near a pose ()."""
        if work.camera.kind != "pinhole" or not work.seen(self.kinematics, self.settings).postures:
            return ()
        seen = seen_posture(work.scene(mask), work.camera, self.kinematics, near, shape)
        if seen is None:
            return ()
        posture = learned_observations(seen, near)[0]
        return (replace(posture, precision=_NETWORK_WORTH * posture.precision),)

    def _problem(self, work: "_Work", further: tuple[PostureKeypoints, ...] = ()) -> PictureProblem:
        detected = work.seen(self.kinematics, self.settings).observations
        return PictureProblem(
            kinematics=self.kinematics,
            camera=work.camera,
            observations=(*detected, *work.in_space(self.kinematics, self.settings), *further),
        )

    def _objection(self, hand: Registered, agreement: Agreement, *, is_detected: bool) -> str:
        s = self.settings
        told = f"overlap {agreement.overlap:.2f}, {hand.edges:.0%} of the outline explained"
        overlap, edges = (s.min_overlap, s.min_edges) if is_detected else (s.alone_overlap, s.alone_edges)
        if agreement.overlap < overlap or hand.edges < edges:
            return f"no hand explains what has its colours ({told})"
        return ""

    @staticmethod
    def _better(one: _Judged | None, other: _Judged | None) -> _Judged | None:
        if one is None or other is None:
            return one or other
        return other if other.score > one.score else one

    def _result(self, best: _Judged, work: "_Work", view: View, camera: Camera, *, is_shape_known: bool) -> SinglePose:
        hand, agreement = best.hand, best.agreement
        space = PictureProblem(kinematics=self.kinematics, camera=camera).space
        at = hand.pose.normalized()
        posed = posed_gaussian(at, hand.covariance, space.about(at.dofs), self.kinematics, hand.shape)
        scale_std = unknown_scale_std(self.kinematics.shape_space, camera, is_shape_known=is_shape_known)
        evidence = self._evidence(best, work, posed.tip_std)
        quality, fingers = qualities(evidence, "single")
        estimate = Estimate(
            status="tracked",
            time_s=0.0,
            pose=posed.pose,
            pose_std=posed.pose_std,
            keypoints=posed.keypoints,
            keypoints_px=camera.project(posed.keypoints)[None],
            keypoints_cov=posed.keypoints_cov + scale_covariance(posed.keypoints, scale_std),
            overlaps=agreement.overlaps,
            overlap=agreement.overlap,
            unexplained=agreement.most_unexplained,
            edges=hand.edges,
            quality=quality,
            finger_quality=fingers,
            evidence=evidence,
            score=best.score,
            views=1,
        )
        return SinglePose(estimate=estimate, shape=hand.shape, modes=hand.modes)

    def _evidence(self, best: _Judged, work: "_Work", tip_std: Float[Tensor, "5"]) -> Float[Tensor, "5 evidence"]:
        hand, scene, camera = best.hand, work.scene(best.mask), work.camera
        pose, learned = hand.pose.normalized(), None
        if camera.kind == "pinhole":
            learned = seen_posture(scene, camera, self.kinematics, pose, hand.shape)
        told = Told(
            pose=pose,
            shape=hand.shape,
            tip_std=tip_std,
            agreement=best.agreement,
            keypoints=work.seen(self.kinematics, self.settings),
            learned=learned,
            direction=None if learned is None else float(learned.direction_agreement(pose.rotation)),
        )
        return FingerEvidence(self.kinematics, (camera,))(told, scene)


@dataclass(frozen=True, kw_only=True)
class _Work:
    """A view as it is worked on: not larger than is needed."""

    camera: Camera
    """float64, the world's frame its own."""
    image: Tensor | None
    mask: Tensor | None
    keypoints: HandKeypoints | None
    is_detector_silent: bool

    @property
    def speaks_against(self) -> bool:
        """Whether a detector finds no hand in a picture of which nobody else has found one."""
        return self.is_detector_silent and self.mask is None

    @cached_property
    def plain(self) -> Scene:
        """Without a silhouette by colours."""
        return self.scene(self.mask)

    @classmethod
    def of(cls, view: View, camera: Camera, max_side_px: int) -> "_Work":
        for name, picture in (("image", view.image), ("mask", view.mask)):
            if picture is not None and picture.shape[:2] != (camera.height, camera.width):
                got = f"{picture.shape[1]}×{picture.shape[0]} px"
                raise ValueError(
                    f"view.{name}: expected {camera.width}×{camera.height} px as the camera says, got {got}"
                )
        if view.image is None and view.mask is None:
            raise ValueError("view: expected a picture or a silhouette, got neither")
        here = camera.to(dtype=torch.float64).at_origin()
        device = here.rotation.device
        scale = max_side_px / max(camera.width, camera.height)
        image, mask, keypoints = view.image, view.mask, view.keypoints
        if scale < 1:
            here = here.resized(scale)
            size = (here.width, here.height)
            image = None if image is None else _shrunk(image, size)
            mask = None if mask is None else _shrunk(255 * mask.to(torch.uint8), size) > 127
            keypoints = _scaled(keypoints, scale)
        seen = sent_to(View(image=image, mask=mask, keypoints=keypoints), device)
        return cls(
            camera=here,
            image=seen.image,
            mask=seen.mask,
            keypoints=seen.keypoints,
            is_detector_silent=view.is_detector_silent,
        )

    def scene(self, mask: Tensor | None) -> Scene:
        return Scene(
            views=(View(image=self.image, mask=mask, keypoints=self.keypoints),),
            masks=(mask,),
            probabilities=(None,),
            time_s=0.0,
        )

    def seen(self, kinematics: HandKinematics, settings: SinglePoseSettings) -> SceneKeypoints:
        """Detected keypoints and the posture that they tell."""
        return scene_keypoints(self.plain, (self.camera,), kinematics, settings.keypoints)

    def in_space(self, kinematics: HandKinematics, settings: SinglePoseSettings) -> tuple[RelativeKeypoints, ...]:
        """Detected points in space as they are, beside the posture that they tell."""
        if self.keypoints is None or not self.seen(kinematics, settings).postures:
            return ()
        assert self.keypoints.points is not None
        points = self.keypoints.points.to(torch.float64)[None]
        return (RelativeKeypoints.of_points(points, kinematics, self.camera),)

    def by_keypoints(self, kinematics: HandKinematics, settings: SinglePoseSettings, shape: Tensor) -> HandPose | None:
        """Hands (k) where detected keypoints are: as these alone tell it, and in that posture seen from other sides,
        for points in a picture do not tell near from far."""
        detected = detected_hand(self.plain, (self.camera,), kinematics, settings.keypoints, shape)
        if detected is None:
            return None
        seen = self.seen(kinematics, settings)
        turned = [starts_in_picture(one, shape, detected.dofs, _TURNED).reshape(-1) for one in seen.pictures]
        return HandPose.cat((detected.reshape(1), *turned))


def _shrunk(picture: Tensor, size: tuple[int, int]) -> Tensor:
    return torch.from_numpy(cv2.resize(picture.cpu().contiguous().numpy(), size, interpolation=cv2.INTER_AREA))


def _scaled(keypoints: HandKeypoints | None, scale: float) -> HandKeypoints | None:
    if keypoints is None:
        return None
    points_px = (keypoints.points_px + 0.5) * scale - 0.5
    return HandKeypoints(points_px=points_px, points=keypoints.points, score=keypoints.score)


def _refused(reason: str, shape: Tensor) -> SinglePose:
    return SinglePose(estimate=Estimate(status="no_hand", time_s=0.0, reason=reason), shape=shape)
