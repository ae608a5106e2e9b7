"""Detected keypoints as observations: in one camera's picture, and in space up to a similarity.

A detector's points in space (such as MediaPipe's world landmarks) have an origin, a size and, for want of the camera,
an orientation of their own. What they tell is the posture, so they are compared with the hand's keypoints after the
similarity that lays them over these best.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.errors import require
from torchhand.fit import Equations, Explained, PosedHands, Stage
from torchhand.geometry import Camera
from torchhand.hand import HandFrames, HandKinematics, PoseJacobian, ShapeJacobian

IN_PICTURE, IN_SPACE = "keypoints", "keypoints in space"
_NEAREST = 0.01  # metres from the camera: points nearer than this cannot be compared
_FEWEST_IN_SPACE = 5  # points that determine a similarity and still say something of the posture


@dataclass(frozen=True, kw_only=True)
class KeypointSettings:
    """How far detected points are believed, where nothing better is known of the detector."""

    std_m: float = 0.008
    """Standard deviation of a point in a picture, metres at the hand; above 0."""
    space_std_m: float = 0.010
    """Standard deviation of a point in space after the similarity, metres at a hand of mean size; above 0."""
    gross: float = 3.0
    """Standard deviations beyond which a point counts for less (Geman and McClure); above 0."""
    correlation: float = 0.7
    """Share of a point's variance that it has in common with the others: what all points together are worth is that
    much less. 0 or more, below 1."""

    min_score: float = 0.3
    """Smallest score of a detector's hand that is taken at all; 0 to 1."""

    def __post_init__(self) -> None:
        require(0 <= self.min_score <= 1, "keypoints.min_score", "0 to 1", self.min_score)
        for name in ("std_m", "space_std_m", "gross"):
            require(
                0 < getattr(self, name) < float("inf"), f"keypoints.{name}", "above 0 and finite", getattr(self, name)
            )
        require(0 <= self.correlation < 1, "keypoints.correlation", "0 or more and below 1", self.correlation)

    @property
    def weight(self) -> float:
        """What a point counts among 21 that are correlated."""
        return 1 / (1 + self.correlation * 20)


@dataclass(frozen=True, kw_only=True)
class PictureKeypoints:
    """Points of one camera's picture; one hand for all hypotheses, or a row for each frame."""

    points_px: Float[Tensor, "#rows 21 2"]
    """NaN for missing points."""
    kinematics: HandKinematics
    camera: Camera
    settings: KeypointSettings
    view: int = 0

    @property
    def is_empty(self) -> bool:
        return not bool(self.points_px.isfinite().all(-1).any())

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "PictureKeypoints":
        """Of some of the frames; itself where the points are the same for all."""
        return self if len(self.points_px) == 1 else replace(self, points_px=self.points_px[rows])

    def associate(self, hands: PosedHands, stage: Stage) -> "PictureKeypointFactor":
        """What each point counts: less, the farther it is from the hand."""
        s = self.settings
        frames = frames_of(self.kinematics, hands)
        points = self.points_px.to(frames.keypoints).expand(len(hands), -1, -1)
        in_cam = self.camera.cam_from_world(frames.keypoints)
        scale = 0.5 * (self.camera.intrinsics[0, 0] + self.camera.intrinsics[1, 1]).to(points)
        depth = in_cam[..., 2].clamp_min(_NEAREST) if self.camera.kind == "pinhole" else torch.ones_like(in_cam[..., 2])
        std = s.std_m * scale / depth
        is_known = points.isfinite().all(-1) & (in_cam[..., 2] > _NEAREST if self.camera.kind == "pinhole" else True)
        known = torch.where(is_known[..., None], points, 0.0)
        factor = PictureKeypointFactor(
            kinematics=self.kinematics,
            camera=self.camera,
            points=known,
            weight=torch.where(is_known, std.square().reciprocal(), 0.0),
            trust=torch.ones_like(std),
            view=self.view,
        )
        distance = factor.distance(frames)
        gross = max(1.0, stage.gross_m / s.std_m / s.gross) * s.gross  # coarse stages must reach their points
        trust = (1 + (distance / (gross * std)).square()).square().reciprocal()
        return replace(factor, trust=s.weight * trust)


