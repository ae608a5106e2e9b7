"""`torchhand track`: what a run leaves, going on after a stop, and one line for whatever a user can get wrong."""

import _thread
import errno
import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import torch
import yaml

import torchhand
from tests.live_pictures import delivered_as_tracked
from tests.report.reading import video_of
from torchhand.cli.command import threads
from torchhand.cli.track import main
from torchhand.cluster import Copies, can_copy_process, copies_for
from torchhand.devices import HOST
from torchhand.export import clip_of_stream
from torchhand.files import (
    Frame,
    FrameRecord,
    FrameSource,
    TrackWriter,
    load_cameras,
    load_hand,
    load_hand_model,
    load_settings,
    load_track,
    open_source,
    save_cameras,
    save_hand,
    write_video,
)
from torchhand.files.results import track_of
from torchhand.fit import Stage
from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import DOFS
from torchhand.runs import settings_of, summary_of
from torchhand.simulate import SceneSettings, render_sequence, scripted_motion
from torchhand.track import DEFAULTS, Tracker, TrackerSettings

FRAMES, WIDTH, HEIGHT = 10, 200, 160
RESULT_NAMES = {"config.yaml", "hand.json", "header.json", "overlay.mp4", "report.html", "track.jsonl", "track.npz"}


@dataclass(frozen=True)
class Clip:
    """A short sequence of an open hand, as files."""

    frames: Path
    """Folder of PNG pictures."""
    pictures: list[np.ndarray]
    """BGR"""
    camera: Path
    result: Path
    """What `track` makes of it; for reading only."""

    @property
    def options(self) -> list[str]:
        return [*self.with_second_pass, "--causal"]

    @property
    def with_second_pass(self) -> list[str]:
        return ["--camera", str(self.camera), "--config", "contour_planar", "--no-overlay"]


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


Run = Callable[..., Outcome]


def _write_folder(folder: Path, pictures: Sequence[np.ndarray]) -> Path:
    folder.mkdir()
    for index, picture in enumerate(pictures):
        assert cv2.imwrite(str(folder / f"{index}.png"), picture)  # natural order: 10 after 9
    return folder


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    folder = tmp_path_factory.mktemp("clip")
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    camera = replace(assumed_camera(WIDTH, HEIGHT, horizontal_fov_deg=48.0), is_assumed=False)
    generator = torch.Generator().manual_seed(1)
    with threads(1):
        motion = scripted_motion("planar", FRAMES, kinematics, camera, generator)
        scene = SceneSettings(supersampling=2)
        rendered = list(render_sequence(kinematics, motion, camera, scene, generator))
    pictures = [cv2.cvtColor(frame.image.numpy(), cv2.COLOR_RGB2BGR) for frame in rendered]
    save_cameras([camera], folder / "cameras.json")
    made = Clip(_write_folder(folder / "frames", pictures), pictures, folder / "cameras.json", folder / "result")
    options = ["--camera", str(made.camera), "--config", "contour_planar", "--causal"]
    assert main([str(made.frames), "--out", str(made.result), *options]) == 0
    return made


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    def call(*argv: str | Path) -> Outcome:
        capfd.readouterr()
        code = main([str(argument) for argument in argv])
        out, err = capfd.readouterr()
        return Outcome(code, out, err)

    return call


@pytest.fixture
def good(clip: Clip, tmp_path: Path) -> Path:
    """An earlier good result, to be left as it is."""
    return Path(shutil.copytree(clip.result, tmp_path / "good"))


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def _assert_refused(outcome: Outcome, *words: str | Path, code: int = 2) -> None:
    """That exit code and exactly one line, which holds these words."""
    assert outcome.code == code, outcome
    assert outcome.out == ""
    assert outcome.err.startswith("torchhand track: error: ")
    assert outcome.err.count("\n") == 1, outcome.err
    for word in words:
        assert str(word) in outcome.err


def _lines_without_seconds(folder: Path) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in (folder / "track.jsonl").read_text().splitlines()]
    return [{key: value for key, value in line.items() if key != "seconds"} for line in lines]


# ---------------------------------------------------------------------------------------- what a run leaves


def test_a_run_leaves_the_whole_result(clip: Clip) -> None:
    assert {path.name for path in clip.result.iterdir()} == RESULT_NAMES
    assert video_of(clip.result / "report.html") == (clip.result / "overlay.mp4").read_bytes()
    track = load_track(clip.result)
    assert track.frame.tolist() == list(range(FRAMES))
    assert set(track.status) == {"tracked"}
    assert track.dof_names == DOFS
    assert track.pose.shape == (FRAMES, 36)
    assert np.isfinite(track.pose).all()
    assert track.keypoints2d is not None
    [camera] = load_cameras(clip.camera)
    projected = camera.project(torch.tensor(track.keypoints3d)).numpy()
    np.testing.assert_allclose(track.keypoints2d, projected, rtol=0, atol=1e-9)
    hand = load_hand(clip.result / "hand.json")
    model = load_hand_model()
    shape = torch.tensor(list(hand.values.values()), dtype=torch.float64)
    again = model.kinematics(dtype=torch.float64)(torch.tensor(track.pose), shape).keypoints
    np.testing.assert_allclose(track.keypoints3d, again.numpy(), rtol=0, atol=1e-9)  # the pose is absolute
    assert (track.seconds > 0).all()
    assert (track.measures["overlap"] > 0.85).all()
    assert ((track.measures["edges"] > 0) & (track.measures["edges"] <= 1)).all()
    assert set(track.measures) == {"nis", "overlap", "edges", "inside", "unexplained", "score", "quality"}
    assert track.finger_quality is not None
    assert ((track.finger_quality > 0) & (track.finger_quality < 1)).all()
    assert np.isnan(track.measures["inside"]).all()  # one camera has no hull
    with open_source(clip.result / "overlay.mp4") as video:
        assert len(list(video)) == FRAMES


def test_the_saved_settings_are_a_configuration(clip: Clip) -> None:
    path = clip.result / "config.yaml"
    assert load_settings(TrackerSettings(), path) == settings_of("contour_planar")
    run = yaml.safe_load(path.read_text())["run"]
    assert run["torchhand"] == torchhand.__version__
    assert run["seed"] == 0
    assert run["input"] == str(clip.frames)
    assert run["camera_is_assumed"] is False
    assert run["causal"] is True


def test_the_last_line_sums_up(clip: Clip, run: Run, tmp_path: Path) -> None:
    outcome = run(clip.frames, "--out", tmp_path / "out", "--max-frames", "2", *clip.options)
    assert outcome.code == 0
    assert outcome.err == ""
    assert outcome.out.count("\n") == 1
    for words in ("frames: 2 frames (2 tracked, 0 lost, 0 recovered, 0 no hand)", "ms per frame", "median overlap 0."):
        assert words in outcome.out
    assert str(tmp_path / "out") in outcome.out
    assert not (tmp_path / "out" / "overlay.mp4").exists()


