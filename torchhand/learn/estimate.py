"""Using a trained network: points in pixels and a camera in, hands out."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.hand import Side
from torchhand.learn.network import HandEstimate, PoseNetwork
from torchhand.learn.observation import MIN_SEEN, mirrored, observe


def estimate_hands(
    network: PoseNetwork,
    points_plane: Float[Tensor, "*batch 21 2"],
    seen: Bool[Tensor, "*batch 21"] | None = None,
    *,
    side: Side = "right",
) -> HandEstimate:
    """Hands in the camera frame from points of the normalised image plane (`Camera.plane_from_pixels`).

    Points that are not finite count as not seen. A left hand is shown to the network in the mirror, and its pose is
    for kinematics of a left hand. A hand with fewer than MIN_SEEN seen points is NaN. All are on the network's device.
    """
    points_plane = points_plane.to(network.start)
    is_finite = points_plane.isfinite().all(-1)
    seen = is_finite if seen is None else seen.to(is_finite.device) & is_finite
    shown = mirrored(points_plane) if side == "left" else points_plane
    with torch.no_grad():
        found = network(observe(shown, seen))
    if side == "left":
        found = _mirrored(found)
    is_enough = seen.sum(-1) >= MIN_SEEN
    values = {name: getattr(found, name) for name in ("pose", "root_reference", "shape", "keypoints")}
    lost = {
        name: torch.where(is_enough.reshape(*is_enough.shape, *(1,) * (value.ndim - is_enough.ndim)), value, torch.nan)
        for name, value in values.items()
    }
    return HandEstimate(**lost)


def _mirrored(found: HandEstimate) -> HandEstimate:
    """The left hands whose mirror images in the camera's plane x = 0 are given.

    A left hand is the right one mirrored in z of the hand frame: M R' with M on the camera's x needs R = M R' M_z.
    """
    across = found.pose.new_tensor((-1.0, 1.0, 1.0))
    in_hand = found.pose.new_tensor((1.0, 1.0, -1.0))
    pose = torch.cat((found.pose[..., :3] * across, found.pose[..., 3:]), -1)
    return replace(
        found,
        pose=pose,
        root_reference=across[:, None] * found.root_reference * in_hand,
        keypoints=found.keypoints * across,
    )
