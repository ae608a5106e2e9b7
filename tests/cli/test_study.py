"""`torchhand study`: what it leaves, the same after a stop, and one line for whatever a user can get wrong."""

import contextlib
import csv
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
import yaml

from torchhand.cli import simulate
from torchhand.cli.study import main
from torchhand.errors import InputError
from torchhand.files import load_hand_model, read_picture, save_hand
from torchhand.hand import DOFS
from torchhand.study.hypotheses import CaseStudy, Hypotheses, StudyBatch, frames_of

RESULT_NAMES = {"study.csv", "study.png", "hypotheses.npz"}
QUICK = (
    *("--size", "96x72", "--starts", "7", "--batch", "3", "--levels", "2", "--iterations", "6"),
    *("--set", "points_per_generator=6", "--set", "points_per_arc=6", "--set", "contour.boundary_points=64"),
    *("--set", "best_of=[1,2]", "--threads", "1"),
)
FRAMES = ("--frames", "0,2")


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


Run = Callable[..., Outcome]


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    def call(*argv: str | Path) -> Outcome:
        capfd.readouterr()
        code = main([str(argument) for argument in argv])
        out, err = capfd.readouterr()
        return Outcome(code, out, err)

    return call


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """A finished study of two simulated pictures, for reading only; and what it said."""
    folder, out, err = tmp_path_factory.mktemp("done") / "study", io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(["--out", str(folder), *FRAMES, *QUICK])
    return folder, Outcome(code, out.getvalue(), err.getvalue())