@dataclass(frozen=True, kw_only=True)
class PictureKeypointFactor:
    """½ Σ trust · |point - keypoint|² / std²; a row per hand."""

    kinematics: HandKinematics
    camera: Camera
    points: Float[Tensor, "k 21 2"]
    weight: Float[Tensor, "k 21"]
    """Inverse variances, px⁻²; 0 for missing points."""
    trust: Float[Tensor, "k 21"]
    """What each point counts, of what it would if it were the only one and no outlier."""
    view: int

    def distance(self, frames: HandFrames) -> Float[Tensor, "k 21"]:
        """Of every point from the hand's keypoint, px; 0 for missing ones."""
        away = self._projected(frames)[0] - self.points
        return torch.where(self.weight > 0, away.norm(dim=-1), 0.0)

    def equations(self, hands: PosedHands) -> Equations:
        """In the DOFs, and in the shape where it is unknown."""
        frames = frames_of(self.kinematics, hands)
        pixels, slopes = self._projected(frames)
        weight = (self.weight * self.trust)[..., None].expand_as(pixels).flatten(1)
        residual = torch.where(weight > 0, (pixels - self.points).flatten(1), 0.0)
        rows = (slopes @ _pose_jacobian(self.kinematics, hands)).flatten(1, 2)
        shared = None
        if hands.unknowns is not None:
            shared = (slopes @ _shape_jacobian(self.kinematics, hands)).flatten(1, 2)
        cost = 0.5 * (weight * residual.square()).sum(-1)
        return Equations.of_rows(residual, weight, rows, cost, shared=shared)

    def predict(self, hands: PosedHands) -> Float[Tensor, "k m"]:
        """Pixels of the keypoints of any number of hands, as `measurement` has them."""
        return self._projected(frames_of(self.kinematics, hands))[0].flatten(1)

    def measurement(self) -> tuple[Float[Tensor, "m"], Float[Tensor, "m"], Bool[Tensor, "m"]]:
        """Of the first row: values, variances, and which are known; for filters."""
        precision = (self.weight[0] * self.trust[0])[:, None].expand(-1, 2).flatten()
        is_known = precision > 0
        return self.points[0].flatten(), torch.where(is_known, precision, 1.0).reciprocal(), is_known

    def rows(self, rows: Int[Tensor, "n"]) -> "PictureKeypointFactor":
        """Of some of the hands."""
        return replace(self, points=self.points[rows], weight=self.weight[rows], trust=self.trust[rows])

    def explained(self) -> tuple[Explained, ...]:
        """Share of the points that are trusted by half at least; their distance counts for nothing here."""
        total = (self.weight > 0).sum(-1).clamp_min(1)
        highest = self.trust.amax(-1, keepdim=True).clamp_min(1e-30)
        share = ((self.trust > 0.25 * highest) & (self.weight > 0)).sum(-1) / total
        return (Explained(name=IN_PICTURE, view=self.view, share=share, distance=torch.zeros_like(self.weight[:, 0])),)

    def _projected(self, frames: HandFrames) -> tuple[Float[Tensor, "k 21 2"], Float[Tensor, "k 21 2 3"]]:
        """Pixels of the keypoints, and their derivative in the places in the world."""
        camera = self.camera
        in_cam = camera.cam_from_world(frames.keypoints)
        plane = camera.plane_from_cam(in_cam)
        on_plane = torch.zeros(*plane.shape, 3, dtype=plane.dtype, device=plane.device)
        if camera.kind == "pinhole":
            nearness = in_cam[..., 2].clamp_min(_NEAREST).reciprocal()
            plane = in_cam[..., :2] * nearness[..., None]
            on_plane[..., 0, 0] = on_plane[..., 1, 1] = nearness
            on_plane[..., 2] = -plane * nearness[..., None]
        else:
            on_plane[..., 0, 0] = on_plane[..., 1, 1] = 1.0
        slopes = camera.pixel_jacobian(plane) @ on_plane @ camera.rotation.to(plane)
        return camera.pixels_from_plane(plane), slopes


