"""What a detector tells of one hand in the pictures of one camera."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.errors import require, require_kind
from torchhand.geometry import Camera
from torchhand.precision import require_exact


@dataclass(frozen=True, kw_only=True)
class SeenKeypoints:
    """Keypoints in one camera's pictures, frame by frame, and the same in space where the detector gives them."""

    camera: Camera
    """One, or a batch with one per frame."""
    points_px: Float[Tensor, "*frames 21 2"]
    """Points in the pictures; NaN for missing ones."""
    points: Float[Tensor, "*frames 21 3"] | None = None
    """Points in space along the camera's axes (such as MediaPipe's world landmarks), metres; their place and size do
    not count. NaN for missing ones, None where the detector gives none."""
    confidence: Float[Tensor, "*frames 21"] | None = None
    """Share of a point's information that is believed, 0 for missing points; all of it where None."""
    cov_px: Float[Tensor, "*frames 21 2 2"] | None = None
    """Covariance of every point in the pictures, px²; NaN where it is not known. That of the settings where None."""

    def __post_init__(self) -> None:
        """Raises ValueError for shapes that do not fit together, for half precision, and for negative confidences;
        TypeError for what is no camera and no tensor."""
        require_kind("camera", self.camera, Camera)
        require_kind("points_px", self.points_px, Tensor)
        is_hand = self.points_px.shape[-2:] == (21, 2)
        require(is_hand, "points_px", "shape (*frames, 21, 2)", tuple(self.points_px.shape))
        frames = self.points_px.shape[:-2]
        if self.camera.intrinsics.shape[:-2] not in ((), frames):
            raise ValueError(
                f"camera: expected one, or one per frame {tuple(frames)},"
                f" got a batch of {tuple(self.camera.intrinsics.shape[:-2])}"
            )
        require_exact("points_px", self.points_px.dtype)
        for name, own in (("points", (21, 3)), ("confidence", (21,)), ("cov_px", (21, 2, 2))):
            if (value := getattr(self, name)) is not None:
                require_kind(name, value, Tensor)
                require_exact(name, value.dtype)
                require(value.shape == (*frames, *own), name, f"shape {(*frames, *own)}", tuple(value.shape))
        if self.confidence is not None and bool((self.confidence < 0).any()):
            raise ValueError(f"confidence: expected 0 or more, got {float(self.confidence.min()):g}")

    @property
    def batch_shape(self) -> torch.Size:
        return self.points_px.shape[:-2]

    def to(self, device: torch.device) -> "SeenKeypoints":
        """The same keypoints on another device."""
        tensors = ("points_px", "points", "confidence", "cov_px")
        moved = {name: None if (own := getattr(self, name)) is None else own.to(device) for name in tensors}
        return replace(self, camera=self.camera.to(device=device), **moved)

    def flat(self, like: Tensor) -> "SeenKeypoints":
        """With one dimension for frames, and everything in the dtype of `like`."""

        def rows(value: Tensor | None, dimensions: int) -> Tensor | None:
            return None if value is None else value.to(like).reshape(-1, *value.shape[value.ndim - dimensions :])

        points_px, confidence = rows(self.points_px, 2), rows(self.confidence, 1)
        assert points_px is not None
        return SeenKeypoints(
            camera=_flat(self.camera.to(dtype=like.dtype, device=like.device)),
            points_px=points_px,
            points=rows(self.points, 2),
            confidence=confidence,
            cov_px=rows(self.cov_px, 3),
        )

    def without(self, frames: Bool[Tensor, "frames"]) -> "SeenKeypoints":
        """With nothing in some of the frames (of one dimension)."""
        return replace(
            self,
            points_px=torch.where(frames[:, None, None], torch.nan, self.points_px),
            points=None if self.points is None else torch.where(frames[:, None, None], torch.nan, self.points),
        )

    @property
    def trust(self) -> Float[Tensor, "*frames 21"]:
        """Confidence of every point; 0 for points in the pictures that are missing."""
        trust = torch.ones_like(self.points_px[..., 0]) if self.confidence is None else self.confidence
        is_known = self.points_px.isfinite().all(-1) & trust.isfinite() & (trust > 0)
        return torch.where(is_known, trust, 0.0)


def _flat(camera: Camera) -> Camera:
    """One camera, or a batch with one dimension."""
    batch = camera.intrinsics.shape[:-2]
    if not batch:
        return camera
    return replace(
        camera,
        intrinsics=camera.intrinsics.reshape(-1, 3, 3),
        rotation=camera.rotation.expand(*batch, 3, 3).reshape(-1, 3, 3),
        translation=camera.translation.expand(*batch, 3).reshape(-1, 3),
        distortion=camera.distortion.expand(*batch, camera.distortion.shape[-1]).flatten(0, -2),
    )
