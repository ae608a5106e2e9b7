"""The page in a real browser: it plays, shows what the track says, and complains of nothing."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from tests.report.browser import CHROMIUM, Page, opened_browser
from tests.report.made_result import FPS, FRAMES, LOST, write_result
from torchhand.files import load_hand_model, load_track
from torchhand.report import load_result, write_report

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs a Chromium or Chrome on the path")

FREE = 20  # joint angles that the made results estimate


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with opened_browser(tmp_path_factory.mktemp("profile")) as page:
        yield page


@pytest.fixture(scope="module")
def report(result: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pages") / "report.html"
    write_report(path, [load_result(result)])
    return path


def _go(page: Page, place: int) -> None:
    page.value(f"report.player.go({place})")


def _colours(page: Page, selector: str) -> np.ndarray:
    """The picture of an element as it is shown, (height, width, 3)."""
    x, y, width, height = page.value(
        f"(b => [b.x, b.y, b.width, b.height].map(Math.round))"
        f"(document.querySelector('{selector}').getBoundingClientRect())"
    )
    image = cv2.imdecode(np.frombuffer(page.picture(), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image[y : y + height, x : x + width]


@pytest.mark.parametrize(("width", "is_dark"), [(1280, False), (900, True)])
def test_it_opens_without_a_complaint_and_fits_the_window(
    browser: Page, report: Path, width: int, is_dark: bool
) -> None:
    browser.messages.clear()
    browser.requests.clear()
    browser.open(report, width=width, height=900, dark=is_dark)
    assert browser.messages == []
    assert all(address.startswith(("file:", "blob:")) for address in browser.requests)
    assert browser.value("document.documentElement.scrollWidth") <= width
    assert browser.value("document.querySelector('#failure').hidden")
    assert browser.value("document.querySelectorAll('.chart').length") == FREE
    assert browser.value("document.documentElement.dataset.theme") == ("dark" if is_dark else "light")
    assert len(np.unique(_colours(browser, "#scene").reshape(-1, 3), axis=0)) > 200  # a shaded hand


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_hand_is_the_one_of_the_track(browser: Page, tmp_path: Path, side: str) -> None:
    """Bones and skin in the page, with what was rounded, against those of the model."""
    folder = write_result(tmp_path / side, side=side, has_video=False)
    write_report(tmp_path / "report.html", [load_result(folder)])
    browser.open(tmp_path / "report.html", width=1000, height=700)
    track, model = load_track(folder), load_hand_model()
    hand = model.hand(side="left" if side == "left" else "right", dtype=torch.float64)
    for row in (0, 20, FRAMES - 1):
        _go(browser, row)
        shown = np.array(browser.value("Array.from(report.hands[0].vertices)")).reshape(-1, 3)
        wanted = hand(torch.from_numpy(track.pose[row])).vertices.numpy()
        assert np.abs(shown - wanted).max() < 1.5e-4
    tips = np.array(browser.value("report.hands[0].tips"))
    np.testing.assert_allclose(tips, track.keypoints3d[FRAMES - 1, [4, 8, 12, 16, 20]], atol=1.5e-4)


def test_a_fingertips_band_is_that_of_its_angles(browser: Page, report: Path, result: Path) -> None:
    """Against the spread of tips over angles drawn at random."""
    browser.open(report, width=1000, height=700)
    row, track, model = 20, load_track(result), load_hand_model()
    _go(browser, row)
    shown = browser.value("report.hands[0].radii")
    noise = torch.randn(20_000, 36, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    pose = torch.from_numpy(track.pose[row]) + noise * torch.from_numpy(track.pose_std[row]) * (torch.arange(36) >= 6)
    tips = model.kinematics(dtype=torch.float64)(pose).keypoints[:, [4, 8, 12, 16, 20]]
    for radius, points in zip(shown, tips.unbind(1), strict=True):
        wanted = 1.96 * float(torch.linalg.eigvalsh(torch.cov(points.T))[-1].sqrt())
        assert radius == pytest.approx(wanted, rel=0.04)


@pytest.mark.slow  # a busy machine plays the video to its end before it is looked at
def test_play_moves_the_hand_in_step_with_the_video(browser: Page, report: Path) -> None:
    browser.open(report, width=1280, height=900)
    before = browser.value("Array.from(report.hands[0].vertices)")
    browser.value("report.player.setSpeed(0.5)")
    browser.value(
        "(told => { window.seen = []; report.player.onFrame = () => { told();"
        " seen.push([report.player.video.currentTime, report.player.place]); }; })(report.player.onFrame)"
    )
    browser.click("#play")
    browser.wait_for("report.player.place >= 5")
    assert browser.value("document.querySelector('#play').getAttribute('aria-label')") == "Pause"
    seen = np.array(browser.value("seen"))
    assert np.abs(seen[:, 0] * FPS - seen[:, 1]).max() < 1.6
    browser.click("#play")
    assert browser.value("document.querySelector('video').paused")
    after = browser.value("Array.from(report.hands[0].vertices)")
    assert np.abs(np.array(after) - np.array(before)).max() > 0.002
    browser.value("report.player.setSpeed(4)")
    browser.click("#play")
    browser.wait_for("!report.player.isPlaying")  # it stops at the end
    assert browser.value("report.player.place") == FRAMES - 1


def test_the_video_shows_the_frame_that_is_scrubbed_to(browser: Page, report: Path) -> None:
    """Frame k of the made video is white on its left 8 k of 320 columns."""
    browser.open(report, width=1280, height=900)
    for place in (30, 9):
        browser.value(
            f"(s => {{ s.value = {place}; s.dispatchEvent(new Event('input')); }})(document.querySelector('#scrub'))"
        )
        browser.wait_for("!document.querySelector('video').seeking")
        browser.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        line = _colours(browser, "video")[100].mean(-1)
        high, wide, tall = browser.value("(v => [v.clientHeight, v.videoWidth, v.videoHeight])(report.player.video)")
        beside = round(0.5 * (len(line) - high * wide / tall))  # the element is wider than the picture in it
        assert (line[beside : len(line) - beside] > 120).mean() == pytest.approx(8 * place / 320, abs=0.03)


def test_lost_frames_and_open_fingers_are_told(browser: Page, report: Path) -> None:
    browser.open(report, width=1280, height=900)
    assert browser.value("document.querySelectorAll('#fingers .open').length") == 1
    _go(browser, LOST[0])
    assert "lost" in browser.value("document.querySelector('#clock').textContent")
    assert browser.value("document.querySelector('#fingers td').textContent.trim()") == "–"
    assert browser.value("report.scene.isShown") == [False]
    _go(browser, LOST[-1] + 1)
    assert "recovered" in browser.value("document.querySelector('#clock').textContent")


def test_the_hand_turns_and_the_curve_leads_to_its_time(browser: Page, report: Path) -> None:
    browser.open(report, width=1280, height=900)
    before = _colours(browser, "#scene")
    browser.value("document.querySelector('#scene').focus()")
    for _ in range(4):
        browser.call("Input.dispatchKeyEvent", type="keyDown", key="ArrowRight", code="ArrowRight")
    assert browser.value("report.scene.turn[0]") == pytest.approx(0.48)
    assert np.abs(_colours(browser, "#scene").astype(int) - before).max() > 40
    browser.click(".chart canvas")
    assert abs(browser.value("report.player.place") - 0.5 * FRAMES) < 4


def test_two_results_play_side_by_side(browser: Page, result: Path, other: Path, tmp_path: Path) -> None:
    browser.messages.clear()
    write_report(tmp_path / "both.html", [load_result(result), load_result(other)])
    browser.open(tmp_path / "both.html", width=1280, height=900)
    assert browser.messages == []
    _go(browser, 30)
    assert browser.value("report.scene.isShown") == [True, True]
    pair = browser.value("report.hands.map(hand => hand.tips[1])")
    assert 0.001 < np.linalg.norm(np.subtract(*pair)) < 0.01
    told = browser.value("[...document.querySelectorAll('.chart p span')].map(e => e.textContent)")
    value = told[told.index("PIP flexion") + 1]
    first, second = (float(part.split("°")[0]) for part in value.split("|"))
    assert second - first == pytest.approx(2.0, abs=0.11)
