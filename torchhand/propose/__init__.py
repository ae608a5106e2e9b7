"""Proposals: from the view of a silhouette to several weighted hands, by a small network. Trained in `learn`."""

from torchhand.propose.channels import CHANNELS, gaussian_blur_of, network_channels
from torchhand.propose.hypotheses import HandHypotheses, Silhouette, propose_hands
from torchhand.propose.network import ProposalNetwork, ViewedHands, picture_layers
from torchhand.propose.posture import LearnedPosture, learned_posture
from torchhand.propose.presence import PresenceNetwork, hand_presence
from torchhand.propose.views import SIDE_PX, SquareViews, palm_middle, views_towards

__all__ = [
    "CHANNELS",
    "SIDE_PX",
    "HandHypotheses",
    "LearnedPosture",
    "PresenceNetwork",
    "ProposalNetwork",
    "Silhouette",
    "SquareViews",
    "ViewedHands",
    "gaussian_blur_of",
    "hand_presence",
    "learned_posture",
    "network_channels",
    "palm_middle",
    "picture_layers",
    "propose_hands",
    "views_towards",
]
