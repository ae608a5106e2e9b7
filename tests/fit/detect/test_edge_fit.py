"""The fit of pose and proportions to one picture, from a start that is off."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.fit import mask_plane
from torchhand.fit.contour import hand_length_px, is_in_picture, is_outer
from torchhand.fit.detect.edge_fit import Fit, FitSettings, fit_contour, fit_contours, pose_prior_std
from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.hand import DOFS, HandPose, posture
from torchhand.simulate import sample_shape
from torchhand.view import HandProjector, raycast

WIDE = (320, 240)


def _perturbed(placed: Any, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Up to 5 mm off in the picture's plane, 3 % in depth, turned by 3 degrees, abductions up to 3 degrees off."""
    pose = placed.pose.clone()
    pose[:2] += 0.005 * (2 * torch.rand(2, generator=generator, dtype=torch.float64) - 1)
    pose[2] *= 1.03
    for i, dof in enumerate(DOFS):
        if dof.endswith("_aa"):
            pose[i] += math.radians(3) * float(2 * torch.rand(1, generator=generator) - 1)
    turn = torch.tensor((0.0, 0.0, math.radians(3)), dtype=torch.float64)
    return pose, rotation_from_vector(turn) @ placed.root_reference


def _exact_mask(placed: Any) -> Tensor:
    """Of the ray caster, an independent drawing."""
    frames = placed.projector.frames(placed.pose, placed.root_reference)
    return raycast(placed.projector.primitives_cam(frames), placed.camera).mask


def _fitted(placed: Any, studio: Any, generator: torch.Generator, shape: Tensor, **options: Any) -> Fit:
    plane = mask_plane(_exact_mask(placed))
    projector = HandProjector(placed.kinematics, placed.camera, shape)
    return fit_contour(plane, projector, studio.table, HandPose.of(*_perturbed(placed, generator)), **options)


def _overlap(fit: Fit, placed: Any) -> float:
    model = HandProjector(placed.kinematics, placed.camera, fit.shape).silhouette(fit.pose, fit.root_reference)
    truth = _exact_mask(placed)
    return float((model & truth).sum() / (model | truth).sum())


def _keypoints_px(fit: Fit, placed: Any) -> Tensor:
    frames = placed.kinematics(fit.pose, fit.shape, root_reference=fit.root_reference)
    return placed.camera.project(frames.keypoints)


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_known_hand_is_recovered_from_a_start_that_is_off(side: str, studio: Any) -> None:
    generator = torch.Generator().manual_seed(5)
    placed = studio.placed(side=side, view="palm", angle_deg=15.0, camera=studio.camera(*WIDE))
    fit = _fitted(placed, studio, generator, placed.shape, fit_shape=False)
    assert torch.equal(fit.shape, placed.shape)
    assert bool((fit.shape_std == 0).all())
    assert fit.residual_px < 0.3
    assert fit.found_fraction > 0.95
    assert _overlap(fit, placed) > 0.97
    off = (_keypoints_px(fit, placed) - placed.keypoints_px).norm(dim=-1)
    assert float(off.mean()) < 1.0
    angles = torch.tensor([dof.endswith("mcp_aa") for dof in DOFS])
    assert float((fit.pose - placed.pose)[angles].abs().max()) < math.radians(2.0)


@pytest.mark.parametrize("kind", ["pinhole", "lens", "orthographic"])
def test_another_persons_shape_is_fitted(kind: str, studio: Any) -> None:
    generator = torch.Generator().manual_seed(8)
    camera = studio.camera(*WIDE, kind="orthographic" if kind == "orthographic" else "pinhole", lens=kind == "lens")
    default = studio.kinematics().default_shape
    shape = sample_shape(studio.kinematics().shape_space, generator, spread=0.8)
    names = studio.kinematics().shape_space.names
    shape[names.index("hand_length")] = default[names.index("hand_length")]
    placed = studio.placed(view="back", angle_deg=-20.0, shape=shape, camera=camera)
    fit = _fitted(placed, studio, generator, default)
    assert fit.residual_px < 1.0
    assert fit.found_fraction > 0.9
    assert _overlap(fit, placed) > 0.95
    off = (_keypoints_px(fit, placed) - placed.keypoints_px).norm(dim=-1)
    assert float(off.mean()) < 0.05 * placed.length_px
    assert _overlap(_fitted(placed, studio, generator, default, fit_shape=False), placed) < _overlap(fit, placed)
    # Proportions come nearer to the truth, weighed by how much people differ.
    std = placed.kinematics.shape_space.std
    seen = std > 0
    before, after = ((s - shape)[seen] / std[seen] for s in (default, fit.shape))
    assert float(after.norm()) < float(before.norm())


