"""Where a posture lies in a silhouette: place, angle, scale and which side faces the camera, without a first guess.

The palm is the largest disc in the hand's silhouette (forearms are narrower), so centres and radii of inscribed discs give
place and scale; the angle is searched about the inertia axis and all around. Hypotheses are judged by a chamfer distance in
both directions, blind beyond the wrist, where a forearm may or may not follow.
"""

import itertools
import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import DOFS, HandKinematics
from torchhand.view import HandProjector

_WORK_SIDE_PX = 200  # pictures are searched at this size
_CANON_PX = 160  # size of the picture in which a posture is drawn once
_CANON_DEPTH = 2.0  # metres: far enough that the drawing is nearly orthographic
_ANGLES = 48
_SCALES = (0.72, 0.8, 0.9, 1.0, 1.1, 1.22, 1.35)
_CENTRES = 4
_REACH = 0.5  # distances are cut off at this share of the palm's radius
_SPREADS = (1.0, 0.35)  # the posture is tried with its abductions as they are and with narrower ones
_COARSE_POINTS, _FINE_POINTS = 110, 260  # outline points compared in the search and in its refinement
_REFINED = 12  # distinct hypotheses refined

# world_from_hand of a hand upright before the camera: fingers up, palm or back towards the camera, for the right hand; the
# left hand's are the same, its frame being mirrored.
FACING = {
    "palm": ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)),
    "back": ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0)),
}


def facing_rotation(facing: str, *, dtype: torch.dtype = torch.float64) -> Float[Tensor, "3 3"]:
    """cam_from_hand of an upright hand that shows its palm or its back."""
    axes = torch.tensor(FACING[facing], dtype=dtype)  # columns are the images of x, y and z
    return axes.T.contiguous()


def turned_in_picture(rotation: Float[Tensor, "3 3"], angle: float) -> Float[Tensor, "3 3"]:
    """The orientation after a turn about the optical axis, radians, clockwise in the picture."""
    c, s = math.cos(angle), math.sin(angle)
    return torch.tensor(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)), dtype=rotation.dtype) @ rotation


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """A posture placed over a silhouette."""

    pose: Float[Tensor, "36"]
    root_reference: Float[Tensor, "3 3"]
    """cam_from_hand"""
    facing: str
    cost: float
    """Mean cut-off chamfer distance of both directions, 0 (perfect) to 1."""


@dataclass(frozen=True, kw_only=True)
class _Template:
    """One posture drawn once: palm at the origin, in units of the palm's radius, fingers up."""

    facing: str
    pose: Tensor  # the posture that is drawn
    edge: np.ndarray  # (n, 2) boundary points that an image should show
    distance: np.ndarray  # distance map of the boundary, units of the radius
    pixels_per_radius: float
    centre_px: np.ndarray
    wrist_y: float  # beyond this line (down) is forearm
    metres_per_radius: float
    centre_offset: np.ndarray  # palm centre relative to the hand's origin in the camera frame, metres


@dataclass(frozen=True)
class _Candidate:
    """A template laid over the reduced silhouette."""

    cost: float
    template: _Template
    centre: np.ndarray  # of the palm, px
    radius: float  # of the palm, px
    angle: float  # from upright, radians


def _boundary(mask: np.ndarray) -> np.ndarray:
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.concatenate([c[:, 0] for c in contours]).astype(np.float64) if contours else np.zeros((0, 2))


