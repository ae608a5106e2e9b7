"""What a candidate is worth beside the areas that it explains: detected points, and the network's view of its side."""

from dataclasses import replace
from typing import Any

import torch

from torchhand.hand import HandPose
from torchhand.numerics import Gaussian
from torchhand.track.belief import FollowedHand
from torchhand.track.scene import Agreement, Candidate, Health, HealthSettings

HEALTH = Health(settings=HealthSettings())
POSE = HandPose(dofs=torch.zeros(36, dtype=torch.float64), reference=torch.eye(3, dtype=torch.float64))
NOTHING = Gaussian(torch.zeros(1, dtype=torch.float64), torch.eye(1, dtype=torch.float64))
SOUND = Candidate(
    hand=FollowedHand(belief=NOTHING, base=POSE.dofs, reference=POSE.reference, start_reference=POSE.reference),
    pose=POSE,
    agreement=Agreement.of_overlaps(torch.tensor([0.95], dtype=torch.float64)),
    edges=0.9,
)


def _seen(**told: Any) -> Candidate:
    return replace(SOUND, **told)


def test_a_hand_that_the_network_sees_from_another_side_is_in_doubt() -> None:
    assert not HEALTH.is_degraded(SOUND, 0.0)
    assert not HEALTH.is_degraded(_seen(direction=0.5), 0.0)
    assert HEALTH.is_degraded(_seen(direction=0.02), 0.0)
    assert not HEALTH.is_failing(_seen(direction=0.02))


def test_one_that_it_sees_from_that_side_is_better() -> None:
    turned, right = _seen(direction=0.02), _seen(direction=0.5)
    assert HEALTH.score(right) > HEALTH.score(turned) + 0.2
    assert HEALTH.better(turned, right, None) is right
    assert HEALTH.score(_seen(direction=0.6)) == HEALTH.score(_seen(direction=0.9))  # either is as good as any


def test_it_does_not_say_where_the_hand_is() -> None:
    """Something else that looks like a hand from its side, such as an arm, is none for that."""
    turned = _seen(direction=0.02)
    away = POSE.dofs.clone()
    away[2] = 0.2
    elsewhere = _seen(direction=0.9, pose=replace(POSE, dofs=away))
    assert HEALTH.score(elsewhere) > HEALTH.score(turned) + 0.2
    assert HEALTH.better(turned, elsewhere, None) is turned


def test_it_does_not_turn_a_followed_hand_over_by_itself() -> None:
    """It sees an eighth of a real hand's frames from the other side, for as long as a posture lasts."""
    facing, half = POSE.rotation, torch.diag(torch.tensor((-1.0, 1.0, -1.0), dtype=torch.float64))
    turned = replace(POSE, reference=half)

    def overlapping(overlap: float, **told: Any) -> Candidate:
        return _seen(agreement=Agreement.of_overlaps(torch.tensor([overlap], dtype=torch.float64)), **told)

    followed = overlapping(0.9, direction=0.03)
    for overlap, is_taken in ((0.86, False), (0.9, False), (0.96, True)):
        other = overlapping(overlap, direction=0.9, pose=turned)
        assert HEALTH.score(other) > HEALTH.score(followed) + 0.2
        assert (HEALTH.better(followed, other, facing, is_firm=True) is other) == is_taken
        assert HEALTH.better(followed, other, facing) is other  # that side was only the network's word before, too
        assert HEALTH.better(followed, other, None, is_firm=True) is other  # none is followed yet
        assert HEALTH.better(followed, replace(other, pose=POSE), facing, is_firm=True) is not followed  # not turned
    by_detector = overlapping(0.88, direction=0.9, keypoints=0.9, pose=turned)
    assert HEALTH.better(replace(followed, keypoints=0.2), by_detector, facing, is_firm=True) is by_detector
    much_better = overlapping(0.96, direction=0.02, pose=turned)
    assert HEALTH.better(overlapping(0.7, direction=0.9), much_better, facing, is_firm=True) is not much_better


def test_a_hand_seldom_leaps_unless_much_speaks_for_it() -> None:
    away = POSE.dofs.clone()
    away[2] = -0.2
    nearer = _seen(pose=replace(POSE, dofs=away))
    poor = _seen(agreement=Agreement.of_overlaps(torch.tensor([0.86], dtype=torch.float64)))
    lost = _seen(agreement=Agreement.of_overlaps(torch.tensor([0.4], dtype=torch.float64)))
    facing = POSE.rotation
    assert HEALTH.better(poor, replace(nearer, pose=POSE), facing) is not poor
    assert HEALTH.better(poor, nearer, facing) is poor
    assert HEALTH.better(poor, nearer, None) is nearer  # none is followed yet
    assert HEALTH.better(lost, nearer, facing) is nearer
    assert HEALTH.better(replace(poor, pose=nearer.pose), SOUND, facing) is SOUND  # back from the arm
    assert Health(settings=HEALTH.settings.for_rig()).better(poor, nearer, facing) is nearer


def test_a_detector_is_believed_before_the_network() -> None:
    told = _seen(direction=0.02, keypoints=0.9)
    assert not HEALTH.is_degraded(told, 0.0)
    assert HEALTH.score(told) == HEALTH.score(_seen(keypoints=0.9))


def test_other_hands_come_the_less_often_the_longer_they_do_not_help() -> None:
    rig = HealthSettings().for_rig()
    waits, after = [], 0
    for has_helped in (False, False, False, False, False, True):
        after = rig.next_alternatives(after, has_helped=has_helped)
        waits.append(after)
    assert waits == [4, 8, 8, 8, 8, 4]
    assert not rig.alternatives_are_due(7, 8, is_failing=False)
    assert not rig.alternatives_are_due(1, 8, is_failing=True)
    assert rig.alternatives_are_due(2, 8, is_failing=True)
    assert rig.alternatives_are_due(0, 0, is_failing=False)


def test_with_several_cameras_a_search_in_vain_makes_the_next_one_wait() -> None:
    rig = HealthSettings().for_rig()
    waits, after = [], rig.first_search_after
    for has_found in (False, False, False, False, False, False, False, False, True):
        after = rig.next_search(after, has_found=has_found)
        waits.append(after)
    assert waits == [1, 2, 4, 8, 16, 32, 60, 60, 5]


def test_one_camera_tries_other_hands_in_every_frame() -> None:
    one = HealthSettings()
    assert one.next_alternatives(0, has_helped=False) == 1
    assert one.next_alternatives(1, has_helped=False) == 1
