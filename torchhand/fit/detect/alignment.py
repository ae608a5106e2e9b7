"""Where a posture lies in a picture: place, angle, scale and which side faces the camera, without a first guess.

The palm is the largest disc in the hand's silhouette (forearms are narrower), so centres and radii of inscribed discs
give place and scale; the angle is searched about the inertia axis and all around. Hypotheses are judged by a chamfer
distance in both directions, blind beyond the wrist, where a forearm may or may not follow.
"""

import itertools
import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.devices import on_host
from torchhand.fit.detect.chamfer import Candidate, chamfer_costs, distinct, refined, thinned
from torchhand.fit.detect.facing import facing_rotation, turned_in_picture
from torchhand.fit.detect.template import boundary, draw_template, edge_distance
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandKinematics
from torchhand.image import depth_map, mask_moments

_WORK_SIDE_PX = 200  # pictures are searched at this size
_ANGLES = 48
_SCALES = (0.72, 0.8, 0.9, 1.0, 1.1, 1.22, 1.35)  # palm radii tried, over that of the disc
_FACINGS = ("palm", "back")
_SPREADS = (1.0, 0.35)  # the posture is tried with its abductions as they are and with narrower ones
_COARSE_POINTS, _FINE_POINTS = 110, 260  # outline points compared in the search and in its refinement
_BEST = 12  # placements kept of each disc and template
_REFINED = 12  # distinct placements refined
_MIN_EDGE_POINTS = 20
_DISCS = 4  # places tried for the palm
_MIN_RADIUS_PX = 2.0
_MIN_RADIUS_RATIO = 0.55  # smallest radius of a disc over that of the largest
_BLANKED = 1.2  # no two discs have centres nearer than so many radii


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """A posture placed over a picture."""

    pose: Float[Tensor, "36"]
    """Metres and radians, camera frame, with a zero rotation vector."""
    root_reference: Float[Tensor, "3 3"]
    """Rotation cam_from_hand."""
    facing: str
    """Side that the camera sees: palm or back."""
    cost: float
    """Mean cut-off chamfer distance of both directions, 0 (perfect) to 1."""


@on_host
def align_posture(
    mask: Bool[Tensor, "height width"],
    camera: Camera,
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
    pose: Float[Tensor, "36"],
    *,
    keep: int = 4,
) -> list[Alignment]:
    """The best placements of a posture over a silhouette, best first, distinct in side, place and angle.

    An empty list where the silhouette is empty or tiny. The hand is held parallel to the picture. The world is the
    camera's frame. Depth comes from scale: the shape's metric size is taken as true; an orthographic camera has no
    depth, so there the shape must have the size that the picture shows.
    """
    height, width = mask.shape
    scale = min(1.0, _WORK_SIDE_PX / max(height, width))
    small = cv2.resize(
        mask.cpu().numpy().astype(np.uint8) * 255, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
    )
    small = (small > 127).astype(np.uint8)
    edge = boundary(small)
    if len(edge) < _MIN_EDGE_POINTS:
        return []
    distance = edge_distance(edge, small.shape)
    found: list[Candidate] = []
    discs = _discs(small)
    inner = (edge[:, 0] > 1) & (edge[:, 1] > 1) & (edge[:, 0] < small.shape[1] - 2) & (edge[:, 1] < small.shape[0] - 2)
    edge = edge[inner]  # the picture's border is no outline
    coarse = thinned(edge, _COARSE_POINTS)
    angles = np.linspace(-math.pi, math.pi, _ANGLES, endpoint=False) + _inertia_angle(small)
    is_spread = torch.tensor([name.endswith("_aa") for name in DOFS])
    for facing, spread in itertools.product(_FACINGS, _SPREADS):
        variant = torch.where(is_spread, spread * pose, pose)
        template = draw_template(kinematics, shape, variant, facing)
        for centre, radius in discs:
            sizes = radius * np.array(_SCALES)
            costs = chamfer_costs(template, distance, coarse, centre, sizes, angles, _COARSE_POINTS)
            for i in np.argsort(costs, axis=None)[:_BEST]:
                a, s = np.unravel_index(i, costs.shape)
                found.append(Candidate(float(costs[a, s]), template, centre, float(sizes[s]), float(angles[a])))
    fine = thinned(edge, _FINE_POINTS)
    better = [refined(candidate, distance, fine, _FINE_POINTS) for candidate in distinct(found, _REFINED)]
    return [_placed(c, (c.centre + 0.5) / scale - 0.5, c.radius / scale, camera) for c in distinct(better, keep)]


