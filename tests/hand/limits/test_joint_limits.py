"""Joint limits on whole poses."""

import torch

from torchhand.files import load_hand_model
from torchhand.hand.limits.joint_limits import clamp_to_limits


def test_angles_are_clamped_and_the_root_is_left() -> None:
    skeleton = load_hand_model().skeleton
    generator = torch.Generator().manual_seed(1)
    pose = 4 * torch.randn(2, 3, 36, generator=generator, dtype=torch.float64)
    clamped = clamp_to_limits(pose, skeleton)
    torch.testing.assert_close(clamped[..., :6], pose[..., :6], rtol=0, atol=0)
    expected = torch.stack([p.clamp(skeleton.lower, skeleton.upper) for p in pose[..., 6:].reshape(6, 30)])
    torch.testing.assert_close(clamped[..., 6:].reshape(6, 30), expected, rtol=0, atol=0)
    assert bool((clamped != pose).any())
    torch.testing.assert_close(clamp_to_limits(pose[1, 2], skeleton), clamped[1, 2], rtol=0, atol=0)


def test_poses_within_the_limits_stay_and_gradients_stop_at_them() -> None:
    skeleton = load_hand_model().skeleton
    pose = torch.zeros(36, dtype=torch.float64)
    pose[6:] = 0.3 * skeleton.lower + 0.7 * skeleton.upper
    torch.testing.assert_close(clamp_to_limits(pose, skeleton), pose, rtol=0, atol=0)
    pose[6] = skeleton.upper[0] + 1
    pose.requires_grad_()
    clamp_to_limits(pose, skeleton).sum().backward()
    assert pose.grad is not None
    moving = skeleton.upper > skeleton.lower
    assert pose.grad[6] == 0
    assert bool((pose.grad[7:][moving[1:]] == 1).all())
    assert clamp_to_limits(pose.detach().float(), skeleton).dtype == torch.float32
