"""A posture drawn once, upright and from afar, to be laid over silhouettes at any place, angle and scale."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.detect.facing import facing_rotation
from torchhand.geometry import assumed_camera
from torchhand.hand import HandKinematics
from torchhand.image import depth_map, distance_map
from torchhand.view import HandProjector

_SIDE_PX = 160
_FIELD_DEG = 10.0
_DEPTH = 2.0  # metres: far enough that the drawing is nearly orthographic
_ABOVE_WRIST = 0.15  # what is compared ends so far on the fingers' side of the wrist, palm radii


@dataclass(frozen=True, kw_only=True)
class Template:
    """One posture, its palm (the largest disc within it) at the origin, lengths in units of the palm's radius."""

    facing: str
    pose: Float[Tensor, "36"]
    """The posture that is drawn."""
    edge: np.ndarray
    """Boundary points (n, 2), x right and y down, that a picture should show: those above `wrist_y`."""
    distance: np.ndarray
    """Distance of every pixel of the drawing from its boundary, radii."""
    pixels_per_radius: float
    centre_px: np.ndarray
    """The palm's centre in the drawing, (x, y)."""
    wrist_y: float
    """Line beyond which (down) there may be a forearm."""
    metres_per_radius: float
    centre_offset: np.ndarray
    """Palm centre relative to the hand's origin, x and y of the camera frame, metres."""


def draw_template(
    kinematics: HandKinematics, shape: Float[Tensor, "shape"], pose: Float[Tensor, "36"], facing: str
) -> Template:
    """Draws the joint angles of `pose`; its root is left out of account."""
    camera = assumed_camera(_SIDE_PX, _SIDE_PX, horizontal_fov_deg=_FIELD_DEG, dtype=pose.dtype)
    rotation = facing_rotation(facing, dtype=pose.dtype)
    placed = pose.clone()
    placed[:6] = 0
    length = kinematics.shape_space.metric(shape)["hand_length"]
    middle = rotation @ torch.tensor((0.0, 0.5 * float(length), 0.0), dtype=pose.dtype)
    placed[:2], placed[2] = -middle[:2], _DEPTH
    drawn = HandProjector(kinematics, camera, shape).silhouette(placed, rotation)
    inscribed, mask = depth_map(drawn).numpy(), drawn.numpy().view(np.uint8)
    radius = float(inscribed.max())
    centre = np.argwhere(inscribed >= radius - 0.5).mean(0)[::-1]
    wrist = camera.project(placed[:3])
    points = boundary(mask)
    wrist_y = (float(wrist[1]) - _ABOVE_WRIST * radius - centre[1]) / radius
    metres_per_px = _DEPTH / float(camera.intrinsics[0, 0])
    return Template(
        facing=facing,
        pose=pose,
        edge=(points[(points[:, 1] - centre[1]) / radius < wrist_y] - centre) / radius,
        distance=edge_distance(points, mask.shape) / radius,
        pixels_per_radius=radius,
        centre_px=centre,
        wrist_y=wrist_y,
        metres_per_radius=radius * metres_per_px,
        centre_offset=(centre - wrist.numpy()) * metres_per_px,
    )


def boundary(mask: np.ndarray) -> np.ndarray:
    """Outermost pixels (n, 2), x and y, of the pieces of an 8-bit mask, along their outlines; holes have none."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.concatenate([c[:, 0] for c in contours]).astype(np.float64) if contours else np.zeros((0, 2))


def edge_distance(points: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Exact distance in px of every pixel of a picture of that shape from the nearest of the points."""
    marked = torch.zeros(shape, dtype=torch.bool)
    index = torch.from_numpy(points).long()
    marked[index[:, 1], index[:, 0]] = True
    return distance_map(marked).numpy()