def _discs(mask: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Largest inscribed discs of the silhouette with distinct centres, and their radii: candidates for the palm."""
    inscribed = depth_map(torch.from_numpy(mask > 0), is_border_outside=True).numpy()
    discs: list[tuple[np.ndarray, float]] = []
    left = inscribed.copy()
    while len(discs) < _DISCS:
        y, x = np.unravel_index(int(left.argmax()), left.shape)
        radius = float(left[y, x])
        if radius < _MIN_RADIUS_PX or (discs and radius < _MIN_RADIUS_RATIO * discs[0][1]):
            break
        discs.append((np.array((x, y), float), radius))
        cv2.circle(left, (int(x), int(y)), max(2, int(_BLANKED * radius)), 0.0, -1)
    return discs


def _inertia_angle(mask: np.ndarray) -> float:
    """Angle of the silhouette's long axis from the upright, radians; a direction is left open."""
    return float(mask_moments(torch.from_numpy(mask > 0)).axis_angle) + math.pi / 2


def _placed(candidate: Candidate, centre_px: np.ndarray, radius_px: float, camera: Camera) -> Alignment:
    """The pose in the camera frame whose picture is the aligned template."""
    template, angle = candidate.template, candidate.angle
    focal_px = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
    is_pinhole = camera.kind == "pinhole"
    depth = focal_px * template.metres_per_radius / radius_px if is_pinhole else 1.0
    placed = template.pose.clone()
    centre_m = camera.plane_from_pixels(torch.tensor(centre_px, dtype=placed.dtype)) * (depth if is_pinhole else 1.0)
    c, s = math.cos(angle), math.sin(angle)
    offset = torch.tensor(np.array(((c, -s), (s, c))) @ template.centre_offset, dtype=placed.dtype)
    placed[:2], placed[2], placed[3:6] = centre_m - offset, depth, 0.0
    reference = turned_in_picture(facing_rotation(template.facing), angle)
    return Alignment(pose=placed, root_reference=reference, facing=template.facing, cost=candidate.cost)


def align_points(
    wrist_px: tuple[float, float],
    tip_px: tuple[float, float],
    camera: Camera,
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
    pose: Float[Tensor, "36"],
) -> list[Alignment]:
    """The placements whose wrist and middle fingertip project to two points that the user gives, one per facing.

    Hand parallel to the picture; depth from the distance of the two points. An orthographic camera has no depth: there
    the wrist and the direction are kept. Raises ValueError for two points that are one.
    """
    wrist, tip = (camera.plane_from_pixels(torch.tensor(p, dtype=pose.dtype)) for p in (wrist_px, tip_px))
    span = tip - wrist
    if not bool(span.norm() > 0):
        raise ValueError(f"start points: expected two different points, got {wrist_px} twice")
    found = []
    for facing in _FACINGS:
        straight = pose.clone()
        straight[:6] = 0
        rotation = facing_rotation(facing, dtype=pose.dtype)
        keypoints = kinematics(straight, shape, root_reference=rotation).keypoints
        reach = keypoints[12] - keypoints[0]
        placed = straight.clone()
        if camera.kind == "pinhole":
            depth = _depth_of_span(span, tip, reach)
            across = depth * span + reach[2] * tip  # of the turned reach: the fingertip may be nearer than the wrist
            placed[:2], placed[2] = depth * wrist, depth
        else:
            across = span
            placed[:2], placed[2] = wrist, 1.0
        angle = float(torch.atan2(across[1], across[0]) - torch.atan2(reach[1], reach[0]))
        found.append(Alignment(pose=placed, root_reference=turned_in_picture(rotation, angle), facing=facing, cost=0.0))
    return found


def _depth_of_span(span: Float[Tensor, "2"], tip: Float[Tensor, "2"], reach: Float[Tensor, "3"]) -> Tensor:
    """Depth of the wrist, metres, at which the reach from wrist to fingertip, turned, spans the normalised picture.

    Larger root of |depth · span + reach_z · tip|² = |reach_xy|².
    """
    a, b = span @ span, reach[2] * (span @ tip)
    c = reach[2] ** 2 * (tip @ tip) - reach[:2] @ reach[:2]
    return (-b + (b * b - a * c).clamp_min(0).sqrt()) / a
