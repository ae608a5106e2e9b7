from dataclasses import replace

import pytest
import torch

from torchhand.fit.hull import HullShapeSettings, HullStartSettings
from torchhand.hand import Anthropometry
from torchhand.track.multiview.acquaintance import acquaint, moments_of
from torchhand.track.multiview.fitting import Anchor, MomentFitter
from torchhand.track.multiview.scale import in_unit, moved_anchor, resized_shape, rough_units, size_factor
from torchhand.track.multiview.settings import RigSettings

SETTINGS = RigSettings(
    start=HullStartSettings(places=1, rolls=4, postures=("open",), coarse=6, fine=2, finger_rounds=0),
    shape=HullShapeSettings(rounds=3, iterations=2),
)


@pytest.mark.parametrize(
    ("count", "frames", "expected"),
    [(12, 12, tuple(range(12))), (100, 4, (12, 37, 62, 87)), (3, 8, (0, 1, 2)), (5, 0, ()), (0, 4, ())],
)
def test_moments_lie_evenly(count, frames, expected):
    assert moments_of(count, frames) == expected


def test_hand_is_met_in_the_moments_that_show_it(rig_hand, rig, pose_at, masks_of):
    fits = MomentFitter(rig_hand, rig, SETTINGS)
    people = Anthropometry(rig_hand.kinematics.shape_space)
    poses = [pose_at(), pose_at(turn=0.45)]
    empty = [torch.zeros_like(mask) for mask in masks_of(poses[0])]
    done = []
    with torch.inference_mode():
        met = acquaint(
            fits,
            [(3, masks_of(poses[0])), (8, empty), (9, masks_of(poses[1]))],
            people,
            done=lambda: done.append(1),
        )
    assert len(done) == 3
    assert set(met.anchors) == {3, 9}
    assert met.learned_from == (3, 9)
    space = rig_hand.kinematics.shape_space
    apart = (met.shape - space.default.to(met.shape)).abs() / space.std.to(met.shape)
    assert float(apart.mean()) < 1.0
    for anchor, pose in zip((met.anchors[3], met.anchors[9]), poses, strict=True):
        found = rig_hand.kinematics(anchor.pose, met.shape, root_reference=anchor.root_reference).keypoints
        truth = rig_hand.kinematics(pose[0], root_reference=pose[1]).keypoints
        assert float((found - truth).norm(dim=-1).mean()) < 0.008


def test_nobody_is_met_where_there_is_nobody(rig_hand, rig, pose_at, masks_of):
    fits = MomentFitter(rig_hand, rig, SETTINGS)
    empty = [torch.zeros_like(mask) for mask in masks_of(pose_at())]
    met = acquaint(fits, [(0, empty)], Anthropometry(rig_hand.kinematics.shape_space))
    assert not met.anchors
    assert met.shape_std is None
    torch.testing.assert_close(met.shape, rig_hand.kinematics.default_shape)


def test_rough_units_hold_the_true_one(rig, pose_at, masks_of):
    unknown = in_unit(rig, 1 / 0.0254)  # as if in inches
    empty = [torch.zeros_like(mask) for mask in masks_of(pose_at())]
    for postures in (("open",), ("fist", "open"), ("fist",)):
        moments = [(i, masks_of(pose_at(name))) for i, name in enumerate(postures)]
        units, telling = rough_units(unknown, [(9, empty), *moments])
        assert min(abs(unit / 0.0254 - 1) for unit in units) < 0.13
        assert [moment for moment, _ in telling] == list(range(len(postures)))
    assert rough_units(unknown, [(9, empty)]) == ((), [])


def test_everything_scales_together(rig_hand, pose_at):
    space = rig_hand.kinematics.shape_space
    shape = rig_hand.kinematics.default_shape
    larger = resized_shape(shape, 1.1, space)
    assert size_factor(shape, larger, space) == pytest.approx(1.1)
    pose, reference = pose_at()
    moved = moved_anchor(Anchor(pose=pose, root_reference=reference), 1.1)
    before = rig_hand.kinematics(pose, shape, root_reference=reference).keypoints
    after = rig_hand.kinematics(moved.pose, larger, root_reference=moved.root_reference).keypoints
    torch.testing.assert_close(after, 1.1 * before)


def test_settings_refuse():
    for name, value in (("pose_space", "dof99"), ("sizes", ()), ("shape_frames", -1)):
        with pytest.raises(ValueError, match=name):
            replace(SETTINGS, **{name: value})
