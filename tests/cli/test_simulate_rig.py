"""`torchhand simulate --rig`: recordings of several cameras with exact truth, and one line where there can be none."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.cli.simulate import main
from torchhand.evaluate import flexion_deg, load_truth
from torchhand.files import load_hand_model, load_rig, open_rig, save_cameras
from torchhand.simulate import named_rig, noisy_mask
from torchhand.volume import CarvingSettings, RootCube, carve, hull_field

SMALL = ("--size", "96x72", "--noise", "0")


def truth_of(folder: Path) -> dict[str, np.ndarray]:
    with np.load(folder / "truth.npz") as stored:
        return dict(stored)


def mask_of(folder: Path, view: int, frame: int) -> np.ndarray:
    return np.asarray(cv2.imread(str(folder / f"masks_{view}" / f"{frame:04d}.png"), cv2.IMREAD_UNCHANGED)) > 0


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rig") / "out"
    poses = ("--pose", "flat", "--pose", "flat,index_mcp_fe=60", "--frames", "3", "--view", "palm")
    assert main(["--out", str(out), "--rig", "frame", *poses, "--random-hand", *SMALL]) == 0
    return out


def test_a_rig_is_recorded_as_others_read_it(recording: Path) -> None:
    cameras = load_rig(recording)
    assert [camera.name for camera in cameras] == ["front", "side", "top", "top45"]
    names = [f"{kind}_{view}" for kind in ("masks", "view") for view in range(4)]
    assert sorted(entry.name for entry in recording.iterdir()) == sorted(
        [*names, "about.json", "cameras.json", "truth.npz"]
    )
    with open_rig(recording, cameras) as source:
        frames = list(source)
    assert [frame.index for frame in frames] == [0, 1, 2]
    for frame in frames:
        assert frame.problems == (None,) * 4
        assert [None if image is None else tuple(image.shape) for image in frame.images] == [(72, 96, 3)] * 4
    assert json.loads((recording / "about.json").read_text())["arguments"]["rig"] == "frame"


def test_the_truth_is_that_of_the_pictures(recording: Path) -> None:
    truth, cameras = truth_of(recording), load_rig(recording)
    stored = load_truth(recording)
    np.testing.assert_array_equal(stored.keypoints3d, truth["keypoints3d"])
    np.testing.assert_array_equal(truth["flexion_deg"], flexion_deg(truth["keypoints3d"]))
    kinematics = load_hand_model().kinematics("right", dtype=torch.float64)
    pose, shape, reference = (torch.from_numpy(truth[name]) for name in ("pose", "shape", "root_reference"))
    frames = kinematics(pose, shape, root_reference=reference)
    np.testing.assert_allclose(frames.keypoints, truth["keypoints3d"], rtol=0, atol=1e-12)
    column = truth["dof_names"].tolist().index("index_mcp_fe")
    np.testing.assert_allclose(np.degrees(truth["pose"][:, column]), [0, 30, 60], rtol=0, atol=1e-9)
    hand = load_hand_model().hand(dtype=torch.float64)
    vertices = hand(pose, shape, root_reference=reference).vertices
    for frame in range(3):
        for view, camera in enumerate(cameras):
            mask, pixels = mask_of(recording, view, frame), camera.project(vertices[frame]).numpy()
            rows, columns = np.nonzero(mask)
            assert abs(pixels[:, 0].min() - columns.min()) < 1
            assert abs(pixels[:, 1].max() - rows.max()) < 1
            [inner] = camera.project(torch.from_numpy(truth["keypoints3d"][frame, 9:10])).round().long().tolist()
            assert mask[inner[1], inner[0]]
    assert truth["in_view"].all()
    assert not truth["is_cut"].any()


def test_the_hand_is_where_the_cameras_look_and_in_their_hull(recording: Path) -> None:
    truth, cameras = truth_of(recording), load_rig(recording)
    points = torch.from_numpy(truth["keypoints3d"][0])
    assert float(points.mean(0).norm()) < 0.05
    masks = [torch.from_numpy(mask_of(recording, view, 0)) for view in range(4)]
    octree = carve(masks, cameras, RootCube(centre=(0.0, 0.0, 0.0), side=0.512), CarvingSettings(level=6, min_views=3))
    value, _ = hull_field(octree).sample(points)
    assert float(value.max()) < 0
    assert float(octree.volume()) < 0.003


def test_the_same_order_gives_the_same_bytes(recording: Path, tmp_path: Path) -> None:
    order = ["--rig", "frame2", "--sampled", "--frames", "2", "--background", "clutter", "--size", "64x48", "--seed"]
    for name, seed in (("one", "5"), ("two", "5"), ("three", "6")):
        assert main(["--out", str(tmp_path / name), *order, seed]) == 0
    one, two, three = (tmp_path / name for name in ("one", "two", "three"))
    for file in sorted(path for path in one.rglob("*") if path.is_file()):
        assert file.read_bytes() == (two / file.relative_to(one)).read_bytes(), file.name
    assert (truth_of(one)["pose"] != truth_of(three)["pose"]).any()
    first, other = ((one / f"view_{view}" / "0000.jpg").read_bytes() for view in (0, 1))
    assert first != other


def test_cameras_from_a_file_and_noise_of_the_masks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cameras = [replace(camera, name=f"own{i}") for i, camera in enumerate(named_rig("ring3", size=(80, 60)))]
    save_cameras(cameras, tmp_path / "cameras.json")
    order = ["--pose", "fist", "--rig", str(tmp_path / "cameras.json"), "--surface", "primitives"]
    assert main(["--out", str(tmp_path / "exact"), *order]) == 0
    assert main(["--out", str(tmp_path / "noisy"), *order, "--mask-noise", "1"]) == 0
    assert capsys.readouterr().err == ""
    assert [camera.name for camera in load_rig(tmp_path / "noisy")] == ["own0", "own1", "own2"]
    generator = torch.Generator().manual_seed(0)
    for view in range(3):
        exact, noisy = (mask_of(tmp_path / name, view, 0) for name in ("exact", "noisy"))
        wanted = noisy_mask(torch.from_numpy(exact), 1.0, generator)
        np.testing.assert_array_equal(noisy, wanted.numpy())
        assert (noisy != exact).any()
        pictures = ((tmp_path / name / f"view_{view}" / "0000.jpg").read_bytes() for name in ("exact", "noisy"))
        assert next(pictures) == next(pictures)


def test_noise_of_a_single_cameras_mask(tmp_path: Path) -> None:
    for name, more in (("exact", []), ("noisy", ["--mask-noise", "2"])):
        assert main(["--out", str(tmp_path / name), "--frames", "1", "--size", "64x48", *more]) == 0
    exact, noisy = (np.asarray(cv2.imread(str(tmp_path / name / "masks" / "0000.png"))) for name in ("exact", "noisy"))
    assert (exact != noisy).any()
    assert "mask_noise" not in json.loads((tmp_path / "exact" / "about.json").read_text())["arguments"]


def test_a_hand_that_leaves_a_picture_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    order = ["--pose", "flat,root_ty=190", "--pose", "flat,root_tz=700", "--rig", "frame2", "--size", "64x48"]
    assert main(["--out", str(tmp_path / "out"), *order]) == 0
    printed = capsys.readouterr().err
    assert "front: the hand is cut by the picture's edge in 1 of 2 frames\n" in printed
    assert "side: the hand is out of the picture in 1 of 2 frames\n" in printed
    assert truth_of(tmp_path / "out")["in_view"].tolist() == [[True, True], [True, False]]


@pytest.mark.parametrize(
    ("order", "message"),
    [
        (["--rig", "desk"], "--rig: expected a file or folder of cameras, frame1 to frame8, or ring2 to ring36"),
        (["--rig", "{tmp}/gone.json"], "gone.json: no such file or folder"),
        (["--rig", "{tmp}/empty"], "empty: holds no cameras"),
        (["--rig", "{tmp}/none.json"], "with at least one camera"),
        (["--rig", "{tmp}/apart.json"], "no two cameras see anything together"),
        (["--rig", "{tmp}/two.json", "--size", "64x48"], "--size: expected a named rig with it"),
        (["--rig", "{tmp}/two.json", "--fov-deg", "50"], "--fov-deg: expected a named rig with it"),
        (["--rig", "frame", "--camera", "{tmp}/two.json"], "at most one of --rig and --camera"),
        (["--rig", "frame", "--video"], "at most one of --rig and --video"),
        (["--rig", "frame", "--size", "4x4"], "--size: expected WIDTHxHEIGHT"),
        (["--pose", "flatt"], "--pose: 'flatt' is no posture (did you mean flat?); allowed: open"),
        (["--pose", "flat", "--pose", "fist", "--frames", "1"], "--frames: expected 2 or more, one for each --pose"),
        (["--pose", "flat", "--sampled"], "at most one of --recorded, --pose and --sampled"),
        (["--mask-noise", "-1"], "--mask-noise: expected 0 to 20, got -1"),
        (["--sampled", "--turn-deg", "200"], "--turn-deg: expected 0 to 180"),
    ],
)
def test_wrong_orders_are_one_line_and_two(
    order: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "none.json").write_text('{"cameras": []}')
    front, side = named_rig("frame2")
    save_cameras([front, side], tmp_path / "two.json")
    away = replace(side, translation=side.translation + side.rotation @ torch.tensor((0.0, 3.0, 0.0)).double())
    save_cameras([front, away], tmp_path / "apart.json")
    order = [word.replace("{tmp}", str(tmp_path)) for word in order]
    assert main(["--out", str(tmp_path / "out"), *order]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("torchhand simulate: error: ")
    assert message in printed.err
    assert printed.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_an_older_rig_is_refused_then_replaced(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    order = ["--out", str(tmp_path / "out"), "--pose", "fist", "--size", "64x48"]
    assert main([*order, "--rig", "frame3"]) == 0
    assert main([*order, "--rig", "frame2"]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main([*order, "--rig", "frame2", "--overwrite"]) == 0
    assert not (tmp_path / "out" / "view_2").exists()
    (tmp_path / "out" / "view_notes").mkdir()
    assert main([*order, "--rig", "frame2", "--overwrite"]) == 2
    assert "it holds view_notes" in capsys.readouterr().err
