"""Hands that views are read to show, and the one that silhouettes choose among them."""

import torch

from torchhand.hand import HandPose
from torchhand.track.multiview import FrameFitter, HandProposer, RigSettings
from torchhand.track.scene import HandKeypoints, Scene, View


def _error_mm(hand, pose: HandPose, truth) -> float:
    found = hand.kinematics(pose.dofs, root_reference=pose.reference).keypoints
    points = hand.kinematics(truth[0], root_reference=truth[1]).keypoints
    return 1e3 * float((found - points).norm(dim=-1).mean(-1).min())


def _scene(masks, keypoints=None) -> Scene:
    seen = keypoints or [None] * len(masks)
    views = tuple(View(mask=mask, keypoints=points) for mask, points in zip(masks, seen, strict=True))
    return Scene(views=views, masks=tuple(masks), probabilities=(None,) * len(masks), time_s=0.0)


def test_silhouettes_of_all_views_correct_what_single_views_show(rig_hand, rig, pose_at, masks_of):
    pose = pose_at("point", turn=-0.8)
    masks, shape = masks_of(pose), rig_hand.kinematics.default_shape
    fitter = FrameFitter(rig_hand, rig, RigSettings())
    with torch.inference_mode():
        proposed = HandProposer(kinematics=rig_hand.kinematics, cameras=fitter.cameras)(_scene(masks), shape)
        assert proposed is not None
        found = fitter.fit_proposed(fitter.hull_anywhere(shape, masks), proposed, shape, masks)
    assert found is not None
    assert _error_mm(rig_hand, found.pose, pose) < 4.0
    assert _error_mm(rig_hand, found.pose, pose) < _error_mm(rig_hand, proposed, pose)


def test_keypoints_come_first(rig_hand, rig, pose_at, masks_of):
    pose, shape = pose_at("point"), rig_hand.kinematics.default_shape
    points = rig_hand.kinematics(pose[0], root_reference=pose[1]).keypoints
    seen = [HandKeypoints(points_px=one.project(points), points=points @ one.rotation.mT) for one in rig]
    cameras = [camera.to(dtype=torch.float64) for camera in rig]
    scene = _scene(masks_of(pose), seen)
    alone = HandProposer(kinematics=rig_hand.kinematics, cameras=cameras, has_network=False)(scene, shape)
    assert alone is not None
    assert len(alone) == 1
    assert _error_mm(rig_hand, alone, pose) < 8.0
    both = HandProposer(kinematics=rig_hand.kinematics, cameras=cameras)(scene, shape)
    assert both is not None
    assert len(both) > 1
    torch.testing.assert_close(both[:1].dofs, alone.dofs)


def test_nothing_is_proposed_where_nothing_is_seen(rig_hand, rig, pose_at, masks_of):
    masks = [torch.zeros_like(mask) for mask in masks_of(pose_at())]
    shape = rig_hand.kinematics.default_shape
    proposer = HandProposer(kinematics=rig_hand.kinematics, cameras=rig)
    assert proposer(_scene([None, *masks[1:]]), shape) is None
    fitter = FrameFitter(rig_hand, rig, RigSettings())
    assert fitter.fit_proposed(fitter.hull_anywhere(shape, masks), None, shape, masks) is None
