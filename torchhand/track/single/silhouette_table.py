"""Postures drawn from many sides once, and laid over a silhouette all together: first poses where nothing is known."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.fit.detect import facing_rotation
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector
from torchhand.hand import DOFS, HandKinematics, HandPose, HandPrior, place_primitives
from torchhand.image import depth_map, hand_region
from torchhand.view import HandProjector
from torchhand.view.outlines import generators

_YAWS, _PITCHES_DEG = 8, (-35.0, 0.0, 35.0)  # of the views: about the hand's long axis, and towards the camera
_FIELD_DEG, _DEPTH_M = 20.0, 2.0  # of the drawings: nearly orthographic
_DRAWN_PX = 128
_CELLS = 36  # of a side of the compared windows
_HALF_WIDTH = 6.0  # of a window, palm radii about the palm's centre: a hand's length beyond the fingertips and the wrist
_STEEP = 0.25  # a palm seen shorter than this, hand lengths, has no direction in the picture
_FOREARMS_DEG = (-30.0, 0.0, 30.0)  # turns of a bare forearm about the wrist, as seen in the picture
_SLEEVES = (0.5, 4.0)  # where a forearm ends, hand lengths from the wrist
_FOREARM_BREADTH = 0.32  # hand lengths; ANSUR II: a wrist is 0.33 hand lengths broad and 0.22 thick
_BEYOND = 0.7  # what a cell beyond the wrist counts: sleeves hide forearms anywhere
_ANGLES = 24  # turns in the picture
_SCALES = (0.85, 1.0, 1.18)  # radii of the palm that are tried, over that of the disc
_WORK_SIDE_PX = 160
_DISCS = 4  # places tried for the palm
_MIN_RADIUS_PX = 2.0
_MIN_RADIUS_RATIO = 0.5  # smallest radius of a disc over that of the largest
_BLANKED = 1.0  # no two discs have centres nearer than so many radii
_PER_POSTURE = 3  # hypotheses of one posture

_ROOT = len(DOFS) - 30


@dataclass(frozen=True, kw_only=True)
class SilhouetteTable:
    """Silhouettes of postures from many sides, about the largest disc within each, in units of its radius."""

    poses: HandPose
    """(n), cam_from_hand, the hand's origin at the camera's."""
    posture: Int[np.ndarray, "n"]
    """Which posture each shows."""
    drawn: Float[Tensor, "n cells"]
    """The silhouettes with a bare forearm or none, times the weights."""
    weight: Float[Tensor, "n cells"]
    """What each cell counts: less beyond the wrist."""
    palm_m: Float[Tensor, "n 2"]
    """Centre of the disc from the hand's origin, x and y of the camera's frame."""
    radius_m: Float[Tensor, "n"]

    @classmethod
    def of_prior(cls, kinematics: HandKinematics, shape: Float[Tensor, "shape"]) -> "SilhouetteTable":
        """The postures of the prior's mixture, from all sides about the hand's long axis."""
        prior = HandPrior(kinematics.skeleton, kinematics.shape_space)
        joints = torch.stack([component.mean for component in prior.settings.components]).to(shape)
        views = _views().to(shape)
        dofs = shape.new_zeros(len(joints) * len(views), len(DOFS))
        dofs[:, _ROOT:] = joints.repeat_interleave(len(views), 0)
        poses = HandPose.of(dofs, views.repeat(len(joints), 1, 1))
        made = [one for i, seen in enumerate(_seen(kinematics, shape, poses)) for one in _drawn(seen, i)]
        own = torch.tensor([one.pose for one in made])
        return cls(
            poses=poses[own],
            posture=own.numpy() // len(views),
            drawn=torch.from_numpy(np.stack([one.drawn * one.weight for one in made])),
            weight=torch.from_numpy(np.stack([one.weight for one in made])),
            palm_m=torch.from_numpy(np.stack([one.palm_m for one in made])).to(shape),
            radius_m=torch.tensor([one.radius_m for one in made]).to(shape),
        )

    def placed(
        self, mask: Bool[Tensor, "height width"], camera: Camera, count: int
    ) -> tuple[HandPose, Float[np.ndarray, "k"]]:
        """The poses whose silhouettes lie best on a mask of hand and forearm, best first, and their intersection over
        union with it; at most `count`, none where the mask is empty. In the camera's frame, distortion left out."""
        scale = min(1.0, _WORK_SIDE_PX / max(mask.shape))
        pixels = mask.cpu().numpy().astype(np.float32)
        small = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else pixels
        discs = largest_discs(small > 0.5)
        if not discs:
            return HandPose.of(self.palm_m.new_zeros(0, len(DOFS))), np.zeros(0)
        turns = [2 * math.pi * step / _ANGLES for step in range(_ANGLES)]
        tried = [(x, y, r * size, turn) for (x, y, r), size, turn in itertools.product(discs, _SCALES, turns)]
        windows = torch.from_numpy(np.stack([_window(small, *one) for one in tried]))
        common = self.drawn @ windows.mT
        total = self.drawn.sum(1, keepdim=True) + self.weight @ windows.mT - common
        overlap, where = (common / total.clamp_min(1)).max(1)
        chosen = self._distinct(overlap.numpy(), count)
        places = np.array([tried[int(where[i])] for i in chosen])
        places[:, :2] = (places[:, :2] + 0.5) / scale - 0.5
        places[:, 2] /= scale
        return self._posed(chosen, torch.from_numpy(places).to(self.palm_m), camera), overlap.numpy()[chosen]

    def _distinct(self, overlap: Float[np.ndarray, "n"], count: int) -> list[int]:
        """The best ones, with few of each posture."""
        chosen: list[int] = []
        used: dict[int, int] = {}
        for i in np.argsort(-overlap, kind="stable"):
            posture = int(self.posture[i])
            if used.get(posture, 0) < _PER_POSTURE:
                used[posture] = used.get(posture, 0) + 1
                chosen.append(int(i))
            if len(chosen) == count:
                break
        return chosen

    def _posed(self, chosen: list[int], places: Float[Tensor, "k 4"], camera: Camera) -> HandPose:
        """Entries of the table with their discs at places (x, y, radius px, turn)."""
        own, (centre, radius, angle) = torch.tensor(chosen), places.split((2, 1, 1), -1)
        focal = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
        is_pinhole = camera.kind == "pinhole"
        depth = focal * self.radius_m[own, None] / radius if is_pinhole else torch.ones_like(radius)
        axis = torch.cat((torch.zeros_like(centre), angle), -1)
        turn = rotation_from_vector(axis)
        palm = torch.nn.functional.pad(self.palm_m[own], (0, 1))
        dofs = self.poses.dofs[own].clone()
        at = camera.plane_from_pixels(centre) * (depth if is_pinhole else 1.0)
        dofs[:, :3] = torch.cat((at, depth), -1) - (turn @ palm[..., None]).squeeze(-1)
        return HandPose.of(dofs, turn @ self.poses.reference[own])


