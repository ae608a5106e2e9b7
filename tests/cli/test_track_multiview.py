"""`torchhand track_multiview`: what a run leaves, going on after a stop, bad views and wrong input."""

import io
import json
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
import yaml

from tests.live_pictures import delivered_as_tracked
from torchhand.cli.track_multiview import main
from torchhand.detect import HandDetector
from torchhand.errors import InputError
from torchhand.files import (
    Frame,
    FrameSource,
    HandDetection,
    load_cameras,
    load_hand_model,
    load_track,
    read_picture,
    save_cameras,
    save_hand,
    write_video,
)
from torchhand.geometry import rotation_from_vector
from torchhand.hand import Hand, posture
from torchhand.runs import Run
from torchhand.simulate import named_rig
from torchhand.track import OCCASIONS, Estimate, ScenesAhead, Tracker, View
from torchhand.track.multiview import Initialization, initialize
from torchhand.track.scene import ViewSilhouettes
from torchhand.view import mesh_silhouette

FRAMES, SIZE = 5, (240, 180)
RESULT_NAMES = {"config.yaml", "hand.json", "header.json", "overlay.mp4", "report.html", "track.jsonl", "track.npz"}
SKIN, WALL = (125, 150, 205), (120, 70, 40)  # BGR
FAST = (
    *("--set", "rig.shape_frames=1"),
    *("--set", "rig.start.places=1"),
    *("--set", "rig.start.rolls=4"),
    *("--set", "rig.start.postures=[open]"),
    *("--set", "rig.start.coarse=6"),
    *("--set", "rig.start.fine=2"),
    *("--set", "rig.start.finger_rounds=0"),
)
Rig = Callable[..., Path]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A moving hand before four cameras: pictures, silhouettes, cameras and the generic hand's file."""
    folder = tmp_path_factory.mktemp("rig")
    model = load_hand_model()
    hand, cameras = model.hand(side="right", dtype=torch.float64), named_rig("frame4", size=SIZE)
    save_cameras(cameras, folder / "cameras.json")
    space = hand.kinematics.shape_space
    save_hand(folder / "hand.json", space.names, space.default.tolist(), "right", {}, units=space.units)
    upright = torch.diag(torch.tensor((1.0, -1.0, -1.0), dtype=torch.float64))
    truth, noise = [], np.random.default_rng(0)
    for view in range(len(cameras)):
        (folder / f"view_{view}").mkdir()
        (folder / f"masks_{view}").mkdir()
    for frame in range(FRAMES):
        turn = rotation_from_vector(torch.tensor((0.0, 0.3 + 0.02 * frame, 0.0), dtype=torch.float64))
        pose = posture("open", dtype=torch.float64).clone()
        pose[:3] = torch.tensor((0.003 * frame, 0.08, 0.0))
        state = hand(pose, root_reference=turn @ upright)
        truth.append(state.keypoints.numpy())
        for view, camera in enumerate(cameras):
            mask = mesh_silhouette(state.vertices, hand.faces, camera).numpy()
            picture = np.where(mask[..., None], SKIN, WALL) + noise.integers(-6, 7, (*mask.shape, 3))
            cv2.imwrite(str(folder / f"view_{view}" / f"{frame:04d}.png"), picture.astype(np.uint8))
            cv2.imwrite(str(folder / f"masks_{view}" / f"{frame:04d}.png"), mask.astype(np.uint8) * 255)
    np.savez(folder / "truth.npz", keypoints3d=np.stack(truth))
    return folder


