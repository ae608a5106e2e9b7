"""What a tracker knows between two frames, and what it says of one."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.files import FrameStatus
from torchhand.hand import DOFS, FINGERS, JOINT_DOFS, HandPose
from torchhand.track.belief import FollowedHand
from torchhand.track.scene import Appearances, PackedMask, View

_SAME_TIME_S = 1e-3
_TURN = 0.7  # radians of joint angles that a radian of the hand's own turn is worth, where frames are told apart
_BENDING = [DOFS.index(f"{finger}_{joint}_fe") for finger in FINGERS[1:] for joint in ("mcp", "pip")]
_OPEN_BELOW = math.radians(45.0)
REFIT_EVERY = 10
"""Frames from one fit with larger steps of a hand that declines to the next at least."""


def posture_features(pose: HandPose) -> Float[Tensor, "*batch 39"]:
    """Coordinates of postures with their directions, radians: how far two of them are apart is how differently they
    show a hand. pose: (*batch), with zero rotation vectors."""
    turn = _TURN * pose.reference.flatten(-2) / 2**0.5  # Frobenius distance of rotations: √2 of a small angle
    return torch.cat((pose.dofs[..., -len(JOINT_DOFS) :], turn), -1)


@dataclass(frozen=True, kw_only=True)
class Keyframe:
    """A hand that was found at some time, to start from there at others."""

    time_s: float
    pose: HandPose
    """Pose with a zero rotation vector."""

    def is_of(self, time_s: float) -> bool:
        """Whether it is of this very time."""
        return abs(self.time_s - time_s) < _SAME_TIME_S


@dataclass(frozen=True, kw_only=True)
class ShapeFrame:
    """What a frame tells of the proportions of a hand that is followed."""

    pose: HandPose
    """Pose with a zero rotation vector."""
    masks: tuple[PackedMask | None, ...] = ()
    """Silhouettes of all views of several cameras; None where there is none."""
    views: tuple[View, ...] = ()
    """The view of one camera: of its picture and mask the part about the hand, keypoints in pixels of the whole."""
    corner: tuple[int, int] = (0, 0)
    """Row and column of the whole picture at which that part begins."""
    time_s: float = 0.0
    """Time of that view."""

    def distance(self, pose: HandPose) -> float:
        """Radians from a posture with its direction, which has a zero rotation vector, to this one."""
        return float((posture_features(self.pose) - posture_features(pose)).norm())


@dataclass(frozen=True, kw_only=True)
class TrackerState:
    """Everything a tracker knows between two frames; `Tracker.step` takes one and returns the next."""

    time_s: float | None = None
    """Time of the last frame; None before the first."""
    detected_s: float | None = None
    """Time of the last frame in which a detector found the hand; None before the first."""
    hand: FollowedHand | None = None
    """The hand that is followed; None while there is none."""
    shape: Float[Tensor, "shape"] | None = None
    """The proportions; None until they are known."""
    shape_keypoints_cov: Float[Tensor, "21 3 3"] | None = None
    """What their uncertainty adds to the keypoints' covariances, tracker's world, m²; None where that is not known."""
    expected: Float[Tensor, "3"] | None = None
    """Where the followed hand was expected at that time, world frame, metres: about there the hull of the next frame is
    carved. None where no hand was followed, or no hull is used."""
    appearance: Appearances = ()
    """Appearance of the hand, view by view; empty until it is known."""
    posture: Float[Tensor, "36"] | None = None
    """Posture of the first hand as it was fitted, for which a search looks."""
    last_seen: Keyframe | None = None
    """Where the hand was last borne out, and when; None before the first time."""
    keyframes: tuple[Keyframe, ...] = ()
    """Hands that were found before tracking began."""
    shape_frames: tuple[ShapeFrame, ...] | None = None
    """Frames so far to which the proportions are fitted while a hand is followed; None where these stand."""
    shape_fitted_to: int = 0
    """How many of these frames the proportions are fitted to already."""
    usual_score: float = 0.0
    """How much of the pictures the frames before were explained, 0 to 1; 0 before there is one."""
    best_score: float = 0.0
    """Best score of the frames before, which is forgotten slowly."""
    frames_since_search: int = 0
    search_after: int = 0
    """Frames after which a search without any guess is due."""
    searches_in_vain: int = 0
    """Searches without any guess that found no hand since one did."""
    frames_since_refit: int = 0
    """Frames since a followed hand was fitted once more with larger steps."""
    refit_after: int = REFIT_EVERY
    """Frames after which such a fit is due."""
    digits_tried: tuple[bool, ...] = ()
    """Digits that have lain outside the silhouette of one camera since they were last tried bent, and those that might
    have covered what is left out of it since they were last tried straight; empty for none."""
    frames_since_alternatives: int = 0
    """Frames since other hands were tried in the place of a degraded one."""
    alternatives_after: int = 0
    """Frames after which other hands are tried in the place of a degraded one."""
    alternatives_tried: int = 0
    """Attempts in which one source of other hands was asked: the next one asks the next source."""
    score_in_vain: float | None = None
    """Score of the hand that stayed degraded when others were last tried, 0 where there was none; None where these
    helped."""
    frames_since_colours: int = 0
    """Good frames since colours were last learned."""
    has_started: bool = False
    """Whether a hand was ever found."""
    picture_scale: float = 1.0
    """How much larger the pictures of one camera are made, along a side, so that the hand is large enough in them."""

    @property
    def began_open(self) -> bool:
        """Whether the first hand had no finger bent much: which side it shows is then known from its outline."""
        return self.posture is not None and bool((self.posture[_BENDING] < _OPEN_BELOW).all())

    @property
    def is_search_due(self) -> bool:
        """Whether a search was made at this time, or would be where the hand is in doubt."""
        return self.frames_since_search == 0 or self.frames_since_search >= self.search_after

    def is_shape_due(self, counts: Iterable[int]) -> bool:
        """Whether the frames are as many as one of some counts, and the proportions are not fitted to so many yet."""
        count = len(self.shape_frames or ())
        return any(self.shape_fitted_to < wanted <= count for wanted in counts)

    def with_shape(
        self,
        shape: Float[Tensor, "shape"],
        frames: tuple[ShapeFrame, ...],
        *,
        is_last: bool,
        keypoints_cov: Float[Tensor, "21 3 3"] | None = None,
    ) -> "TrackerState":
        """The state with proportions that are fitted to its frames, with which these go on, or which stand.

        keypoints_cov: what their uncertainty adds to the keypoints' covariances, where that is known."""
        kept, count = (None, 0) if is_last else (frames, len(frames))
        return replace(self, shape=shape, shape_keypoints_cov=keypoints_cov, shape_frames=kept, shape_fitted_to=count)


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """One frame's result. Where status is lost or no_hand the hand's own fields are None."""

    status: FrameStatus
    time_s: float
    pose: Float[Tensor, "36"] | None = None
    """Full pose with the root's whole rotation vector, metres and radians; the world's frame, which is that of the
    camera where there is one."""
    pose_std: Float[Tensor, "36"] | None = None
    """Standard deviations, 0 for DOFs that are held; those of the root's rotation are of a small turn in the world's
    axes."""
    keypoints: Float[Tensor, "21 3"] | None = None
    """Keypoints in metres, world frame."""
    keypoints_px: Float[Tensor, "views 21 2"] | None = None
    """Keypoints in every camera's picture."""
    keypoints_cov: Float[Tensor, "21 3 3"] | None = None
    """Square metres: the belief's covariance and what no filter can know."""
    overlaps: Float[Tensor, "views"] | None = None
    """Intersection over union with every view's silhouette, forearm cut at the wrist; NaN in views that are missing,
    and in those of several whose pictures hardly show the hand."""
    overlap: float | None = None
    """Mean over the views."""
    unexplained: float | None = None
    """Area of a picture's hand outside the model, in pieces as thick as a finger and in squares of the hand's
    length."""
    edges: float | None = None
    """Share of the contour, or of the silhouettes' edges, that is found where the hand says."""
    inside: float | None = None
    """Share of the skin inside the hull of all silhouettes; None without a hull."""
    nis: float | None = None
    """Normalised innovation squared per accepted measurement; None where it means nothing."""
    quality: float | None = None
    """Probability that no fingertip is more than 20 mm from where it is, as `torchhand evaluate` judges the status: for
    one camera across the line of sight, for several in space."""
    finger_quality: Float[Tensor, "5"] | None = None
    """Probability that each fingertip, thumb to little, lies within 20 mm of where it is, once the two hands are laid
    over one another; below `torchhand.files.results.DETERMINED` the finger is not determined."""
    evidence: Float[Tensor, "5 evidence"] | None = None
    """What these probabilities are made of: columns of `torchhand.track.quality.EVIDENCE`."""
    score: float = 0.0
    """How much of the pictures is explained, 0 to 1."""
    views: int = 0
    """Views that the hand was compared with."""
    is_new: bool = False
    """Whether the hand was found otherwise than by following it from the frame before."""
    is_doubted: bool = False
    """Whether other hands were to be looked for, where the step was not to."""
    reason: str = ""
    """Why a frame is lost or without a hand."""
