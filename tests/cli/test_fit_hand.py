"""The command from picture to hand.json, its options, and one clear line for every picture that will not do."""

import json
import math
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.cli.fit_hand import main
from torchhand.files import load_hand, load_hand_model, read_picture, save_cameras
from torchhand.fit.detect import facing_rotation
from torchhand.geometry import assumed_camera
from torchhand.hand import posture
from torchhand.simulate import Motion, SceneSettings, render_sequence

CAMERA = assumed_camera(320, 260)
DISTANCE = 0.45


def scene(posed: str = "open", shift: tuple[float, float] = (0.0, 0.09)) -> tuple[np.ndarray, np.ndarray]:
    """Picture (BGR) and mask of a right hand's back."""
    kinematics = load_hand_model().kinematics("right", dtype=torch.float64)
    pose = posture(posed, dtype=torch.float64)
    pose[:3] = torch.tensor((shift[0], shift[1], DISTANCE))
    motion = Motion(name="still", poses=pose[None], root_reference=facing_rotation("back"), fps=30.0)
    scene = SceneSettings(background="plain", supersampling=2)
    frame = next(iter(render_sequence(kinematics, motion, CAMERA, scene, torch.Generator().manual_seed(0))))
    return frame.image.numpy()[..., ::-1].copy(), frame.mask.numpy().astype(np.uint8) * 255


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of an open hand and of what is none."""
    place = tmp_path_factory.mktemp("hands")
    image, mask = scene()
    cv2.imwrite(str(place / "open.png"), image)
    cv2.imwrite(str(place / "open_mask.png"), mask)
    cv2.imwrite(str(place / "two.png"), np.concatenate((mask, mask[:, ::-1]), 1))
    cv2.imwrite(str(place / "two_picture.png"), np.concatenate((image, image[:, ::-1]), 1))
    cv2.imwrite(str(place / "wall.png"), np.full((200, 300, 3), 140, np.uint8))
    cv2.imwrite(str(place / "empty.png"), np.zeros_like(mask))
    image, mask = scene("victory")
    cv2.imwrite(str(place / "victory.png"), image)
    cv2.imwrite(str(place / "victory_mask.png"), mask)
    image, mask = scene(shift=(0.0, -0.03))
    cv2.imwrite(str(place / "cut.png"), image)
    cv2.imwrite(str(place / "cut_mask.png"), mask)
    save_cameras([CAMERA], place / "cameras.json")
    return place


def run(folder: Path, out: Path, picture: str, *more: str, mask: str | None = None) -> int:
    given = [] if mask is None else ["--mask", str(folder / mask)]
    return main([str(folder / picture), "--out", str(out / "hand.json"), *given, *more])


@pytest.mark.parametrize("mask", [None, "open_mask.png"])
def test_writes_a_hand_that_loads(folder: Path, tmp_path: Path, mask: str | None) -> None:
    overlay = tmp_path / "overlay.png"
    assert run(folder, tmp_path, "open.png", "--side", "right", "--overlay", str(overlay), mask=mask) == 0
    names = load_hand_model().shape_space.names
    hand = load_hand(tmp_path / "hand.json", names)
    facts = hand.provenance
    assert hand.side == "right"
    assert facts["facing"] == "back"
    assert facts["metric_source"] == "population"
    assert facts["quality"] == "good"
    assert tuple(facts["std"]) == names
    assert all(math.isfinite(value) and value > 0 for value in facts["std"].values())
    assert facts["overlap"] > 0.9
    drawn, plain = (read_picture(path).numpy() for path in (overlay, folder / "open.png"))
    assert drawn.shape[1] > plain.shape[1]
    assert int((drawn[:260, :320] != plain).any(-1).sum()) > 300


def test_size_from_a_ruler_and_from_a_distance(folder: Path, tmp_path: Path) -> None:
    ruler = ("--side", "right", "--hand-length", "0.2")
    assert run(folder, tmp_path, "open.png", *ruler, mask="open_mask.png") == 0
    first = json.loads((tmp_path / "hand.json").read_text())
    assert first["shape"]["hand_length"] == pytest.approx(0.2)
    assert first["provenance"]["metric_source"] == "hand length"
    assert first["provenance"]["std"]["hand_length"] == pytest.approx(0.001)
    camera = ("--camera", str(folder / "cameras.json"), "--distance", str(DISTANCE), "--overwrite", "--side", "right")
    assert run(folder, tmp_path, "open.png", *camera, mask="open_mask.png") == 0
    second = json.loads((tmp_path / "hand.json").read_text())
    assert second["provenance"]["metric_source"] == "camera and distance"
    assert second["shape"]["hand_length"] == pytest.approx(0.187, rel=0.04)
    ratio = second["shape"]["middle_proximal"] / first["shape"]["middle_proximal"]
    assert ratio == pytest.approx(1.0, abs=1e-9)


def test_side_follows_from_facing_and_is_named_ambiguous(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(folder, tmp_path, "open.png", mask="open_mask.png") == 0
    assert "a right hand's back or a left hand's palm; taken for right" in capsys.readouterr().out
    assert run(folder, tmp_path, "open.png", "--facing", "palm", "--overwrite", mask="open_mask.png") == 0
    assert load_hand(tmp_path / "hand.json").side == "left"
    assert "taken for right" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("picture", "mask", "more", "words"),
    [
        ("wall.png", None, (), "no hand"),
        ("open.png", "empty.png", (), "almost empty (0 px"),
        ("two_picture.png", "two.png", (), "two hands"),
        ("victory.png", "victory_mask.png", (), "only"),
        ("cut.png", "cut_mask.png", (), "picture's edge cuts"),
        ("two_picture.png", "open_mask.png", (), "expected a mask of 640x260 px, the size of the picture, got 320x260"),
        (
            "open.png",
            "open_mask.png",
            ("--side", "right", "--facing", "palm"),
            "the thumb lies where a right hand's back",
        ),
        ("open.png", "open_mask.png", ("--distance", "0.4"), "--distance: expected --camera"),
        ("open.png", "open_mask.png", ("--hand-length", "187"), "--hand-length: expected 0.14 to 0.24 metres"),
        ("missing.png", None, (), "missing.png"),
        (
            "open.png",
            "open_mask.png",
            ("--overlay", "/nowhere/x.png"),
            "--overlay: expected a file in an existing folder",
        ),
    ],
)
def test_refusals_are_one_line_and_nothing_is_overwritten(
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    picture: str,
    mask: str | None,
    more: tuple[str, ...],
    words: str,
) -> None:
    out = tmp_path / "hand.json"
    out.write_text("kept")
    assert run(folder, tmp_path, picture, "--overwrite", *more, mask=mask) == 2
    message = capsys.readouterr().err
    assert words in message
    assert message.count("\n") == 1
    assert out.read_text() == "kept"
    assert [path.name for path in tmp_path.iterdir()] == ["hand.json"]


def test_victory_names_the_fingers_found(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(folder, tmp_path, "victory.png", mask="victory_mask.png") == 2
    assert "stand out, not" in capsys.readouterr().err


def test_older_results_are_kept_unless_told(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "hand.json").write_text("kept")
    assert run(folder, tmp_path, "open.png", mask="open_mask.png") == 2
    assert "exists already" in capsys.readouterr().err
    assert (tmp_path / "hand.json").read_text() == "kept"


def test_distance_that_makes_a_giant_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = ("--camera", str(folder / "cameras.json"), "--distance", "2")
    assert run(folder, tmp_path, "open.png", *camera, mask="open_mask.png") == 2
    assert "m long, expected 0.14 to 0.24" in capsys.readouterr().err


def test_inputs_are_never_written_over(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = folder / "open.png"
    before = picture.read_bytes()
    assert main([str(picture), "--out", str(picture), "--overwrite"]) == 2
    assert "other than that of an input" in capsys.readouterr().err
    assert picture.read_bytes() == before


@pytest.mark.slow
def test_a_photograph_of_50_megapixels_takes_less_than_a_gigabyte(data_dir: Path, tmp_path: Path) -> None:
    small = cv2.imread(str(data_dir / "real" / "open_hand_black" / "IMG-1843.jpg"))
    assert small is not None
    photograph = cv2.resize(small, (6120, 8160), interpolation=cv2.INTER_CUBIC)
    assert cv2.imwrite(str(tmp_path / "photograph.jpg"), photograph)
    program = (
        "import resource, sys; from torchhand.cli.fit_hand import main; code = main(sys.argv[1:]);"
        " print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10); sys.exit(code)"
    )
    arguments = [str(tmp_path / "photograph.jpg"), "--out", str(tmp_path / "hand.json")]
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=True)
    assert int(done.stdout.splitlines()[-1]) < 1000
