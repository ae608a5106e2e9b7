"""Pure tensor geometry: rotations, cameras, quadrics and conics. Knows no hand."""

from torchhand.geometry.cameras import Camera, assumed_camera
from torchhand.geometry.quadrics import (
    RayHits,
    cone,
    conic_of_quadric,
    ellipsoid,
    evaluate,
    half_space,
    meet_rays,
    moved,
    orthographic_conic_of_quadric,
    plane_pair,
    quadratic_roots,
    ray_coefficients,
    ray_table,
    slab,
)
from torchhand.geometry.rotations import (
    exponential_coefficients,
    left_jacobian,
    rotation_from_vector,
    skew,
    vector_from_rotation,
)
from torchhand.geometry.tapered_capsules import tapered_capsule_depth

__all__ = [
    "Camera",
    "RayHits",
    "assumed_camera",
    "cone",
    "conic_of_quadric",
    "ellipsoid",
    "evaluate",
    "exponential_coefficients",
    "half_space",
    "left_jacobian",
    "meet_rays",
    "moved",
    "orthographic_conic_of_quadric",
    "plane_pair",
    "quadratic_roots",
    "ray_coefficients",
    "ray_table",
    "rotation_from_vector",
    "skew",
    "slab",
    "tapered_capsule_depth",
    "vector_from_rotation",
]
