"""Proposals: other hands that may explain a scene, by the shape of a posture, of a hull, by turns and fingers."""

from torchhand.track.proposals.digits import PlacedDigits
from torchhand.track.proposals.hull import hull_sources
from torchhand.track.proposals.keypoints import KeypointHand, KeypointStart
from torchhand.track.proposals.learned import LearnedHands
from torchhand.track.proposals.posture_search import PostureSearch
from torchhand.track.proposals.protocol import OCCASIONS, Occasion, Proposals, ProposalSource, Proposed
from torchhand.track.proposals.single_picture import SinglePictureHands
from torchhand.track.proposals.tilted import TiltedHands, tilted_hands

__all__ = [
    "OCCASIONS",
    "KeypointHand",
    "KeypointStart",
    "LearnedHands",
    "Occasion",
    "PlacedDigits",
    "PostureSearch",
    "ProposalSource",
    "Proposals",
    "Proposed",
    "SinglePictureHands",
    "TiltedHands",
    "hull_sources",
    "tilted_hands",
]
