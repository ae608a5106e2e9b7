"""Measures of `torchhand benchmark` on what the hand model promises: mesh, constraints, fit to keypoints."""

import time

import torch
from torch import Tensor

from torchhand.cli.benchmarks.figures import Figure
from torchhand.files import load_hand_model
from torchhand.fit.keypoints import fit_keypoints
from torchhand.geometry import assumed_camera
from torchhand.hand import DOFS, HandState, PoseConstraints, named_pose_space, posed_mesh, posture
from torchhand.image import intersection_over_union
from torchhand.view import silhouette

HANDS, PICTURE_PX, FIELD_OF_VIEW_DEG, DISTANCE = 100, 320, 25.0, 0.6
RANDOM_POSES, RANGE_RAD = 100_000, 10.0
FRAMES, FIT_ROUNDS = 10_000, 3


def mesh_silhouettes(name: str, repeats: int | None) -> Figure:
    """Overlap of the mesh's silhouette with that of the primitives: people and postures of the prior, random sides."""
    model = load_hand_model()
    hand, generator = model.hand(dtype=torch.float64), torch.Generator().manual_seed(0)
    poses, shapes = model.prior(dtype=torch.float64).sample(HANDS, generator)
    poses[:, 3:6] = 1.5 * torch.randn(HANDS, 3, generator=generator, dtype=poses.dtype)
    camera = assumed_camera(PICTURE_PX, PICTURE_PX, horizontal_fov_deg=FIELD_OF_VIEW_DEG)
    identity = torch.eye(3, dtype=torch.float64)
    overlaps = []
    for pose, shape in zip(poses.double(), shapes.double(), strict=True):
        state = hand(pose, shape)
        ahead = torch.tensor((0.0, 0.0, DISTANCE), dtype=torch.float64) - state.keypoints.mean(0)
        surfaces = (state.primitives, posed_mesh(hand, state))
        one, other = (silhouette(surface.moved(identity, ahead), camera) for surface in surfaces)
        overlaps.append(float(intersection_over_union(one, other)))
    found = torch.tensor(overlaps)
    details = {"median": float(found.median()), "lowest": float(found.min()), "hands": HANDS}
    return Figure(name=name, value=float(found.mean()), unit="IoU", must=0.96, aim=0.98, repeats=1, details=details)


def mesh_volume(name: str, repeats: int | None) -> Figure:
    """Change of the mesh's volume from the open hand to the posture in which it changes most."""
    hand = load_hand_model().hand(dtype=torch.float64)
    rest = _volume(hand(posture("open", dtype=torch.float64)))
    changes = {
        p: 100 * abs(float(_volume(hand(posture(p, dtype=torch.float64))) / rest) - 1)
        for p in ("flat", "fist", "point", "pinch")
    }
    return Figure(name=name, value=changes["fist"], unit="%", must=12.0, aim=5.0, repeats=1, details=changes)


def _volume(state: HandState) -> Tensor:
    a, b, c = state.vertices[state.faces].unbind(1)
    return (a * torch.linalg.cross(b, c)).sum() / 6


def pose_projection(name: str, repeats: int | None) -> Figure:
    """Largest violation of a hard constraint that is left after projecting random poses, float64."""
    constraints = PoseConstraints(load_hand_model().skeleton)
    generator = torch.Generator().manual_seed(0)
    poses = RANGE_RAD * (2 * torch.rand(RANDOM_POSES, len(DOFS), generator=generator, dtype=torch.float64) - 1)
    start = time.perf_counter()
    projected = constraints.project(poses)
    elapsed_ms = 1e3 * (time.perf_counter() - start)
    details = {
        "poses": RANDOM_POSES,
        "not_numbers": int(projected.isnan().sum()),
        "change_when_repeated": float((constraints.project(projected) - projected).abs().max()),
    }
    worst = float(constraints.violation(projected).worst.max())
    return Figure(name=name, value=worst, unit="rad", must=1e-6, ours_ms=elapsed_ms, repeats=1, details=details)


def keypoints_to_pose(name: str, repeats: int | None) -> Figure:
    """Milliseconds per frame to fit the 27-DOF hand to 21 exact points in space, many frames in one call, float64."""
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    skeleton, space = kinematics.skeleton, named_pose_space("dof27")
    generator = torch.Generator().manual_seed(0)
    fraction = torch.rand(FRAMES, len(skeleton.lower), generator=generator, dtype=torch.float64)
    joints = skeleton.lower + fraction * (skeleton.upper - skeleton.lower)
    root = torch.randn(FRAMES, 6, generator=generator, dtype=torch.float64)
    truth = space.dof(torch.cat((root, joints), -1)[:, [DOFS.index(dof) for dof in space.free_names]])
    points = kinematics(truth).keypoints
    times = []
    for _ in range(repeats or FIT_ROUNDS):
        start = time.perf_counter()
        fit = fit_keypoints(kinematics, points)
        times.append(1e3 * (time.perf_counter() - start) / FRAMES)
    errors = (kinematics(fit.pose).keypoints - points).norm(dim=-1)
    degrees = torch.rad2deg((fit.pose - truth)[:, 6:].abs().amax(-1))
    details = {"frames": FRAMES, "worst_mm": 1e3 * float(errors.max()), "worst_deg": float(degrees.max())}
    value = sorted(times)[len(times) // 2]
    note = f"largest errors of {FRAMES} frames: {details['worst_mm']:.1e} mm, {details['worst_deg']:.1e} degrees"
    return Figure(name=name, value=value, unit="ms", must=2.0, aim=0.5, repeats=len(times), note=note, details=details)
