"""Learning of proposals: random hands of the simulator, what cameras and segmentations make of them, the training."""

from torchhand.learn.proposals.figures import FIGURES, ProposalFigures, figures_table, proposal_figures
from torchhand.learn.proposals.measuring import measured_on_pictures, measured_on_views
from torchhand.learn.proposals.pictures import PosedPicture, posed_pictures
from torchhand.learn.proposals.rendering import hand_pool
from torchhand.learn.proposals.training import Progress, ProposalTraining, new_network, train_proposals

__all__ = [
    "FIGURES",
    "PosedPicture",
    "Progress",
    "ProposalFigures",
    "ProposalTraining",
    "figures_table",
    "hand_pool",
    "measured_on_pictures",
    "measured_on_views",
    "new_network",
    "posed_pictures",
    "proposal_figures",
    "train_proposals",
]