@pytest.mark.parametrize(
    ("quality", "words"),
    [
        ((0.2, 0.3), "median quality 0.25, so in most of them a fingertip is probably off by more than 20 mm; saved"),
        ((0.9, np.nan), "median quality 0.90; saved"),
        ((np.nan, np.nan), "median overlap 0.80; saved"),
    ],
)
def test_the_last_line_tells_a_hand_that_is_hardly_borne_out(quality: tuple[float, ...], words: str) -> None:
    records = (
        FrameRecord.empty(row, "lost", dofs=len(DOFS), seconds=0.1, measures={"overlap": 0.8, "quality": one})
        for row, one in enumerate(quality)
    )
    rows = (json.loads(one.as_json()) for one in records)
    header = {"dof_names": DOFS, "units": "m, rad", "convention": "opencv"}
    assert words in summary_of("frames", track_of(header, rows), Path("out"))


def test_an_assumed_camera_is_said_once_and_saved(clip: Clip, run: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    short = ("--max-frames", "1", "--config", "contour_planar", "--causal")
    outcome = run(clip.frames, "--out", out, "--no-overlay", "--no-report", *short)
    assert outcome.code == 0
    assert not (out / "report.html").exists()
    assert outcome.err.count("\n") == 1
    assert "a field of view is assumed" in outcome.err
    assert load_track(out).header["camera"]["is_assumed"] is True
    assert yaml.safe_load((out / "config.yaml").read_text())["run"]["camera_is_assumed"] is True


def test_single_settings_from_the_command_line(clip: Clip, run: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    changes = [
        "--set",
        "noise.rotation=81",
        "--set",
        "health.patience=4",
        "--set",
        "motion.order=1",
    ]
    assert run(clip.frames, "--out", out, "--max-frames", "1", *changes, *clip.options).code == 0
    settings = load_settings(TrackerSettings(), out / "config.yaml")
    assert (settings.noise.rotation, settings.health.patience, settings.motion.order) == (81.0, 4, 1)


def test_a_known_left_hand_is_not_fitted(clip: Clip, run: Run, tmp_path: Path) -> None:
    space = load_hand_model().shape_space
    shape = (space.default + 0.1 * space.std).tolist()
    mirrored = _write_folder(tmp_path / "mirrored", [picture[:, ::-1] for picture in clip.pictures[:2]])
    save_hand(tmp_path / "hand.json", space.names, shape, "left", {}, units=space.units)
    out = tmp_path / "out"
    assert run(mirrored, "--out", out, "--hand", tmp_path / "hand.json", *clip.options).code == 0
    track = load_track(out)
    assert track.status.tolist() == ["tracked", "tracked"]
    assert track.header["side"] == "left"
    saved = load_hand(out / "hand.json", space.names)
    assert list(saved.values.values()) == shape
    assert saved.side == "left"


def test_start_points(clip: Clip, run: Run, tmp_path: Path) -> None:
    keypoints = load_track(clip.result).keypoints2d
    assert keypoints is not None
    points = keypoints[0, [0, 12]].ravel()
    text = ",".join(f"{value:.1f}" for value in points)
    out = tmp_path / "out"
    assert run(clip.frames, "--out", out, "--start-points", text, "--max-frames", "1", *clip.options).code == 0
    track = load_track(out)
    assert track.status.tolist() == ["tracked"]
    assert track.header["made_with"]["start_points"] == [float(number) for number in text.split(",")]
    assert track.keypoints2d is not None
    np.testing.assert_allclose(track.keypoints2d[0, [0, 12]].ravel(), points, rtol=0, atol=3.0)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_folder_of_videos_gives_one_result_each_and_one_bad_video_stops_no_other(
    workers: int, clip: Clip, run: Run, tmp_path: Path
) -> None:
    videos = tmp_path / "videos"
    videos.mkdir()
    for name in ("a", "c"):
        with write_video(videos / f"{name}.mp4", width=WIDTH, height=HEIGHT, fps=25.0) as video:
            for picture in clip.pictures[:2]:
                video.write(torch.from_numpy(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)))
    (videos / "b.mp4").write_bytes(b"no video")
    options = ("--config", "contour_planar", "--no-overlay", "--causal", "--workers", str(workers))
    outcome = run(videos, "--out", tmp_path / "out", *options)
    assert outcome.code == 2
    are_copies = workers > 1 and can_copy_process(HOST)
    assert outcome.err.count("\n") == 2 + are_copies
    assert outcome.err.count("a field of view is assumed") == 1
    assert "b.mp4: is no video that can be opened" in outcome.err
    assert outcome.out.count("\n") == 2
    for name in ("a", "c"):
        assert load_track(tmp_path / "out" / name).status.tolist() == ["tracked", "tracked"]
    assert not (tmp_path / "out" / "b").exists()
    with open_source(videos / "a.mp4") as source:
        assert (
            yaml.safe_load((tmp_path / "out" / "a" / "config.yaml").read_text())["run"]["frames_per_second"]
            == source.fps
        )


# ---------------------------------------------------------------------------------------- stopping and going on


def _stop_after(monkeypatch: pytest.MonkeyPatch, steps: int, error: BaseException) -> None:
    original = Tracker.step
    calls = 0

    def step(self: Any, *arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > steps:
            raise error
        return original(self, *arguments)

    monkeypatch.setattr(Tracker, "step", step)


def test_ctrl_c_keeps_what_is_tracked_and_resume_gives_the_uninterrupted_result(
    clip: Clip, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr("torchhand.runs.tracking.CHECKPOINT_EVERY", 4)
    with monkeypatch.context() as patch:
        _stop_after(patch, 6, KeyboardInterrupt())
        stopped = run(clip.frames, "--out", out, *clip.options)
    assert stopped.code == 130
    assert stopped.out == ""
    assert stopped.err.count("\n") == 1
    assert str(out) in stopped.err
    assert "--resume" in stopped.err
    assert load_track(out).frame.tolist() == list(range(6))
    np.testing.assert_array_equal(load_track(out / "track.npz").frame, range(6))

    (out / "hand.json").unlink()  # a run that goes on writes it again
    steps: list[int] = []
    original = Tracker.step
    with monkeypatch.context() as patch:
        patch.setattr(Tracker, "step", lambda *arguments: (steps.append(1), original(*arguments))[1])
        assert run(clip.frames, "--out", out, "--resume", *clip.options).code == 0
    assert len(steps) == FRAMES - 4  # from the last saved state on
    assert _lines_without_seconds(out) == _lines_without_seconds(clip.result)
    for name in ("hand.json", "config.yaml"):
        assert (out / name).read_bytes() == (clip.result / name).read_bytes()
    one, other = (load_track(folder / "track.npz") for folder in (out, clip.result))
    np.testing.assert_array_equal(one.pose, other.pose)
    np.testing.assert_array_equal(one.keypoints3d_cov, other.keypoints3d_cov)


@pytest.mark.slow
def test_the_distance_map_tracker_is_chosen_saved_and_resumed(
    clip: Clip, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    options = [
        "--camera",
        clip.camera,
        "--config",
        "distance_abduction",
        "--no-overlay",
        "--max-frames",
        "6",
        "--causal",
    ]
    assert run(clip.frames, "--out", whole, *options).code == 0
    track = load_track(whole / "track.npz")
    assert track.status.tolist() == ["tracked"] * 6
    assert (track.measures["overlap"] > 0.85).all()
    settings = load_settings(DEFAULTS["distance"], whole / "config.yaml")
    assert settings == settings_of("distance_abduction")
    assert settings_of(str(whole / "config.yaml")) == settings

    monkeypatch.setattr("torchhand.runs.tracking.CHECKPOINT_EVERY", 2)
    with monkeypatch.context() as patch:
        _stop_after(patch, 3, KeyboardInterrupt())
        assert run(clip.frames, "--out", parts, *options).code == 130
    assert run(clip.frames, "--out", parts, "--resume", *options).code == 0
    assert _lines_without_seconds(parts) == _lines_without_seconds(whole)
    other = run(clip.frames, "--out", parts, "--resume", *options, "--set", "update.pose_weight=0.5")
    _assert_refused(other, "made_with.settings.update.pose_weight was", "is now 0.5")


def test_ctrl_c_while_replacing_leaves_the_old_result(
    clip: Clip, run: Run, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = _contents(good)
    _stop_after(monkeypatch, 2, KeyboardInterrupt())
    stopped = run(clip.frames, "--out", good, "--overwrite", *clip.options)
    assert stopped.code == 130
    assert "--resume in place of --overwrite" in stopped.err
    assert _contents(good) == before
    assert load_track(good / "unfinished").frame.tolist() == [0, 1]


def test_a_finished_run_goes_on_further(clip: Clip, run: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run(clip.frames, "--out", out, "--max-frames", "3", "--keep-checkpoint", *clip.options).code == 0
    assert run(clip.frames, "--out", out, "--resume", *clip.options).code == 0
    assert _lines_without_seconds(out) == _lines_without_seconds(clip.result)
    before = _contents(out)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Tracker, "step", lambda *_: pytest.fail("tracked again"))
        again = run(clip.frames, "--out", out, "--resume", *clip.options)
    assert again.code == 0
    assert "is finished; nothing is left to do" in again.err
    assert again.out.startswith(f"{clip.frames.name}: {FRAMES} frames")
    assert _contents(out) == before


# ---------------------------------------------------------------------------------------- the second pass


@pytest.fixture(scope="module")
def smoothed(clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `track` makes of the clip in two passes; for reading only."""
    out = tmp_path_factory.mktemp("smoothed") / "out"
    assert main([str(clip.frames), "--out", str(out), *clip.with_second_pass]) == 0
    return out


def test_a_recording_is_corrected_backwards_and_its_forward_pass_is_kept(clip: Clip, smoothed: Path) -> None:
    assert {path.name for path in smoothed.iterdir()} == RESULT_NAMES - {"overlay.mp4"} | {"forward.jsonl"}
    forward, causal, track = (load_track(path) for path in (smoothed / "forward.jsonl", clip.result, smoothed))
    np.testing.assert_array_equal(forward.pose, causal.pose)
    np.testing.assert_array_equal(forward.keypoints3d_cov, causal.keypoints3d_cov)
    assert track.frame.tolist() == list(range(FRAMES))
    assert len((smoothed / "track.jsonl").read_text().splitlines()) == FRAMES
    off = np.linalg.norm(track.keypoints3d - forward.keypoints3d, axis=-1).mean(-1)
    assert (off[:-1] > 0).all()
    assert np.median(off) < 0.005
    assert (track.seconds > forward.seconds).all()
    assert set(track.measures) == set(forward.measures)
    assert yaml.safe_load((smoothed / "config.yaml").read_text())["run"]["causal"] is False


def test_the_second_pass_is_told_on_one_line(clip: Clip, run: Run, tmp_path: Path) -> None:
    outcome = run(clip.frames, "--out", tmp_path / "out", "--max-frames", "2", *clip.with_second_pass)
    assert outcome.code == 0
    assert outcome.err.count("\n") == 1
    assert "second pass" in outcome.err
    assert "--causal" in outcome.err


@pytest.mark.parametrize("steps", [6, FRAMES, FRAMES + 4], ids=["forwards", "between", "backwards"])
def test_a_run_that_is_stopped_in_either_pass_ends_as_if_it_had_not_been(
    clip: Clip, smoothed: Path, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, steps: int
) -> None:
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        _stop_after(patch, steps, KeyboardInterrupt())
        assert run(clip.frames, "--out", out, *clip.with_second_pass).code == 130
    assert len(load_track(out)) == min(steps, FRAMES)
    assert run(clip.frames, "--out", out, "--resume", *clip.with_second_pass).code == 0
    assert {path.name for path in out.iterdir()} == {path.name for path in smoothed.iterdir()}
    assert _lines_without_seconds(out) == _lines_without_seconds(smoothed)


def test_frames_in_which_the_passes_differ_are_followed_once_more_and_again_where_that_is_stopped(
    clip: Clip, smoothed: Path, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only of hands that are tilted, and without a detector; this one is not, and is taken for one that is."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    monkeypatch.setattr("torchhand.runs.records.joined._OPEN_M", 0.0)
    assert "third pass" not in run(clip.frames, "--out", tmp_path / "out", *clip.with_second_pass).err
    monkeypatch.setattr(
        "torchhand.runs.further_passes.TiltAlternatives", SimpleNamespace(can_tilt=lambda tracker: True)
    )
    outcome = run(clip.frames, "--out", whole, *clip.with_second_pass)
    for name in ("third", "fourth"):
        assert f"{name} pass: {FRAMES} frames" in outcome.err
    assert {path.name for path in whole.iterdir()} == {path.name for path in smoothed.iterdir()}
    twice, track = load_track(smoothed), load_track(whole)
    off = np.linalg.norm(track.keypoints3d - twice.keypoints3d, axis=-1).mean(-1)
    assert (off > 0).any()
    assert np.median(off) < 0.005
    for number in (2, 3):
        out = parts / str(number)
        with monkeypatch.context() as patch:
            _stop_after(patch, number * FRAMES + 4, KeyboardInterrupt())
            assert run(clip.frames, "--out", out, *clip.with_second_pass).code == 130
        assert run(clip.frames, "--out", out, "--resume", *clip.with_second_pass).code == 0
        assert _lines_without_seconds(out) == _lines_without_seconds(whole)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not copy processes")
def test_shares_of_a_pass_give_the_same_in_any_number_of_processes(
    clip: Clip, smoothed: Path, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("_SMALLEST", 2), ("_WITHIN", 1), ("RUN_IN", 1)):
        monkeypatch.setattr(f"torchhand.runs.recordings.shares.{name}", value)
    asked = list[tuple[int, int]]()

    def counted(count: int, workers: int, device: torch.device) -> Copies | None:
        asked.append((count, workers))
        return copies_for(count, workers, device)

    monkeypatch.setattr("torchhand.runs.further_passes.copies_for", counted)
    for workers in (1, 2):
        out = tmp_path / str(workers)
        assert run(clip.frames, "--out", out, "--workers", workers, *clip.with_second_pass).code == 0
    assert asked == [(4, 1), (4, 2)]
    assert _lines_without_seconds(tmp_path / "1") == _lines_without_seconds(tmp_path / "2")
    whole, cut = load_track(smoothed), load_track(tmp_path / "1")
    assert len(cut) == FRAMES
    assert np.linalg.norm(cut.keypoints3d - whole.keypoints3d, axis=-1).mean() < 0.002


def test_a_finished_run_of_two_passes_goes_on_further(clip: Clip, smoothed: Path, run: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with_second_pass = [*clip.with_second_pass, "--keep-checkpoint"]
    assert run(clip.frames, "--out", out, "--max-frames", "4", *with_second_pass).code == 0
    assert run(clip.frames, "--out", out, "--resume", *with_second_pass).code == 0
    assert _lines_without_seconds(out) == _lines_without_seconds(smoothed)


def test_more_frames_of_a_finished_run_are_refused_unless_its_checkpoint_was_kept(
    clip: Clip, run: Run, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert run(clip.frames, "--out", out, "--max-frames", "2", *clip.options).code == 0
    before = _contents(out)
    _assert_refused(run(clip.frames, "--out", out, "--resume", *clip.options), "finished with frame 1", "--overwrite")
    assert _contents(out) == before


def test_one_shape_for_the_whole_recording_and_again_where_it_is_resumed(
    clip: Clip, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    monkeypatch.setattr("torchhand.track.shape.SCHEDULE", (Stage(gross_m=0.0075, rounds=1, iterations=1),))
    plain = ["--camera", clip.camera, "--config", "contour_full", "--no-overlay", "--max-frames", "7"]
    settings = ("shape_frames=4", "learned_posture=false", "learned_proposals=false")
    options = [*plain, *(word for setting in settings for word in ("--set", setting))]
    outcome = run(clip.frames, "--out", whole, *options)
    assert outcome.code == 0
    assert "proportions: fitted over 4 frames" in outcome.err
    hand, first = json.loads((whole / "hand.json").read_text()), json.loads((clip.result / "hand.json").read_text())
    told = hand["provenance"]
    assert told["held_out_nats_per_frame"]["this"] < told["held_out_nats_per_frame"]["first_hand"]
    assert len(told["frames"]) == 4
    assert "hand_length" not in told["std"]  # which one camera cannot tell
    assert hand["shape"]["hand_breadth"] != first["shape"]["hand_breadth"]
    track, kinematics = load_track(whole), load_hand_model().kinematics(dtype=torch.float64)
    shape = torch.tensor(list(hand["shape"].values()), dtype=torch.float64)
    keypoints = kinematics(torch.from_numpy(track.pose), shape).keypoints  # every hand is one of this shape
    np.testing.assert_allclose(track.keypoints3d, keypoints.numpy(), rtol=0, atol=1e-6)
    shutil.copytree(whole, parts)  # a run that is resumed fits the shape anew, by the first pass
    assert run(clip.frames, "--out", parts, "--resume", *options).code == 0
    assert _lines_without_seconds(parts) == _lines_without_seconds(whole)
    assert (parts / "hand.json").read_bytes() == (whole / "hand.json").read_bytes()


def test_proportions_of_a_single_frame_are_told_in_the_singular(clip: Clip, run: Run, tmp_path: Path) -> None:
    options = ["--camera", clip.camera, "--no-overlay", "--no-report", "--max-frames", "1"]
    assert "proportions: fitted over 1 frame (" in run(clip.frames, "--out", tmp_path / "out", *options).err


def test_proportions_that_are_fitted_on_the_way_are_kept_with_the_frame(
    clip: Clip, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torchhand.track.proportions.outlines._APART", 0.0)  # the clip's hand keeps its posture
    monkeypatch.setattr("torchhand.track.proportions.outlines._GOOD", 1.0)
    monkeypatch.setattr("torchhand.track.proportions.fitted.FittedShape.is_contradicted", False)
    monkeypatch.setattr("torchhand.track.assembly.SCHEDULE", (Stage(gross_m=0.0075, rounds=1, iterations=1),))
    settings = ("shape_frames=4", "learned_posture=false", "learned_proposals=false")
    settings += (f"max_pixels={WIDTH * HEIGHT}",)  # the first frame counts, as in pictures that are not enlarged
    options = ["--camera", clip.camera, "--config", "contour_full", "--no-overlay", "--max-frames", "6"]
    options += [word for setting in settings for word in ("--set", setting)]
    assert run(clip.frames, "--out", tmp_path / "out", "--causal", *options).code == 0
    hand = json.loads((tmp_path / "out" / "hand.json").read_text())
    assert (hand["provenance"]["method"], hand["provenance"]["frame"]) == (
        "fit to frames while the hand was followed",
        3,
    )
    track, kinematics = load_track(tmp_path / "out"), load_hand_model().kinematics(dtype=torch.float64)
    shape = torch.tensor(list(hand["shape"].values()), dtype=torch.float64)
    apart = np.abs(track.keypoints3d - kinematics(torch.from_numpy(track.pose), shape).keypoints.numpy()).max((1, 2))
    assert (apart[:4] > 1e-4).all()  # hands of the first picture's proportions
    assert (apart[4:] < 1e-6).all()


class _Webcam(FrameSource):
    """Delivers a picture of the clip when the one before is tracked, until a hand was tracked in three, which it takes
    another process to find; then, as a user would, presses Ctrl-C, or ends."""

    def __init__(self, frames: Path, lines: Path, *, is_stopped: bool = True) -> None:
        self.name, self.fps, self.count, self.width, self.height = "webcam0", 30.0, None, WIDTH, HEIGHT
        self.frames, self.lines, self.is_stopped = frames, lines, is_stopped

    def __iter__(self) -> Iterator[Frame]:
        yield from delivered_as_tracked(self.frames, self.lines)
        if self.is_stopped:
            _thread.interrupt_main()
            time.sleep(1)

    def close(self) -> None:
        pass


def test_a_webcam_ends_well_with_ctrl_c_and_draws_live(
    clip: Clip, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []

    def open_webcam(source: str, **_: Any) -> _Webcam:
        opened.append(source)
        return _Webcam(clip.frames, tmp_path / "out" / "track.jsonl")

    monkeypatch.setattr("torchhand.files.live.rig.open_source", open_webcam)
    monkeypatch.chdir(tmp_path)
    outcome = run("0", "--out", "out", "--camera", clip.camera, "--config", "contour_planar")
    assert outcome.code == 0
    assert opened == ["0"]  # and not a second time for the overlay
    track = load_track(tmp_path / "out")
    followed = [status for status in track.status.tolist() if status != "no_hand"]
    assert track.status.tolist() == ["no_hand"] * (len(track) - len(followed)) + followed
    assert followed[-3:] == ["tracked"] * 3
    assert set(followed) <= {"recovered", "tracked"}  # by the picture at which the other process finds it
    assert track.time_s is not None
    assert (np.diff(track.time_s) > 0).all()
    assert f"camera cam0: {len(track)} pictures used, 0 dropped" in outcome.err
    with open_source(tmp_path / "out" / "overlay.mp4") as video:
        assert len(list(video)) >= 2  # Ctrl-C may come before the last one is drawn
    _assert_refused(run("0", "--out", "out", "--resume", *clip.options), "webcam 0: cannot be resumed")


def test_a_recording_is_played_live_to_other_programs(
    clip: Clip, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every estimate at once on standard output, and nothing else there."""
    out, grown = tmp_path / "out", tmp_path / "live.thp"
    lines = out / "track.jsonl"
    monkeypatch.setattr("torchhand.files.live.rig.open_source", lambda source: _Webcam(source, lines, is_stopped=False))
    streams = ("--stream", "jsonl", "--stream", grown)
    outcome = run(clip.frames, "--out", out, "--live", "--no-page", *streams, *clip.options)
    assert outcome.code == 0
    messages = [json.loads(line) for line in outcome.out.splitlines()]
    track = load_track(out)
    assert track.time_s is not None
    assert [message["time_s"] for message in messages] == track.time_s.tolist()
    assert [message["status"] for message in messages] == track.status.tolist()
    np.testing.assert_allclose(list(messages[-1]["angles"].values()), track.pose[-1, 6:], atol=1e-6)
    assert messages[0]["time_s"] == 0.0
    assert not (out / "overlay.mp4").exists()
    assert "pictures used" in outcome.err
    assert "saved in" in outcome.err
    stream = clip_of_stream(grown, load_hand_model())
    assert stream.notes == ()  # it was ended
    first = int(np.isfinite(track.pose).all(-1).argmax())
    assert len(stream) == 1 + round(stream.fps * (messages[-1]["time_s"] - messages[first]["time_s"]))
    assert float((stream.poses[0] - torch.from_numpy(track.pose[first]))[6:].abs().max()) < np.radians(2)
    _assert_refused(run(clip.frames, "--out", out, "--stream", grown, *clip.options), "--stream", "is there already")


def test_what_live_tracking_cannot_do(clip: Clip, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    _assert_refused(run(clip.frames, "--out", out, "--live", "--resume", *clip.options), "--live", "--resume")
    _assert_refused(run(clip.frames, "--out", out, "--live", "--start", "1", *clip.options), "--live", "--start")
    _assert_refused(run(clip.frames, "--out", out, "--stream", "udp:9", *clip.options), "--stream", "udp://HOST:PORT")
    _assert_refused(run("-", "--out", out, "--resume", *clip.options), "-: cannot be resumed")
    monkeypatch.setitem(sys.modules, "viser", None)
    _assert_refused(run(clip.frames, "--out", out, "--live", *clip.options), "pip install 'torchhand[view]'")


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--live", "--port", "-1"), "--port: expected 1 to 65535, got -1"),
        (("--stream", "live.thp", "--stream", "osc://nowhere.invalid:9000"), "nowhere.invalid: no such host"),
        (("--stream", "live.thp", "--start", "99"), "start 99 lies after the last frame"),
    ],
)
def test_a_run_that_fails_before_its_first_frame_leaves_nothing(
    clip: Clip, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], word: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with write_video(tmp_path / "clip.mp4", width=WIDTH, height=HEIGHT, fps=25.0) as video:
        for picture in clip.pictures[:3]:
            video.write(torch.from_numpy(picture[..., ::-1].copy()))
    _assert_refused(run("clip.mp4", "--out", "new/out", *options, *clip.options), word)
    assert [path.name for path in tmp_path.iterdir()] == ["clip.mp4"]


# ---------------------------------------------------------------------------------------- pictures that are not right


def test_inputs_that_are_none(clip: Clip, run: Run, good: Path, tmp_path: Path) -> None:
    before = _contents(good)
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.txt").write_text("a hand")
    (tmp_path / "cut.mp4").write_bytes(b"\x00\x00\x00\x18ftypmp42")
    (tmp_path / "nothing.png").write_bytes(b"")
    cases = {
        "missing.mp4": "no such file or folder",
        "empty": "is an empty folder",
        "text.txt": "expected a video or a picture",
        "cut.mp4": "is no video that can be opened",
        "nothing.png": "is empty (0 bytes)",
    }
    for name, words in cases.items():
        _assert_refused(run(tmp_path / name, "--out", good, "--overwrite", *clip.options), tmp_path / name, words)
        assert not (good / "unfinished").exists()
    _assert_refused(run(clip.frames, "--out", good, "--overwrite", "--start", "99", *clip.options), "start 99")
    _assert_refused(run(clip.frames, "--out", good, "--overwrite", "--max-frames", "0", *clip.options), "max_frames")
    assert _contents(good) == before


def test_a_corrupt_picture_in_the_middle_is_skipped_and_reported(clip: Clip, run: Run, tmp_path: Path) -> None:
    frames = _write_folder(tmp_path / "frames", clip.pictures[:6])
    (frames / "3.png").write_bytes((frames / "3.png").read_bytes()[:500])
    outcome = run(frames, "--out", tmp_path / "out", *clip.options)
    assert outcome.code == 0
    assert outcome.err.count("\n") == 1
    assert str(frames / "3.png") in outcome.err
    assert "frame 3: " in outcome.err
    track = load_track(tmp_path / "out")
    assert track.status.tolist() == ["tracked", "tracked", "tracked", "no_hand", "tracked", "tracked"]
    assert np.isnan(track.pose[3]).all()
    assert np.isnan(track.keypoints3d[3]).all()
    assert np.isfinite(track.pose[[2, 4]]).all()
    assert track.reason is not None
    assert "3.png" in track.reason[3]


def test_many_corrupt_pictures_are_counted_and_end_the_track(clip: Clip, run: Run, tmp_path: Path) -> None:
    frames = _write_folder(tmp_path / "frames", clip.pictures[:8])
    for index in range(1, 7):
        (frames / f"{index}.png").write_bytes(b"")
    outcome = run(frames, "--out", tmp_path / "out", *clip.options)
    assert outcome.code == 0
    assert outcome.err.count("\n") == 4
    assert "3 more pictures are missing or unreadable" in outcome.err
    assert load_track(tmp_path / "out").status.tolist() == ["tracked", *["no_hand"] * 6, "recovered"]


def test_a_container_that_promises_too_much(clip: Clip, run: Run, tmp_path: Path) -> None:
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (WIDTH, HEIGHT))
    for picture in clip.pictures:
        writer.write(picture)
    writer.release()
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    outcome = run(path, "--out", tmp_path / "out", "--camera", clip.camera, "--config", "contour_planar", "--causal")
    assert outcome.code == 0
    assert outcome.err.count("\n") == 1
    assert f"{path}: the container promises {FRAMES} frames" in outcome.err
    track = load_track(tmp_path / "out")
    assert 2 <= len(track) < FRAMES
    assert track.status[:2].tolist() == ["tracked", "tracked"]
    with open_source(tmp_path / "out" / "overlay.mp4") as video:
        assert len(list(video)) == len(track)


@pytest.mark.parametrize("kind", ["16-bit", "4 channels"])
def test_pictures_of_other_kinds_are_tracked_as_well(clip: Clip, run: Run, tmp_path: Path, kind: str) -> None:
    if kind == "16-bit":
        pictures = [picture.astype(np.uint16) * 257 for picture in clip.pictures[:2]]
    else:
        pictures = [np.dstack((picture, np.full((HEIGHT, WIDTH), 7, np.uint8))) for picture in clip.pictures[:2]]
    frames = _write_folder(tmp_path / "frames", pictures)
    assert run(frames, "--out", tmp_path / "out", *clip.options).code == 0
    np.testing.assert_array_equal(load_track(tmp_path / "out").pose, load_track(clip.result).pose[:2])


def test_grey_pictures_are_tracked_from_start_points(clip: Clip, run: Run, tmp_path: Path) -> None:
    grey = [cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) for picture in clip.pictures[:2]]
    frames = _write_folder(tmp_path / "frames", grey)
    outcome = run(frames, "--out", tmp_path / "alone", *clip.options)
    assert outcome.code == 0
    assert load_track(tmp_path / "alone").status.tolist() == ["no_hand", "no_hand"]  # no colours to find a hand by
    assert not (tmp_path / "alone" / "hand.json").exists()
    assert outcome.err.count("\n") == 1
    assert "no hand was found" in outcome.err
    assert "--start-points" in outcome.err
    keypoints = load_track(clip.result).keypoints2d
    assert keypoints is not None
    points = ",".join(f"{value:.1f}" for value in keypoints[0, [0, 12]].ravel())
    assert run(frames, "--out", tmp_path / "out", "--start-points", points, *clip.options).code == 0
    track = load_track(tmp_path / "out")
    assert track.status.tolist() == ["tracked", "tracked"]
    assert track.keypoints2d is not None
    assert np.linalg.norm(track.keypoints2d[:2] - keypoints[:2], axis=-1).max() < 6.0


def test_pictures_of_changing_size_end_the_run_there(clip: Clip, run: Run, tmp_path: Path) -> None:
    frames = _write_folder(tmp_path / "frames", [*clip.pictures[:2], clip.pictures[2][:-10]])
    outcome = run(frames, "--out", tmp_path / "out", *clip.options)
    _assert_refused(outcome, frames / "2.png", f"expected a picture of {WIDTH}x{HEIGHT} px like the first")
    assert load_track(tmp_path / "out").frame.tolist() == [0, 1]


# ---------------------------------------------------------------------------------------- files that are not right


def _camera_case(camera: Camera, what: str, path: Path) -> Sequence[str]:
    """Write a camera file with that fault; returns what the message must say."""
    save_cameras([camera], path)
    content = json.loads(path.read_text())
    entry = content["cameras"][0]
    if what == "partial":
        del entry["K"]
    elif what == "wrong":
        entry["K"][0][0] = "long"
    elif what == "two":
        content["cameras"].append({**entry, "name": "other"})
    elif what == "size":
        entry["width"] = 2 * WIDTH
    path.write_text("{" if what == "broken" else json.dumps(content))
    return {
        "partial": ("cameras[0]: lacks K",),
        "wrong": ("cameras[0].K",),
        "two": ("expected one camera, got 2",),
        "size": (f"expected a camera of {WIDTH}x{HEIGHT} px", f"got {2 * WIDTH}x{HEIGHT}"),
        "broken": (),
    }[what]


@pytest.mark.parametrize("what", ["partial", "wrong", "two", "size", "broken"])
def test_camera_files_that_do_not_fit(clip: Clip, run: Run, good: Path, tmp_path: Path, what: str) -> None:
    before = _contents(good)
    path = tmp_path / "cameras.json"
    words = _camera_case(load_cameras(clip.camera)[0], what, path)
    _assert_refused(run(clip.frames, "--out", good, "--overwrite", "--camera", path), path, *words)
    assert _contents(good) == before


def test_a_missing_camera_file(clip: Clip, run: Run, tmp_path: Path) -> None:
    _assert_refused(run(clip.frames, "--out", tmp_path / "out", "--camera", tmp_path / "none.json"), "none.json")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--set", "nois.rotation=3"], ["unknown key nois", "noise", "allowed: method, update, pose_space"]),
        (["--set", "noise.rotatoin=3"], ["unknown key noise.rotatoin", "rotation"]),
        (["--set", "update.gate=-1"], ["update.gate: expected above 0"]),
        (["--set", "update.gate=wide"], ["update.gate: expected a number, got 'wide'"]),
        (["--set", "health.patience=2.5"], ["health.patience: expected a whole number"]),
        (["--set", "gate"], ["--set: expected KEY=VALUE", "'gate'"]),
        (["--set", "update.gate=[1"], ["--set update.gate: expected a value as in YAML"]),
        (["--set", "motion=1", "--set", "motion.order=2"], ["--set: expected each field once"]),
        (["--set", "pose_space=dof99"], ["pose_space: expected one of planar"]),
        (["--posture", "opne"], ["posture: expected one of open", "'opne'"]),
        (["--config", "contour_flat"], ["contour_flat: no such configuration", "contour_full", "contour_planar"]),
        (["--start-points", "1,2,3"], ["--start-points: expected 4 numbers", "'1,2,3'"]),
        (["--start-points", "1,2,3,x"], ["--start-points: expected 4 numbers"]),
        (["--start-points", "10,20,nan,40"], ["--start-points: expected 4 finite numbers"]),
        (["--start-points", "50,50,50,400"], ["--start-points: middle fingertip", "0 to 159", "got 50, 400"]),
        (["--start-points", "-3,50,50,40"], ["--start-points: wrist", "0 to 199", "got -3, 50"]),
        (["--start-points", "50,50,52,52"], ["--start-points: expected wrist and middle fingertip at least 10 px"]),
        (["--side", "both"], ["both", "left"]),
        (["--threads", "0"], ["--threads: expected 1 to 1024, got 0"]),
        (["--hand-model", "hand_landmarker.task"], ["--hand-model: expected --keypoints mediapipe with it"]),
        (["--keypoints", "mediapipe", "--hand-model", "none.task"], ["mediapipe"]),
        (
            ["--keypoints", "a.npz", "--keypoints", "b.npz"],
            ["--keypoints: expected one for the one camera, got a.npz, b"],
        ),
        (["--resume", "--overwrite"], ["at most one of --resume and --overwrite"]),
        (["--start", "-1"], ["start: expected a frame number of 0 or more"]),
    ],
)
def test_options_that_cannot_be(clip: Clip, run: Run, tmp_path: Path, options: list[str], words: list[str]) -> None:
    _assert_refused(run(clip.frames, "--out", tmp_path / "out", "--camera", clip.camera, *options), *words)
    assert not (tmp_path / "out").exists()


def test_a_configuration_with_an_unknown_key_or_an_impossible_value(clip: Clip, run: Run, tmp_path: Path) -> None:
    config = tmp_path / "mine.yaml"
    for text, words in (
        ("update: {edge_std: 2}", "unknown key update.edge_std"),
        ("update: {edge_std_px: 0}", "update.edge_std_px: expected above 0"),
        ("noise: 3", "noise: expected keys among translation"),
        ("gate: [", "is no valid YAML"),
    ):
        config.write_text(text)
        outcome = run(clip.frames, "--out", tmp_path / "out", "--config", config)
        _assert_refused(outcome, config, words)
    assert not (tmp_path / "out").exists()


def test_hand_files_that_do_not_fit(clip: Clip, run: Run, good: Path, tmp_path: Path) -> None:
    before = _contents(good)
    space = load_hand_model().shape_space
    path = tmp_path / "hand.json"
    names, values = list(space.names), space.default.tolist()

    def refused(*words: str) -> None:
        outcome = run(clip.frames, "--out", good, "--overwrite", "--hand", path, *clip.options)
        _assert_refused(outcome, path, *words)

    refused("no such file")
    path.write_text("{}")
    refused("expected a hand file")
    save_hand(path, names[:-1], values[:-1], "right", {})
    refused(f"shape: lacks {names[-1]}")
    save_hand(path, names, [10 * values[0], *values[1:]], "right", {})
    refused(f"shape.{names[0]}: expected ", f"got {10 * values[0]:g}")
    assert _contents(good) == before


# ---------------------------------------------------------------------------------------- where results go


def test_a_folder_with_a_result_is_refused(clip: Clip, run: Run, good: Path) -> None:
    before = _contents(good)
    _assert_refused(run(clip.frames, "--out", good, *clip.options), good, "--resume", "--overwrite")
    assert _contents(good) == before


def test_resume_with_other_options_is_refused(clip: Clip, run: Run, good: Path) -> None:
    before = _contents(good)
    outcome = run(clip.frames, "--out", good, "--resume", "--set", "update.gate=7.75", *clip.options)
    _assert_refused(outcome, good / "track.jsonl", "made_with.settings.update.gate was", "is now 7.75")
    assert _contents(good) == before


def test_overwrite_replaces_the_result(clip: Clip, run: Run, good: Path) -> None:
    assert run(clip.frames, "--out", good, "--overwrite", "--max-frames", "2", *clip.options).code == 0
    assert load_track(good / "track.npz").frame.tolist() == [0, 1]
    assert {path.name for path in good.iterdir()} == RESULT_NAMES - {"overlay.mp4"}  # none of the old run is left


def test_a_place_without_permission(clip: Clip, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    outcome = run(clip.frames, "--out", tmp_path / "out", *clip.options)
    _assert_refused(outcome, f"{tmp_path / 'out'}: cannot be written (no permission to write)")


class _FullDisk:
    """A file of lines that takes `room` more bytes and then says that the disk is full."""

    def __init__(self, file: Any, room: int) -> None:
        self.file, self.room = file, room

    def write(self, data: bytes) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = self.file.write(data[: self.room])
        self.room -= written
        return written

    def __getattr__(self, name: str) -> Any:
        return getattr(self.file, name)


@pytest.mark.parametrize("has_result", [False, True])
def test_a_full_disk(
    clip: Clip, run: Run, good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_result: bool
) -> None:
    out = good if has_result else tmp_path / "out"
    before = _contents(out) if has_result else None
    line = len((clip.result / "track.jsonl").read_bytes().splitlines()[2])
    original = TrackWriter.__enter__

    def enter(self: TrackWriter) -> TrackWriter:
        self._lines._file = _FullDisk(self._lines._file, int(2.5 * line))  # pyright: ignore[reportAttributeAccessIssue]
        return original(self)

    monkeypatch.setattr(TrackWriter, "__enter__", enter)
    outcome = run(clip.frames, "--out", out, "--overwrite", *clip.options)
    _assert_refused(outcome, "track.jsonl: cannot be written (no space left on the disk)", code=1)
    if has_result:
        assert _contents(out) == before
    assert load_track(out / "unfinished" if has_result else out).frame.tolist() == [0, 1]


def test_a_full_disk_under_the_overlay_keeps_the_track(
    clip: Clip, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "overlay.mp4")

    monkeypatch.setattr("torchhand.runs.tracking.write_overlay", full)
    out = tmp_path / "out"
    options = ["--camera", clip.camera, "--config", "contour_planar", "--max-frames", "2", "--causal"]
    _assert_refused(run(clip.frames, "--out", out, *options), "overlay.mp4: No space left on device", code=1)
    assert load_track(out / "track.npz").frame.tolist() == [0, 1]
    monkeypatch.undo()
    assert run(clip.frames, "--out", out, "--resume", *options).code == 0  # only the overlay is left to do
    assert (out / "overlay.mp4").stat().st_size > 0


def test_a_picture_of_the_empty_scene(clip: Clip, run: Run, tmp_path: Path) -> None:
    by_plate = ["--set", "silhouette.method=background"]
    empty = tmp_path / "empty.png"
    cv2.imwrite(str(empty), _plain(clip))
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((20, 30, 3), np.uint8))
    for options, words in (
        (by_plate, ("--background",)),
        (["--background", str(empty)], ("--background: expected --set silhouette.method=background", "'skin'")),
        ([*by_plate, "--background", str(small)], ("small.png: expected a picture of 200x160 px", "got 30x20")),
        ([*by_plate, "--background", str(tmp_path / "none.png")], ("none.png",)),
    ):
        outcome = run(clip.frames, "--out", tmp_path / "out", *clip.options, *options)
        _assert_refused(outcome, *words)
        assert not (tmp_path / "out").exists()
    cv2.imwrite(str(empty), _plain(clip))
    assert run(clip.frames, "--out", tmp_path / "out", *clip.options, *by_plate, "--background", empty).code == 0
    assert set(load_track(tmp_path / "out").status) == {"tracked"}


def _plain(clip: Clip) -> np.ndarray:
    """The colour of the clip's plain background everywhere, BGR."""
    colour = np.median(clip.pictures[0][:5], (0, 1)).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(colour, clip.pictures[0].shape))


