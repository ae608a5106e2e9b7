"""`torchhand evaluate` on result folders made from a truth, and on folders that are wrong."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from tests.report.made_result import FRAMES as FRAMES_OF_A_RESULT
from tests.report.made_result import write_result
from torchhand.cli.evaluate import main
from torchhand.cli.simulate import main as simulate
from torchhand.evaluate import flexion_deg
from torchhand.files import Track, load_hand_model, save_cameras, save_hand
from torchhand.geometry import assumed_camera, rotation_from_vector, vector_from_rotation
from torchhand.hand import DOFS

FRAMES = 5


@pytest.fixture
def truth_dir(tmp_path: Path) -> Path:
    folder = tmp_path / "truth"
    folder.mkdir()
    points = np.random.default_rng(0).normal(scale=0.05, size=(21, 3)) + [0.0, 0.0, 0.5]
    sequence = points + 0.01 * np.arange(FRAMES)[:, None, None] * np.array([1.0, 0.5, 0.0])
    np.savez(
        folder / "truth.npz",
        keypoints3d=sequence,
        keypoints2d=400.0 * sequence[..., :2] / 0.5,
        flexion_deg=flexion_deg(sequence),
    )
    return folder


@pytest.fixture
def result_dir(tmp_path: Path, truth_dir: Path) -> Path:
    """A result 6 mm and (3, 4) px off in every frame but 0, with frame 3 lost."""
    folder = tmp_path / "result"
    folder.mkdir()
    with np.load(truth_dir / "truth.npz") as truth:
        points, points_px = truth["keypoints3d"], truth["keypoints2d"]
    points[1:] += [0.0, 0.006, 0.0]
    points_px[1:] += [3.0, 4.0]
    points[3], points_px[3] = np.nan, np.nan
    track = Track(
        frame=np.arange(FRAMES),
        status=np.array(["tracked", "tracked", "tracked", "lost", "recovered"], dtype="<U16"),
        pose=np.where(np.arange(FRAMES)[:, None] == 3, np.nan, np.zeros((FRAMES, 36))),
        pose_std=np.where(np.arange(FRAMES)[:, None] == 3, np.nan, np.ones((FRAMES, 36))),
        keypoints3d=points,
        keypoints2d=points_px,
        keypoints3d_cov=np.where(np.isnan(points)[..., None], np.nan, 36e-6 * np.eye(3)),
        seconds=np.full(FRAMES, 0.012),
        dof_names=tuple(f"dof{number}" for number in range(36)),
        units="metres",
        convention="OpenCV",
        header={},
    )
    np.savez(folder / "track.npz", **track.arrays())  # type: ignore[arg-type]
    return folder


def test_the_errors_are_printed_and_saved(
    result_dir: Path, truth_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(result_dir), str(truth_dir)]) == 0
    text, errors = capsys.readouterr()
    assert errors == ""
    figures = json.loads((result_dir / "evaluation.json").read_text())
    assert figures["tracking"]["followed"] == 4
    assert figures["tracking"]["frames_until_first_loss"] == 3
    assert figures["tracking"]["frames_to_recover"] == [1]
    assert figures["position_mm"]["frame"]["mean"] == pytest.approx(6.0 * 3 / 4, rel=1e-9)
    assert figures["position_mm"]["aligned"]["largest"] == pytest.approx(0.0, abs=1e-9)
    assert figures["planar_motion"]["displacement_rms_px"] == pytest.approx(5.0, rel=1e-9)
    assert figures["planar_motion"]["rotation_rms_deg"] == pytest.approx(0.0, abs=1e-9)
    assert figures["flexion_deg"]["raw_mean"] == pytest.approx(0.0, abs=1e-9)
    # 6 mm at a standard deviation of 6 mm: NEES 1 in three frames of four, 0 in the other, 3 degrees of freedom each.
    assert figures["uncertainty"]["mean_per_dof"] == pytest.approx(0.25, rel=1e-9)
    assert figures["uncertainty"]["fraction_inside"] == pytest.approx(0.75)
    assert figures["speed"]["median_ms_per_frame"] == pytest.approx(12.0)
    for pattern in (
        r"frames followed +4 of 5 \(the truth has 5\)",
        r"frames until first loss +3\n",
        r"losses, frames to recover +1: 1\n",
        r"joint position \(camera or world frame\) +mean 4\.50, median 6\.00, largest 6\.00 mm",
        r"planar displacement since frame 0 +RMS 5\.000 px, largest 5\.000 px",
        r"squared errors, as a share of what was expected +0\.25 \(1: honest, less: cautious, more: too sure\)",
        r"joints inside their 95 % region +100\.0% \(95 % or more: not too sure\)",
        r"compute time per frame +median 12\.00 ms",
    ):
        assert re.search(pattern, text), pattern


def test_another_result_in_place_of_a_truth_is_compared_joint_by_joint(
    result_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with np.load(result_dir / "track.npz") as stored:
        arrays = dict(stored)
    arrays["dof_names"] = np.array(DOFS)
    np.savez(result_dir / "track.npz", **arrays)  # type: ignore[arg-type]
    other = tmp_path / "other"
    other.mkdir()
    arrays["pose"] = arrays["pose"].copy()
    arrays["pose"][:2, DOFS.index("middle_pip_fe")] += 5.0  # radians; √2 of them is the combined deviation
    np.savez(other / "track.npz", **arrays)  # type: ignore[arg-type]
    assert main([str(result_dir), str(other)]) == 0
    lines = capsys.readouterr().out.splitlines()
    [middle] = [line.split() for line in lines if line.startswith("middle_pip_fe")]
    assert middle[:6] == ["middle_pip_fe", "50.0%", "50.0%", "202.6", "143.2", "286.5"]
    assert "4 frames with a hand in both results, 0 in one alone" in lines
    figures = json.loads((result_dir / "stability.json").read_text())["stability"]
    assert figures["joints"]["middle_pip_fe"]["fraction_apart"] == 0.5
    assert figures["whole"]["fraction_apart"] == pytest.approx(2 / (4 * 30))


def test_what_is_of_another_hand_or_recording_is_noted(
    tmp_path: Path, truth_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right, left = write_result(tmp_path / "right"), write_result(tmp_path / "left", side="left")
    assert main([str(right), str(left)]) == 0
    assert f"note: {right} and {left} differ: a right hand against a left one\n" in capsys.readouterr().out
    with np.load(truth_dir / "truth.npz") as stored:
        arrays = {key: np.repeat(array, FRAMES_OF_A_RESULT, axis=0) for key, array in stored.items()}
    np.savez(truth_dir / "truth.npz", **arrays, side=np.array("left"))  # type: ignore[arg-type]
    save_cameras([assumed_camera(720, 480)], truth_dir / "cameras.json")
    assert main([str(right), str(truth_dir)]) == 0
    told = "differ: a right hand against a left one; pictures of 640x480 px against 720x480 px\n"
    assert f"note: {right} and {truth_dir} {told}" in capsys.readouterr().out
    assert main([str(left), str(left)]) == 0
    assert "note" not in capsys.readouterr().out


def test_without_a_truth_the_range_of_motion_is_told(
    simulated: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    result_dir, _ = simulated
    capsys.readouterr()
    assert main([str(result_dir)]) == 0
    text, _ = capsys.readouterr()
    figures = json.loads((result_dir / "range_of_motion.json").read_text())["range_of_motion_deg"]
    with np.load(result_dir / "track.npz") as track:
        bent = np.rad2deg(track["pose"][:, DOFS.index("index_pip_fe")])
    assert figures["index_pip_fe"]["largest_deg"] == pytest.approx(np.nanmax(bent))
    assert figures["index_pip_fe"]["smallest_deg"] == pytest.approx(np.nanmin(bent))
    assert re.search(r"index_pip_fe +-?\d+\.\d ± \d+\.\d +\d +-?\d+\.\d ± \d+\.\d +\d +\d+\.\d\n", text)
    assert not (result_dir / "evaluation.json").exists()


def test_the_file_may_go_elsewhere(result_dir: Path, truth_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "figures.json"
    assert main([str(result_dir), str(truth_dir / "truth.npz"), "--out", str(out)]) == 0
    assert json.loads(out.read_text())["tracking"]["frames"] == FRAMES
    assert not (result_dir / "evaluation.json").exists()


def test_silhouettes_are_evaluated_where_both_have_masks(result_dir: Path, truth_dir: Path) -> None:
    square = np.zeros((40, 40), dtype=np.uint8)
    square[10:30, 10:30] = 255
    with np.load(truth_dir / "truth.npz") as truth:
        arrays = dict(truth)
    arrays["keypoints2d"][:, 0], arrays["keypoints2d"][:, 9] = [20.0, 35.0], [20.0, 20.0]
    np.savez(truth_dir / "truth.npz", **arrays)
    for folder, mask in ((truth_dir, square), (result_dir, square[:, ::-1] * (np.arange(40) < 20).astype(np.uint8))):
        (folder / "masks").mkdir()
        cv2.imwrite(str(folder / "masks" / "0002.png"), mask)
    assert main([str(result_dir), str(truth_dir)]) == 0
    figures = json.loads((result_dir / "evaluation.json").read_text())
    assert figures["silhouette"]["frames"] == 1
    assert figures["silhouette"]["median_iou"] == pytest.approx(0.5)


@pytest.fixture
def simulated(tmp_path: Path) -> tuple[Path, Path]:
    """A result folder without masks/ that holds the truth itself but for one lost frame, and the truth."""
    truth_dir, result_dir = tmp_path / "simulated", tmp_path / "drawn"
    order = ["--motion", "wave", "--size", "120x96", "--frames", str(FRAMES), "--side", "left", "--random-hand"]
    assert simulate(["--out", str(truth_dir), *order]) == 0
    with np.load(truth_dir / "truth.npz") as stored:
        truth = dict(stored)
    turn = rotation_from_vector(torch.from_numpy(truth["pose"][:, 3:6])) @ torch.from_numpy(truth["root_reference"])
    truth["pose"][:, 3:6] = vector_from_rotation(turn).numpy()  # a track's rotation vector is the whole rotation
    is_lost = np.arange(FRAMES) == 3
    for name in ("pose", "keypoints3d", "keypoints2d"):
        truth[name][is_lost] = np.nan
    track = Track(
        frame=np.arange(FRAMES),
        status=np.array(["tracked", "tracked", "tracked", "lost", "recovered"], dtype="<U16"),
        pose=truth["pose"],
        pose_std=np.where(is_lost[:, None], np.nan, np.ones((FRAMES, 36))),
        keypoints3d=truth["keypoints3d"],
        keypoints2d=truth["keypoints2d"],
        keypoints3d_cov=np.where(is_lost[:, None, None, None], np.nan, np.tile(1e-6 * np.eye(3), (FRAMES, 21, 1, 1))),
        seconds=np.full(FRAMES, 0.012),
        dof_names=DOFS,
        units="metres",
        convention="OpenCV",
        header={"side": "left", "camera": json.loads((truth_dir / "cameras.json").read_text())["cameras"][0]},
        measures={"overlap": np.array([0.9, 0.8, 0.7, np.nan, 0.75])},
    )
    result_dir.mkdir()
    np.savez(result_dir / "track.npz", **track.arrays())  # type: ignore[arg-type]
    space = load_hand_model().shape_space
    save_hand(result_dir / "hand.json", space.names, truth["shape"].tolist(), "left", {}, units=space.units)
    return result_dir, truth_dir


def test_silhouettes_are_drawn_from_the_saved_hand(
    simulated: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    result_dir, truth_dir = simulated
    capsys.readouterr()
    assert main([str(result_dir), str(truth_dir)]) == 0
    text, errors = capsys.readouterr()
    assert errors == ""
    figures = json.loads((result_dir / "evaluation.json").read_text())
    assert figures["silhouette"]["frames"] == 4  # the lost one has none
    assert figures["silhouette"]["smallest_iou"] > 0.95
    assert figures["overlap_with_own_segmentation"]["median"] == pytest.approx(0.775)
    assert re.search(r"silhouette IoU in 4 frames +median 0\.9[5-9]", text)
    assert re.search(r"overlap with the tracker's own segmentation +median 0\.775", text)


def test_another_hand_has_another_silhouette(simulated: tuple[Path, Path]) -> None:
    result_dir, truth_dir = simulated
    space = load_hand_model().shape_space
    save_hand(result_dir / "hand.json", space.names, space.lower.tolist(), "left", {}, units=space.units)
    assert main([str(result_dir), str(truth_dir)]) == 0
    assert json.loads((result_dir / "evaluation.json").read_text())["silhouette"]["median_iou"] < 0.8


def test_no_silhouettes_without_a_hand_or_true_masks(simulated: tuple[Path, Path]) -> None:
    result_dir, truth_dir = simulated
    (result_dir / "hand.json").rename(result_dir / "away.json")
    assert main([str(result_dir), str(truth_dir)]) == 0
    assert "silhouette" not in json.loads((result_dir / "evaluation.json").read_text())
    (result_dir / "hand.json").write_text("{}")  # not needed where nothing is to be compared with
    (truth_dir / "masks").rename(truth_dir / "away")
    assert main([str(result_dir), str(truth_dir)]) == 0
    assert "silhouette" not in json.loads((result_dir / "evaluation.json").read_text())


def test_a_hand_of_other_parameters_is_refused(
    simulated: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    result_dir, truth_dir = simulated
    save_hand(result_dir / "hand.json", ["hand_length"], [0.19], "left", {})
    capsys.readouterr()
    assert main([str(result_dir), str(truth_dir)]) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert "hand.json: shape: lacks " in errors
    assert errors.count("\n") == 1


def test_what_is_unknown_is_null_in_the_file(result_dir: Path, truth_dir: Path) -> None:
    with np.load(truth_dir / "truth.npz") as truth:
        points = truth["keypoints3d"]
    points[np.arange(FRAMES) != 3] = np.nan  # but for the frame that the result has lost
    np.savez(truth_dir / "truth.npz", keypoints3d=points)
    assert main([str(result_dir), str(truth_dir)]) == 0
    assert json.loads((result_dir / "evaluation.json").read_text())["position_mm"]["frame"]["mean"] is None


def test_a_shorter_truth_is_another_sequences(
    result_dir: Path, truth_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with np.load(truth_dir / "truth.npz") as truth:
        np.savez(truth_dir / "truth.npz", keypoints3d=truth["keypoints3d"][:3])
    assert main([str(result_dir), str(truth_dir)]) == 2
    assert "holds frames 0 to 2 and the result has frame 4" in capsys.readouterr().err
    assert not (result_dir / "evaluation.json").exists()


@pytest.mark.parametrize("broken", ["no_result", "no_track", "no_truth", "no_key", "bad_track"])
def test_wrong_input_is_one_line_and_two(
    broken: str, result_dir: Path, truth_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if broken == "no_result":
        result_dir, culprit = tmp_path / "gone", "gone"
    elif broken == "no_track":
        (result_dir / "track.npz").unlink()
        culprit = "result"
    elif broken == "no_truth":
        (truth_dir / "truth.npz").unlink()
        culprit = "truth"
    elif broken == "no_key":
        np.savez(truth_dir / "truth.npz", pose=np.zeros(3))
        culprit = "truth.npz"
    else:
        (result_dir / "track.npz").write_bytes(b"PK\x03\x04 cut off")
        culprit = "track.npz"
    assert main([str(result_dir), str(truth_dir)]) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors.startswith("torchhand evaluate: error: ")
    assert culprit in errors
    assert errors.count("\n") == 1


def test_the_truth_as_its_own_result_has_no_error(data_dir: Path, result_dir: Path) -> None:
    """A real truth file: read as a result it must come out perfect."""
    folder = data_dir / "synthetic" / "free"
    with np.load(folder / "truth.npz") as truth:
        frames = len(truth["keypoints3d"])
        track = Track(
            frame=np.arange(frames),
            status=np.full(frames, "tracked", dtype="<U16"),
            pose=np.zeros((frames, 36)),
            pose_std=np.ones((frames, 36)),
            keypoints3d=truth["keypoints3d"],
            keypoints2d=truth["keypoints2d"],
            keypoints3d_cov=np.tile(1e-6 * np.eye(3), (frames, 21, 1, 1)),
            seconds=np.full(frames, 0.012),
            dof_names=tuple(f"dof{number}" for number in range(36)),
            units="",
            convention="",
            header={},
        )
    np.savez(result_dir / "track.npz", **track.arrays())  # type: ignore[arg-type]
    assert main([str(result_dir), str(folder)]) == 0
    figures = json.loads((result_dir / "evaluation.json").read_text())
    for kind in ("frame", "root_relative", "aligned"):
        assert figures["position_mm"][kind]["largest"] == pytest.approx(0.0, abs=1e-9)
    assert figures["planar_motion"]["displacement_largest_px"] == pytest.approx(0.0, abs=1e-9)
    assert figures["flexion_deg"]["raw_mean"] == pytest.approx(0.0, abs=1e-9)
    assert figures["tracking"]["share_largest_error_below_20mm"] == 1.0


def _detections(path: Path, points: np.ndarray) -> str:
    np.savez(path, keypoints=points, units="metres")
    return str(path)


def test_a_detector_is_judged_beside_the_result(
    result_dir: Path, truth_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Points of another origin, size and direction are as right as the truth; one frame has none."""
    with np.load(truth_dir / "truth.npz") as truth:
        points = truth["keypoints3d"]
    turn = rotation_from_vector(torch.tensor([0.3, -0.2, 0.9], dtype=torch.float64)).numpy()
    exact = 1.2 * (points - points[:, :1]) @ turn.T
    exact[2] = np.nan
    assert main([str(result_dir), str(truth_dir), "--keypoints", _detections(tmp_path / "exact.npz", exact)]) == 0
    assert "the detector alone, in 4 frames" in capsys.readouterr().out
    figures = json.loads((result_dir / "evaluation.json").read_text())["detector"]
    assert figures["aligned_mm"]["mean"] == pytest.approx(0, abs=1e-6)
    assert figures["flexion_deg"]["raw_mean"] == pytest.approx(0, abs=1e-6)
    wrong = exact.copy()
    wrong[1:, 8] += [0.02, 0.0, 0.0]
    assert main([str(result_dir), str(truth_dir), "--keypoints", _detections(tmp_path / "wrong.npz", wrong)]) == 0
    assert json.loads((result_dir / "evaluation.json").read_text())["detector"]["aligned_mm"]["mean"] > 0.3


def test_points_of_pictures_alone_are_refused_beside_a_result(
    result_dir: Path, truth_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "picture.npz"
    np.savez(file, keypoints=np.full((FRAMES, 21, 2), 5.0), units="px")
    assert main([str(result_dir), str(truth_dir), "--keypoints", str(file)]) == 2
    assert "--keypoints: expected points in space" in capsys.readouterr().err
