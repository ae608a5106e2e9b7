"""A hand fitted to a mask by gradient descent through its soft silhouette.

    python docs/examples/fit_mask.py

Draws the mask of a hand that the fit does not know, starts from four open hands that are turned and placed wrongly,
and lets torch's Adam move their poses and proportions together until the silhouettes agree. Two fingers of a start may
end in the place of one: that is what several starts are for. Any mask of a hand before a known camera will do instead
of the one that is drawn here.
"""

import torch
from torch import Tensor

from torchhand import assumed_camera, load_hand_model
from torchhand.hand import posture
from torchhand.image import intersection_over_union
from torchhand.losses import distance_map_loss, prior_loss, signed_distance, silhouette_loss
from torchhand.view import SoftRenderer

STEPS, PLACING, SIZE = 150, 30, 128
model = load_hand_model()
camera = assumed_camera(SIZE, SIZE, horizontal_fov_deg=25.0, dtype=torch.float32)
hand, prior = model.hand(), model.prior()
renderer = SoftRenderer(hand.faces)
facing = torch.tensor(((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)))  # cam_from_hand: palm or back, upright


def wanted_mask() -> Tensor:
    """(SIZE, SIZE) True where a hand is that nobody has told the fit about."""
    pose = posture("open")
    pose[:6] = torch.tensor((-0.02, 0.09, 0.58, 0.1, -0.15, 0.1))
    pose[6:] += torch.tensor((0.08, -0.06, 0.12)).repeat(10)
    pose[6:] = model.skeleton.within_limits(pose[6:].double()).float()
    _, shape = prior.sample(1, torch.Generator().manual_seed(3))
    with torch.no_grad():
        return renderer.silhouette(hand(pose, shape[0], root_reference=facing).vertices, camera) > 0.5


def starts() -> Tensor:
    """(4, 36): open hands about where the mask is, turned a little in the picture and away from it."""
    poses = posture("open").expand(4, -1).clone()
    poses[:, :3] = torch.tensor((-0.02, 0.08, 0.63))
    poses[:, 3:6] = 0.25 * torch.randn(4, 3, generator=torch.Generator().manual_seed(0))
    return poses


def fit(mask: Tensor, start: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Poses (hands, 36), proportions (hands, 52), and their overlaps (steps, hands) with the mask on the way."""
    distance = signed_distance(mask)
    place, turns = start[:, :3].clone().requires_grad_(), start[:, 3:].clone().requires_grad_()
    shape = model.shape_space.default.float().expand(len(start), -1).clone().requires_grad_()
    optimizer = torch.optim.Adam(
        [{"params": [place], "lr": 3e-3}, {"params": [turns], "lr": 3e-2}, {"params": [shape], "lr": 1e-2}]
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS)
    overlaps = []
    for step in range(STEPS):
        still = turns[:, 3:].detach() if step < PLACING else turns[:, 3:]  # first the hand as a whole
        poses = torch.cat((place, turns[:, :3], still), -1)
        coverage = renderer.silhouette(hand(poses, shape, root_reference=facing).vertices, camera)
        loss = silhouette_loss(coverage, mask, reduction="sum")
        loss = loss + 0.02 * distance_map_loss(coverage, distance, reduction="sum")
        loss = loss + 2e-4 * prior_loss(prior, poses, shape, reduction="sum")
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        overlaps.append(intersection_over_union(coverage.detach() > 0.5, mask.expand(len(start), -1, -1)))
    return torch.cat((place, turns), -1).detach(), shape.detach(), torch.stack(overlaps)


def main() -> float:
    """The overlap of the best hand with the mask."""
    poses, _, overlaps = fit(wanted_mask(), starts())
    best = int(overlaps[-1].argmax())
    print(f"overlap {overlaps[0, best]:.3f} at the start, {overlaps[-1, best]:.3f} after {STEPS} steps")
    print(f"of all {len(poses)} starts:", " ".join(f"{overlap:.3f}" for overlap in overlaps[-1].tolist()))
    return float(overlaps[-1, best])


if __name__ == "__main__":
    main()