@pytest.fixture(scope="module")
def result(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a run makes of it; for reading only."""
    out = tmp_path_factory.mktemp("out") / "result"
    assert main([str(recording), "--out", str(out), "--hand", str(recording / "hand.json"), *FAST]) == 0
    return out


@pytest.fixture(autouse=True, scope="module")
def _initialized_once() -> Iterator[None]:
    """The hand is looked for once in the same pictures: it is the same hand every time, and takes most of a run."""
    found: dict[bytes, Initialization] = {}

    def remembered(
        hand: Hand, silhouettes: ViewSilhouettes, frames: Iterable, *rest: Any, **options: Any
    ) -> Initialization:
        done, frames = options.pop("done", lambda is_found: None), list(frames)
        what = (silhouettes.cameras, silhouettes.settings, frames, rest[:1], options)
        content = io.BytesIO()
        torch.save(what, content)
        key = content.getvalue()
        if key not in found:
            found[key] = initialize(hand, silhouettes, frames, *rest, **options, done=done)
        return found[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torchhand.runs.tracking.initialize", remembered)
        yield


@pytest.fixture
def copied(recording: Path, tmp_path: Path) -> Path:
    return shutil.copytree(recording, tmp_path / "rig")


def run(folder: Path, out: Path, *more: str) -> int:
    return main([str(folder), "--out", str(out), "--hand", str(folder / "hand.json"), *FAST, *more])


def line_of(capsys: pytest.CaptureFixture[str]) -> str:
    """The one error line of the command."""
    errors = [line for line in capsys.readouterr().err.splitlines() if "error:" in line]
    assert len(errors) == 1
    return errors[0]


def test_result_folder(result: Path, recording: Path) -> None:
    assert {path.name for path in result.iterdir()} == RESULT_NAMES
    track = load_track(result)
    assert track.status.tolist() == ["tracked"] * FRAMES
    assert track.keypoints2d is None
    truth = np.load(recording / "truth.npz")["keypoints3d"]
    assert np.linalg.norm(track.keypoints3d - truth, axis=-1).mean() < 0.004
    assert {"overlap", "overlap_front", "overlap_top45", "inside", "edges", "views"} <= set(track.measures)
    assert np.all(track.measures["views"] == 4)
    assert "world frame" in track.convention
    config = yaml.safe_load((result / "config.yaml").read_text())
    assert config["run"]["masks_given"] is True
    assert [camera["name"] for camera in config["run"]["cameras_used"]] == ["front", "side", "top", "top45"]
    overlay = cv2.VideoCapture(str(result / "overlay.mp4"))
    assert overlay.get(cv2.CAP_PROP_FRAME_COUNT) == FRAMES
    assert overlay.get(cv2.CAP_PROP_FRAME_WIDTH) == 2 * SIZE[0]


def test_the_first_hand_is_looked_for_where_cameras_without_distortion_see_its_points(
    copied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bare = load_cameras(copied / "cameras.json")
    bent = [
        replace(camera, distortion=torch.tensor((-0.2, 0.1, 0.0, 0.0, 0.0), dtype=torch.float64)) for camera in bare
    ]
    save_cameras(bent, copied / "cameras.json")
    truth = torch.from_numpy(np.load(copied / "truth.npz")["keypoints3d"])
    files = [copied / f"points_{view}.npz" for view in range(len(bent))]
    for path, camera in zip(files, bent, strict=True):
        points = camera.project(truth).numpy()
        np.savez(path, points_px=points, label=np.full(FRAMES, "Left"), score=np.ones(FRAMES))
    seen: list[tuple[int, tuple[View, ...]]] = []

    def asked(hand: Hand, silhouettes: ViewSilhouettes, frames: Iterable, *_: Any, **__: Any) -> Initialization:
        seen.extend(frames)
        raise InputError("seen enough")

    monkeypatch.setattr("torchhand.runs.tracking.initialize", asked)
    given = [part for path in files for part in ("--keypoints", str(path))]
    assert run(copied, tmp_path / "out", *given) == 2
    assert seen
    for frame, views in seen:
        for view, camera in zip(views, bare, strict=True):
            assert view.keypoints is not None
            torch.testing.assert_close(view.keypoints.points_px, camera.project(truth[frame]), rtol=0, atol=0.01)


class _Looking:
    """Finds a hand at as many pixels as it has seen pictures (`Landmarker`, `Landmarks`)."""

    name = "looking"

    def __init__(self) -> None:
        self.seen = 0

    def open(self, hands: int) -> "_Looking":
        return self

    def detect(self, image: torch.Tensor) -> list[HandDetection]:
        self.seen += 1
        points = np.full((21, 2), float(self.seen))
        return [HandDetection(picture=points, space=None, confidence=None, label="right", score=0.9)]

    def close(self) -> None: ...


def test_a_detector_that_runs_along_sees_the_pictures_of_the_start(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[_Looking] = []
    told: list[list[float]] = []

    def detector(**options: Any) -> HandDetector:
        made.append(_Looking())
        return HandDetector(side=options["side"], landmarker=made[-1])

    def asked(hand: Hand, silhouettes: ViewSilhouettes, frames: Iterable, *_: Any, **__: Any) -> Initialization:
        for _, views in frames:
            told.append([float(view.keypoints.points_px[0, 0]) for view in views])
        raise InputError("seen enough")

    monkeypatch.setattr("torchhand.runs.request.HandDetector", detector)
    monkeypatch.setattr("torchhand.runs.tracking.initialize", asked)
    assert run(recording, tmp_path / "out", "--keypoints", "mediapipe") == 2
    assert told == [[2 * count] * 4 for count in range(1, len(told) + 1)]  # each is looked at twice
    assert len(told) == 1  # rig.shape_frames
    own, other = made[:4], made[4:]
    assert [one.seen for one in own] == [0] * 4  # those of the run have yet to see its first picture
    assert [one.seen for one in other] == [2 * len(told)] * 4


def test_skin_in_place_of_masks_and_videos_in_place_of_pictures(recording: Path, tmp_path: Path) -> None:
    folder = tmp_path / "videos"
    folder.mkdir()
    for name in ("cameras.json", "hand.json"):
        shutil.copy(recording / name, folder)
    for view, name in enumerate(("front", "side", "top", "top45")):
        with write_video(folder / f"{name}.mp4", width=SIZE[0], height=SIZE[1]) as video:
            for path in sorted((recording / f"view_{view}").iterdir()):
                video.write(read_picture(path))
    assert run(folder, tmp_path / "out", "--max-frames", "3", "--no-overlay") == 0
    track = load_track(tmp_path / "out")
    assert track.status.tolist() == ["tracked"] * 3
    truth = np.load(recording / "truth.npz")["keypoints3d"][:3]
    assert np.linalg.norm(track.keypoints3d - truth, axis=-1).mean() < 0.006


def test_a_second_process_changes_nothing(recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes made ahead (`ScenesAhead`), which needs a second core."""
    with monkeypatch.context() as patch:
        patch.setattr("torchhand.track.ahead.usable_cores", lambda: 1)
        patch.setattr(ScenesAhead, "step", lambda *_: pytest.fail("another process"))
        assert run(recording, tmp_path / "alone", "--no-overlay", "--no-report") == 0
    monkeypatch.setattr("torchhand.track.ahead.usable_cores", lambda: 2)
    monkeypatch.setattr("torchhand.track.ahead._MIN_FRAMES", 0)
    step, ordered = ScenesAhead.step, []

    def waiting(self, state, views, time_s, following=None):
        self.wait()
        ordered.append(None if following is None else round(30 * following[1]))
        return step(self, state, views, time_s, following)

    monkeypatch.setattr(ScenesAhead, "step", waiting)
    out = tmp_path / "out"
    assert run(recording, out, "--no-overlay", "--no-report") == 0
    assert ordered == [*range(1, FRAMES), None]
    alone, ahead = load_track(tmp_path / "alone"), load_track(out)
    for name in ("frame", "pose", "keypoints3d_cov", "finger_quality"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(ahead, name))
    np.testing.assert_array_equal(alone.measures["quality"], ahead.measures["quality"])


def test_stopped_run_goes_on_to_the_same_end(
    result: Path, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torchhand.runs.tracking.CHECKPOINT_EVERY", 2)
    step, seen = Run.step, []

    def stopping(self, frame, following):
        seen.append(frame.index)
        if len(seen) == 4:
            raise KeyboardInterrupt
        return step(self, frame, following)

    monkeypatch.setattr(Run, "step", stopping)
    out = tmp_path / "out"
    assert run(recording, out) == 130
    seen[:] = [0] * 4
    assert run(recording, out, "--resume") == 0
    assert seen[4:] == [2, 3, 4]
    whole, resumed = load_track(result), load_track(out)
    np.testing.assert_array_equal(whole.pose, resumed.pose)
    np.testing.assert_array_equal(whole.keypoints3d_cov, resumed.keypoints3d_cov)


@pytest.mark.slow
def test_frames_that_were_lost_are_filled_in_once_the_hand_is_found(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torchhand.runs.tracking.CHECKPOINT_EVERY", 2)
    step, run_step = Tracker.step, Run.step
    stops_at: list[int] = []

    def losing(self, state, views, time_s, **named):
        if round(30 * time_s) in (1, 2):
            gone = replace(state, hand=None, time_s=time_s)
            return gone, Estimate(status="lost", time_s=time_s, reason="occluded")
        return step(self, state, views, time_s, **named)

    def stopping(self, frame, following):
        if frame.index in stops_at:
            raise KeyboardInterrupt
        return run_step(self, frame, following)

    monkeypatch.setattr(Tracker, "step", losing)
    monkeypatch.setattr(Run, "step", stopping)
    whole = tmp_path / "whole"
    assert run(recording, whole, "--no-overlay") == 0
    track = load_track(whole)
    assert track.frame.tolist() == list(range(FRAMES))
    assert track.status.tolist() == ["tracked", "tracked", "tracked", "recovered", "tracked"]
    truth = np.load(recording / "truth.npz")["keypoints3d"]
    assert np.linalg.norm(track.keypoints3d - truth, axis=-1).mean() < 0.004
    for stop, left in (
        (4, ["tracked", "tracked", "tracked", "recovered"]),  # 1 and 2 are corrected, the last checkpoint is behind 3
        (3, ["tracked", "lost", "lost"]),  # the last checkpoint is behind 1, which is yet to be corrected
    ):
        broken = tmp_path / f"broken_{stop}"
        stops_at[:] = [stop]
        assert run(recording, broken, "--no-overlay") == 130
        assert load_track(broken).status.tolist() == left
        stops_at[:] = []
        assert run(recording, broken, "--no-overlay", "--resume") == 0
        for name in ("pose", "keypoints3d_cov", "status"):
            np.testing.assert_array_equal(getattr(load_track(broken), name), getattr(track, name))


def test_finished_run_is_resumed_without_work(
    result: Path, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = shutil.copytree(result, tmp_path / "out")
    monkeypatch.setattr(Run, "step", lambda *_: pytest.fail("tracked again"))
    assert run(recording, out, "--resume") == 0
    assert "is finished; nothing is left to do" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == {
        path.name: path.read_bytes() for path in result.iterdir()
    }


def _mirrored(folder: Path) -> None:
    """Make a recording that of the left hand: as in a mirror."""
    mirror = torch.diag(torch.tensor((-1.0, 1.0, 1.0), dtype=torch.float64))
    cameras = []
    for camera in load_cameras(folder / "cameras.json"):
        intrinsics = camera.intrinsics.clone()
        intrinsics[0, 2] = camera.width - 1 - intrinsics[0, 2]
        rotation, translation = mirror @ camera.rotation @ mirror, mirror @ camera.translation
        cameras.append(replace(camera, intrinsics=intrinsics, rotation=rotation, translation=translation))
    save_cameras(cameras, folder / "cameras.json")
    for path in (*folder.glob("view_*/*.png"), *folder.glob("masks_*/*.png")):
        picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert picture is not None
        cv2.imwrite(str(path), picture[:, ::-1])
    truth = np.load(folder / "truth.npz")["keypoints3d"]
    np.savez(folder / "truth.npz", keypoints3d=truth * (-1.0, 1.0, 1.0))


def test_a_left_hand_is_told_where_nobody_names_its_side(
    copied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And hands of both sides are not tried again by a run that is resumed."""
    _mirrored(copied)
    out, step = tmp_path / "out", Run.step
    arguments = [str(copied), "--out", str(out), "--no-overlay", *FAST]

    def stopping(self, frame, following):
        if frame.index == 2:
            raise KeyboardInterrupt
        return step(self, frame, following)

    with monkeypatch.context() as patch:
        patch.setattr(Run, "step", stopping)
        assert main(arguments) == 130
    assert "a left hand, with probability 0.8" in capsys.readouterr().err
    monkeypatch.setattr("torchhand.runs.tracking._hands_of", lambda *_: pytest.fail("tried again"))
    assert main([*arguments, "--resume"]) == 0
    track = load_track(out)
    truth = np.load(copied / "truth.npz")["keypoints3d"]
    assert np.linalg.norm(track.keypoints3d - truth, axis=-1).mean() < 0.004
    assert track.header["side"] == "left"
    assert yaml.safe_load((out / "config.yaml").read_text())["run"]["side_is"] == "tried"
    assert main([*arguments, "--resume", "--side", "right"]) == 2
    assert "side was 'left', is now 'right'" in line_of(capsys)


def test_resuming_with_other_settings_is_refused(result: Path, recording: Path, tmp_path: Path, capsys) -> None:
    out = shutil.copytree(result, tmp_path / "out")
    assert run(recording, out, "--resume", "--set", "rig.octree.level=6") == 2
    assert "made_with.settings.rig.octree.level was 7, is now 6" in line_of(capsys)


@pytest.mark.slow
def test_proportions_can_be_fitted_to_one_frame(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main([str(recording), "--out", str(out), "--max-frames", "1", "--no-overlay", *FAST]) == 0
    hand = json.loads((out / "hand.json").read_text())
    assert hand["provenance"]["method"] == "visual hulls"
    assert hand["provenance"]["frames"] == [0]
    assert 0.17 < hand["shape"]["hand_length"] < 0.21


@pytest.mark.parametrize("kind", ["missing", "black", "size", "frozen"])
def test_bad_view_does_not_spoil_the_others(kind: str, copied: Path, tmp_path: Path, capsys) -> None:
    pictures = sorted((copied / "view_1").iterdir())
    if kind == "missing":
        shutil.rmtree(copied / "view_1")
    for path in pictures if kind != "missing" else []:
        image = np.ascontiguousarray(read_picture(pictures[0]).numpy()[..., ::-1])
        image = {"black": image * 0, "size": cv2.resize(image, (120, 90)), "frozen": image}[kind]
        cv2.imwrite(str(path), image)
    for view in range(4):
        shutil.rmtree(copied / f"masks_{view}")
    assert run(copied, tmp_path / "out", "--max-frames", "2", "--no-overlay") == 0
    track = load_track(tmp_path / "out")
    assert track.status.tolist() == ["tracked", "tracked"]
    if kind != "frozen":  # which is told only after some frames
        assert np.all(track.measures["views"] == 3)
        assert "side" in capsys.readouterr().err


def test_frame_without_silhouettes_is_lost_and_the_next_one_found(copied: Path, tmp_path: Path) -> None:
    for view in range(1, 4):
        cv2.imwrite(str(copied / f"masks_{view}" / "0001.png"), np.zeros(SIZE[::-1], np.uint8))
    assert run(copied, tmp_path / "out", "--max-frames", "3", "--no-overlay") == 0
    track = load_track(tmp_path / "out")
    assert track.status.tolist() == ["tracked", "lost", "tracked"]
    assert track.reason is not None
    assert "a silhouette in 1 of 4 views" in track.reason[1]
    assert not np.isfinite(track.pose[1]).any()


@pytest.mark.slow
def test_unit_from_the_hand(copied: Path, tmp_path: Path, capsys) -> None:
    cameras = [replace(c, translation=c.translation / 0.0254) for c in named_rig("frame4", size=SIZE)]
    save_cameras(cameras, copied / "cameras.json")
    out = tmp_path / "out"
    assert run(copied, out, "--unit", "hand", "--max-frames", "2", "--no-overlay") == 0
    unit = yaml.safe_load((out / "config.yaml").read_text())["run"]["cameras_used"][0]["t"][2] / 0.4
    assert unit == pytest.approx(1.0, abs=0.05)
    assert "one unit of the rig is" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--unit", "furlong"), "unit: expected one of m, cm, mm, inch, hand or a number of metres"),
        (("--silhouettes", "background"), "expected --background with pictures of the empty scene, got none"),
        (("--background", "x"), "--background: expected --silhouettes background with it"),
        (("--set", "rig.octree.depth=3"), "unknown key rig.octree.depth"),
        (("--set", "rig.octree.level=99"), "rig.octree.level: expected 1 to 10, got 99"),
        (("--offset", "left=3"), "'left' is no camera; allowed: front, side, top, top45"),
        (("--cameras", "nowhere.json"), "nowhere.json: no such file or folder"),
        (("--start", "-1"), "--start: expected 0 or more"),
        (("--start", "50"), "start 50 lies after the last frame (4)"),
        (("--max-frames", "0"), "--max-frames: expected 1 or more"),
    ],
)
def test_wrong_options(options, words: str, recording: Path, tmp_path: Path, capsys) -> None:
    assert run(recording, tmp_path / "out", *options) == 2
    assert words in line_of(capsys)
    assert not (tmp_path / "out").exists()


def test_wrong_rigs(copied: Path, tmp_path: Path, capsys) -> None:
    entries = json.loads((copied / "cameras.json").read_text())["cameras"]

    def refused(changed, words: str) -> None:
        (copied / "cameras.json").write_text(json.dumps({"cameras": changed}))
        assert run(copied, tmp_path / "out") == 2
        assert words in line_of(capsys)

    metres = [{**entry, "t": [1000 * value for value in entry["t"]]} for entry in entries]
    refused(metres, "unit mm makes it")
    away = [{**entry, "t": [0.0, 0.0, -0.4]} for entry in entries]
    refused(away, "look away")
    broken = [{**entries[0], "R": [[1, 0, 0], [0, 1, 0], [0, 0.4, 1]]}, *entries[1:]]
    refused(broken, "R")
    refused(entries[:1], "expected two cameras or more, got 1")
    (copied / "cameras.json").unlink()
    assert run(copied, tmp_path / "out") == 2
    assert "holds no cameras" in line_of(capsys)


def test_folder_without_pictures(copied: Path, tmp_path: Path, capsys) -> None:
    for view in range(3):
        shutil.rmtree(copied / f"view_{view}")
    assert run(copied, tmp_path / "out") == 2
    assert "expected pictures of two cameras or more" in line_of(capsys)
    assert run(copied / "nowhere", tmp_path / "out") == 2


def test_older_result_is_kept(result: Path, recording: Path, capsys) -> None:
    before = (result / "track.npz").read_bytes()
    assert run(recording, result) == 2
    assert "is not empty" in line_of(capsys)
    assert (result / "track.npz").read_bytes() == before


class _Camera(FrameSource):
    """Delivers its first picture until a hand was tracked (`delivered_as_tracked`)."""

    def __init__(self, pictures: Path, lines: Path) -> None:
        self.name, self.fps, self.count, (self.width, self.height) = pictures.name, 30.0, None, SIZE
        self.pictures, self.lines = pictures, lines

    def __iter__(self) -> Iterator[Frame]:
        return delivered_as_tracked(self.pictures, self.lines)

    def close(self) -> None:
        pass


def test_cameras_are_watched_live(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What takes seconds is done by another process: frames come all the while."""
    lines, steps, step = tmp_path / "out" / "track.jsonl", list[tuple[str, ...]](), Tracker.step

    def observed(*given: Any, **named: Any) -> Any:
        steps.append(tuple(named.get("occasions", OCCASIONS)))
        return step(*given, **named)

    monkeypatch.setattr(Tracker, "step", observed)  # of this process alone
    monkeypatch.setattr("torchhand.files.live.rig.open_source", lambda source: _Camera(source, lines))
    live = ",".join(str(recording / f"view_{view}") for view in range(4))
    assert run(recording, tmp_path / "out", "--live", live) == 0
    track, said = load_track(tmp_path / "out"), capsys.readouterr().err
    assert len(steps) == len(track)
    assert not {occasion for occasions in steps for occasion in occasions} & {"declining", "degraded", "search"}
    assert track.reason is not None
    whole = np.array(["no picture of this time" not in reason for reason in track.reason])  # cameras may be late
    status, points = track.status[whole], track.keypoints3d[whole]
    followed = status.tolist().index("tracked")
    assert set(status[:followed]) == {"no_hand"}
    assert set(status[followed:]) <= {"tracked", "recovered"}
    truth = np.load(recording / "truth.npz")["keypoints3d"]
    assert np.linalg.norm(points[followed:] - truth[0], axis=-1).mean() < 0.006
    assert "from a picture to its estimate" in said
    for name in ("front", "side", "top", "top45"):
        assert f"camera {name}: " in said
    assert not (tmp_path / "out" / "overlay.mp4").exists()
    assert (tmp_path / "out" / "hand.json").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--live", "0,,1"), "--live: expected numbers of webcams or video files, with commas between them"),
        (("--live", "a,b", "--resume"), "expected none of what needs a recording with it, got --resume"),
        (("--live", "a,b", "--unit", "hand"), "expected none of what needs a recording with it, got --unit hand"),
    ],
)
def test_what_live_cameras_cannot_do(
    options: tuple[str, ...], words: str, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(recording, tmp_path / "out", *options) == 2
    assert words in line_of(capsys)


def test_cameras_that_see_nothing_together_are_told_before_anything_is_written(
    copied: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(copied, tmp_path / "out", "--unit", "mm") == 2
    assert "no volume is seen by all of" in (line := line_of(capsys))
    assert "--unit" in line
    assert not (tmp_path / "out").exists()
