"""Where makers of hands put joints: farther apart along the bones than across them."""

import torch

from torchhand.files import load_hand_model
from torchhand.hand import KEYPOINTS, bone_directions, centre_covariance, centre_spread, scale_covariance

BASE, KNUCKLE, TIP, BEFORE = (KEYPOINTS.index(name) for name in ("thumb_cmc", "thumb_mcp", "index_tip", "index_dip"))

ALONG_M = (0.011, 0.021, 0.005, 0.005, 0.0075, *(0.004, 0.004, 0.004, 0.0075) * 4)
ACROSS_M = 0.004


def _keypoints() -> torch.Tensor:
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    return kinematics(torch.zeros(2, 36, dtype=torch.float64), kinematics.default_shape).keypoints


def test_the_base_of_the_thumb_is_unknown_along_its_metacarpal() -> None:
    """Two centimetres along it, and no more across than any joint, however the hand is turned."""
    keypoints = _keypoints()
    bone = torch.nn.functional.normalize(keypoints[0, KNUCKLE] - keypoints[0, BASE], dim=0)
    covariance = centre_covariance(keypoints)[0, BASE]
    assert abs(float(bone @ covariance @ bone) ** 0.5 - 0.021) < 1e-9
    values = torch.linalg.eigvalsh(covariance).sqrt()
    torch.testing.assert_close(values[:2], values.new_full((2,), 0.004))


def test_every_joint_is_known_as_well_as_makers_agree() -> None:
    values = torch.linalg.eigvalsh(centre_covariance(_keypoints())[0]).sqrt()
    expected = torch.stack((*[torch.full((21,), ACROSS_M)] * 2, torch.tensor(ALONG_M)), -1)
    torch.testing.assert_close(values, expected.to(values), rtol=1e-6, atol=0)


def test_a_tip_is_unknown_along_the_last_bone() -> None:
    keypoints = _keypoints()
    along = torch.nn.functional.normalize(keypoints[:, TIP] - keypoints[:, BEFORE], dim=-1)
    torch.testing.assert_close(bone_directions(keypoints)[:, TIP], along)
    torch.testing.assert_close(bone_directions(keypoints)[:, BEFORE], along)


def test_the_spread_is_the_root_of_the_covariance() -> None:
    keypoints = _keypoints()
    spread = centre_spread(keypoints)
    torch.testing.assert_close(spread, spread.mT)
    torch.testing.assert_close(spread @ spread, centre_covariance(keypoints))


def test_an_unknown_size_moves_all_along_their_rays() -> None:
    keypoints = _keypoints() + torch.tensor((0.0, 0.0, 0.5), dtype=torch.float64)
    moved = 1.01 * keypoints - keypoints
    torch.testing.assert_close(scale_covariance(keypoints, 0.01), moved[..., :, None] * moved[..., None, :])
