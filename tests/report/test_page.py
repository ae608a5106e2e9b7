"""The page: it holds the track's values and the video, names what was assumed, and asks for nothing from elsewhere."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.report.made_result import FPS, FRAMES, LOST, OPEN_FINGER, write_result
from tests.report.reading import data_of, unpacked, video_of, words_of
from torchhand.errors import InputError
from torchhand.files import load_track, write_video
from torchhand.geometry import rotation_from_vector, rotation_of_quaternion
from torchhand.hand import JOINT_DOFS
from torchhand.report import content as content_module
from torchhand.report import load_result, write_report
from torchhand.report.video import small_video


@pytest.fixture(scope="module")
def page(result: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pages") / "report.html"
    write_report(path, [load_result(result)])
    return path


def test_the_data_are_the_tracks(page: Path, result: Path) -> None:
    track = load_track(result)
    assert track.finger_quality is not None
    [held] = data_of(page)["results"]
    np.testing.assert_allclose(unpacked(held["angles"]), np.rad2deg(track.pose[:, 6:]), rtol=0, atol=0.00501)
    np.testing.assert_allclose(unpacked(held["std"]), np.rad2deg(track.pose_std[:, 6:]), rtol=0, atol=0.00501)
    np.testing.assert_allclose(unpacked(held["position"]), track.pose[:, :3], rtol=0, atol=1.01e-5)
    np.testing.assert_allclose(unpacked(held["quality"]), track.finger_quality, rtol=0, atol=0.00251)
    np.testing.assert_allclose(unpacked(held["time"]), np.arange(FRAMES) / FPS, rtol=0, atol=5.1e-5)
    np.testing.assert_array_equal(unpacked(held["frame"]), track.frame)
    assert [held["statuses"][int(i)] for i in unpacked(held["status"])] == track.status.tolist()
    has_hand = track.has_hand
    assert np.flatnonzero(~has_hand).tolist() == list(LOST)
    turned = rotation_of_quaternion(torch.from_numpy(unpacked(held["rotation"])[has_hand]))
    wanted = rotation_from_vector(torch.from_numpy(track.pose[has_hand, 3:6]))
    torch.testing.assert_close(turned, wanted, rtol=0, atol=1e-4)
    assert np.isnan(unpacked(held["rotation"])[~has_hand]).all()
    held_names = {name for name, free in zip(held["names"], held["is_free"], strict=True) if not free}
    assert held_names == {name for name in JOINT_DOFS if name.endswith(("_tw", "cmc_fe"))}


def test_the_video_is_the_overlay_to_the_byte(page: Path, result: Path) -> None:
    assert video_of(page) == (result / "overlay.mp4").read_bytes()


def test_nothing_comes_from_elsewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not re.findall(r"(?:https?:)?//[\w.-]+\.\w+", re.sub(r'(?s)id="(video-)?data">.*?</script>', "", text))
    assert "default-src 'none'" in text
    assert "<!--slot" not in text


def test_words_of_a_result(page: Path) -> None:
    words = words_of(page)
    for told in (
        "right hand, 40 frames: 36 tracked, 3 lost, 1 recovered, 0 no hand",
        "&lt;wave&gt;.mp4",
        "not calibrated, 640×480 px: a horizontal field of view of 56° is assumed",
        "The hand's length of 187 mm is assumed",
        "right hand (as given)",
        "20 frames a second.",
        "Model-Based Hand Tracking Using an Unscented Kalman Filter",
        "index PIP flexion -5° to 110°",
        "index total flexion",
    ):
        assert told.replace("'", "&#x27;") in words, told
    assert "MCP twist" not in words  # held
    row = re.search(r"index PIP flexion -5° to 110° (\S+) ± 3.0° (\S+) ± 3.0° (\S+)", words)
    assert row is not None
    smallest, largest, extent = (float(cell.rstrip("°")) for cell in row.groups())
    assert extent == pytest.approx(largest - smallest, abs=0.11)
    assert largest > 80


def test_two_results_of_a_rigid_hand(result: Path, tmp_path: Path) -> None:
    """Every joint angle is held: none can be compared, which is no lack of frames with a hand."""
    loaded = load_result(result)
    rigid = replace(loaded, track=replace(loaded.track, pose_std=np.zeros_like(loaded.track.pose_std)))
    write_report(tmp_path / "both.html", [rigid, rigid])
    assert "No joint angle was free in both results: none is compared." in words_of(tmp_path / "both.html")


def test_two_results(result: Path, other: Path, tmp_path: Path) -> None:
    write_report(tmp_path / "both.html", [load_result(other), load_result(result)])
    words = words_of(tmp_path / "both.html")
    assert "In 37 frames both have a hand, in 0 only one of them" in words
    assert re.search(r"index PIP flexion .* 2\.0° 0% ", words)
    assert len(data_of(tmp_path / "both.html")["results"]) == 2
    assert video_of(tmp_path / "both.html") == (result / "overlay.mp4").read_bytes()  # the first has none


def test_names_that_look_like_html_stay_text(result: Path, tmp_path: Path) -> None:
    name = '</script><img src="x" onerror="alert(1)">'
    write_report(tmp_path / "report.html", [load_result(result, name=name)])
    assert "<img" not in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert data_of(tmp_path / "report.html")["results"][0]["name"] == name


def test_a_long_track_is_thinned_and_says_so(result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(content_module, "MAX_FRAMES", 15)
    write_report(tmp_path / "report.html", [load_result(result)])
    [held] = data_of(tmp_path / "report.html")["results"]
    assert unpacked(held["frame"]).tolist() == list(range(0, FRAMES, 3))
    assert "one frame in 3 is drawn" in words_of(tmp_path / "report.html")


def test_a_track_without_any_hand(result: Path, tmp_path: Path) -> None:
    whole = load_result(result)
    nothing = {
        name: np.full_like(getattr(whole.track, name), np.nan) for name in ("pose", "pose_std", "finger_quality")
    }
    lost = replace(whole.track, status=np.full(FRAMES, "lost", "<U16"), **nothing)
    write_report(tmp_path / "report.html", [replace(whole, track=lost, overlay=None)])
    assert "there is no range of motion" in words_of(tmp_path / "report.html")
    assert video_of(tmp_path / "report.html") == b""


def test_a_result_without_qualities_and_rate(result: Path, tmp_path: Path) -> None:
    whole = load_result(result)
    plain = replace(whole, track=replace(whole.track, finger_quality=None, header={}), run={}, provenance={})
    write_report(tmp_path / "report.html", [plain])
    words = words_of(tmp_path / "report.html")
    assert "the result tells no rate; 30 frames a second are assumed" in words
    assert "the points were given in space" in words
    assert data_of(tmp_path / "report.html")["results"][0]["quality"] is None


def test_a_large_video_is_encoded_anew(tmp_path: Path) -> None:
    overlay, random = tmp_path / "overlay.mp4", torch.Generator().manual_seed(0)
    with write_video(overlay, width=320, height=240, fps=FPS) as video:
        for _ in range(20):
            video.write(torch.randint(0, 255, (240, 320, 3), dtype=torch.uint8, generator=random))
    size = overlay.stat().st_size
    with small_video(overlay, tmp_path / "report.html", max_bytes=size) as (path, note):
        assert (path, note) == (overlay, "")
    with small_video(overlay, tmp_path / "report.html", max_bytes=size // 4) as (path, note):
        assert path != overlay
        assert path.stat().st_size < size // 2  # a second of noise is too short for the rate to settle
        assert "encoded anew at " in note
        assert "overlay.mp4 beside it has the full quality" in note
    assert [entry.name for entry in tmp_path.iterdir()] == ["overlay.mp4"]


def test_what_is_no_result_of_one_hand(tmp_path: Path, result: Path) -> None:
    with pytest.raises(InputError, match="no such file or folder"):
        load_result(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"expected a folder with track.npz"):
        load_result(tmp_path)
    (tmp_path / "track.npz").write_bytes((result / "track.npz").read_bytes())
    with pytest.raises(InputError, match=r"hand.json: no such file"):
        load_result(tmp_path)
    left = write_result(tmp_path / "left", side="left", has_video=False)
    (left / "hand.json").write_bytes((result / "hand.json").read_bytes())
    with pytest.raises(InputError, match=r"expected a right hand as in hand.json, got a left one"):
        load_result(left)
    with pytest.raises(ValueError, match="results: expected one or two, got 0"):
        write_report(tmp_path / "report.html", [])


def test_a_finger_that_is_not_determined_is_so_in_the_page(page: Path) -> None:
    [held] = data_of(page)["results"]
    quality = unpacked(held["quality"])
    is_open = np.nanmax(quality, axis=0) < held["determined"]
    assert np.flatnonzero(is_open).tolist() == [OPEN_FINGER]
