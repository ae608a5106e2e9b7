"""The poses of a recording as one path: smoothed, filled, and free of single leaps."""

import torch

from torchhand.files import load_hand_model
from torchhand.fit.keypoints.recording import Motion, PosePath, is_short_gap
from torchhand.hand import DOFS, HandPose, named_pose_space

SPACE = named_pose_space("dof27").to(dtype=torch.float64)
SKELETON = load_hand_model().kinematics("right", dtype=torch.float64).skeleton
INDEX = DOFS.index("index_pip_fe")
COUNT = 60


def _poses(noise: float) -> tuple[HandPose, HandPose]:
    """A finger that bends and stretches while the hand turns right around; true, and with errors."""
    time = torch.arange(COUNT, dtype=torch.float64)
    dofs = torch.zeros(COUNT, len(DOFS), dtype=torch.float64)
    dofs[:, 0] = 0.001 * time
    dofs[:, 5] = 0.12 * time
    dofs[:, INDEX] = 0.8 + 0.6 * (0.2 * time).sin()
    true = HandPose.of(dofs).normalized()
    off = dofs.clone()
    off[:, INDEX] += noise * torch.randn(COUNT, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    return true, HandPose.of(off).normalized()


def _path(pose: HandPose, is_known: torch.Tensor, noise: float) -> PosePath:
    covariance = noise**2 * torch.eye(SPACE.size, dtype=torch.float64).expand(COUNT, -1, -1)
    return PosePath.of(pose, covariance, is_known, SPACE)


def test_smoothing_lowers_errors_that_are_new_in_every_frame_and_its_covariance_says_so() -> None:
    true, noisy = _poses(0.1)
    path = _path(noisy, torch.ones(COUNT, dtype=torch.bool), 0.1)
    found = path.smoothed(path.motion(), SKELETON)
    before, after = (
        float((one.dofs - true.dofs)[:, INDEX].square().mean().sqrt()) for one in (noisy, found.pose.normalized())
    )
    assert after < 0.7 * before
    torch.testing.assert_close(found.pose.rotation, true.rotation, rtol=0, atol=0.01)


def test_what_all_frames_have_wrong_stays_in_the_covariance() -> None:
    _, pose = _poses(0.0)
    path = _path(pose, torch.ones(COUNT, dtype=torch.bool), 0.1)
    motion = Motion(
        acceleration=torch.full((SPACE.size,), 1e-4, dtype=torch.float64),
        fresh=torch.full((SPACE.size,), 0.01, dtype=torch.float64),
    )
    std = path.smoothed(motion, SKELETON).covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    assert 0.0994 < float(std.min()) <= float(std.max()) < 0.1001


def test_a_gap_is_filled_by_its_neighbours_with_a_larger_spread() -> None:
    true, pose = _poses(0.0)
    is_known = torch.ones(COUNT, dtype=torch.bool)
    is_known[30:34] = False
    path = _path(pose, is_known, 0.02)
    found = path.smoothed(path.motion(), SKELETON)
    torch.testing.assert_close(found.pose.normalized().dofs[30:34], true.dofs[30:34], rtol=0, atol=0.05)
    torch.testing.assert_close(found.pose.rotation[30:34], true.rotation[30:34], rtol=0, atol=0.05)
    spread = found.covariance.diagonal(dim1=-2, dim2=-1).sum(-1)
    assert float(spread[31]) > float(spread[29])
    assert is_short_gap(is_known, 4).nonzero().flatten().tolist() == [30, 31, 32, 33]
    assert not bool(is_short_gap(is_known, 3).any())
    assert not bool(is_short_gap(~is_known, 60)[:30].any())  # before the first known frame there is no gap


def test_single_leaps_are_found_and_steady_motion_is_none() -> None:
    true, pose = _poses(0.0)
    pose.dofs[20, INDEX] += 1.0
    path = _path(pose, torch.ones(COUNT, dtype=torch.bool), 0.1)
    assert path.leaps().nonzero().flatten().tolist() == [20]
    without = path.without(path.leaps())
    found = without.smoothed(without.motion(), SKELETON).pose.normalized()
    assert abs(float(found.dofs[20, INDEX] - true.dofs[20, INDEX])) < 0.1