def test_limits_bounds_and_the_hands_length_are_kept(studio: Any) -> None:
    generator = torch.Generator().manual_seed(2)
    kinematics = studio.kinematics()
    space, skeleton = kinematics.shape_space, kinematics.skeleton
    shape = torch.where(torch.arange(len(space.names)) % 2 == 0, space.lower, space.upper)  # no human being
    placed = studio.placed(shape=shape, camera=studio.camera(*WIDE))
    start = kinematics.default_shape
    fit = _fitted(placed, studio, generator, start, settings=FitSettings(edge_std_px=0.05))
    assert bool((fit.shape >= space.lower).all())
    assert bool((fit.shape <= space.upper).all())
    length = space.names.index("hand_length")
    assert fit.shape[length] == start[length]
    assert fit.shape_std[length] == 0
    assert bool((fit.pose[6:] >= skeleton.lower).all())
    assert bool((fit.pose[6:] <= skeleton.upper).all())
    at_bound = (fit.shape == space.lower) | (fit.shape == space.upper)
    free = torch.arange(len(space.names)) != length
    assert bool((at_bound & free).any())  # there was something to keep within
    assert bool((fit.shape_std[at_bound] == 0).all())
    inside = ~at_bound & free & (space.std > 0)
    assert bool((fit.shape_std[inside] > 0).all())
    assert bool((fit.shape_std <= space.std * (1 + 1e-9)).all())  # a picture only adds knowledge


def test_the_pose_comes_back_with_a_zero_rotation_vector_and_frozen_joints(studio: Any) -> None:
    generator = torch.Generator().manual_seed(3)
    placed = studio.placed()
    start, _ = _perturbed(placed, torch.Generator().manual_seed(3))
    fit = _fitted(placed, studio, generator, placed.shape, fit_shape=False)
    assert bool((fit.pose[3:6] == 0).all())
    eye = torch.eye(3, dtype=torch.float64)
    torch.testing.assert_close(fit.root_reference @ fit.root_reference.T, eye, rtol=0, atol=1e-12)
    is_frozen = pose_prior_std(start) == 0
    is_frozen[3:6] = False
    assert bool(is_frozen.any())
    assert torch.equal(fit.pose[is_frozen], start[is_frozen])
    assert bool((fit.pose_std[is_frozen] == 0).all())


def test_edges_that_are_none_leave_the_start(studio: Any) -> None:
    placed = studio.placed()
    empty = torch.zeros(placed.camera.height, placed.camera.width)
    fit = fit_contour(empty, placed.projector, studio.table, HandPose.of(placed.pose, placed.root_reference))
    assert fit.found_fraction == 0.0
    assert fit.residual_px == math.inf
    torch.testing.assert_close(fit.pose, placed.pose, rtol=0, atol=1e-9)
    torch.testing.assert_close(fit.shape, placed.shape, rtol=0, atol=1e-9)
    torch.testing.assert_close(fit.root_reference, placed.root_reference, rtol=0, atol=1e-9)


def test_several_placements_at_once_end_where_each_ends_by_itself(studio: Any) -> None:
    placed = studio.placed(camera=studio.camera(*WIDE))
    generator, plane = torch.Generator().manual_seed(6), mask_plane(_exact_mask(placed))
    starts = [HandPose.of(*_perturbed(placed, generator)) for _ in range(3)]
    behind = HandPose(dofs=starts[0].dofs - 2.0 * (torch.arange(36) == 2), reference=starts[0].reference)
    starts.insert(1, behind)
    together = fit_contours(plane, placed.projector, studio.table, HandPose.stack(starts))
    alone = [fit_contour(plane, placed.projector, studio.table, start, fit_shape=False) for start in starts]
    assert [fit.found_fraction > 0.9 for fit in together] == [True, False, True, True]
    for one, other in zip(together, alone, strict=True):
        torch.testing.assert_close(one.pose, other.pose, rtol=0, atol=1e-7)
        torch.testing.assert_close(one.root_reference, other.root_reference, rtol=0, atol=1e-7)
        torch.testing.assert_close(one.pose_std, other.pose_std, rtol=1e-6, atol=1e-9)
        assert one.found_fraction == pytest.approx(other.found_fraction, abs=1e-9)
    empty = fit_contours(torch.zeros_like(plane), placed.projector, studio.table, HandPose.stack(starts))
    assert [fit.found_fraction for fit in empty] == [0.0] * len(starts)