@pytest.fixture(scope="module")
def done(finished: tuple[Path, Outcome]) -> Path:
    return finished[0]


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of our own simulator, 3 frames; for reading only."""
    out = tmp_path_factory.mktemp("sequence") / "sequence"
    order = ["--out", str(out), "--size", "128x96", "--frames", "3", "--motion", "abduction", "--pictures", "png"]
    assert simulate.main(order) == 0
    return out


@pytest.fixture
def good(done: Path, tmp_path: Path) -> Path:
    """An earlier good result, to be left as it is."""
    return Path(shutil.copytree(done, tmp_path / "good"))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def assert_refused(outcome: Outcome, *words: str | Path) -> None:
    """Exit code 2 and exactly one line, which holds these words."""
    assert outcome.code == 2, outcome
    assert outcome.out == ""
    assert outcome.err.startswith("torchhand study: error: ")
    assert outcome.err.count("\n") == 1, outcome.err
    for word in words:
        assert str(word) in outcome.err


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "study.csv").open() as file:
        return list(csv.DictReader(file))


# ---------------------------------------------------------------------------------------- what a study leaves


def test_the_whole_result(done: Path) -> None:
    assert {path.name for path in done.iterdir()} == RESULT_NAMES
    with np.load(done / "hypotheses.npz") as stored:
        arrays = dict(stored)
    assert arrays["frame"].tolist() == [0] * 4 + [2] * 3
    assert arrays["batch"].tolist() == [0, 0, 0, 1, 2, 2, 2]
    assert len(set(arrays["seed"].tolist())) == 3
    assert set(arrays["status"]) <= {"converged", "stalled"}
    assert tuple(arrays["dof_names"]) == DOFS
    assert arrays["perturbation"].shape == (7, len(arrays["free_names"]))
    np.testing.assert_array_equal(arrays["success"], arrays["angle_deg"] <= 5)
    assert arrays["reference_frame"].tolist() == [0, 2]
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    reference = kinematics(torch.from_numpy(arrays["reference_pose"][[0, 0, 0, 0, 1, 1, 1]])).keypoints
    points = kinematics(torch.from_numpy(arrays["pose"])).keypoints
    missed = 1e3 * (points - reference).norm(dim=-1).mean(-1).numpy()
    np.testing.assert_allclose(arrays["keypoint_mm"], missed, atol=1e-4)  # worked in single precision
    assert float(arrays["reference_overlap"].min()) > 0.97
    assert arrays["reference_shape"].shape == (2, len(arrays["shape_names"]))


def test_the_table_is_that_of_the_hypotheses(done: Path) -> None:
    with np.load(done / "hypotheses.npz") as stored:
        arrays = dict(stored)
    table = rows(done)
    assert [(row["frame"], row["size"]) for row in table] == [
        (frame, size) for frame in ("all", "0", "2") for size in ("0.5", "1")
    ]
    for row in table:
        own = arrays["level"] == 2 * float(row["size"])
        own &= True if row["frame"] == "all" else arrays["frame"] == int(row["frame"])
        assert int(row["starts"]) == own.sum() > 0
        assert float(row["success"]) == pytest.approx(arrays["success"][own].mean(), rel=1e-5)
        middle = np.quantile(arrays["angle_deg"][own], 0.5, method="inverted_cdf")
        assert float(row["angle_median_deg"]) == pytest.approx(middle, rel=1e-5)
        assert float(row["converged"]) + float(row["stalled"]) == pytest.approx(1)
    assert table[1]["angle_deg"] == table[1]["rotation_deg"] == "15"
    assert table[0]["translation_mm"] == "5"


def test_registration_helps_in_the_end(done: Path) -> None:
    largest = rows(done)[1]
    assert float(largest["keypoint_median_mm"]) < 0.8 * float(largest["start_keypoint_median_mm"])
    assert float(largest["angle_median_deg"]) < 0.8 * float(largest["start_angle_median_deg"])


def config_of(folder: Path) -> Any:
    """The settings that a study keeps with its starts."""
    with np.load(folder / "hypotheses.npz") as stored:
        return yaml.safe_load(str(stored["config"]))


def test_the_plot_shows_lines(done: Path) -> None:
    picture = read_picture(done / "study.png")
    assert picture.shape == (760, 1200, 3)
    coloured = (picture.int().amax(-1) - picture.int().amin(-1)) > 60
    for top in (0, 380):
        for left in (0, 600):
            assert int(coloured[top + 34 : top + 318, left + 58 : left + 582].sum()) > 500


def test_the_configuration_tells_everything(done: Path) -> None:
    config = config_of(done)
    assert config["starts"] == 7
    assert config["perturbation"] == {"angle_deg": 15.0, "translation_mm": 10.0, "rotation_deg": 15.0, "levels": 2}
    assert config["batch"] == 3
    assert config["contour"]["boundary_points"] == 64
    assert [stage["iterations"] for stage in config["schedule"]] == [2, 2, 1, 1]  # six in four rounds
    run_config = config["run"]
    assert (run_config["input"], run_config["frames"], run_config["seed"]) == ("simulated pictures", [0, 2], 0)
    assert run_config["reference"] == "exact, of simulated pictures"
    assert run_config["camera_used"]["width"] == 96


def test_the_terminal_gets_the_table(finished: tuple[Path, Outcome]) -> None:
    folder, outcome = finished
    assert outcome.code == 0
    assert outcome.err == ""  # no progress bar where nobody watches
    lines = outcome.out.splitlines()
    assert [line[:22].strip() for line in lines[2:4]] == ["±7.5° ±5 mm ±7.5°", "±15° ±10 mm ±15°"]
    assert "ms per start; reference: exact, of simulated pictures" in lines[-2]
    assert lines[-1] == f"saved study.csv, study.png and hypotheses.npz in {folder}"


# ---------------------------------------------------------------------------------------- stopped and resumed


class Stopping:
    """In place of a batch's work: does so many batches, then is stopped."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, after: int, stop: type[BaseException]) -> None:
        own = CaseStudy.run
        self.left, self.patch = after, monkeypatch

        def work(study: CaseStudy, batch: StudyBatch, seed: int) -> Hypotheses:
            if not self.left:
                raise stop
            self.left -= 1
            return own(study, batch, seed)

        monkeypatch.setattr(CaseStudy, "run", work)


