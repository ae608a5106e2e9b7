"""Keypoints of posed hands as a detector defines them, their derivatives, and the cost of points that missed them."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import constant_tensor, kept, read_back
from torchhand.errors import require
from torchhand.fit import Equations, PosedHands, Stage
from torchhand.hand import KEYPOINT_BONES, KEYPOINTS, HandFrames, HandKinematics, PoseJacobian, ShapeJacobian
from torchhand.numerics import RobustLoss

_POINTS = len(KEYPOINTS)
_GROSS = 3.0  # standard deviations beyond which a point counts for less (Geman and McClure)


@dataclass(frozen=True, kw_only=True)
class KeypointSettings:
    """How far detected points are believed, where nothing better is known of the detector.

    The standard deviation in a picture and what points have in common are those of MediaPipe's points in seven
    recordings of known hands: 4 to 6.5 mm along each axis, a quarter of the variance common to all points of a hand.
    """

    std_m: float = 0.005
    """Standard deviation of a point in a picture, metres at the hand; above 0."""
    space_std_m: float = 0.010
    """Standard deviation of a point of known place in space, metres; above 0."""
    angle_error: float = 1.0
    """Standard deviation of a joint angle by points in space, over that measured of MediaPipe's; above 0."""
    correlation: float = 0.2
    """Share of a point's variance that it has in common with the others: what all points together are worth is that
    much less. 0 or more, below 1."""
    min_score: float = 0.3
    """Smallest score of a detector's hand that is taken at all; 0 to 1."""

    def __post_init__(self) -> None:
        require(0 <= self.min_score <= 1, "keypoints.min_score", "0 to 1", self.min_score)
        for name in ("std_m", "space_std_m", "angle_error"):
            require(
                0 < getattr(self, name) < float("inf"), f"keypoints.{name}", "above 0 and finite", getattr(self, name)
            )
        require(0 <= self.correlation < 1, "keypoints.correlation", "0 or more and below 1", self.correlation)

    @property
    def weight(self) -> float:
        """What a point counts among 21 that are correlated."""
        return 1 / (1 + self.correlation * (_POINTS - 1))

    def trust(
        self, distance: Float[Tensor, "k 21"], std: "Float[Tensor, '#k 21'] | float", own_std_m: float, stage: Stage
    ) -> Float[Tensor, "k 21"]:
        """What points at some distance from the hand count; distance and std are in one unit, own_std_m is that std in
        metres."""
        gross = max(1.0, stage.gross_m / own_std_m / _GROSS) * _GROSS  # coarse stages must reach their points
        return self.weight * (1 + (distance / (gross * std)).square()).square().reciprocal()


@dataclass(frozen=True, kw_only=True)
class Detector:
    """What is constant about the maker of keypoints: the unit of points in space, and where its keypoints lie.

    The two may be unknown: they are then the numbers after the shape among the shared unknowns (`PosedHands.extra`),
    first the scale, then the offsets; the lags of cameras (`ViewLag`) come after them.
    """

    log_scale: Float[Tensor, ""]
    """Logarithm of the metres per unit of points in space."""
    offsets: Float[Tensor, "21 3"]
    """The maker's keypoints less ours in the frames of the bones that they are the ends of, metres; of a right hand."""
    has_unknown_scale: bool = False
    has_unknown_offsets: bool = False

    @classmethod
    def known(cls, like: Tensor) -> "Detector":
        """The detector of points in metres, at our own keypoints."""
        return _known_detector(like.dtype, like.device)

    @property
    def extra(self) -> Float[Tensor, "extra"]:
        """The unknown ones as one vector."""
        parts = [self.log_scale.reshape(1)] if self.has_unknown_scale else []
        parts += [self.offsets.flatten()] if self.has_unknown_offsets else []
        return torch.cat(parts) if parts else self.offsets.new_zeros(0)

    def at(self, extra: Float[Tensor, "extra"] | None) -> "Detector":
        """The detector with other values of its unknown properties, which come first; None keeps its own."""
        if extra is None or not len(self.extra):
            return self
        log_scale = extra[0] if self.has_unknown_scale else self.log_scale
        offsets = extra[self._offsets_at].unflatten(0, (_POINTS, 3)) if self.has_unknown_offsets else self.offsets
        return replace(self, log_scale=log_scale, offsets=offsets)

    @property
    def _offsets_at(self) -> slice:
        """Place of the offsets among the unknowns after the shape."""
        first = int(self.has_unknown_scale)
        return slice(first, first + 3 * _POINTS)

    @cached_property
    def _has_ours(self) -> bool:
        """Whether its keypoints are known to lie where ours do."""
        return not self.has_unknown_offsets and not read_back(self.offsets).any()

    def keypoints(self, kinematics: HandKinematics, hands: PosedHands) -> Float[Tensor, "k 21 3"]:
        """The maker's keypoints of posed hands, metres in the world."""
        frames = frames_of(kinematics, hands)
        if self._has_ours:
            return frames.keypoints
        offsets, bones = self.at(hands.extra).offsets, _keypoint_bones(frames)
        return frames.keypoints + (bones @ (_mirror(kinematics, offsets) * offsets)[..., None]).squeeze(-1)

    def pose_jacobian(self, kinematics: HandKinematics, hands: PosedHands) -> Float[Tensor, "k 21 3 36"]:
        """Derivative of `keypoints` in the DOFs."""
        if self._has_ours:
            return pose_jacobian(kinematics, hands)
        frames = replace(frames_of(kinematics, hands), keypoints=self.keypoints(kinematics, hands))
        return pose_jacobian_of(kinematics)(hands.pose.dofs, frames)

    def shared_jacobian(self, kinematics: HandKinematics, hands: PosedHands) -> Float[Tensor, "k 21 3 c"]:
        """Derivative of `keypoints` in the shared unknowns; 0 in the scale and in what is not this detector's."""
        assert hands.unknowns is not None
        frames = frames_of(kinematics, hands)
        of_shape = shape_jacobian_of(kinematics, hands.unknowns.columns)(frames, hands.shape)
        found = torch.nn.functional.pad(of_shape, (0, len(hands.unknowns.extra)))
        if self.has_unknown_offsets:
            each = torch.arange(_POINTS, device=found.device)
            bones = _keypoint_bones(frames) * _mirror(kinematics, found)
            after_shape = found[..., len(hands.unknowns.columns) :]
            after_shape[..., self._offsets_at].unflatten(-1, (_POINTS, 3))[:, each, :, each] = bones.movedim(1, 0)
        return found


