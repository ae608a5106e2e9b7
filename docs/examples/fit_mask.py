"""A hand fitted to a mask by gradient descent through its soft silhouette.

    python docs/examples/fit_mask.py
    python docs/examples/fit_mask.py 50    # success over 50 other masks

Draws the mask of a hand that the fit does not know, starts from sixteen open hands that are turned and placed wrongly,
moves each as a whole, and lets torch's Adam move poses and proportions of the best four until the silhouettes agree.
Two fingers of a start may end in the place of one: that is what several starts are for. Any mask of a hand before a
known camera will do instead of the one that is drawn here.
"""

import statistics
import sys

import torch
from torch import Tensor

from torchhand import assumed_camera, load_hand_model
from torchhand.hand import posture
from torchhand.image import intersection_over_union
from torchhand.losses import distance_map_loss, prior_loss, signed_distance, silhouette_loss
from torchhand.view import SoftRenderer

STEPS, PLACING, SIZE = 150, 30, 128
KEPT = 4  # hands that are fitted on once all have been placed
model = load_hand_model()
camera = assumed_camera(SIZE, SIZE, horizontal_fov_deg=25.0, dtype=torch.float32)
hand, prior = model.hand(), model.prior()
renderer = SoftRenderer(hand.faces)
facing = torch.tensor(((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)))  # cam_from_hand: palm or back, upright


def wanted(seed: int) -> tuple[Tensor, Tensor]:
    """(SIZE, SIZE) True where a hand is that nobody has told the fit about, and its keypoints (21, 2), px: somebody's
    proportions, all joints some 6 degrees from those of an open hand, turned by some 9 degrees about each axis."""
    generator = torch.Generator().manual_seed(seed)
    pose = posture("open")
    pose[:3] = torch.tensor((-0.02, 0.09, 0.60)) + 0.015 * (2 * torch.rand(3, generator=generator) - 1)
    pose[3:6] = 0.15 * torch.randn(3, generator=generator)
    pose[6:] += 0.1 * torch.randn(30, generator=generator)
    pose[6:] = model.skeleton.within_limits(pose[6:].double()).float()
    _, shape = prior.sample(1, generator)
    with torch.no_grad():
        there = hand(pose, shape[0], root_reference=facing)
        return renderer.silhouette(there.vertices, camera) > 0.5, camera.project(there.keypoints)


def starts() -> Tensor:
    """(16, 36): open hands about where the mask is, turned in the picture by up to 35 degrees, and away from it."""
    generator, count = torch.Generator().manual_seed(0), 16
    poses = posture("open").expand(count, -1).clone()
    poses[:, :3] = torch.tensor((-0.02, 0.08, 0.63))
    poses[:, 3:6] = 0.25 * torch.randn(count, 3, generator=generator)
    poses[:, 5] = torch.linspace(-0.6, 0.6, count)
    return poses


def descend(hands: list[Tensor], mask: Tensor, steps: int, rates: tuple[float, ...]) -> tuple[list[Tensor], Tensor]:
    """Places (hands, 3), rotations (hands, 3), joint angles (hands, 30) and proportions (hands, 52) after steps of Adam
    at these rates, 0 for what stays; and their overlaps (steps, hands) with the mask on the way."""
    distance = signed_distance(mask)
    hands = [part.clone().requires_grad_(rate > 0) for part, rate in zip(hands, rates, strict=True)]
    moving = [{"params": [part], "lr": rate} for part, rate in zip(hands, rates, strict=True) if rate > 0]
    optimizer = torch.optim.Adam(moving)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    overlaps = []
    for _ in range(steps):
        poses, shape = torch.cat(hands[:3], -1), hands[3]
        coverage = renderer.silhouette(hand(poses, shape, root_reference=facing).vertices, camera)
        loss = silhouette_loss(coverage, mask, reduction="sum")
        loss = loss + 0.02 * distance_map_loss(coverage, distance, reduction="sum")
        loss = loss + 2e-4 * prior_loss(prior, poses, shape, reduction="sum")
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        overlaps.append(intersection_over_union(coverage.detach() > 0.5, mask.expand(len(poses), -1, -1)))
    return [part.detach() for part in hands], torch.stack(overlaps)


def fit(mask: Tensor, start: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Poses (hands, 36), proportions (hands, 52) of the best hands, and their overlaps (steps, hands) with the mask."""
    shape = model.shape_space.default.float().expand(len(start), -1)
    placed, first = descend([start[:, :3], start[:, 3:6], start[:, 6:], shape], mask, PLACING, (6e-3, 6e-2, 0, 1e-2))
    best = first[-1].topk(KEPT).indices
    found, then = descend([part[best] for part in placed], mask, STEPS - PLACING, (3e-3, 3e-2, 3e-2, 1e-2))
    return torch.cat(found[:3], -1), found[3], torch.cat((first[:, best], then))


def main() -> float:
    """The overlap of the best hand with a mask."""
    _, _, overlaps = fit(wanted(0)[0], starts())
    best = int(overlaps[-1].argmax())
    print(f"overlap {overlaps[0, best]:.3f} at the start, {overlaps[-1, best]:.3f} after {STEPS} steps")
    print(f"of the {KEPT} hands that were kept:", " ".join(f"{overlap:.3f}" for overlap in overlaps[-1].tolist()))
    return float(overlaps[-1, best])


def measure(count: int) -> None:
    """Fit as many other masks, and print how often the best hand overlaps by 0.95 and has every fingertip in place."""
    found, right = [], 0
    for seed in range(1, count + 1):
        mask, keypoints = wanted(seed)
        poses, shapes, overlaps = fit(mask, starts())
        best = int(overlaps[-1].argmax())
        found.append(float(overlaps[-1, best]))
        fitted = camera.project(hand(poses[best], shapes[best], root_reference=facing).keypoints)
        right += float((fitted - keypoints)[4::4].norm(dim=-1).max()) < 4  # px; a fingertip is some 5 px wide
    good = sum(overlap > 0.95 for overlap in found)
    print(f"{count} masks: overlap above 0.95 in {good}, median {statistics.median(found):.3f}, least {min(found):.3f}")
    print(f"all five fingertips within 4 px in {right}")


if __name__ == "__main__":
    measure(int(sys.argv[1])) if len(sys.argv) > 1 else main()