@pytest.mark.parametrize("after", [0, 2])
def test_a_stopped_study_ends_with_the_same_bytes(
    after: int, done: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        Stopping(patch, after, KeyboardInterrupt)
        outcome = run("--out", out, *FRAMES, *QUICK)
    assert outcome.code == 130
    assert outcome.err == (
        f"torchhand study: stopped by Ctrl-C; the same command with --resume goes on from {out / 'unfinished'}\n"
    )
    with (out / "unfinished" / "batches.bin").open("ab") as file:
        file.write(b"what a killed program leaves")
    with monkeypatch.context() as patch:
        Stopping(patch, 3 - after, AssertionError)  # no batch is done twice
        assert run("--out", out, *FRAMES, *QUICK, "--resume").code == 0
    assert contents(out) == contents(done)
    assert {path.name for path in out.iterdir()} == RESULT_NAMES


def test_batches_side_by_side_give_the_same_bytes(done: Path, tmp_path: Path, run: Run) -> None:
    assert run("--out", tmp_path / "out", *FRAMES, *QUICK, "--threads", "3").code == 0
    assert contents(tmp_path / "out") == contents(done)


def test_another_seed_is_another_study(done: Path, tmp_path: Path, run: Run) -> None:
    assert run("--out", tmp_path / "out", *FRAMES, *QUICK, "--seed", "1").code == 0
    with np.load(done / "hypotheses.npz") as one, np.load(tmp_path / "out" / "hypotheses.npz") as other:
        assert not (one["angle_deg"] == other["angle_deg"]).any()
        assert not (one["reference_pose"][:, 6:12] == other["reference_pose"][:, 6:12]).all()


def test_a_finished_study_is_only_shown_again(good: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    before = contents(good)
    Stopping(monkeypatch, 0, AssertionError)
    outcome = run("--out", good, *FRAMES, *QUICK, "--resume")
    assert outcome.code == 0
    assert "±15° ±10 mm ±15°" in outcome.out
    assert outcome.out.endswith(f"finished already: {good}\n")
    assert contents(good) == before


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        (("--starts", "24"), "settings.starts was 7, is now 24"),
        (("--angle-deg", "10", "--batch", "3"), "settings.perturbation.angle_deg was 15.0, is now 10.0"),
        (("--frames", "0"), "frames was [0, 2], is now [0]"),
        (("--size", "96x80"), "pictures was"),
    ],
)
def test_another_study_is_not_resumed(change: tuple[str, ...], difference: str, good: Path, run: Run) -> None:
    before = contents(good)
    assert_refused(
        run("--out", good, *FRAMES, *QUICK, *change, "--resume"),
        f"{good / 'hypotheses.npz'}: cannot be resumed: {difference}",
        "give the same options as before, or --overwrite",
    )
    assert contents(good) == before