def largest_discs(mask: Bool[np.ndarray, "height width"]) -> list[tuple[float, float, float]]:
    """Centre (x, y) and radius of the largest discs within a mask, distinct in place: where a palm may be."""
    left = depth_map(torch.from_numpy(mask), is_border_outside=True).numpy().copy()
    discs: list[tuple[float, float, float]] = []
    while len(discs) < _DISCS:
        y, x = np.unravel_index(int(left.argmax()), left.shape)
        radius = float(left[y, x])
        if radius < _MIN_RADIUS_PX or (discs and radius < _MIN_RADIUS_RATIO * discs[0][2]):
            break
        discs.append((float(x), float(y), radius))
        cv2.circle(left, (int(x), int(y)), max(2, int(_BLANKED * radius)), 0.0, -1)
    return discs


def _views() -> Float[Tensor, "views 3 3"]:
    """cam_from_hand of upright hands, float64."""
    upright, views = facing_rotation("palm"), []
    for step, pitch in itertools.product(range(_YAWS), _PITCHES_DEG):
        yaw = rotation_from_vector(torch.tensor((0.0, 2 * math.pi * step / _YAWS, 0.0), dtype=torch.float64))
        tilt = rotation_from_vector(torch.tensor((math.radians(pitch), 0.0, 0.0), dtype=torch.float64))
        views.append(tilt @ yaw @ upright)
    return torch.stack(views)


