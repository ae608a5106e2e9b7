"""`torchhand animate` and `torchhand build_signs`: files of every kind, and what users get wrong."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.cli import build_signs
from torchhand.cli.animate import main
from torchhand.cli.main import command_descriptions
from torchhand.draw.spelling import spelling_camera
from torchhand.export import clip_of_bap, clip_of_bvh, load_clip
from torchhand.files import load_hand_model, models_dir, save_hand
from torchhand.signs import load_signs

REPOSITORY = Path(__file__).resolve().parents[2]
QUICK = ("--fps", "10", "--seconds", "0.6")


def _error(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main([str(a) for a in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.splitlines()
    assert line.startswith("torchhand animate: error: ")
    return line


def test_the_commands_are_known() -> None:
    assert "manual alphabet" in command_descriptions()["animate"]
    assert "build_signs" in command_descriptions()


def test_a_video(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "hi.mp4"
    assert main(["Hi 5", "--to", str(target), "--size", "160x120", *QUICK]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    first, note = captured.out.splitlines()
    assert first.startswith("HI 5: right hand, ")
    assert "times as fast as it plays" in note
    capture = cv2.VideoCapture(str(target))
    frames = []
    while (read := capture.read())[0]:
        frames.append(read[1])
    assert len(frames) == int(first.split(" frames")[0].split()[-1])
    assert frames[0].shape == (120, 160, 3)
    middle = [frame[10:95, 30:130].astype(int) for frame in (frames[0], frames[1], frames[-1])]
    assert np.abs(middle[0] - middle[1]).mean() < 1  # held
    assert np.abs(middle[0] - middle[2]).mean() > 5  # another sign
    assert (np.ptp(middle[0], axis=-1) > 25).sum() > 400  # skin is no grey


@pytest.mark.parametrize("name", ["hi.glb", "hi.bvh", "hi.bap", "hi.thp", "hi.mano.npz", "hi.keypoints.json", "hi.x3d"])
def test_export_formats(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    assert main(["Hi", "--to", str(tmp_path / name), "--side", "left", *QUICK]) == 0
    assert capsys.readouterr().out.startswith("HI: left hand, ")
    assert (tmp_path / name).stat().st_size > 300


def test_what_was_written_is_the_signs(tmp_path: Path) -> None:
    model, signs = load_hand_model(), load_signs()
    for name in ("a.bvh", "a.bap", "a.thp"):
        assert main(["AV", "--to", str(tmp_path / name), *QUICK]) == 0
    shape = model.shape_space.default.double()
    clips = [clip_of_bvh(tmp_path / "a.bvh", model, shape)[0], clip_of_bap(tmp_path / "a.bap", model, shape)]
    clips += [load_clip(tmp_path / "a.thp")]
    kept = [i for i in range(30) if i != 4]  # BAPs have no thumb_mcp_aa
    for clip, bound in zip(clips, (1e-6, 1e-5, np.radians(2.0)), strict=True):
        for frame, sign in ((0, "A"), (-1, "V")):
            assert float((clip.poses[frame, 6:] - signs[sign])[kept].abs().max()) < bound


def test_another_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = load_hand_model()
    space = model.shape_space
    values = space.default.double().clone()
    values[space.names.index("hand_length")] = 0.2
    save_hand(tmp_path / "hand.json", space.names, values.tolist(), "left", {}, units=space.units)
    assert main(["5", "--to", str(tmp_path / "a.thp"), "--hand", str(tmp_path / "hand.json"), *QUICK]) == 0
    clip = load_clip(tmp_path / "a.thp")
    assert clip.side == "left"
    assert float(clip.shape[space.names.index("hand_length")]) == pytest.approx(0.2)
    assert main(["5", "--to", str(tmp_path / "b.thp"), "--hand", str(tmp_path / "hand.json"), "--side", "right"]) == 0
    assert load_clip(tmp_path / "b.thp").side == "right"
    capsys.readouterr()
    assert "none.json: no such file" in _error(
        capsys, "5", "--to", tmp_path / "c.thp", "--hand", tmp_path / "none.json"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("HÄ", "--to", "OUT/a.mp4"), "text: expected letters A to Z, digits 0 to 9 and spaces, got 'Ä' (character 2"),
        ((" ", "--to", "OUT/a.mp4"), "text: expected at least one letter"),
        (("A", "--to", "OUT/a.avi"), "expected a file name with a known ending (.mp4, .glb, .bvh, "),
        (("A", "--to", "OUT/a.mp4", "--format", "glb"), "--format: expected none for .mp4, got glb"),
        (("A", "--to", "OUT/a.mp4", "--size", "640"), "--size: expected WIDTHxHEIGHT, each 64 to 4096 px, got '640'"),
        (("A", "--to", "OUT/a.mp4", "--size", "10x480"), "--size: expected WIDTHxHEIGHT"),
        (("A", "--to", "OUT/a.mp4", "--fps", "0"), "--fps: expected more than 0, 1000 at most, got 0"),
        (("A", "--to", "OUT/a.mp4", "--seconds", "0.01"), "--seconds: expected 0.2 to 20, got 0.01"),
        (("A", "--to", "OUT/a.mp4", "--side", "both"), "both"),
        (("A", "--to", "OUT/none/a.mp4"), "--to: expected a file in an existing folder"),
        (("A", "--to", "OUT/taken.mp4"), "taken.mp4: exists already; give another name, or --overwrite"),
        (("A",), "--to"),
    ],
)
def test_wrong_arguments(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    (tmp_path / "taken.mp4").write_text("mine")
    assert message in _error(capsys, *(argument.replace("OUT", str(tmp_path)) for argument in arguments))
    assert [path.name for path in tmp_path.iterdir()] == ["taken.mp4"]
    assert (tmp_path / "taken.mp4").read_text() == "mine"


def test_the_camera_sees_the_hand_whatever_its_size() -> None:
    for width, height, length in ((640, 480, 0.187), (200, 300, 0.187), (320, 240, 0.21)):
        camera = spelling_camera(width, height, length)
        reach = 0.13 * length / 0.187
        corners = torch.tensor([(x, y, 0.0) for x in (-reach, reach) for y in (-reach, reach)], dtype=torch.float64)
        pixels = camera.project(corners)
        assert bool(((pixels >= 0) & (pixels <= torch.tensor((width, height)))).all())
        assert float((pixels.amax(0) - pixels.amin(0)).max()) > 0.75 * min(width, height)


def test_the_sheet_in_the_model_folder_is_that_of_the_signs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = models_dir() / "generic_hand"
    (tmp_path / "signs.json").write_bytes((folder / "signs.json").read_bytes())
    two_views = tmp_path / "two.png"
    assert build_signs.main(["--out", str(tmp_path), "--sheet-only", "--two-views", str(two_views)]) == 0
    pairs = ((tmp_path / "signs.png", folder / "signs.png"), (two_views, REPOSITORY / "docs" / "images" / "signs.png"))
    for drawn_path, known_path in pairs:
        drawn, known = (cv2.imread(str(path)) for path in (drawn_path, known_path))
        assert drawn is not None
        assert known is not None
        assert np.abs(drawn.astype(int) - known).mean() < 0.6  # letters are drawn a little otherwise by OpenCV 4
        assert known_path.stat().st_size < 300_000
    assert build_signs.main(["--out", str(tmp_path / "none")]) == 2
    assert "--out: expected an existing folder" in capsys.readouterr().err


def test_the_script_runs(tmp_path: Path) -> None:
    script = REPOSITORY / "scripts" / "animate.py"
    arguments = [sys.executable, str(script), "A", "--to", str(tmp_path / "a.bap")]
    run = subprocess.run(arguments, capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stderr) == (0, "")
    assert "saved" in run.stdout