def test_an_older_study_is_refused_then_replaced(good: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    before = contents(good)
    assert_refused(run("--out", good, *QUICK), f"{good}: the output folder exists and is not empty", "--overwrite")
    with monkeypatch.context() as patch:
        Stopping(patch, 1, KeyboardInterrupt)
        stopped = run("--out", good, *QUICK, "--overwrite")
    assert stopped.code == 130
    assert "--resume in place of --overwrite" in stopped.err
    assert contents(good) == before
    assert run("--out", good, *QUICK, "--resume").code == 0
    assert contents(good).keys() == before.keys()
    assert [row["frame"] for row in rows(good)] == ["all", "all"]


# ---------------------------------------------------------------------------------------- pictures of other kinds


def test_a_simulated_sequence_with_its_truth(sequence: Path, tmp_path: Path, run: Run) -> None:
    outcome = run(sequence, "--out", tmp_path / "out", "--frames", "all", *QUICK)
    assert outcome.code == 0, outcome.err
    assert "reference: exact, of the truth" in outcome.out
    with np.load(tmp_path / "out" / "hypotheses.npz") as stored, np.load(sequence / "truth.npz") as truth:
        assert stored["reference_frame"].tolist() == [0, 1, 2]
        np.testing.assert_allclose(stored["reference_pose"][:, 6:], truth["pose"][:, 6:], atol=1e-12)
        assert np.bincount(stored["frame"]).tolist() == [3, 2, 2]
        kinematics = load_hand_model().kinematics(dtype=torch.float64)
        points = kinematics(torch.from_numpy(stored["reference_pose"])).keypoints.numpy()
        np.testing.assert_allclose(points, truth["keypoints3d"], atol=1e-9)


def test_another_maker_s_truth_of_keypoints(sequence: Path, tmp_path: Path, run: Run) -> None:
    """Without poses and masks: our hand is fitted to the keypoints, and the silhouette found by the skin's colour."""
    copy = Path(shutil.copytree(sequence, tmp_path / "sequence"))
    shutil.rmtree(copy / "masks")
    with np.load(sequence / "truth.npz") as truth:
        np.savez(copy / "truth.npz", keypoints3d=truth["keypoints3d"])
    outcome = run(copy, "--out", tmp_path / "out", *QUICK)
    assert outcome.code == 0, outcome.err
    assert "our hand fitted to the truth's keypoints" in outcome.out
    assert "right hand)" in outcome.out
    run_config = config_of(tmp_path / "out")["run"]
    assert run_config["reference_overlap"][0] > 0.85


def test_a_picture_without_truth_is_its_own_reference(sequence: Path, tmp_path: Path, run: Run) -> None:
    picture, mask = sequence / "frames" / "0000.png", sequence / "masks" / "0000.png"
    given = ("--camera", sequence / "cameras.json", "--mask", mask, "--hand", saved_hand(tmp_path, 1.0, "right"))
    outcome = run(picture, "--out", tmp_path / "out", *QUICK, "--starts", "3", *given)
    assert outcome.code == 0, outcome.err
    assert "reference: the best registration about the fit of an open hand" in outcome.out
    with np.load(tmp_path / "out" / "hypotheses.npz") as stored, np.load(sequence / "truth.npz") as truth:
        difference = np.abs(stored["reference_pose"][0] - truth["pose"][0])[6:]
        assert np.degrees(difference.mean()) < 6
        assert float(stored["reference_overlap"][0]) > 0.9
        kinematics = load_hand_model().kinematics(dtype=torch.float64)
        points = kinematics(torch.from_numpy(stored["reference_pose"][0])).keypoints.numpy()
        assert np.linalg.norm(points - truth["keypoints3d"][0], axis=-1).mean() < 0.015
    run_config = config_of(tmp_path / "out")["run"]
    assert list(run_config["shape_of_first_frame"].values()) == load_hand_model().shape_space.default.tolist()


def saved_hand(folder: Path, factor: float, side: str) -> Path:
    """The default hand, its length times the factor."""
    space = load_hand_model().shape_space
    shape = [factor * float(space.default[0]), *space.default[1:].tolist()]
    save_hand(folder / "hand.json", space.names, shape, side, {}, units=space.units)
    return folder / "hand.json"


def test_a_known_hand_is_simulated(tmp_path: Path, run: Run) -> None:
    hand = saved_hand(tmp_path, 1.1, "left")
    assert run("--out", tmp_path / "out", *QUICK, "--starts", "2", "--hand", hand).code == 0
    run_config = config_of(tmp_path / "out")["run"]
    assert run_config["side"] == "left"
    assert run_config["shape_of_first_frame"]["hand_length"] == pytest.approx(
        1.1 * float(load_hand_model().shape_space.default[0])
    )


def test_settings_from_a_file_and_single_ones(tmp_path: Path, run: Run) -> None:
    content = {"success_deg": 4.0, "has_prior": False, "perturbation": {"levels": 3}, "run": {"seed": 9}}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(content))
    order = (
        "--config",
        tmp_path / "own.yaml",
        *QUICK,
        "--success-deg",
        "3",
        "--method",
        "gradient_descent",
        "--space",
        "dof27",
        "--starts",
        "2",
    )
    assert run("--out", tmp_path / "out", *order).code == 0
    config = config_of(tmp_path / "out")
    assert (config["success_deg"], config["has_prior"], config["space"]) == (3.0, False, "dof27")
    assert config["perturbation"]["levels"] == 2
    assert [stage["method"] for stage in config["schedule"]] == ["gradient_descent"] * 4
    assert config["run"]["seed"] == 0
    again = run("--out", tmp_path / "again", "--config", tmp_path / "out" / "hypotheses.npz", "--print-config")
    assert yaml.safe_load(again.out) == {key: value for key, value in config.items() if key != "run"}


def test_an_older_version_s_settings_go_with_it(done: Path, tmp_path: Path, run: Run) -> None:
    """The file in which they stood does not stay beside results that it does not belong to."""
    old = Path(shutil.copytree(done, tmp_path / "old"))
    (old / "config.yaml").write_text("starts: 7\n")
    assert run("--out", old, *QUICK, "--starts", "2", "--overwrite").code == 0
    assert {path.name for path in old.iterdir()} == RESULT_NAMES


# ---------------------------------------------------------------------------------------- what a user can get wrong