def _mirror(kinematics: HandKinematics, like: Tensor) -> Float[Tensor, "3"]:
    """What turns offsets of a right hand's bones into those of this hand."""
    return constant_tensor((1.0, 1.0, 1.0 if kinematics.side == "right" else -1.0), like.dtype, like.device)


def _keypoint_bones(frames: HandFrames) -> Float[Tensor, "k 21 3 3"]:
    """Rotations of the bones that the keypoints are the ends of."""
    rotation = frames.rotation
    return rotation.index_select(1, constant_tensor(KEYPOINT_BONES, torch.long, rotation.device))


@kept(8)
def _known_detector(dtype: torch.dtype, device: torch.device) -> Detector:
    nothing = torch.zeros(_POINTS, 3, dtype=dtype, device=device)
    return Detector(log_scale=nothing.new_zeros(()), offsets=nothing)


def equations_of_points(
    missed: Float[Tensor, "k 21 d"],
    precision: Float[Tensor, "k 21"],
    loss: RobustLoss | None,
    rows: Float[Tensor, "k 21 d 36"],
    shared: Float[Tensor, "k 21 d c"] | None,
) -> Equations:
    """Normal equations of ½ Σ precision · |missed|², or of a robust loss of it; points of precision 0 do not count."""
    known = torch.where(precision[..., None] > 0, missed, 0.0)
    weight = precision[..., None].expand_as(known)
    if loss is None:
        cost = 0.5 * (weight * known.square()).flatten(1).sum(-1)
    else:
        cost, slope = loss.cost_and_weights((known * precision.sqrt()[..., None]).flatten(1))
        weight = weight * slope.unflatten(1, known.shape[1:])
    return Equations.of_rows(
        known.flatten(1),
        weight.flatten(1),
        rows.flatten(1, 2).contiguous(),  # products of strided matrices are slow
        cost,
        shared=None if shared is None else shared.flatten(1, 2).contiguous(),
    )


def trusted_fraction(weight: Float[Tensor, "k 21"], trust: Float[Tensor, "k 21"]) -> Float[Tensor, "k"]:
    """Share of the known points (weight above 0) that are trusted by half of the best one at least."""
    highest = trust.amax(-1, keepdim=True).clamp_min(1e-30)
    is_trusted = (trust > 0.25 * highest) & (weight > 0)
    return is_trusted.sum(-1).to(trust) / (weight > 0).sum(-1).clamp_min(1)


def frames_of(kinematics: HandKinematics, hands: PosedHands) -> HandFrames:
    """Bones and keypoints of posed hands; computed once for all factors."""
    pose = hands.pose
    return hands.once(
        ("frames", id(kinematics)), lambda: kinematics(pose.dofs, hands.shape, root_reference=pose.reference)
    )


def keep_frames(kinematics: HandKinematics, hands: PosedHands, frames: HandFrames) -> None:
    """Have `frames_of` one hand return what is known already; frames: of that hand, without a batch."""
    own = {name: getattr(frames, name)[None] for name in ("rotation", "position", "keypoints")}
    hands.once(("frames", id(kinematics)), lambda: HandFrames(**own))


def pose_jacobian(kinematics: HandKinematics, hands: PosedHands) -> Float[Tensor, "k 21 3 36"]:
    """Derivative of our own keypoints; computed once for all factors."""
    return hands.once(
        ("keypoint jacobian", id(kinematics)),
        lambda: pose_jacobian_of(kinematics)(hands.pose.dofs, frames_of(kinematics, hands)),
    )


@kept(8)
def pose_jacobian_of(kinematics: HandKinematics) -> PoseJacobian:
    """The Jacobian in all DOFs; laid out once for each kinematics module."""
    return PoseJacobian(kinematics)


@kept(8)
def shape_jacobian_of(kinematics: HandKinematics, columns: tuple[int, ...]) -> ShapeJacobian:
    """The Jacobian in some shape parameters; laid out once for each kinematics module."""
    return ShapeJacobian(kinematics, columns)
