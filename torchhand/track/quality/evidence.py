"""What the pictures, the belief, a network and a detector say of each finger of an estimated hand."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import are_equal, kept, sent_to
from torchhand.fit.contour import hand_length_px, is_in_picture, is_outer
from torchhand.geometry import Camera
from torchhand.hand import CONE_NAMES, ELLIPSOID_NAMES, FINGERS, JOINT_DOFS, HandKinematics, HandPose
from torchhand.image import EdgeSettings, search_edges
from torchhand.propose import LearnedPosture
from torchhand.track.scene import (
    Agreement,
    AlikeViews,
    Box,
    PlacedHand,
    Scene,
    SceneKeypoints,
    SeenHand,
    deviations_of_digits,
)
from torchhand.view import HandProjector, OutlineTable, outline_table

EVIDENCE = (
    "spread",
    "outer_found",
    "outer_missed",
    "inner_found",
    "inner_missed",
    "points",
    "no_points",
    "posture",
    "learned",
    "learned_spread",
    "direction",
    "no_learned",
    "overlap",
    "unexplained",
    "curl",
    "curl_squared",
    "facing",
    "facing_found",
)
"""Columns of the evidence, each of one finger of one estimate.

spread: logarithm of the standard deviation of the fingertip about the wrist, in centimetres. outer_found, outer_missed:
shares of the contour of the middle and distal phalanx that lie on the hand's outline, with and without an edge of the
silhouette there; inner_found, inner_missed: the same of what is seen before the palm or another finger, by edges of the
grey levels; the rest is hidden. points, posture, learned: ln(1 + d²) of the finger's difference from a detector's
points in the pictures, from the posture of its points in space and from the posture that the network sees, d in root
mean square standard deviations; learned_spread: logarithm of the spread of the network's hypotheses about the finger's
angles; direction: logarithm of how far these bear out the hand's direction. All of them are 0 where there is nothing,
and then no_points and no_learned are 1. overlap: of the hand. unexplained: ln(1 + a / 0.002) of the area a of the hand
that the model leaves out, in squares of its length. curl, curl_squared: flexion of the last two joints, in half turns.
facing: how far palm or back face the cameras, 0 for a hand that is seen edge-on; facing_found: its product with
outer_found, for edge-on fingers hide one another."""

_PARTS = ("middle", "distal", "pip", "dip", "tip")
_THUMB_PARTS = ("proximal", "distal", "ip", "tip")
_OUTER = EdgeSettings(polarity="inside_bright", min_strength=0.2, choose="nearest")
_INNER = EdgeSettings(min_strength=0.04, choose="nearest")
_OUTER_REACH, _INNER_REACH = 0.025, 0.015  # shares of the hand's length: half lengths of the searches
_MIN_REACH_PX = 2.0
_SPREAD_M = 0.01
_SPECK = 0.002
_MIN_DIRECTION = 0.02
_CURLS = {finger: ("mcp", "ip") if finger == "thumb" else ("pip", "dip") for finger in FINGERS}


@dataclass(frozen=True, kw_only=True)
class Told:
    """What is known of one estimated hand."""

    pose: HandPose
    """(), in the world."""
    placed: PlacedHand | None = None
    """The hand of that pose before the cameras; None where that has to be computed."""
    shape: Float[Tensor, "shape"]
    tip_std: Float[Tensor, "5"]
    """Standard deviation of every fingertip about the wrist, metres."""
    agreement: Agreement
    keypoints: SceneKeypoints
    learned: LearnedPosture | None = None
    """What the network sees there."""
    direction: float | None = None
    """How far it bears out the hand's direction."""


