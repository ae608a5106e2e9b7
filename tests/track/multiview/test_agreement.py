import math
from dataclasses import replace

import torch

from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandPose
from torchhand.track.scene import Scene, SilhouetteComparison, View, mean_overlap


def comparison(hand, cameras):
    """Overlaps of a pose with masks."""
    compare = SilhouetteComparison(hand.kinematics, cameras, hand.kinematics.default_shape, side_px=320)
    return lambda pose, reference, masks: compare.overlaps(HandPose(dofs=pose, reference=reference), masks)


def test_own_silhouettes_agree_and_others_less(rig_hand, rig, pose_at, masks_of):
    agree = comparison(rig_hand, rig)
    pose, reference = pose_at()
    overlaps = agree(pose, reference, masks_of((pose, reference)))
    assert bool((overlaps > 0.8).all())
    moved = pose.clone()
    moved[0] += 0.03
    fist, _ = pose_at("fist")
    for other in (moved, fist):
        assert mean_overlap(agree(other, reference, masks_of((pose, reference)))) < mean_overlap(overlaps) - 0.15


def test_forearm_does_not_count(rig_hand, rig, pose_at, masks_of):
    agree = comparison(rig_hand, rig[:1])
    pose, reference = pose_at()
    mask = masks_of((pose, reference))[0]
    rows, columns = mask.nonzero().unbind(1)
    arm = mask.clone()
    below = columns[rows == rows.max()]
    arm[int(rows.max()) - 3 :, int(below.min()) : int(below.max()) + 1] = True
    alone, with_arm = (float(agree(pose, reference, [seen])[0]) for seen in (mask, arm))
    assert abs(alone - with_arm) < 0.03


def test_view_along_the_palm_is_compared_too(rig_hand, rig, masks_of, pose_at):
    agree = comparison(rig_hand, rig)
    pose, reference = pose_at()
    tilt = rotation_from_vector(torch.tensor((math.pi / 2, 0.0, 0.0), dtype=torch.float64)) @ reference
    pose = pose.clone()
    pose[:3] = torch.tensor((0.0, 0.0, 0.06))
    overlaps = agree(pose, tilt, masks_of((pose, tilt)))
    assert bool((overlaps > 0.7).all())


def test_missing_views_have_no_overlap(rig_hand, rig, pose_at, masks_of):
    agree = comparison(rig_hand, rig)
    pose, reference = pose_at()
    masks = masks_of((pose, reference))
    overlaps = agree(pose, reference, [None, *masks[1:]])
    assert bool(overlaps[0].isnan())
    assert mean_overlap(overlaps) == float(overlaps[1:].mean())
    assert mean_overlap(torch.full((2,), math.nan)) == 0.0


def test_a_picture_of_several_that_hardly_shows_the_hand_is_not_compared(rig_hand, rig, pose_at, masks_of):
    (pose, reference), masks = pose_at(), masks_of(pose_at())
    points = rig[1].project(rig_hand.kinematics(pose, root_reference=reference).keypoints)[:, 0].sort().values
    for shown, is_compared in ((3, False), (8, True)):
        width = int(points[shown - 1]) + 1
        cut, mask = replace(rig[1], width=width), masks[1][:, :width]
        overlaps = comparison(rig_hand, [rig[0], cut])(pose, reference, [masks[0], mask])
        assert overlaps.isfinite().tolist() == [True, is_compared]
        assert bool(comparison(rig_hand, [cut])(pose, reference, [mask]).isfinite().all())


def test_overlaps_are_those_of_the_whole_comparison(rig_hand, rig, pose_at, masks_of):
    compare = SilhouetteComparison(rig_hand.kinematics, rig, rig_hand.kinematics.default_shape, side_px=160)
    pose, reference = pose_at()
    masks = tuple([None, *masks_of((pose, reference))[1:]])
    scene = Scene(views=(View(),) * len(rig), masks=masks, probabilities=(None,) * len(rig), time_s=0.0)
    hand = HandPose(dofs=pose, reference=reference)
    whole = compare(hand, scene)
    torch.testing.assert_close(compare.overlaps(hand, masks), whole.overlaps, rtol=0, atol=0, equal_nan=True)
    assert whole.views == len(rig) - 1
    assert bool(whole.unexplained[0].isnan())


def test_a_finger_that_the_model_lacks_is_unexplained(rig_hand, rig, pose_at, masks_of):
    compare = SilhouetteComparison(rig_hand.kinematics, rig, rig_hand.kinematics.default_shape, side_px=320)
    (seen, reference), (fist, _) = pose_at(), pose_at("fist")
    scene = Scene(
        views=(View(),) * len(rig),
        masks=tuple(masks_of((seen, reference))),
        probabilities=(None,) * len(rig),
        time_s=0.0,
    )
    own, other = (compare(HandPose(dofs=pose, reference=reference), scene) for pose in (seen, fist))
    assert own.most_unexplained < 0.01  # squares of the hand's length; one finger has some 0.04
    assert other.most_unexplained > 0.1
