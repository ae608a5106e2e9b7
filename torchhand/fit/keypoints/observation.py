"""Keypoints that a detector found in one camera's picture, as an observation."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import read_back
from torchhand.fit import Equations, Explained, PosedHands, Stage
from torchhand.fit.keypoints.points import (
    Detector,
    KeypointSettings,
    equations_of_points,
    frames_of,
    trusted_fraction,
)
from torchhand.fit.keypoints.rig import ViewLag
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics
from torchhand.numerics import RobustLoss

IN_PICTURE = "keypoints"
_NEAREST = 0.01  # metres from the camera: points nearer than this cannot be compared


@dataclass(frozen=True, kw_only=True)
class PictureKeypoints:
    """Points of one camera's picture; one hand for all hypotheses, or a row for each frame."""

    points_px: Float[Tensor, "#rows 21 2"]
    """NaN for missing points."""
    kinematics: HandKinematics
    camera: Camera
    """One, or a batch of one for each row."""
    settings: KeypointSettings
    view: int = 0
    confidence: Float[Tensor, "#rows 21"] | None = None
    """Share of a point's information that is believed, 0 for missing points; all of it where None."""
    std_px: Float[Tensor, "#rows"] | None = None
    """Standard deviation of a point along each axis; None for that of the settings at the hand's distance."""
    cov_px: Float[Tensor, "#rows 21 2 2"] | None = None
    """Covariance of every point, in place of that; points where it is NaN have that. None where none is known."""
    loss: RobustLoss | None = None
    """Loss of residuals in standard deviations, evaluated at every hand; None for what each point is trusted at the
    association."""
    detector: Detector | None = None
    """Properties of the detector; None for one whose keypoints are ours."""
    lag: ViewLag | None = None
    """How late the pictures are; None where they are not."""

    @property
    def is_empty(self) -> bool:
        return self._is_empty

    @cached_property
    def _is_empty(self) -> bool:
        return not read_back(self.is_known).any()

    @property
    def is_known(self) -> Bool[Tensor, "#rows 21"]:
        """Points that are not missing."""
        is_known = self.points_px.isfinite().all(-1)
        return is_known if self.confidence is None else is_known & (self.confidence > 0)

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "PictureKeypoints":
        """The rows of some of the frames; itself where the points are the same for all."""
        if len(self.points_px) == 1:
            return self
        return replace(
            self,
            points_px=self.points_px[rows],
            camera=self.camera.rows(rows),
            confidence=None if self.confidence is None else self.confidence[rows],
            std_px=None if self.std_px is None else self.std_px[rows],
            cov_px=None if self.cov_px is None else self.cov_px[rows],
            lag=None if self.lag is None else self.lag.rows(rows),
        )

    def associate(self, hands: PosedHands, stage: Stage) -> "PictureKeypointFactor":
        """What each point counts: less, the farther it is from the hand."""
        keypoints = frames_of(self.kinematics, hands).keypoints
        camera, is_known = self.camera, self.is_known
        depth = camera.cam_from_world(keypoints)[..., 2]
        if self.std_px is None:
            scale = 0.5 * (camera.intrinsics[..., 0, 0] + camera.intrinsics[..., 1, 1]).to(depth)[..., None]
            near = depth.clamp_min(_NEAREST) if camera.kind == "pinhole" else torch.ones_like(depth)
            std = self.settings.std_m * scale / near
        else:
            std = self.std_px[:, None].to(depth).expand_as(depth)
        if self.loss is None and camera.kind == "pinhole":
            is_known = is_known & (depth > _NEAREST)
        std, white = self._whitened(std)
        weight = std.square().reciprocal() * (1.0 if self.confidence is None else self.confidence)
        known = torch.where(is_known[..., None], self.points_px.to(depth), 0.0)
        factor = PictureKeypointFactor(
            kinematics=self.kinematics,
            camera=camera,
            points=known.expand(len(hands), -1, -1),
            weight=torch.where(is_known, weight, 0.0),
            trust=torch.full_like(std, self.settings.weight),
            white=None if white is None else white.expand(len(hands), -1, -1, -1),
            view=self.view,
            loss=self.loss,
            detector=self.detector or Detector.known(keypoints),
            lag=None if self.lag is None else self.lag.of_hands(len(hands)),
        )
        if self.loss is not None:
            return factor
        trust = self.settings.trust(factor.distance(hands), std, self.settings.std_m, stage)
        return replace(factor, trust=trust)

    def _whitened(self, std: Float[Tensor, "k 21"]) -> tuple[Float[Tensor, "k 21"], Float[Tensor, "#k 21 2 2"] | None]:
        """Standard deviations of the points as one number each, and what makes their errors that much in every
        direction; None where they are that already."""
        if self.cov_px is None:
            return std, None
        is_told = self.cov_px.isfinite().all((-2, -1)).expand_as(std)
        cov = torch.where(
            is_told[..., None, None], self.cov_px.to(std), torch.eye(2, dtype=std.dtype, device=std.device)
        )
        size = torch.linalg.det(cov).clamp_min(torch.finfo(std.dtype).tiny).pow(0.25)  # geometric mean of the axes
        # A covariance that is none gives points that fit nowhere; to raise for it would be to wait for the device.
        factor, info = torch.linalg.cholesky_ex(cov)
        inverse = torch.linalg.inv_ex(factor).inverse
        white = torch.where((info == 0)[..., None, None], size[..., None, None] * inverse, torch.nan)
        return torch.where(is_told, size, std), white