def test_a_hand_behind_the_camera_is_no_error(studio: Any) -> None:
    placed = studio.placed()
    pose = placed.pose.clone()
    pose[2] = -0.5
    plane = mask_plane(placed.mask)
    fit = fit_contour(plane, placed.projector, studio.table, HandPose.of(pose, placed.root_reference))
    assert fit.found_fraction == 0.0
    assert torch.equal(fit.pose, pose)


def test_more_noise_of_edges_trusts_the_start_more(studio: Any) -> None:
    placed = studio.placed()
    pose, _ = _perturbed(placed, torch.Generator().manual_seed(4))
    moved = []
    for std in (1.5, 500.0):
        fit = _fitted(
            placed, studio, torch.Generator().manual_seed(4), placed.shape, settings=FitSettings(edge_std_px=std)
        )
        moved.append(float((fit.pose[:3] - pose[:3]).norm()))
    assert moved[1] < 0.2 * moved[0]


def test_bent_fingers_of_the_posture_have_more_freedom() -> None:
    straight, bent = (
        pose_prior_std(posture("open", dtype=torch.float64)),
        pose_prior_std(posture("fist", dtype=torch.float64)),
    )
    index = DOFS.index("index_pip_fe")
    assert (float(straight[index]), float(bent[index])) == (0.08, 0.25)
    assert float(straight[DOFS.index("index_mcp_tw")]) == 0.0
    assert bool((straight[:6] > 0).all())


def test_a_placement_that_nothing_was_compared_with(studio: Any) -> None:
    placed = studio.placed()
    fit = Fit.of_start(placed.pose, placed.root_reference, placed.shape)
    assert (fit.found_fraction, fit.residual_px) == (0.0, math.inf)
    assert float(fit.pose_std.sum() + fit.shape_std.sum()) == 0.0


def test_length_in_the_picture(studio: Any) -> None:
    placed = studio.placed(size=0.5)
    length_px = hand_length_px(placed.camera, placed.kinematics, placed.pose, placed.shape)
    assert length_px == pytest.approx(0.5 * placed.camera.height, rel=1e-9)
    flat = studio.placed(camera=studio.camera(kind="orthographic"))
    moved = flat.pose.clone()
    moved[2] = 7.0
    lengths = [hand_length_px(flat.camera, flat.kinematics, pose, flat.shape) for pose in (flat.pose, moved)]
    assert lengths == pytest.approx([0.6 * flat.camera.height] * 2, rel=1e-9)


def test_points_in_the_picture() -> None:
    camera = assumed_camera(10, 6)
    inside = torch.tensor(((0.0, 0.0), (9.0, 5.0), (4.5, 2.5)))
    outside = torch.tensor(((-0.1, 2.0), (9.1, 2.0), (4.0, -0.1), (4.0, 5.1), (torch.nan, 2.0)))
    assert is_in_picture(inside, camera).tolist() == [True] * 3
    assert is_in_picture(outside, camera).tolist() == [False] * 5
    assert is_in_picture(torch.stack((inside, outside[:3])), camera).tolist() == [[True] * 3, [False] * 3]


def test_outer_points_are_those_at_the_silhouettes_edge() -> None:
    silhouette = torch.zeros(40, 60, dtype=torch.bool)
    silhouette[10:30, 20:60] = True
    points = torch.tensor(((20.0, 20.0), (40.0, 20.0), (59.0, 20.0), (30.0, 29.0)))
    normals = torch.tensor(((-1.0, 0.0), (1.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
    # to the left of the block; in its middle; at the picture's edge; at its lower edge
    assert is_outer(silhouette, points, normals, 100.0).tolist() == [True, False, True, True]


def test_the_fit_is_the_same_every_time(studio: Any) -> None:
    placed = studio.placed(angle_deg=12.0)
    settings = replace(FitSettings(), iterations=3)
    one, other = (
        _fitted(placed, studio, torch.Generator().manual_seed(1), placed.shape, settings=settings) for _ in range(2)
    )
    assert torch.equal(one.pose, other.pose)
    assert torch.equal(one.shape, other.shape)
