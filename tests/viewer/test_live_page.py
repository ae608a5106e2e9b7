"""The page of a hand that is tracked: what it shows of a frame, and what its controls ask for."""

import numpy as np
import pytest
import torch

from tests.report.made_result import poses
from torchhand.files import FrameRecord, load_hand_model
from torchhand.viewer import LivePage, ViewerServer


@pytest.fixture
def page(server: ViewerServer) -> LivePage:
    return LivePage(server, load_hand_model(), "right")


def _record(frame: int, time_s: float) -> FrameRecord:
    model = load_hand_model()
    pose = poses()[frame]
    frames = model.kinematics(dtype=torch.float64)(torch.from_numpy(pose), model.shape_space.default.double())
    return FrameRecord(
        frame=frame, time_s=time_s, status="tracked", pose=pose, pose_std=np.full(36, np.deg2rad(2.0)),
        keypoints3d=frames.keypoints.numpy(), keypoints2d=np.zeros((21, 2)),
        keypoints3d_cov=np.tile(4e-6 * np.eye(3), (21, 1, 1)), seconds=0.05,
        finger_quality=np.array([0.9, 0.9, 0.1, 0.9, 0.9]),
    )  # fmt: skip


def test_a_frame_is_shown_as_it_is(page: LivePage) -> None:
    shape = load_hand_model().shape_space.default.double()
    picture = torch.full((6, 8, 3), 77, dtype=torch.uint8)
    for frame in range(4):
        page.show(_record(frame, 0.5 * frame), shape, picture, {"pictures dropped": "12"})
    hand = load_hand_model().hand(dtype=torch.float64)
    expected = hand(torch.from_numpy(poses()[3])).vertices.numpy()
    np.testing.assert_allclose(np.asarray(page.scene.skin.vertices), expected, atol=1e-6)
    assert page.scene.skin.visible
    assert page.scene.balls[2].color != page.scene.balls[1].color
    assert page.scene.balls[0].scale == pytest.approx(2e-3)
    for words in ("**tracked**, frame 3, 1.50 s", "shown 2.0 times a second, tracked in 50 ms", "pictures dropped: 12"):
        assert words in page.told.content
    assert f"{np.rad2deg(poses()[3, 16]):.0f}° ± 2°" in page.angles.content
    time_s, low, high, value = (np.asarray(one) for one in page.curve.data)
    np.testing.assert_allclose(time_s, [0.0, 0.5, 1.0, 1.5])
    np.testing.assert_allclose(value, np.rad2deg(poses()[:4, 16]))
    np.testing.assert_allclose(high - low, 4.0)


def test_a_frame_without_a_hand_shows_none(page: LivePage) -> None:
    shape = load_hand_model().shape_space.default.double()
    page.show(_record(0, 0.0), shape, None, {})
    page.show(FrameRecord.empty(1, "lost", dofs=36, seconds=0.1, time_s=0.1, reason="out of view"), shape, None, {})
    assert not page.scene.skin.visible
    assert "**lost** (out of view)" in page.told.content


def test_controls_ask_for_what_they_say(page: LivePage) -> None:
    assert not page.takes_restart()
    for call in page.restart._impl.update_cb:
        call(None)
    assert page.takes_restart()
    assert not page.takes_restart()  # once
    assert not page.records
    page.record.value = True
    assert page.records
