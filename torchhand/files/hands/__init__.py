"""Hand models, their meshes, and the fitted hands of people."""

from torchhand.files.hands.hand_file import FittedHand, load_hand, save_hand
from torchhand.files.hands.hand_model import load_hand_model, read_shape_space
from torchhand.files.hands.mesh_file import load_mesh, save_mesh
from torchhand.files.hands.network_files import (
    load_presence_network,
    load_proposal_network,
    save_presence_network,
    save_proposal_network,
)
from torchhand.files.hands.skeleton_file import save_parsed_skeleton
from torchhand.files.hands.urdf import read_skeleton, skeleton_to_urdf

__all__ = [
    "FittedHand",
    "load_hand",
    "load_hand_model",
    "load_mesh",
    "load_presence_network",
    "load_proposal_network",
    "read_shape_space",
    "read_skeleton",
    "save_hand",
    "save_mesh",
    "save_parsed_skeleton",
    "save_presence_network",
    "save_proposal_network",
    "skeleton_to_urdf",
]