@dataclass(frozen=True, kw_only=True)
class _Drawn:
    """One silhouette of the table."""

    pose: int
    drawn: Float[np.ndarray, "cells"]
    weight: Float[np.ndarray, "cells"]
    palm_m: Float[np.ndarray, "2"]
    radius_m: float


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """One view of a hand, far away and in the middle of the picture."""

    mask: Float[np.ndarray, "side side"]
    wrist: Float[np.ndarray, "2"]
    knuckle: Float[np.ndarray, "2"]
    metres_per_px: float
    length_px: float


def _seen(kinematics: HandKinematics, shape: Float[Tensor, "shape"], poses: HandPose) -> Iterator[_Seen]:
    """Hands in all poses (n)."""
    camera = assumed_camera(_DRAWN_PX, _DRAWN_PX, horizontal_fov_deg=_FIELD_DEG, dtype=shape.dtype)
    projector, length = HandProjector(kinematics, camera, shape), float(kinematics.shape_space.metric(shape)["hand_length"])
    dofs, metres_per_px = poses.dofs.clone(), _DEPTH_M / float(camera.intrinsics[0, 0])
    dofs[:, :2], dofs[:, 2] = -0.5 * length * poses.reference[:, :2, 1], _DEPTH_M
    frames = kinematics(dofs, shape, root_reference=poses.reference)
    placed = place_primitives(frames, projector.sizes, is_left=kinematics.side == "left")
    cones, arcs = generators(placed, is_orthographic=False, with_normals=False)
    points = camera.project(frames.keypoints[:, [0, 9]]).numpy()
    for i in range(len(poses)):
        mask = projector.silhouette_of(placed.select(i), (cones.of_hand(i), arcs.of_hand(i)))
        yield _Seen(
            mask=mask.numpy().astype(np.float32),
            wrist=points[i, 0],
            knuckle=points[i, 1],
            metres_per_px=metres_per_px,
            length_px=length / metres_per_px,
        )


def _drawn(seen: _Seen, number: int) -> list[_Drawn]:
    """One view without a forearm and with forearms."""
    mask, towards = seen.mask, seen.wrist - seen.knuckle
    x, y, radius = largest_discs(mask > 0)[0]
    weight, pictures, span = np.ones_like(mask), [mask], float(np.linalg.norm(towards))
    if span > _STEEP * seen.length_px:
        ends = torch.from_numpy(seen.wrist), torch.from_numpy(seen.knuckle)
        weight = np.where(hand_region((_DRAWN_PX, _DRAWN_PX), *ends).numpy(), 1.0, _BEYOND).astype(np.float32)
        for turn, end in itertools.product(_FOREARMS_DEG, _SLEEVES):
            size = np.array((end, _FOREARM_BREADTH)) * seen.length_px
            pictures.append(_with_forearm(mask, seen.wrist, towards / span, math.radians(turn), size))
    cells = _window(weight, x, y, radius, 0.0, beyond=_BEYOND)
    palm = (np.array((x, y)) - seen.wrist) * seen.metres_per_px
    size = radius * seen.metres_per_px
    return [
        _Drawn(pose=number, drawn=_window(one, x, y, radius, 0.0), weight=cells, palm_m=palm, radius_m=size)
        for one in pictures
    ]


def _with_forearm(
    mask: np.ndarray, wrist: np.ndarray, towards: np.ndarray, turn: float, size_px: np.ndarray
) -> np.ndarray:
    """The silhouette with a bar from the wrist on, of a length and a breadth."""
    c, s = math.cos(turn), math.sin(turn)
    along = np.array((c * towards[0] - s * towards[1], s * towards[0] + c * towards[1]))
    across, end = 0.5 * size_px[1] * np.array((-along[1], along[0])), wrist + size_px[0] * along
    corners = np.stack((wrist - across, wrist + across, end + across, end - across))
    picture = mask.copy()
    cv2.fillConvexPoly(picture, np.rint(16 * corners).astype(np.int32), 1.0, shift=4)
    return picture


def _window(pixels: np.ndarray, x: float, y: float, radius: float, turn: float, *, beyond: float = 0.0) -> np.ndarray:
    """The cells about a disc, turned back; beyond: the value outside the picture."""
    cell = 2 * _HALF_WIDTH * radius / _CELLS
    c, s, middle = cell * math.cos(turn), cell * math.sin(turn), 0.5 * (_CELLS - 1)
    matrix = np.array(((c, -s, x - (c - s) * middle), (s, c, y - (s + c) * middle)))
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(pixels, matrix, (_CELLS, _CELLS), flags=flags, borderValue=beyond).ravel()
