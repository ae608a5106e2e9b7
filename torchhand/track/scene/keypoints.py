"""Detected keypoints of a scene as observations of the hand, and the hand that they alone tell of."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import constant_tensor, kept
from torchhand.fit import PosedHands, Stage
from torchhand.fit.keypoints import KeypointSettings, PictureKeypoints, PostureKeypoints, keep_frames, place_hand
from torchhand.geometry import Camera
from torchhand.hand import FINGER_CHAINS, FINGERS, JOINT_DOFS, HandFrames, HandKinematics, HandPose
from torchhand.track.scene.views import Scene

_PALM = (0, *(chain[1] for chain in FINGER_CHAINS))  # with the thumb's base
_DIGITS = tuple(chain[2:] for chain in FINGER_CHAINS)
"""Keypoints beyond the palm, digit by digit."""
_COMPARED = Stage(gross_m=0.01)
_CREDIBLE = 2.2  # root mean square deviation of a part's three or four measurements: one in a thousand (χ²) by chance


@dataclass(frozen=True, kw_only=True)
class SceneKeypoints:
    """What detectors found in the views of one scene."""

    pictures: tuple[PictureKeypoints, ...]
    """Points in the picture of every view in which a hand was found."""
    postures: tuple[PostureKeypoints, ...]
    """Postures of the views whose detector gives points in space."""

    kept: dict[tuple[int, int], "_Compared"] = field(default_factory=dict, repr=False, compare=False)

    def hands(self, pose: HandPose, shape: Float[Tensor, "shape"], frames: HandFrames | None = None) -> PosedHands:
        """A hand () as observations are asked about it; made once for a pose. frames: of it, where they are known."""
        return self._compared(pose, shape, frames).hands

    def deviations(
        self, pose: HandPose, shape: Float[Tensor, "shape"], frames: HandFrames | None = None
    ) -> list[Float[Tensor, "21"]]:
        """Distance of every point of each picture from those of a hand (), standard deviations; NaN for missing points.
        Computed once for a pose."""
        return self._compared(pose, shape, frames).deviations(self.pictures)

    def _compared(self, pose: HandPose, shape: Tensor, frames: HandFrames | None) -> "_Compared":
        key = (id(pose), id(shape))
        if key not in self.kept:
            hands = PosedHands(pose=pose.reshape(1), shape=shape)
            if frames is not None and self.pictures:
                keep_frames(self.pictures[0].kinematics, hands, frames)
            self.kept[key] = _Compared(pose=pose, hands=hands)  # they are kept, so that no others have their numbers
        return self.kept[key]

    @property
    def observations(self) -> tuple[PictureKeypoints | PostureKeypoints, ...]:
        return (*self.pictures, *self.postures)

    def deviation(self, pose: HandPose, shape: Float[Tensor, "shape"]) -> Float[Tensor, "6"]:
        """How far the palm and the five digits of a hand lie from the detector's, in root mean square standard
        deviations: the largest over pictures and the smallest over postures, whichever is more. 0 where nothing is
        known."""
        points = self.deviations(pose, shape)
        parts = [torch.cat((_rms(one[None, list(_PALM)]), deviations_of_digits(one))) for one in points]
        found = torch.stack(parts).nan_to_num().amax(0) if parts else pose.dofs.new_zeros(1 + len(_DIGITS))
        if self.postures:
            joints = pose.dofs[None, -len(JOINT_DOFS) :]
            digits = torch.stack([one.deviation(joints)[0] for one in self.postures])
            nearest = digits.nan_to_num(nan=torch.inf).amin(0)  # of those that know of the digit
            found[1:] = torch.maximum(found[1:], nearest.where(nearest.isfinite(), 0.0))
        return found

    def contradicted(self, pose: HandPose, shape: Float[Tensor, "shape"]) -> Bool[Tensor, "6"]:
        """Whether the palm and the five digits of a hand are not credibly the detector's."""
        return self.deviation(pose, shape) > _CREDIBLE

    def agreement(
        self, pose: HandPose, shape: Float[Tensor, "shape"], frames: HandFrames | None = None
    ) -> float | None:
        """How far a hand is the detector's, 0 to 1: mean over the points in the pictures and over the fingers of the
        postures of 1 / (1 + d² / 4), d in root mean square standard deviations. None where nothing was detected."""
        joints = pose.dofs[None, -len(JOINT_DOFS) :]
        found = self.deviations(pose, shape, frames) + [one.deviation(joints)[0] for one in self.postures]
        shares = [float((1 / (1 + one[one.isfinite()] ** 2 / 4)).mean()) for one in found if bool(one.isfinite().any())]
        return sum(shares) / len(shares) if shares else None


