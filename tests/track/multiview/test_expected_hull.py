"""The hull about where a hand was expected before serves the frame, unless the hand is elsewhere."""

import pytest
import torch

from torchhand.hand import HandPose
from torchhand.track.multiview import RigSettings, hull_about
from torchhand.track.multiview.fitting import FrameFitter
from torchhand.track.scene import Scene, View


@pytest.mark.parametrize(("moved_m", "is_served"), [(0.03, True), (0.05, False)])
def test_it_serves_hands_within_four_centimetres(rig, rig_hand, pose_at, masks_of, moved_m, is_served):
    at = pose_at()
    pose = HandPose(dofs=at[0], reference=at[1])
    fitter = FrameFitter(rig_hand, rig, RigSettings())
    place = fitter.place_of(pose.normalized(), rig_hand.shape)
    expected = place + torch.tensor((0.0, moved_m, 0.0), dtype=torch.float64)
    masks = tuple(masks_of(at))
    scene = Scene(
        views=tuple(View() for _ in rig), masks=masks, probabilities=(None,) * len(rig), time_s=0.0, expected=expected
    )
    hull = hull_about(fitter, scene, pose, rig_hand.shape)
    assert hull.target is not None
    assert hull.about is not None
    torch.testing.assert_close(hull.about, expected if is_served else place, atol=0, rtol=0)
    assert hull_about(fitter, scene, pose, rig_hand.shape) is hull