@dataclass(frozen=True, kw_only=True)
class SpaceKeypoints:
    """Points in space up to a similarity; one hand for all hypotheses, or a row for each frame."""

    points: Float[Tensor, "#rows 21 3"]
    """Metres, any frame; NaN for missing points."""
    kinematics: HandKinematics
    settings: KeypointSettings

    @property
    def is_empty(self) -> bool:
        return int(self.points.isfinite().all(-1).sum(-1).max()) < _FEWEST_IN_SPACE

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "SpaceKeypoints":
        """Of some of the frames; itself where the points are the same for all."""
        return self if len(self.points) == 1 else replace(self, points=self.points[rows])

    def associate(self, hands: PosedHands, stage: Stage) -> "SpaceKeypointFactor":
        """What each point counts: less, the farther it is from the hand."""
        s, keypoints = self.settings, frames_of(self.kinematics, hands).keypoints
        points = self.points.to(keypoints).expand(len(hands), -1, -1)
        is_known = points.isfinite().all(-1)
        is_known &= is_known.sum(-1, keepdim=True) >= _FEWEST_IN_SPACE
        known = torch.where(is_known[..., None], points, 0.0)
        factor = SpaceKeypointFactor(
            kinematics=self.kinematics,
            points=known,
            weight=torch.where(is_known, s.space_std_m**-2, 0.0).to(known),
            trust=torch.ones_like(known[..., 0]),
        )
        away = (keypoints - factor.laid_over(keypoints)).norm(dim=-1)
        gross = max(1.0, stage.gross_m / s.space_std_m / s.gross) * s.gross
        return replace(factor, trust=s.weight * (1 + (away / (gross * s.space_std_m)).square()).square().reciprocal())


@dataclass(frozen=True, kw_only=True)
class SpaceKeypointFactor:
    """½ Σ trust · |keypoint - similarity(point)|² / std² for the best similarity; a row per hand.

    The derivative is that of the variable projection (Kaufman 1975): what a similarity of the points can follow costs
    nothing, so that place, orientation and size of the hand are left to others.
    """

    kinematics: HandKinematics
    points: Float[Tensor, "k 21 3"]
    weight: Float[Tensor, "k 21"]
    """Inverse variances, m⁻²; 0 for missing points."""
    trust: Float[Tensor, "k 21"]

    def laid_over(self, keypoints: Float[Tensor, "k 21 3"]) -> Float[Tensor, "k 21 3"]:
        """The points after the similarity that lays them over the keypoints best (Umeyama 1991)."""
        weight = self.weight * self.trust
        total = weight.sum(-1).clamp_min(torch.finfo(weight.dtype).tiny)[:, None]
        middle, wanted = ((weight[..., None] * x).sum(-2) / total for x in (self.points, keypoints))
        own, other = self.points - middle[:, None], keypoints - wanted[:, None]
        product = (weight[..., None] * other).mT @ own
        left, singular, right = torch.linalg.svd(product)
        sign = torch.ones_like(singular)
        sign[:, 2] = torch.where(torch.linalg.det(left) * torch.linalg.det(right) < 0, -1.0, 1.0)
        spread = (weight * own.square().sum(-1)).sum(-1).clamp_min(torch.finfo(weight.dtype).tiny)
        scale = (singular * sign).sum(-1) / spread
        rotation = (left * sign[:, None]) @ right
        return scale[:, None, None] * (own @ rotation.mT) + wanted[:, None]

    def equations(self, hands: PosedHands) -> Equations:
        """In the DOFs, and in the shape where it is unknown."""
        keypoints = frames_of(self.kinematics, hands).keypoints
        laid = self.laid_over(keypoints)
        root = (self.weight * self.trust).sqrt()[..., None]
        residual = (root * (keypoints - laid)).flatten(1)
        tangent = _similarity_tangent(root, keypoints, laid)
        rows = _without(tangent, (root[..., None] * _pose_jacobian(self.kinematics, hands)).flatten(1, 2))
        shared = None
        if hands.unknowns is not None:
            shared = _without(tangent, (root[..., None] * _shape_jacobian(self.kinematics, hands)).flatten(1, 2))
        cost = 0.5 * residual.square().sum(-1)
        return Equations.of_rows(residual, torch.ones_like(residual), rows, cost, shared=shared)

    def predict(self, hands: PosedHands) -> Float[Tensor, "k m"]:
        """Keypoints of any number of hands, each laid over the points of the first row by the similarity that fits
        best:
        what of them the points can tell."""
        keypoints = frames_of(self.kinematics, hands).keypoints
        count = len(keypoints)
        inverse = SpaceKeypointFactor(
            kinematics=self.kinematics,
            points=keypoints,
            weight=self.weight[:1].expand(count, -1),
            trust=self.trust[:1].expand(count, -1),
        )
        return inverse.laid_over(self.points[:1].expand(count, -1, -1)).flatten(1)

    def measurement(self) -> tuple[Float[Tensor, "m"], Float[Tensor, "m"], Bool[Tensor, "m"]]:
        """Of the first row: values, variances, and which are known; for filters."""
        precision = (self.weight[0] * self.trust[0])[:, None].expand(-1, 3).flatten()
        is_known = precision > 0
        return self.points[0].flatten(), torch.where(is_known, precision, 1.0).reciprocal(), is_known

    def rows(self, rows: Int[Tensor, "n"]) -> "SpaceKeypointFactor":
        """Of some of the hands."""
        return replace(self, points=self.points[rows], weight=self.weight[rows], trust=self.trust[rows])

    def explained(self) -> tuple[Explained, ...]:
        """Share of the points that are trusted by half at least."""
        total = (self.weight > 0).sum(-1).clamp_min(1)
        highest = self.trust.amax(-1, keepdim=True).clamp_min(1e-30)
        share = ((self.trust > 0.25 * highest) & (self.weight > 0)).sum(-1) / total
        return (Explained(name=IN_SPACE, view=None, share=share, distance=torch.zeros_like(self.weight[:, 0])),)


