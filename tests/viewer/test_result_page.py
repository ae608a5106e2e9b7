"""The page of a result, driven as a browser does: the slider shows the frame's hand, playing keeps its times."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.report.made_result import FPS, FRAMES, LOST, OPEN_FINGER, poses, write_result
from torchhand.report import load_result
from torchhand.viewer import ResultPage, ViewerServer


@pytest.fixture
def page(server: ViewerServer, tmp_path: Path) -> ResultPage:
    result = load_result(write_result(tmp_path / "result", has_video=False))
    track, model = result.track, result.model
    return ResultPage(server, track, model, side=result.side, shape=result.shape, fps=result.fps)


def test_the_slider_shows_the_hand_of_its_frame(page: ResultPage) -> None:
    hand = page.hand
    for row in (0, 20, FRAMES - 1):
        page.frame.value = row
        expected = hand(torch.from_numpy(poses()[row])).vertices.numpy()
        np.testing.assert_allclose(np.asarray(page.scene.skin.vertices), expected, atol=1e-6)
        assert page.scene.skin.visible
        assert f"frame {row}, {row / FPS:.3f} s" in page.told.content
        assert "not determined: middle" in page.told.content
    colours = {tuple(ball.color) for ball in page.scene.balls}
    assert len(colours) == 2
    assert page.scene.balls[OPEN_FINGER].color != page.scene.balls[0].color
    assert page.scene.balls[0].scale == pytest.approx(1e-3)


def test_a_lost_frame_shows_no_hand(page: ResultPage) -> None:
    page.frame.value = LOST[0]
    assert not page.scene.skin.visible
    assert not any(ball.visible for ball in page.scene.balls)
    assert "**lost**" in page.told.content
    page.frame.value = 0
    assert page.scene.skin.visible


def test_playing_keeps_the_times_of_the_track_and_begins_again(page: ResultPage) -> None:
    page.frame.value = 4
    page.advance(1e9)
    assert page.frame.value == 4  # nothing plays yet
    page.play.value = True
    started_s, first_s = page.playing_since or (0.0, 0.0)
    assert first_s == pytest.approx(4 / FPS)
    for elapsed_s, row in ((0.26, 9), (1.01, 24), (FRAMES / FPS, 4)):
        page.advance(started_s + elapsed_s)
        assert abs(page.frame.value - row) <= 1
    page.play.value = False
    page.advance(started_s + 0.5)
    assert abs(page.frame.value - 4) <= 1


def test_the_curve_is_that_of_the_angle_with_its_band(page: ResultPage) -> None:
    page.angle.value = "index_pip_fe"
    times_s, low, high, value = (np.asarray(one) for one in page.curve.data)
    np.testing.assert_allclose(times_s, np.arange(FRAMES) / FPS)
    known = np.isfinite(value)
    assert known.sum() == FRAMES - len(LOST)
    np.testing.assert_allclose(value[known], np.rad2deg(poses()[known, 16]))
    np.testing.assert_allclose((high - low)[known], 6.0)
