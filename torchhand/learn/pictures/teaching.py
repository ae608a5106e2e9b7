"""What teaches on crops that nobody has labelled: silhouettes, detected points, and what hands are like."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.geometry import assumed_camera
from torchhand.hand import HandModel
from torchhand.learn import HandEstimate
from torchhand.learn.pictures.recorded import RecordedCrops
from torchhand.losses import keypoint_loss, prior_loss, silhouette_loss
from torchhand.propose import SIDE_PX
from torchhand.view import SoftRenderer

_NEAREST = 0.02  # metres: depth below which a point is not projected


@dataclass(frozen=True, kw_only=True)
class TeachingWeights:
    """Factors of the terms."""

    silhouette: float = 4.0
    """One less the overlap of the silhouettes."""
    points: float = 1.0
    """Distance from the detected points, in standard deviations of the detector."""
    prior: float = 3e-3
    """Energy of the prior, nats."""
    points_std_px: float = 1.5
    """Standard deviation of the detected points, px of the crop; what detectors call joints is off by as much."""


class Teacher:
    """Projects and draws estimated hands as the crops' cameras see them."""

    def __init__(self, model: HandModel) -> None:
        self._hand = model.hand(dtype=torch.float32)
        self._prior = model.prior(dtype=torch.float32)
        self._renderer = SoftRenderer(self._hand.faces)
        self._camera = assumed_camera(SIDE_PX, SIDE_PX, dtype=torch.float32).to(device=self._hand.faces.device)

    def silhouettes(
        self, estimate: HandEstimate, intrinsics: Float[Tensor, "crops 3 3"]
    ) -> Float[Tensor, "crops side side"]:
        """Share of each pixel that shows the hand."""
        state = self._hand(estimate.pose, estimate.shape, root_reference=estimate.root_reference)
        # One camera shows what each crop's own does, of points that are moved within planes of equal depth.
        shared = torch.linalg.solve(self._camera.intrinsics.to(intrinsics), intrinsics)
        return self._renderer.silhouette(state.vertices @ shared.mT, self._camera)

    def loss(
        self,
        estimate: HandEstimate,
        crops: RecordedCrops,
        rows: Int[Tensor, "n"],
        weights: TeachingWeights,
        energy_hands: int,
    ) -> Float[Tensor, ""]:
        """The weighted terms, means over the crops. energy_hands: of how many crops the prior's energy is reckoned."""
        coverage = self.silhouettes(estimate, crops.intrinsics[rows])
        points = projected(estimate, crops.intrinsics[rows])
        loss = weights.silhouette * silhouette_loss(coverage, crops.mask[rows], crops.known[rows])
        loss = loss + weights.points * keypoint_loss(points, crops.points_px[rows], std=weights.points_std_px)
        few = slice(energy_hands)
        if energy_hands and weights.prior:
            loss = loss + weights.prior * prior_loss(self._prior, estimate.pose[few], estimate.shape[few])
        return loss


def projected(estimate: HandEstimate, intrinsics: Float[Tensor, "crops 3 3"]) -> Float[Tensor, "crops 21 2"]:
    """Keypoints in the crops, px."""
    points = estimate.keypoints
    plane = points[..., :2] / points[..., 2:].clamp_min(_NEAREST)
    return plane @ intrinsics[:, :2, :2].mT + intrinsics[:, None, :2, 2]


def part(estimate: HandEstimate, rows: slice) -> HandEstimate:
    """Some of the hands."""
    return replace(
        estimate,
        pose=estimate.pose[rows],
        root_reference=estimate.root_reference[rows],
        shape=estimate.shape[rows],
        keypoints=estimate.keypoints[rows],
    )