@pytest.mark.parametrize(
    ("order", "message"),
    [
        (("{tmp}/gone",), "{tmp}/gone: no such file or folder (expected a sequence, a picture or a video)"),
        (("{tmp}/wall.png",), "{tmp}/wall.png: no hand"),
        (("{tmp}/notes.txt",), "{tmp}/notes.txt: expected a video or a picture"),
        (("{tmp}/wall.png", "--frames", "3"), "start 3 lies after the last picture (0)"),
        (("--starts", "0"), "command line: starts: expected 1 to 10000000, got 0"),
        (("--starts", "2", "--frames", "0-4"), "--starts: expected 5 or more, one for each frame, got 2"),
        (("--levels", "0"), "perturbation.levels: expected 1 to 100, got 0"),
        (("--angle-deg", "-3"), "perturbation.angle_deg: expected 0 to 180, got -3.0"),
        (("--iterations", "3"), "--iterations: expected 4 or more, one for each round of the schedule, got 3"),
        (("--batch", "5000"), "command line: batch: expected 1 to 4096, got 5000"),
        (("--space", "planar"), "space: expected one of planar_abduction, dof26, dof27, dof28, dof31, dof36"),
        (("--surface", "clay"), "--surface: expected mesh or primitives, got 'clay'"),
        (("--success-deg", "0"), "success_deg: expected above 0 and finite, got 0.0"),
        (("--frames", "some"), "--frames: expected numbers such as 0 or 0,10,20-29, or all; got 'some'"),
        (("--frames", "all"), "--frames: expected numbers for simulated pictures, which have no end; got all"),
        (("--size", "640"), "--size: expected WIDTHxHEIGHT in px, each 64 to 9999, like 640x480; got '640'"),
        (("--size", "20x20"), "--size: expected WIDTHxHEIGHT in px, each 64 to 9999"),
        (("--set", "starts"), "--set: expected KEY=VALUE"),
        (("--set", "start=3"), "command line: unknown key start (did you mean starts?)"),
        (("--set", "perturbation=3", "--set", "perturbation.levels=3"), "--set: expected each field once"),
        (("--config", "{tmp}/gone.yaml"), "{tmp}/gone.yaml: cannot be read (No such file or directory)"),
        (("--camera", "{tmp}/gone.json"), "--camera: expected INPUT with it; simulated pictures have their own"),
        (("--mask", "{tmp}/wall.png"), "--mask: expected INPUT with it; simulated pictures have their own"),
        (("--hand", "{tmp}/gone.json"), "{tmp}/gone.json: no such file"),
        (("--device", "abacus"), "--device: expected cpu"),
        (("--threads", "0"), "--threads: expected 1 to 1024, got 0"),
        (("--seed", str(2**63)), "--seed: expected a number of 64 bits"),
        (("--resume", "--overwrite"), "expected at most one of --resume and --overwrite, got both"),
    ],
)
def test_wrong_orders_are_one_line_and_two(order: tuple[str, ...], message: str, tmp_path: Path, run: Run) -> None:
    cv2.imwrite(str(tmp_path / "wall.png"), np.full((96, 128, 3), 140, np.uint8))
    (tmp_path / "notes.txt").write_text("x")
    words = [word.replace("{tmp}", str(tmp_path)) for word in order]
    outcome = run(*words, "--out", tmp_path / "out", *(() if "--starts" in order else ("--starts", "8")))
    assert_refused(outcome, message.replace("{tmp}", str(tmp_path)))
    assert not (tmp_path / "out").exists()


@dataclass(frozen=True)
class Broken:
    """A sequence made worse."""

    folder: Path

    def truth(self, **arrays: Any) -> None:
        with np.load(self.folder / "truth.npz") as stored:
            content = dict(stored)
        np.savez(self.folder / "truth.npz", **(content | arrays))


@pytest.fixture
def broken(sequence: Path, tmp_path: Path) -> Broken:
    return Broken(Path(shutil.copytree(sequence, tmp_path / "sequence")))


