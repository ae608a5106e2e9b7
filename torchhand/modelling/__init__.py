"""How the mesh of a hand model is made: a smooth union of its parts, an even mesh of it, weights and shape basis."""

from torchhand.modelling.build import build_mesh, build_steps

__all__ = [
    "build_mesh",
    "build_steps",
]