@dataclass(frozen=True, kw_only=True)
class PictureKeypointFactor:
    """½ Σ trust · |point - keypoint|² / std², or a robust loss of that; a row per hand. A hand with a known point that
    is not before the camera costs infinitely much."""

    kinematics: HandKinematics
    camera: Camera
    points: Float[Tensor, "k 21 2"]
    weight: Float[Tensor, "k 21"]
    """Inverse variances, px⁻²; 0 for missing points."""
    trust: Float[Tensor, "k 21"]
    """Weight of each point, as a fraction of what it would if it were the only one and no outlier."""
    view: int
    loss: RobustLoss | None
    detector: Detector
    white: Float[Tensor, "k 21 2 2"] | None = None
    """What makes errors equally likely in all directions, of determinant 1; None where they are."""
    lag: ViewLag | None = None
    """How late the pictures are; a row per hand. None where they are not."""

    def distance(self, hands: PosedHands) -> Float[Tensor, "k 21"]:
        """Distance of every point from the hand's keypoint, px; 0 for missing ones."""
        away = self._missed(hands, self._projected(hands)[0])
        return torch.where(self.weight > 0, away.norm(dim=-1), 0.0)

    def deviation(self, hands: PosedHands) -> Float[Tensor, "k 21"]:
        """Distance of every point from the hand's keypoint in standard deviations along one axis, over √2; NaN for
        missing ones."""
        away = (0.5 * self.weight).sqrt() * self.distance(hands)
        return torch.where(self.weight > 0, away, torch.nan)

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in the DOFs, and in the shared unknowns where there are some."""
        pixels, slopes, depth = self._projected(hands)
        rows = slopes @ self.detector.pose_jacobian(self.kinematics, hands)
        missed, shared = self._missed(hands, pixels), None
        if hands.unknowns is not None:
            shared = slopes @ self.detector.shared_jacobian(self.kinematics, hands)
        if self.lag is not None:
            lag = self.lag.at(hands.extra)
            size, growth = lag.noise()
            missed, rows = missed / size, rows / size
            if shared is not None and hands.unknowns is not None:
                shared = shared / size
                change = lag.points_px()[1].nan_to_num() / size + missed * (growth / size)
                shared[..., len(hands.unknowns.columns) + lag.place] -= change
        if self.white is not None:
            missed, rows = (self.white @ missed[..., None])[..., 0], self.white @ rows
            shared = None if shared is None else self.white @ shared
        found = equations_of_points(missed, self.weight * self.trust, self.loss, rows, shared)
        if self.camera.kind != "pinhole":
            return found
        is_before = ((depth > _NEAREST) | (self.weight == 0)).all(-1)
        return replace(found, cost=torch.where(is_before, found.cost, torch.inf))

    def predict(self, hands: PosedHands) -> Float[Tensor, "k m"]:
        """Pixels of the keypoints of any number of hands, as `measurement` has them."""
        return self._projected(hands)[0].flatten(1)

    def measurement(self) -> tuple[Float[Tensor, "m"], Float[Tensor, "m"], Bool[Tensor, "m"]]:
        """Measurement of the first row: values, variances, and which are known; for filters."""
        precision = (self.weight[0] * self.trust[0])[:, None].expand(-1, 2).flatten()
        is_known = precision > 0
        return self.points[0].flatten(), torch.where(is_known, precision, 1.0).reciprocal(), is_known

    def rows(self, rows: Int[Tensor, "n"]) -> "PictureKeypointFactor":
        """The rows of some of the hands."""
        own = {name: getattr(self, name)[rows] for name in ("points", "weight", "trust")}
        white = None if self.white is None else self.white[rows]
        lag = None if self.lag is None else self.lag.rows(rows)
        return replace(self, camera=self.camera.rows(rows), white=white, lag=lag, **own)

    def explained(self) -> tuple[Explained, ...]:
        """Share of the points that are trusted by half at least; their distance counts for nothing here."""
        fraction = trusted_fraction(self.weight, self.trust)
        return (Explained(name=IN_PICTURE, view=self.view, fraction=fraction, distance=torch.zeros_like(fraction)),)

    def _missed(self, hands: PosedHands, pixels: Float[Tensor, "k 21 2"]) -> Float[Tensor, "k 21 2"]:
        """How far keypoints in the picture are from the points, px."""
        if self.lag is None:
            return pixels - self.points
        return pixels - torch.where(self.weight[..., None] > 0, self.lag.at(hands.extra).points_px()[0], 0.0)

    def _projected(
        self, hands: PosedHands
    ) -> tuple[Float[Tensor, "k 21 2"], Float[Tensor, "k 21 2 3"], Float[Tensor, "k 21"]]:
        """Pixels of the keypoints, their derivative in the places in the world, and the depths; computed once for the
        hands that points are associated with."""
        camera, detector = self.camera, self.detector
        kept = hands.once(("projected", id(camera), id(detector)), lambda: (camera, detector, self._projection(hands)))
        return kept[2]  # what is kept with it holds the numbers of the key

    def _projection(
        self, hands: PosedHands
    ) -> tuple[Float[Tensor, "k 21 2"], Float[Tensor, "k 21 2 3"], Float[Tensor, "k 21"]]:
        camera = self.camera
        in_cam = camera.cam_from_world(self.detector.keypoints(self.kinematics, hands))
        plane = in_cam[..., :2]
        on_plane = torch.zeros(*plane.shape, 3, dtype=plane.dtype, device=plane.device)
        if camera.kind == "pinhole":
            nearness = in_cam[..., 2].clamp_min(_NEAREST).reciprocal()
            plane = plane * nearness[..., None]
            on_plane[..., 0, 0] = on_plane[..., 1, 1] = nearness
            on_plane[..., 2] = -plane * nearness[..., None]
        else:
            on_plane[..., 0, 0] = on_plane[..., 1, 1] = 1.0
        rotation = camera.rotation.to(plane)
        turned = on_plane @ (rotation if rotation.ndim == 2 else rotation[:, None])
        return camera.pixels_from_plane(plane), camera.pixel_jacobian(plane) @ turned, in_cam[..., 2]