class FingerEvidence:
    """Gathers the evidence of estimates of one hand in the views of a rig."""

    def __init__(self, kinematics: HandKinematics, cameras: Sequence[Camera]) -> None:
        """cameras: as they see the scene's silhouettes."""
        self.kinematics, self.cameras = kinematics, tuple(cameras)
        self._made: tuple[Tensor, list[HandProjector]] | None = None

    def __call__(self, told: Told, scene: Scene) -> Float[Tensor, "5 evidence"]:
        """A row for each finger, thumb to little, in the columns of EVIDENCE."""
        placed = _placed(self._projectors(told.shape), told) if told.placed is None else told.placed
        return self.of(told, self.borne_out(told.pose, placed, told.shape, scene))

    def of(self, told: Told, borne_out: Float[Tensor, "5 4"]) -> Float[Tensor, "5 evidence"]:
        """The same, where it is known what the views bear out (`borne_out`)."""
        joints, device = told.pose.dofs[None, -len(JOINT_DOFS) :], told.tip_std.device
        in_pictures = [deviations_of_digits(one) for one in told.keypoints.deviations(told.pose, told.shape)]
        postures = [one.deviation(joints)[0] for one in told.keypoints.postures]
        unexplained = math.log1p(told.agreement.most_unexplained / _SPECK)
        curl, facing = joints[0][_curls(device)].sum(-1) / math.pi, self._facing(told.pose)
        columns = [
            (told.tip_std.clamp_min(1e-4) / _SPREAD_M).log(),
            *borne_out.unbind(-1),
            _difference(in_pictures, device),
            torch.full((len(FINGERS),), float(not in_pictures), device=device),
            _difference(postures, device),
            *_learned(told, joints[0]).unbind(-1),
            torch.full((len(FINGERS),), told.agreement.overlap, device=device),
            torch.full((len(FINGERS),), unexplained, device=device),
            curl,
            curl.square(),
            facing.expand(len(FINGERS)),
            facing * borne_out[:, 0],
        ]
        return torch.stack([column.to(told.tip_std) for column in columns], -1)

    def borne_out(
        self, pose: HandPose, placed: PlacedHand, shape: Float[Tensor, "shape"], scene: Scene
    ) -> Float[Tensor, "5 4"]:
        """Shares of each finger's contour in all views: outer found and missed, inner found and missed.

        pose, placed: the hand (), and the same before the cameras.
        """
        counts = pose.dofs.new_zeros(len(FINGERS), 4)
        total = 0.0
        visible = placed.visible(_table(counts.device))
        for view, (projector, seen) in enumerate(zip(self._projectors(shape), placed.views, strict=True)):
            if not scene.is_known(view):
                continue
            counts += self._in_view(pose, scene, view, (projector, seen, visible[view]))
            total += 1.0
        return counts / (_points_of_fingers(counts.device) * max(1.0, total))[:, None]

    def _in_view(
        self, pose: HandPose, scene: Scene, view: int, before: tuple[HandProjector, SeenHand, Bool[Tensor, "points"]]
    ) -> Float[Tensor, "5 4"]:
        """Numbers of each finger's contour points in one view.

        before: the hand before the camera of that view, and which points the camera sees.
        """
        projector, seen, visible = before
        camera = projector.camera
        contour = projector.contour_of(seen.primitives, _table(pose.dofs.device), seen.generators, visible)
        shown = (contour.visible & is_in_picture(contour.points_px, camera)).nonzero().squeeze(-1)
        points, normals, finger = (
            values.index_select(0, shown)
            for values in (contour.points_px, contour.normals, _finger_of_point(pose.dofs.device))
        )
        in_cam = torch.cat((camera.cam_from_world(pose.dofs[:3]), pose.dofs[3:]))
        length_px = hand_length_px(camera, self.kinematics, in_cam, projector.shape)
        outer = is_outer(projector.filled(seen.polygons), points, normals, length_px)
        found = torch.zeros_like(outer)
        searches = ((outer, scene.plane_in, _OUTER, _OUTER_REACH), (~outer, scene.grey_in, _INNER, _INNER_REACH))
        for which, picture, how, reach in searches:
            if bool(which.any()):
                own, half_px = points[which], max(_MIN_REACH_PX, reach * length_px)
                box = _box_around(own, camera, how.reach_px(half_px))
                part = picture(view, box)
                if part is not None:
                    start = own.new_tensor((box[1].start, box[0].start))
                    edges = search_edges(part, own - start, normals[which], how, half_length_px=half_px)
                    found[which] = edges.found
        kind = 2 * (~outer).long() + (~found).long()
        return torch.bincount(4 * finger + kind, minlength=4 * len(FINGERS)).reshape(-1, 4).double()

    def _facing(self, pose: HandPose) -> Float[Tensor, ""]:
        """Cosine between the palm's normal and the line of sight to the wrist, without its sign; mean over the
        cameras."""
        told = []
        for camera in self.cameras:
            normal = camera.rotation.to(pose.dofs) @ pose.rotation[:, 0]
            sight = camera.cam_from_world(pose.dofs[:3])
            told.append(normal[2] if camera.kind == "orthographic" else normal @ sight / sight.norm())
        return torch.stack(told).abs().mean()

    def _projectors(self, shape: Tensor) -> list[HandProjector]:
        made = self._made
        if made is None or not (shape is made[0] or are_equal(shape, made[0])):
            made = (shape, [HandProjector(self.kinematics, camera, shape) for camera in self.cameras])
            self._made = made
        return made[1]


