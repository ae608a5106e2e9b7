"""A hand that may be the one in the pictures, and what speaks for it."""

from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import cosine_between
from torchhand.hand import HandFrames, HandPose
from torchhand.propose import LearnedPosture
from torchhand.track.belief import FollowedHand
from torchhand.track.scene.agreement import Agreement, PlacedHand

_PALM_M = 0.05  # from the wrist to the middle of the palm
_DIRECTION_KEPT = 0.8  # share of the direction's agreement that outlasts a frame


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A hand estimated from one scene."""

    hand: FollowedHand
    pose: HandPose
    placed: PlacedHand | None = None
    """The hand of that pose before the cameras; None where that has to be computed."""
    agreement: Agreement
    edges: float
    """Fraction of the contour, or of the silhouettes' edges, that is found where the hand predicts it."""
    in_view: float = 1.0
    """Fraction of the visible contour inside the pictures."""
    nis: float | None = None
    """Normalised innovation squared per accepted measurement; None where it means nothing."""
    inside: float | None = None
    """Share of the skin inside the hull of all silhouettes; None where there is no hull."""
    keypoints: float | None = None
    """How far the hand is the one that a detector found, 0 to 1; None where it found none."""
    direction: float | None = None
    """How far a network that looks where the hand is bears out its direction, 0 to 1
    (`LearnedPosture.direction_agreement`); None where none was asked."""
    learned: LearnedPosture | None = None
    """What that network sees there; None where none was asked."""
    cost: float = 0.0
    """Cost in nats, comparable between candidates of one scene; 0 where the update has none."""
    is_sound: bool = True
    """Whether the estimate explains enough; one that does not is degraded, whatever the frames before explained."""
    if_failing: FollowedHand | None = None
    """Hand to go on with where the scene does not bear this one out; None stands for `hand` itself."""

    @property
    def frames(self) -> HandFrames | None:
        """Bones and keypoints of the pose, where they are known."""
        return None if self.placed is None else self.placed.frames

    @property
    def overlap(self) -> float:
        return self.agreement.overlap

    @property
    def palm(self) -> Float[Tensor, "3"]:
        """About the middle of the palm, metres."""
        return self.pose.dofs[:3] + _PALM_M * self.rotation[:, 1]

    @property
    def rotation(self) -> Float[Tensor, "3 3"]:
        """world_from_hand"""
        return self.pose.rotation

    def is_turned_from(self, facing: Float[Tensor, "3 3"]) -> bool:
        """Whether the hand is turned by more than a quarter turn; facing: world_from_hand of another one."""
        return float(cosine_between(facing, self.rotation)) < 0

    def remembering(self, direction: float | None) -> "Candidate":
        """The hand with the network's agreement over the frames up to this one; as it is where there is none of this
        frame. direction: that over the frames before; None where there were none."""
        here = self.direction
        if here is None:
            return self
        if direction is not None:
            here = _DIRECTION_KEPT * direction + (1 - _DIRECTION_KEPT) * here
        return replace(self, direction=here, hand=replace(self.hand, direction=here))