def _edge_distance(points: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    canvas = np.full(shape, 255, np.uint8)
    index = points.astype(int)
    canvas[index[:, 1], index[:, 0]] = 0
    return cv2.distanceTransform(canvas, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)


def draw_template(kinematics: HandKinematics, shape: Tensor, pose: Tensor, facing: str) -> _Template:
    camera = assumed_camera(_CANON_PX, _CANON_PX, horizontal_fov_deg=10.0)
    rotation = facing_rotation(facing)
    placed = pose.clone()
    placed[:6] = 0
    middle = rotation @ torch.tensor((0.0, 0.5 * float(shape[0]), 0.0), dtype=pose.dtype)
    placed[:2], placed[2] = -middle[:2], _CANON_DEPTH
    mask = HandProjector(kinematics, camera, shape).silhouette(placed, rotation).numpy().astype(np.uint8)
    inscribed = cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    radius = float(inscribed.max())
    centre = np.argwhere(inscribed >= radius - 0.5).mean(0)[::-1]
    wrist = camera.project(placed[:3])
    points = _boundary(mask)
    wrist_y = (float(wrist[1]) - 0.15 * radius - centre[1]) / radius
    metres_per_px = _CANON_DEPTH / float(camera.intrinsics[0, 0])
    return _Template(
        facing=facing,
        pose=pose,
        edge=(points[(points[:, 1] - centre[1]) / radius < wrist_y] - centre) / radius,
        distance=_edge_distance(points, mask.shape) / radius,
        pixels_per_radius=radius,
        centre_px=centre,
        wrist_y=wrist_y,
        metres_per_radius=radius * metres_per_px,
        centre_offset=(centre - wrist.numpy()) * metres_per_px,
    )


def align_posture(
    mask: Bool[Tensor, "height width"],
    camera: Camera,
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
    pose: Float[Tensor, "36"],
    *,
    facings: tuple[str, ...] = ("palm", "back"),
    keep: int = 4,
) -> list[Alignment]:
    """The best placements of a posture over a silhouette, best first, distinct in place and angle; [] for an empty mask.

    The world is the camera's frame. Depth comes from scale: the shape's metric size is taken as true.
    """
    height, width = mask.shape
    scale = min(1.0, _WORK_SIDE_PX / max(height, width))
    small = cv2.resize(mask.numpy().astype(np.uint8) * 255, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    small = (small > 127).astype(np.uint8)
    edge = _boundary(small)
    if len(edge) < 20:
        return []
    distance = _edge_distance(edge, small.shape)
    found: list[_Candidate] = []
    discs = _discs(small)
    inner = (edge[:, 0] > 1) & (edge[:, 1] > 1) & (edge[:, 0] < small.shape[1] - 2) & (edge[:, 1] < small.shape[0] - 2)
    edge = edge[inner]  # the picture's border is no outline
    coarse = _thinned(edge, _COARSE_POINTS)
    angles = np.linspace(-math.pi, math.pi, _ANGLES, endpoint=False) + _inertia_angle(small)
    is_spread = torch.tensor([name.endswith("_aa") for name in DOFS])
    for facing, spread in itertools.product(facings, _SPREADS):
        variant = torch.where(is_spread, spread * pose, pose)
        template = draw_template(kinematics, shape, variant, facing)
        for centre, radius in discs:
            costs = _costs(template, distance, coarse, centre, radius, angles, _SCALES, _COARSE_POINTS)
            for i in np.argsort(costs, axis=None)[:12]:
                a, s = np.unravel_index(i, costs.shape)
                found.append(_Candidate(float(costs[a, s]), template, centre, radius * _SCALES[s], float(angles[a])))
    fine = _thinned(edge, _FINE_POINTS)
    refined = [_refine(candidate, distance, fine) for candidate in _distinct(found, _REFINED)]
    return [
        _placed(c, (c.centre + 0.5) / scale - 0.5, c.radius / scale, camera) for c in _distinct(refined, keep)
    ]


def _thinned(points: np.ndarray, count: int) -> np.ndarray:
    return points[:: max(1, len(points) // count)]


def _distinct(candidates: list[_Candidate], count: int) -> list[_Candidate]:
    """The best candidates that differ in side, place, angle or scale."""
    chosen: list[_Candidate] = []
    for one in sorted(candidates, key=lambda c: c.cost):
        if all(_differs(one, other) for other in chosen):
            chosen.append(one)
        if len(chosen) == count:
            break
    return chosen


def _differs(one: _Candidate, other: _Candidate) -> bool:
    turn = abs(math.remainder(one.angle - other.angle, 2 * math.pi))
    apart = float(np.hypot(*(one.centre - other.centre))) / max(one.radius, other.radius)
    return one.template.facing != other.template.facing or turn > 0.12 or apart > 0.25


def _discs(mask: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Largest inscribed discs of the silhouette with distinct centres: candidates for the palm."""
    inscribed = cv2.distanceTransform(np.pad(mask, 1), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    discs: list[tuple[np.ndarray, float]] = []
    left = inscribed.copy()
    while len(discs) < _CENTRES:
        y, x = np.unravel_index(int(left.argmax()), left.shape)
        radius = float(left[y, x])
        if radius < 2 or (discs and radius < 0.55 * discs[0][1]):
            break
        discs.append((np.array((x, y), float), radius))
        cv2.circle(left, (int(x), int(y)), max(2, int(1.2 * radius)), 0.0, -1)
    return discs


def _inertia_angle(mask: np.ndarray) -> float:
    """Angle of the silhouette's long axis from the upright, radians; a direction is left open."""
    moments = cv2.moments(mask, binaryImage=True)
    return 0.5 * math.atan2(2 * moments["mu11"], moments["mu20"] - moments["mu02"]) + math.pi / 2


def _lookup(grid: np.ndarray, points: np.ndarray, outside: float) -> np.ndarray:
    x, y = np.rint(points[..., 0]).astype(int), np.rint(points[..., 1]).astype(int)
    inside = (x >= 0) & (y >= 0) & (x < grid.shape[1]) & (y < grid.shape[0])
    return np.where(inside, grid[np.where(inside, y, 0), np.where(inside, x, 0)], outside)


def _costs(
    template: _Template,
    distance: np.ndarray,
    edge: np.ndarray,
    centre: np.ndarray,
    radius: float,
    angles: np.ndarray,
    scales: tuple[float, ...],
    points: int,
) -> np.ndarray:
    """Chamfer cost of every angle and scale: the template's edge on the picture's, and the picture's on the template's."""
    size = radius * np.array(scales)
    turn = np.stack((np.cos(angles), -np.sin(angles), np.sin(angles), np.cos(angles)), -1).reshape(-1, 2, 2)
    model = _thinned(template.edge, points)
    there = np.einsum("aij,nj->ani", turn, model)[:, None] * size[:, None, None] + centre
    # A point that falls outside the picture says nothing, but a hand that is mostly outside is not believed.
    forward = np.minimum(_lookup(distance, there, np.nan) / size[:, None], _REACH)
    seen = np.isfinite(forward)
    ahead = np.where(seen, forward, 0).sum(-1) / np.maximum(seen.sum(-1), 1)
    ahead = ahead + 0.5 * _REACH * (1 - seen.mean(-1))
    back = np.einsum("aji,nj->ani", turn, edge - centre)[:, None] / size[:, None, None]
    is_hand = back[..., 1] < template.wrist_y
    behind = _lookup(template.distance, back * template.pixels_per_radius + template.centre_px, _REACH)
    behind = np.minimum(behind, _REACH)
    backward = np.where(is_hand, behind, 0).sum(-1) / np.maximum(is_hand.sum(-1), 1)
    backward = np.where(is_hand.sum(-1) < 10, _REACH, backward)
    return 0.5 * (ahead + backward) / _REACH


def _refine(candidate: _Candidate, distance: np.ndarray, edge: np.ndarray) -> _Candidate:
    """Coordinate descent over place, angle and scale with shrinking steps."""
    best = replace(candidate, cost=math.inf)
    shift, turn, stretch = 0.25 * candidate.radius, 0.07, 0.08
    still = np.zeros(2)
    for _ in range(10):
        moves = [(still, 0.0, 1.0), (still, turn, 1.0), (still, -turn, 1.0), (still, 0.0, 1 + stretch), (still, 0.0, 1 - stretch)]
        moves += [(np.array(d) * shift, 0.0, 1.0) for d in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        trials = []
        for d, t, s in moves:
            centre, radius, angle = best.centre + d, best.radius * s, best.angle + t
            cost = _costs(best.template, distance, edge, centre, radius, np.array((angle,)), (1.0,), _FINE_POINTS)
            trials.append(_Candidate(float(cost[0, 0]), best.template, centre, radius, angle))
        winner = min(trials, key=lambda c: c.cost)
        if winner is trials[0]:
            shift, turn, stretch = 0.5 * shift, 0.5 * turn, 0.5 * stretch
        best = winner
    return best


def _placed(candidate: _Candidate, centre_px: np.ndarray, radius_px: float, camera: Camera) -> Alignment:
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
    *,
    facings: tuple[str, ...] = ("palm", "back"),
) -> list[Alignment]:
    """The placements whose wrist and middle fingertip project to two points that the user gives, one per facing.

    Hand parallel to the picture; depth from the distance of the two points.
    """
    wrist, tip = (camera.plane_from_pixels(torch.tensor(p, dtype=pose.dtype)) for p in (wrist_px, tip_px))
    found = []
    for facing in facings:
        straight = pose.clone()
        straight[:6] = 0
        rotation = facing_rotation(facing)
        keypoints = kinematics(straight, shape, root_reference=rotation).keypoints
        reach = (keypoints[12] - keypoints[0])[:2]
        span = tip - wrist
        scale = float(span.norm() / reach.norm())
        angle = float(torch.atan2(span[1], span[0]) - torch.atan2(reach[1], reach[0]))
        placed = straight.clone()
        depth = 1.0 / scale if camera.kind == "pinhole" else 1.0
        placed[:2], placed[2] = wrist * depth if camera.kind == "pinhole" else wrist, depth
        found.append(Alignment(pose=placed, root_reference=turned_in_picture(rotation, angle), facing=facing, cost=0.0))
    return found
