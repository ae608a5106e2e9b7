"""Sizes of hands in a picture, and what becomes of the points of their contours there."""

from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, HandPose

_MIN_DEPTH = 1e-3  # metres before the camera
_BEYOND = 0.02  # how far beyond the contour the silhouette is looked at, share of the hand's length in the picture


def pixels_per_metre(camera: Camera, pose: HandPose) -> Float[Tensor, "*batch"]:
    """Pixels of a metre held parallel to the picture at the wrist of each hand; the pose is in the world."""
    focal = 0.5 * (camera.intrinsics[0, 0] + camera.intrinsics[1, 1]).to(pose.dofs)
    if camera.kind == "orthographic":
        return focal.expand(pose.batch_shape)
    return focal / camera.cam_from_world(pose.dofs[..., :3])[..., 2].clamp_min(_MIN_DEPTH)


def hand_length_px(
    camera: Camera, kinematics: HandKinematics, pose: Float[Tensor, "36"], shape: Float[Tensor, "shape"]
) -> float:
    """Length in the picture of a hand held parallel to it at the pose's depth; the pose is in the camera's frame."""
    focal_px = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
    length = float(shape[kinematics.shape_space.names.index("hand_length")])
    return focal_px * length / (float(pose[2]) if camera.kind == "pinhole" else 1.0)


def is_in_picture(points_px: Float[Tensor, "*points 2"], camera: Camera) -> Bool[Tensor, "*points"]:
    """Points between the centres of the picture's outermost pixels, these included."""
    x, y = points_px[..., 0], points_px[..., 1]
    return (x >= 0) & (y >= 0) & (x <= camera.width - 1) & (y <= camera.height - 1)


def is_outer(
    silhouette: Bool[Tensor, "height width"],
    points_px: Float[Tensor, "points 2"],
    normals: Float[Tensor, "points 2"],
    length_px: float,
) -> Bool[Tensor, "points"]:
    """Contour points of a hand beyond which its own silhouette ends, as against those of fingers before the palm.

    Beyond the picture nothing is hand. `length_px` is the hand's length in the picture.
    """
    height, width = silhouette.shape
    beyond = (points_px + (_BEYOND * length_px + 1) * normals).round().long()
    inside = (beyond >= 0).all(-1) & (beyond[:, 0] < width) & (beyond[:, 1] < height)
    x, y = beyond[:, 0].clamp(0, width - 1), beyond[:, 1].clamp(0, height - 1)
    return ~(inside & silhouette[y, x])
