"""The joints of OpenXR: order, batches, the way back."""

import torch

from torchhand.files import load_hand_model
from torchhand.hand.conventions.openxr import (
    OPENXR_JOINTS,
    OPENXR_KEYPOINTS,
    openxr_joints,
    openxr_radii,
    pose_of_openxr,
)
from torchhand.hand.kinematics import KEYPOINTS


def test_the_21_keypoints_among_the_26_joints() -> None:
    """Without metacarpals and palm: drop 0, 6, 11, 16, 21."""
    assert len(OPENXR_JOINTS) == 26
    assert sorted({*range(26)} - {*OPENXR_KEYPOINTS}) == [0, 6, 11, 16, 21]
    words = {"metacarpal": "cmc", "tip": "tip"}
    for joint, keypoint in zip(OPENXR_KEYPOINTS, KEYPOINTS, strict=True):
        finger, _, part = OPENXR_JOINTS[joint].partition("_")
        thumb = {"proximal": "mcp", "distal": "ip"}
        others = {"proximal": "mcp", "intermediate": "pip", "distal": "dip"}
        expected = (words | (thumb if finger == "thumb" else others)).get(part)
        assert keypoint == (f"{finger}_{expected}" if part else "wrist")


def test_any_batch_is_a_loop_and_comes_back(generator: torch.Generator) -> None:
    model = load_hand_model()
    for side in ("right", "left"):
        kinematics = model.kinematics("right" if side == "right" else "left", dtype=torch.float64)
        poses, _ = model.prior(dtype=torch.float64).sample(6, generator)
        poses = poses.double()
        many = openxr_joints(kinematics(poses.unflatten(0, (2, 3))))
        back = pose_of_openxr(kinematics, many)
        assert torch.allclose(back.pose[..., 6:].flatten(0, 1), poses[:, 6:], rtol=0, atol=1e-9)
        for i in range(6):
            one = openxr_joints(kinematics(poses[i]))
            assert torch.allclose(many.position[i // 3, i % 3], one.position, rtol=0, atol=1e-14)
            assert torch.allclose(many.rotation[i // 3, i % 3], one.rotation, rtol=0, atol=1e-14)
            assert float((one.rotation @ one.rotation.mT - torch.eye(3).double()).abs().max()) < 1e-12
            assert float(torch.det(one.rotation).min()) > 0.999


def test_radii_follow_the_shape(generator: torch.Generator) -> None:
    space = load_hand_model().shape_space
    _, shapes = load_hand_model().prior(dtype=torch.float64).sample(3, generator)
    radii = openxr_radii(space, shapes)
    assert radii.shape == (3, 26)
    metres = space.metric(shapes)
    assert torch.equal(radii[:, OPENXR_JOINTS.index("ring_distal")], metres["ring_dip_radius"])
    assert torch.equal(radii[:, OPENXR_JOINTS.index("thumb_proximal")], metres["thumb_mcp_radius"])
    assert float(radii.min()) > 0.003
    assert float(radii.max()) < 0.03