@dataclass(frozen=True, kw_only=True)
class _Compared:
    """A hand that detected points are compared with."""

    pose: HandPose
    hands: PosedHands
    found: list[Float[Tensor, "21"]] = field(default_factory=list)

    def deviations(self, pictures: Sequence[PictureKeypoints]) -> list[Float[Tensor, "21"]]:
        if not self.found:
            self.found.extend(one.associate(self.hands, _COMPARED).deviation(self.hands)[0] for one in pictures)
        return list(self.found)


def deviations_of_digits(points: Float[Tensor, "21"]) -> Float[Tensor, "5"]:
    """Root mean squares of the known deviations of each digit's points; NaN where none is known."""
    return _rms(points[constant_tensor(_DIGITS, torch.long, points.device)])


def _rms(values: Float[Tensor, "k n"]) -> Float[Tensor, "k"]:
    return values.square().nanmean(-1).sqrt()


@kept(8)
def parts_of(dofs: tuple[str, ...], device: torch.device) -> Int[Tensor, "dofs"]:
    """Which part of the hand (as `SceneKeypoints.deviation` has them) a degree of freedom moves: 0 the whole, then
    digits."""
    names = [name.split("_")[0] for name in dofs]
    return torch.tensor(
        [1 + FINGERS.index(name) if name in FINGERS else 0 for name in names], dtype=torch.long, device=device
    )


def scene_keypoints(
    scene: Scene, cameras: Sequence[Camera], kinematics: HandKinematics, settings: KeypointSettings
) -> SceneKeypoints:
    """The detector's hands; computed once for a scene.

    Hands that a detector does not believe itself (a score below `settings.min_score`) are left out.
    """
    return scene.once("keypoints", lambda: _made(scene, cameras, kinematics, settings))


def _made(
    scene: Scene, cameras: Sequence[Camera], kinematics: HandKinematics, settings: KeypointSettings
) -> SceneKeypoints:
    pictures: list[PictureKeypoints] = []
    postures: list[PostureKeypoints] = []
    for index, (view, camera) in enumerate(zip(scene.views, cameras, strict=True)):
        seen = view.keypoints
        if seen is None or seen.score < settings.min_score:
            continue
        points_px = seen.points_px.to(torch.float64)[None]
        in_picture = PictureKeypoints(
            points_px=points_px, kinematics=kinematics, camera=camera, settings=settings, view=index
        )
        if in_picture.is_empty:
            continue
        pictures.append(in_picture)
        if seen.points is not None:
            posture = PostureKeypoints.of_points(
                seen.points.to(torch.float64)[None],
                kinematics,
                kinematics.default_shape,  # angles between bones do not depend on it
                settings,
                world_from_points=camera.rotation.to(torch.float64).mT,
                view=index,
            )
            postures += [] if posture.is_empty else [posture]
    return SceneKeypoints(pictures=tuple(pictures), postures=tuple(postures))


def with_further_postures(seen: SceneKeypoints, scene: Scene) -> SceneKeypoints:
    """Detected keypoints, and postures among the scene's further observations, such as a network's."""
    further = tuple(one for one in scene.observations if isinstance(one, PostureKeypoints))
    return replace(seen, postures=(*seen.postures, *further)) if seen.pictures else seen


def detected_hand(
    scene: Scene,
    cameras: Sequence[Camera],
    kinematics: HandKinematics,
    settings: KeypointSettings,
    shape: Float[Tensor, "shape"],
) -> HandPose | None:
    """The hand that the detected points of all views tell of, together with further postures; computed once for a
    scene. None without any points, and where none fits them."""
    seen = with_further_postures(scene_keypoints(scene, cameras, kinematics, settings), scene)

    def placed() -> HandPose | None:
        found = place_hand(seen.pictures, seen.postures, kinematics, shape)
        return None if found is None or not bool(found.cost.isfinite()) else found.pose.normalized()

    told = tuple(value for one in seen.postures for value in one.precision.flatten().tolist())
    return scene.once(("detected", told, tuple(shape.tolist())), placed)
