"""`torchhand export` on results of tracking, and on what users get wrong."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from torchhand.cli.export import main
from torchhand.cli.main import command_descriptions
from torchhand.cli.simulate import main as simulate
from torchhand.cli.track import main as track
from torchhand.export import clip_of_bap, clip_of_bvh, clip_of_mano, clip_of_openxr
from torchhand.files import Track, load_hand_model, load_track, save_hand
from torchhand.files.results import CONVENTION, UNITS, write_npz
from torchhand.hand import DOFS

FRAMES = 5
REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def result(tmp_path: Path) -> Path:
    """A result folder of five frames, the second lost."""
    folder = tmp_path / "result"
    folder.mkdir()
    model = load_hand_model()
    space = model.shape_space
    save_hand(folder / "hand.json", space.names, space.default.tolist(), "right", {}, units=space.units)
    poses, _ = model.prior(dtype=torch.float64).sample(FRAMES, torch.Generator().manual_seed(5))
    pose = poses.double().numpy()
    pose[:, 2] = 0.5
    pose[1] = np.nan
    status = np.array(["tracked", "lost", "recovered", "tracked", "tracked"], dtype="<U16")
    content = Track(
        frame=np.arange(FRAMES),
        status=status,
        pose=pose,
        pose_std=np.full_like(pose, np.nan),
        keypoints3d=np.full((FRAMES, 21, 3), np.nan),
        keypoints2d=None,
        keypoints3d_cov=np.full((FRAMES, 21, 3, 3), np.nan),
        seconds=np.zeros(FRAMES),
        dof_names=DOFS,
        units=UNITS,
        convention=CONVENTION,
        header={"side": "right", "source": "nowhere.mp4"},
    )
    write_npz(content, folder / "track.npz")
    return folder


def _error(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main([str(a) for a in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.splitlines()
    assert line.startswith("torchhand export: error: ")
    return line


def test_the_command_is_known() -> None:
    assert "GLB" in command_descriptions()["export"]


@pytest.mark.parametrize(
    "name",
    [
        *("hand.glb", "hand.bvh", "hand.urdf", "hand.xml", "hand.ply", "hand.mano.npz", "hand.openxr.json"),
        *("hand.keypoints.json", "hand.bap", "hand.x3d"),
    ],
)
def test_every_format(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    (tmp_path / "out").mkdir()
    assert main([str(result), "--to", str(tmp_path / "out" / name)]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    first, *notes = captured.out.splitlines()
    assert first.startswith("right hand, 5 frames at 30 per second, 1 of them lost and held; saved ")
    assert all(note.startswith("note: ") for note in notes)
    assert any((tmp_path / "out").iterdir())


def test_readers_find_the_poses_again(result: Path, tmp_path: Path) -> None:
    model, known = load_hand_model(), load_track(result).pose[[0, 0, 2, 3, 4], 6:]
    shape = model.shape_space.default
    for name in ("hand.bvh", "hand.openxr.json", "hand.bap"):
        assert main([str(result), "--to", str(tmp_path / name)]) == 0
    angles = clip_of_bvh(tmp_path / "hand.bvh", model, shape)[0].poses[:, 6:].numpy()
    assert np.abs(angles - known).max() < 1e-6
    angles = clip_of_openxr(tmp_path / "hand.openxr.json", model, shape)[0].poses[:, 6:].numpy()
    assert np.abs(angles - known).max() < 1e-7
    angles = clip_of_bap(tmp_path / "hand.bap", model, shape).poses[:, 6:].numpy()
    assert np.abs(np.delete(angles - known, DOFS.index("thumb_mcp_aa") - 6, axis=1)).max() < 0.51e-5


def test_gaps_are_cut_when_asked(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(result), "--to", str(tmp_path / "hand.mano.npz"), "--gaps", "cut", "--fps", "12"]) == 0
    assert capsys.readouterr().out.startswith("right hand, 4 frames at 12 per second; saved mano: ")
    clip, _ = clip_of_mano(tmp_path / "hand.mano.npz", load_hand_model())
    assert (len(clip), clip.fps) == (4, 12.0)
    with np.load(tmp_path / "hand.mano.npz") as stored:
        assert stored["frame"].tolist() == [0, 2, 3, 4]


def test_one_frame_or_one_file_per_frame(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(result), "--to", str(tmp_path / "one.obj"), "--frame", "3"]) == 0
    assert main([str(result), "--to", str(tmp_path / "all.obj"), "--gaps", "cut"]) == 0
    capsys.readouterr()
    assert sorted(path.name for path in tmp_path.glob("*.obj")) == [
        *("all_000000.obj", "all_000002.obj", "all_000003.obj", "all_000004.obj", "one.obj")
    ]
    one, same = (trimesh.load_mesh(tmp_path / name, process=False) for name in ("one.obj", "all_000003.obj"))
    assert np.array_equal(one.vertices, same.vertices)
    assert "expected the number of a frame in the clip, 0 to 4, got 9" in _error(
        capsys, result, "--to", tmp_path / "x.obj", "--frame", 9
    )
    assert "got 1 (lost frames are cut)" in _error(
        capsys, result, "--to", tmp_path / "x.obj", "--frame", 1, "--gaps", "cut"
    )


def test_a_hand_file_alone(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(result / "hand.json"), "--to", str(tmp_path / "rest.glb")]) == 0
    assert capsys.readouterr().out.startswith("right hand, one frame; saved glb: ")
    other = tmp_path / "larger.json"
    other.write_text((result / "hand.json").read_text().replace('"hand_length": 0.187', '"hand_length": 0.2'))
    assert main([str(result), "--to", str(tmp_path / "larger.keypoints.npz"), "--hand", str(other)]) == 0
    assert main([str(result), "--to", str(tmp_path / "same.keypoints.npz")]) == 0
    with np.load(tmp_path / "larger.keypoints.npz") as larger, np.load(tmp_path / "same.keypoints.npz") as same:
        size = [np.linalg.norm(f["keypoints3d"][0, 9] - f["keypoints3d"][0, 0]) for f in (larger, same)]
    assert size[0] / size[1] == pytest.approx(0.2 / 0.187, rel=0.02)


def test_existing_files_and_inputs_are_kept(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "hand.bap"
    target.write_text("mine")
    assert "exists already; give another name, or --overwrite" in _error(capsys, result, "--to", target)
    assert target.read_text() == "mine"
    assert main([str(result), "--to", str(target), "--overwrite"]) == 0
    assert target.read_text().startswith("# numbering final")
    capsys.readouterr()
    before = (result / "track.npz").read_bytes()
    arguments = (result, "--to", result / "track.npz", "--format", "mano", "--overwrite")
    assert "expected a name other than those of the result" in _error(capsys, *arguments)
    assert (result / "track.npz").read_bytes() == before
    (tmp_path / "hand_urdf_meshes").mkdir()
    assert "hand_urdf_meshes: exists already" in _error(capsys, result, "--to", tmp_path / "hand.urdf")
    assert main([str(result), "--to", str(result / "hand.glb")]) == 0  # beside the result is fine


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--to", "OUT/hand.foo"),
            "hand.foo: expected a file name with a known ending (.glb, .bvh, .urdf, .xml, ",
        ),
        (("--to", "OUT/hand.foo"), ".keypoints.json, .keypoints.npz, .csv, .npy, .joints.csv, "),
        (("--to", "OUT/hand.json"), ".json may be openxr (.openxr.json) or keypoints (.keypoints.json)"),
        (("--to", "OUT/hand.bvh", "--format", "glb"), "expected an ending .glb for glb, got '.bvh'"),
        (("--to", "OUT/hand.bvh", "--format", "fbx"), "fbx"),
        (("--to", "OUT/none/hand.bvh"), "--to: expected a file in an existing folder, got "),
        (("--to", "OUT/hand.bvh", "--fps", "0"), "--fps: expected more than 0, 1e6 at most, got 0"),
        (
            ("--to", "OUT/hand.bvh", "--max-gap-s", "0"),
            "--max-gap-s: expected more than 0, 86400 (a day) at most, got 0",
        ),
        (("--to", "OUT/hand.bvh", "--gaps", "fill"), "fill"),
        (("--to", "OUT/hand.bvh", "--hand", "OUT/none.json"), "none.json: no such file"),
        ((), "--to"),
    ],
)
def test_wrong_arguments(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    line = _error(capsys, result, *(argument.replace("OUT", str(out)) for argument in arguments))
    assert message in line
    assert list(out.iterdir()) == []


def test_wrong_results(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "hand.glb"
    assert "nothing: no such file or folder" in _error(capsys, tmp_path / "nothing", "--to", out)
    content = load_track(result)
    write_npz(replace(content, pose=np.full_like(content.pose, np.nan)), result / "track.npz")
    assert "expected at least one tracked frame, got none in 5 frames: all are lost" in _error(
        capsys, result, "--to", out
    )
    write_npz(content, result / "track.npz")
    (result / "track.npz").write_bytes((result / "track.npz").read_bytes()[:900])
    assert re.search(r"track\.npz: is no track that can be read", _error(capsys, result, "--to", out))
    (result / "hand.json").write_text('{"format": "torchhand hand 1"')
    assert "hand.json, line 1: is no valid JSON" in _error(capsys, result / "hand.json", "--to", out)
    assert not out.exists()


def test_what_was_tracked_in_a_video(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sequence, folder = tmp_path / "sequence", tmp_path / "tracked"
    scene = ["--motion", "planar", "--frames", "4", "--background", "dark", "--seed", "1", "--size", "320x240"]
    assert simulate(["--out", str(sequence), *scene]) == 0
    assert track([str(sequence / "frames"), "--out", str(folder), "--camera", str(sequence / "cameras.json")]) == 0
    assert main([str(folder), "--to", str(tmp_path / "hand.keypoints.npz")]) == 0
    capsys.readouterr()
    with np.load(tmp_path / "hand.keypoints.npz") as stored:
        assert np.abs(stored["keypoints3d"] - load_track(folder).keypoints3d).max() < 1e-6


def test_the_script_runs(result: Path, tmp_path: Path) -> None:
    script = REPOSITORY / "scripts" / "export.py"
    arguments = [sys.executable, str(script), str(result), "--to", str(tmp_path / "hand.bap")]
    run = subprocess.run(arguments, capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stderr) == (0, "")
    assert "saved bap" in run.stdout
