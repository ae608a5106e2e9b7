"""First poses for 21 points in a picture: rest postures seen from all around, each turned and sized in closed form."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.keypoints.observation import PictureKeypoints
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, FINGERS, HandPose, posture

_POSTURES = ("open", "fist")  # tried besides the natural posture
_RING, _LATITUDES_DEG = 8, (-60.0, -30.0, 0.0, 30.0, 60.0)
_UNKNOWN_DEPTH = 0.5  # metres, for cameras that do not show depth


def viewing_directions() -> Float[Tensor, "views 3 3"]:
    """Rotations that bring each of 42 directions of the hand frame onto the optical axis; float64."""
    back = rotation_from_vector(torch.tensor((0.0, math.pi / 2, 0.0), dtype=torch.float64))
    up = rotation_from_vector(torch.tensor((math.pi / 2, 0.0, 0.0), dtype=torch.float64))
    views = [up, up.T]  # along the fingers, both ways
    for latitude in _LATITUDES_DEG:
        tilt = rotation_from_vector(torch.tensor((math.radians(latitude), 0.0, 0.0), dtype=torch.float64))
        for step in range(_RING):
            around = torch.tensor((0.0, 2 * math.pi * step / _RING, 0.0), dtype=torch.float64)
            views.append(tilt @ rotation_from_vector(around) @ back)
    return torch.stack(views)


def starts_in_picture(
    observed: PictureKeypoints,
    shape: Float[Tensor, "shape"],
    natural: Float[Tensor, "36"],
    starts: int,
) -> HandPose:
    """Poses (frames, starts) with zero rotation vectors, the best under weak perspective first.

    For every viewing direction the best of a few postures is kept; the rotation in the picture, the depth and the
    place are those of the plane similarity that brings its points nearest to the measured ones (in complex numbers,
    one division). The directions differ, so the starts do.
    """
    camera, points = observed.camera, torch.where(observed.is_known[..., None], observed.points_px, 0.0)
    plane = camera.plane_from_pixels(points)
    weight = (observed.is_known & plane.isfinite().all(-1)).to(points)
    if observed.confidence is not None:
        weight = weight * observed.confidence
    plane = torch.where(weight[..., None] > 0, plane, 0.0)
    weight = weight / weight.sum(-1, keepdim=True).clamp_min(torch.finfo(weight.dtype).tiny)
    joints = torch.stack([natural, *(posture(name, dtype=torch.float64).to(natural) for name in _POSTURES)])
    joints[:, :6] = 0
    views = viewing_directions().to(points)
    rest = observed.kinematics(joints, shape).keypoints
    seen = torch.einsum("vij,pkj->vpki", views, rest)
    model = torch.complex(seen[..., 0], seen[..., 1])
    measured = torch.complex(plane[..., 0], plane[..., 1])
    complex_weight = weight.to(model.dtype)
    model_mean = torch.einsum("fk,vpk->fvp", complex_weight, model)
    mean = (complex_weight * measured).sum(-1)
    spread = torch.einsum("fk,vpk->fvp", weight, model.abs().square()) - model_mean.abs().square()
    product = (
        torch.einsum("fk,vpk->fvp", complex_weight * measured, model.conj()) - mean[:, None, None] * model_mean.conj()
    )
    gain = product.abs().square() / spread.clamp_min(torch.finfo(spread.dtype).tiny)  # what the fit explains
    best_gain, best_posture = gain.max(-1)
    chosen = best_gain.topk(min(starts, len(views)), -1).indices  # frames, starts
    which = torch.gather(best_posture, 1, chosen)
    each = torch.arange(len(points), device=points.device)[:, None]
    similarity = product[each, chosen, which] / spread[each, chosen, which]
    size = similarity.abs().clamp_min(1e-6)
    angle = torch.zeros(*size.shape, 3).to(points)
    angle[..., 2] = similarity.angle()
    cam_from_hand = rotation_from_vector(angle) @ views[chosen]
    place = mean[:, None] - similarity * model_mean[each, chosen, which]
    if camera.kind == "pinhole":
        depth = 1 / size
        # the points lie at their mean depth, the wrist before or behind it
        middle = torch.einsum("fk,fsk->fs", weight, seen[chosen, which][..., 2])
        root = torch.stack((place.real * depth, place.imag * depth, depth - middle), -1)
    else:
        root = torch.stack((place.real, place.imag, torch.full_like(size, _UNKNOWN_DEPTH)), -1)
    world_from_cam = (camera.rotation if camera.rotation.ndim == 2 else camera.rotation[:, None]).mT
    translation = camera.translation if camera.translation.ndim == 1 else camera.translation[:, None]
    poses = joints[which]
    poses[..., :3] = (world_from_cam @ (root - translation)[..., None]).squeeze(-1)
    return HandPose(dofs=poses, reference=world_from_cam @ cam_from_hand)


def placed_in_pictures(pictures: Sequence[PictureKeypoints], pose: HandPose, shape: Float[Tensor, "shape"]) -> HandPose:
    """Hands (frames) of known rotation and posture where the points of all pictures want them in linear least
    squares."""
    arms = pictures[0].kinematics(pose.dofs, shape, root_reference=pose.reference).keypoints - pose.dofs[:, None, :3]
    eye = torch.eye(3).to(arms)
    matrix, value = 1e-9 * eye, torch.zeros_like(arms[:, 0])  # cameras that show no depth leave one direction open
    for one in pictures:
        camera = one.camera
        rotation, translation = camera.rotation.to(arms), camera.translation.to(arms)
        is_pinhole = camera.kind == "pinhole"
        points = torch.where(one.is_known[..., None], one.points_px, 0.0).to(arms)
        plane = camera.plane_from_pixels(points)
        weight = one.is_known.to(arms)[..., None]
        seen = (arms @ rotation.mT) + (translation if translation.ndim == 1 else translation[:, None])
        depth = seen[..., 2:] if is_pinhole else torch.ones_like(seen[..., 2:])
        along = rotation if rotation.ndim == 2 else rotation[:, None]
        rows = along[..., :2, :] - (plane[..., None] * along[..., 2:, :] if is_pinhole else 0.0)
        rows = (weight[..., None] * rows).flatten(1, 2)
        missed = (weight * (plane * depth - seen[..., :2])).flatten(1)
        matrix, value = matrix + rows.mT @ rows, value + (rows.mT @ missed[..., None])[..., 0]
    dofs = pose.dofs.clone()
    dofs[:, :3] = torch.linalg.solve(matrix, value)
    return HandPose(dofs=dofs, reference=pose.reference)


def other_ways(start: HandPose) -> HandPose:
    """Six alternatives of each pose (frames), (frames, 6): itself, then for each digit the same with that digit bent if
    it was straight, or straight if it was bent."""
    pose = start.dofs
    bent, straight = (posture(name, dtype=torch.float64).to(pose) for name in ("fist", "open"))
    poses = [pose]
    for finger in FINGERS:
        own = [i for i, dof in enumerate(DOFS) if dof.startswith(finger)]
        flexions = [i for i in own if DOFS[i].endswith(("mcp_fe", "ip_fe"))]
        is_bent = pose[:, flexions].sum(-1, keepdim=True) > 0.5 * bent[flexions].sum()
        changed = pose.clone()
        changed[:, own] = torch.where(is_bent, straight[own], bent[own])
        poses.append(changed)
    return HandPose.of(torch.stack(poses, 1), start.reference[:, None])