def test_wrong_sequences_are_told(broken: Broken, tmp_path: Path, run: Run, good: Path) -> None:
    folder, before = broken.folder, contents(good)

    def refused(*words: str | Path, options: tuple[str | Path, ...] = ()) -> None:
        assert_refused(run(folder, "--out", good, *QUICK, *options, "--overwrite"), *words)
        assert contents(good) == before
        assert {path.name for path in good.iterdir()} == RESULT_NAMES

    refused(f"--frames: expected 0 to 2, the frames of {folder}, got 3", options=("--frames", "3"))
    refused("--mask: expected a picture without truth with it", options=("--mask", folder / "masks" / "0000.png"))
    refused(f"--side: expected right, that of {folder / 'truth.npz'}, got left", options=("--side", "left"))
    mask = folder / "masks" / "0000.png"
    cv2.imwrite(str(mask), np.zeros((10, 20), np.uint8))
    refused(f"{mask}: expected a mask of 128x96 px, the size of the picture, got 20x10")
    cv2.imwrite(str(mask), np.zeros((96, 128), np.uint8))
    with pytest.MonkeyPatch.context() as patch:
        Stopping(patch, 0, AssertionError)  # told before any work
        outcome = run(folder, "--out", good, *QUICK, "--overwrite")
    assert outcome.code == 2
    assert outcome.err.splitlines() == [
        "torchhand study: frame 0: its silhouette has no contour to register on",
        f"torchhand study: error: {folder}: expected a silhouette with a contour to register on, got almost empty ones",
    ]
    mask.unlink()
    refused(f"{folder / 'masks'}: expected a mask of every frame, lacks number 0")
    (folder / "cameras.json").unlink()
    refused(f"{folder / 'cameras.json'}: no such file")


def test_a_frame_without_a_pose_is_told(broken: Broken, tmp_path: Path, run: Run) -> None:
    with np.load(broken.folder / "truth.npz") as stored:
        pose = stored["pose"]
    pose[1] = np.nan
    broken.truth(pose=pose)
    outcome = run(broken.folder, "--out", tmp_path / "out", *QUICK, "--frames", "0-2")
    assert_refused(outcome, "truth.npz: frame 1: expected a pose, or keypoints to fit, got none")


def test_a_frame_without_contour_leaves_the_others(broken: Broken, tmp_path: Path, run: Run) -> None:
    cv2.imwrite(str(broken.folder / "masks" / "0001.png"), np.zeros((96, 128), np.uint8))
    outcome = run(broken.folder, "--out", tmp_path / "out", *QUICK, "--frames", "0,1")
    assert outcome.code == 0
    assert outcome.err == "torchhand study: frame 1: its silhouette has no contour to register on\n"
    table = {(row["frame"], row["size"]): row for row in rows(tmp_path / "out")}
    assert table["1", "1"]["no_data"] == "1"
    assert table["1", "1"]["angle_median_deg"] == "inf"
    assert table["0", "1"]["no_data"] == "0"
    assert float(table["all", "1"]["success_high"]) < 0.95


def test_all_hypotheses_failed(broken: Broken, good: Path, run: Run) -> None:
    """The hand of the truth is behind the camera: nothing of it is ever in sight."""
    with np.load(broken.folder / "truth.npz") as stored:
        pose = stored["pose"]
    pose[:, 2] = -0.5
    broken.truth(pose=pose)
    before = contents(good)
    outcome = run(broken.folder, "--out", good, *QUICK, "--overwrite")
    assert outcome.code == 2
    assert outcome.err.splitlines()[-1] == (
        f"torchhand study: error: {broken.folder}: all hypotheses failed (7 failed); nothing is saved"
    )
    assert contents(good) == before
    assert {path.name for path in good.iterdir()} == RESULT_NAMES


def test_frame_numbers() -> None:
    assert frames_of("7") == (7,)
    assert frames_of("10, 2-4,3") == (2, 3, 4, 10)
    assert frames_of(" ALL") is None
    for text in ("", "3-1", "-2", "1,,2", "0-999999999", "1.5"):
        with pytest.raises(InputError, match="--frames: expected numbers such as"):
            frames_of(text)


def test_help_has_an_example(run: Run) -> None:
    outcome = run("--help")
    assert outcome.code == 0
    assert "torchhand study --out out/study" in outcome.out


def test_the_header_is_json_in_the_arrays(done: Path) -> None:
    with np.load(done / "hypotheses.npz") as stored:
        header = json.loads(str(stored["header"]))
    assert header["format"] == "torchhand hypothesis study 3"
    assert header["settings"]["best_of"] == [1, 2]
    assert header["frames"] == [0, 2]