def _placed(projectors: Sequence[HandProjector], told: Told) -> PlacedHand:
    """The hand before the cameras, one by one."""
    frames = projectors[0].frames(told.pose.dofs, told.pose.reference)
    alike = []
    for view, projector in enumerate(projectors):
        own = projector.primitives_cam(frames)
        row = replace(own, rotation=own.rotation[None], position=own.position[None])
        alike.append(AlikeViews.of(row, (view,), is_orthographic=projector.is_orthographic))
    return PlacedHand(frames=frames, alike=tuple(alike))


def _box_around(points_px: Float[Tensor, "points 2"], camera: Camera, margin_px: float) -> Box:
    """Rows and columns of a picture around some points in it."""
    low, high = torch.stack((points_px.amin(0) - margin_px, points_px.amax(0) + margin_px)).tolist()
    columns, rows = (
        slice(max(0, math.floor(begin)), min(size, math.ceil(end) + 1))
        for begin, end, size in zip(low, high, (camera.width, camera.height), strict=True)
    )
    return rows, columns


def _difference(deviations: Sequence[Tensor], device: torch.device) -> Float[Tensor, "5"]:
    """ln(1 + d²) of the mean over those that are known; 0 where none is."""
    if not deviations:
        return torch.zeros(len(FINGERS), device=device)
    return torch.stack([one.square().log1p() for one in deviations]).nanmean(0).nan_to_num()


def _learned(told: Told, joints: Float[Tensor, "30"]) -> Float[Tensor, "5 4"]:
    """What the network says of each finger: difference, spread, direction of the hand, and whether it says nothing."""
    if told.learned is None:
        return joints.new_tensor((0.0, 0.0, 0.0, 1.0)).repeat(len(FINGERS), 1)
    variance = told.learned.variance
    missed = (joints - told.learned.joints).square() / variance
    per_finger = (missed, variance)
    deviation, spread = (one.unflatten(-1, (len(FINGERS), -1)).mean(-1) for one in per_finger)
    direction = torch.full_like(spread, math.log(max(told.direction or 0.0, _MIN_DIRECTION)))
    return torch.stack((deviation.log1p(), 0.5 * spread.log(), direction, torch.zeros_like(spread)), -1)


def _finger_of(name: str) -> int | None:
    finger, _, part = name.partition("_")
    parts = _THUMB_PARTS if finger == "thumb" else _PARTS
    return FINGERS.index(finger) if finger in FINGERS and part in parts else None


@kept(4)
def _curls(device: torch.device) -> Int[Tensor, "5 2"]:
    """Places of the last two joints' flexions among the joint angles."""
    places = [[JOINT_DOFS.index(f"{finger}_{joint}_fe") for joint in last] for finger, last in _CURLS.items()]
    return sent_to(torch.tensor(places), device)


@kept(4)
def _table(device: torch.device) -> OutlineTable:
    """Points of the fingers' last two phalanges alone."""
    names = (*CONE_NAMES, *ELLIPSOID_NAMES)
    without = tuple(name for name in names if _finger_of(name) is None)
    return sent_to(outline_table(8, 10, without=without), device)


@kept(4)
def _finger_of_point(device: torch.device) -> Int[Tensor, "points"]:
    fingers = [_finger_of(name) for name in (*CONE_NAMES, *ELLIPSOID_NAMES)]
    return torch.tensor([-1 if one is None else one for one in fingers], device=device)[_table(device).primitive]


@kept(4)
def _points_of_fingers(device: torch.device) -> Float[Tensor, "5"]:
    """Number of points that each finger has at all."""
    return torch.bincount(_finger_of_point(device), minlength=len(FINGERS)).double()
