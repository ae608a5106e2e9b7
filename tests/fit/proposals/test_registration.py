"""Proposed hands registered on a silhouette: near ones come to the truth, and the truth is the cheapest."""

import math

import pytest
import torch

from tests.studio import StagedHand, Studio
from torchhand.fit.proposals.registration import ProposalRegistration
from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandPose, posture
from torchhand.propose import Silhouette


@pytest.fixture(scope="module")
def staged() -> StagedHand:
    return Studio().placed(posed="open", size=0.8, view="back", angle_deg=20.0, camera=Studio().camera(320, 240))


def _starts(staged: StagedHand) -> HandPose:
    """A hand some degrees and millimetres off, and a fist there."""
    off = rotation_from_vector(torch.tensor([0.05, 0.05, math.radians(3)], dtype=torch.float64))
    near = staged.pose.clone()
    near[:3] += torch.tensor([0.006, -0.004, 0.01])
    near[6:] *= 0.95
    fist = torch.cat((near[:6], posture("fist", dtype=torch.float64)[6:]))
    return HandPose.of(torch.stack((near, fist)), off @ staged.root_reference)


def _errors_px(staged: StagedHand, pose: HandPose) -> torch.Tensor:
    """Mean distance of the keypoints in the picture: a silhouette tells little of depth."""
    found = staged.kinematics(pose.dofs, staged.shape, root_reference=pose.reference).keypoints
    return (staged.camera.project(found) - staged.keypoints_px).norm(dim=-1).mean(-1)


def test_a_near_hand_comes_to_the_truth_and_is_the_cheapest(staged: StagedHand) -> None:
    registration = ProposalRegistration(kinematics=staged.kinematics)
    seen = Silhouette(mask=staged.mask, camera=staged.camera)
    starts = _starts(staged)
    found = registration(seen, starts, staged.shape)
    assert found.best == 0
    before, after = _errors_px(staged, starts), _errors_px(staged, found.pose)
    assert float(before[0]) > 5
    assert float(after[0]) < 0.4 * float(before[0])


def test_weights_count_in_nats(staged: StagedHand) -> None:
    registration = ProposalRegistration(kinematics=staged.kinematics)
    seen, starts = Silhouette(mask=staged.mask, camera=staged.camera), _starts(staged)
    weight = torch.tensor([0.2, 0.8], dtype=torch.float64)
    plain, weighted = (registration(seen, starts, staged.shape, weight=one) for one in (None, weight))
    torch.testing.assert_close(weighted.cost, plain.cost - weight.log())
    torch.testing.assert_close(weighted.pose.dofs, plain.pose.dofs)