def frames_of(kinematics: HandKinematics, hands: PosedHands) -> HandFrames:
    """Bones and keypoints of posed hands; computed once for all factors."""
    pose = hands.pose
    return hands.once(
        ("frames", id(kinematics)), lambda: kinematics(pose.dofs, hands.shape, root_reference=pose.reference)
    )


def _pose_jacobian(kinematics: HandKinematics, hands: PosedHands) -> Float[Tensor, "k 21 3 36"]:
    def found() -> Tensor:
        return pose_jacobian_of(kinematics)(hands.pose.dofs, frames_of(kinematics, hands))

    return hands.once(("keypoint jacobian", id(kinematics)), found)


def _shape_jacobian(kinematics: HandKinematics, hands: PosedHands) -> Float[Tensor, "k 21 3 c"]:
    """In the shared unknowns; those after the shape have no effect."""
    assert hands.unknowns is not None
    found = ShapeJacobian(kinematics, hands.unknowns.columns)(frames_of(kinematics, hands), hands.shape)
    return torch.nn.functional.pad(found, (0, len(hands.unknowns.extra)))


@lru_cache(maxsize=8)
def pose_jacobian_of(kinematics: HandKinematics) -> PoseJacobian:
    """The Jacobian in all DOFs; laid out once for each kinematics module."""
    with torch.inference_mode(False):  # kept for callers in any mode
        return PoseJacobian(kinematics)


def _similarity_tangent(
    root: Float[Tensor, "k 21 1"], keypoints: Float[Tensor, "k 21 3"], laid: Float[Tensor, "k 21 3"]
) -> Float[Tensor, "k 63 7"]:
    """An orthonormal basis of how weighted residuals change with translation, rotation and size.

    The residuals of the best similarity are at right angles to all of it: to turns of the keypoints as to those of the
    points laid over them, and to a change of these points' size.
    """
    count = len(laid)
    shift = torch.eye(3, dtype=laid.dtype, device=laid.device).expand(count, laid.shape[1], 3, 3)
    arm, size = (x - _weighted_mean(root, x) for x in (keypoints, laid))
    x, y, z = arm.unbind(-1)
    zero = torch.zeros_like(x)
    turn = torch.stack((zero, z, -y, -z, zero, x, y, -x, zero), -1).unflatten(-1, (3, 3))
    columns = torch.cat((shift, turn, size[..., None]), -1)
    basis, _ = torch.linalg.qr((root[..., None] * columns).flatten(1, 2))
    return basis


def _weighted_mean(root: Float[Tensor, "k 21 1"], points: Float[Tensor, "k 21 3"]) -> Float[Tensor, "k 1 3"]:
    weight = root.square()
    return (weight * points).sum(1, keepdim=True) / weight.sum(1, keepdim=True).clamp_min(1e-30)


def _without(basis: Float[Tensor, "k 63 7"], rows: Float[Tensor, "k 63 n"]) -> Float[Tensor, "k 63 n"]:
    """The part of the columns that is at right angles to the basis."""
    return rows - basis @ (basis.mT @ rows)
