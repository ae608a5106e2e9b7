"""Learning of proposals: random hands of the simulator, what cameras and segmentations make of them, the training."""

from torchhand.learn.proposals.figures import FIGURES, ProposalFigures, figures_table, proposal_figures
from torchhand.learn.proposals.measuring import measured_on_pictures, measured_on_views
from torchhand.learn.proposals.observing import observed_channels, seen_hands
from torchhand.learn.proposals.pictures import PosedPicture, posed_pictures
from torchhand.learn.proposals.rendering import RENDERED_PX, RenderedHands, hand_pool, stored_bytes
from torchhand.learn.proposals.training import Progress, ProposalTraining, generator_of, new_network, train_proposals

__all__ = [
    "FIGURES",
    "RENDERED_PX",
    "PosedPicture",
    "Progress",
    "ProposalFigures",
    "ProposalTraining",
    "RenderedHands",
    "figures_table",
    "generator_of",
    "hand_pool",
    "measured_on_pictures",
    "measured_on_views",
    "new_network",
    "observed_channels",
    "posed_pictures",
    "proposal_figures",
    "seen_hands",
    "stored_bytes",
    "train_proposals",
]