def test_a_cluster_wants_a_folder_of_videos(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "one.mp4").touch()
    assert main([str(tmp_path / "one.mp4"), "--out", str(tmp_path / "out"), "--ray"]) == 2
    assert "--ray: expected a folder of videos with it, got" in capsys.readouterr().err
    assert main([str(tmp_path / "one.mp4"), "--out", str(tmp_path / "out"), "--ray", "one", "two"]) == 2
    assert "--ray: expected one address or none, got one two" in capsys.readouterr().err


@pytest.fixture(scope="module")
def opening(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with pictures of a hand that opens after its first frames, and its camera."""
    folder = tmp_path_factory.mktemp("opening")
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    camera = replace(assumed_camera(320, 256, horizontal_fov_deg=48.0), is_assumed=False)
    generator = torch.Generator().manual_seed(1)
    still = scripted_motion("planar", 1, kinematics, camera, generator)
    closed = still.poses[0].clone()
    joints = [DOFS.index(f"{finger}_{joint}") for finger in ("index", "middle") for joint in ("mcp_fe", "pip_fe")]
    closed[joints] = 1.4
    share = torch.linspace(-0.4, 1.2, 17, dtype=torch.float64).clamp(0, 1)[:, None]
    motion = replace(still, poses=(1 - share) * closed + share * still.poses)
    with threads(1):
        rendered = list(render_sequence(kinematics, motion, camera, SceneSettings(supersampling=2), generator))
    save_cameras([camera], folder / "cameras.json")
    _write_folder(folder / "frames", [cv2.cvtColor(one.image.numpy(), cv2.COLOR_RGB2BGR) for one in rendered])
    return folder


def test_a_recording_is_followed_from_the_frame_that_shows_the_hand_open(
    opening: Path, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = ["--camera", opening / "cameras.json", "--no-overlay", "--no-report", "--set", "shape_frames=0"]
    whole = run(opening / "frames", "--out", tmp_path / "whole", *options)
    assert whole.code == 0
    assert "frame 10 shows the hand open" in whole.err
    forward, track = load_track(tmp_path / "whole" / "forward.jsonl"), load_track(tmp_path / "whole")
    assert forward.status.tolist() == ["no_hand"] * 10 + ["tracked"] * 7
    assert forward.reason is not None
    assert forward.reason[0] == "a hand is looked for from frame 10 on"
    assert track.status.tolist() == ["tracked"] * 17
    bent = np.degrees(track.pose[:, [DOFS.index("middle_mcp_fe"), DOFS.index("middle_pip_fe")]].sum(1))
    assert bent[0] > bent[-1] + 30
    with monkeypatch.context() as patch:
        _stop_after(patch, 6, KeyboardInterrupt())
        assert run(opening / "frames", "--out", tmp_path / "stopped", *options).code == 130
    assert run(opening / "frames", "--out", tmp_path / "stopped", "--resume", *options).code == 0
    assert _lines_without_seconds(tmp_path / "stopped") == _lines_without_seconds(tmp_path / "whole")


def test_what_may_not_look_ahead_begins_at_the_first_frame(opening: Path, run: Run, tmp_path: Path) -> None:
    options = ["--camera", opening / "cameras.json", "--no-overlay", "--no-report", "--causal", "--max-frames", "1"]
    outcome = run(opening / "frames", "--out", tmp_path / "out", *options)
    assert "shows the hand open" not in outcome.err
    track = load_track(tmp_path / "out")
    assert track.reason is not None
    assert "looked for from frame" not in track.reason[0]


def test_what_cannot_be_looked_ahead_to_is_told_when_the_run_gets_there(
    opening: Path, run: Run, tmp_path: Path
) -> None:
    frames = tmp_path / "frames"
    shutil.copytree(opening / "frames", frames)
    assert cv2.imwrite(str(frames / "2.png"), np.zeros((128, 160, 3), np.uint8))
    options = ["--camera", opening / "cameras.json", "--no-overlay", "--no-report", "--set", "shape_frames=0"]
    outcome = run(frames, "--out", tmp_path / "out", *options)
    assert outcome.code == 2
    assert "2.png" in outcome.err
    assert load_track(tmp_path / "out").frame.tolist() == [0, 1]


def test_a_run_that_ended_before_the_hand_was_open_goes_on_with_its_own(
    opening: Path, run: Run, tmp_path: Path
) -> None:
    options = ["--camera", opening / "cameras.json", "--no-overlay", "--no-report", "--set", "shape_frames=0"]
    options += ["--out", tmp_path / "out", "--keep-checkpoint"]
    assert run(opening / "frames", *options, "--max-frames", "2").code == 0
    before = load_track(tmp_path / "out").has_hand
    outcome = run(opening / "frames", *options, "--resume", "--max-frames", "17")
    assert outcome.code == 0
    assert before.all()
    assert load_track(tmp_path / "out" / "forward.jsonl").has_hand.all()


@pytest.mark.parametrize("words", [("--config", "hull_lm"), ("--set", "method=hull")])
def test_a_hull_needs_several_cameras(
    words: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["clip.mp4", "--out", str(tmp_path / "out"), *words]) == 2
    assert "error: --config: expected one for a single camera, got" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
