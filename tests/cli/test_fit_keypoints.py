"""The command from detector files to keypoints_fit.npz and hand.json."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from torchhand import devices
from torchhand.cli.fit_keypoints import main
from torchhand.files import load_hand, load_hand_model, load_rig, save_cameras
from torchhand.geometry import assumed_camera, rotation_from_vector, vector_from_rotation
from torchhand.hand import Side, posture

POSTURES = ("open", "flat", "fist", "point")


def _points(side: Side = "left") -> tuple[np.ndarray, np.ndarray]:
    """Poses and keypoints in the camera's frame, metres: the palm towards the camera."""
    kinematics = load_hand_model().kinematics(side, dtype=torch.float64)
    poses = torch.stack([posture(name, dtype=torch.float64) for name in POSTURES])
    poses[:, 6:] = kinematics.skeleton.within_limits(poses[:, 6:])
    poses[:, :3] = torch.tensor((0.0, 0.08, 0.5), dtype=torch.float64)
    facing = torch.tensor(((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)), dtype=torch.float64)
    tilt = rotation_from_vector(torch.tensor((0.3, -0.4, 0.1), dtype=torch.float64))
    poses[:, 3:6] = vector_from_rotation(tilt @ facing)
    return poses.numpy(), kinematics(poses).keypoints.numpy()


def _openpose(folder: Path, pixels: np.ndarray) -> Path:
    folder.mkdir()
    for i, hand in enumerate(pixels):
        numbers = np.column_stack((hand, np.full(21, 0.9))).flatten().tolist()
        content = {"people": [{"hand_left_keypoints_2d": numbers, "hand_right_keypoints_2d": [0.0] * 63}]}
        (folder / f"clip_{i + 8}_keypoints.json").write_text(json.dumps(content))
    return folder


def _run(*arguments: str | Path) -> int:
    return main([str(argument) for argument in arguments])


def test_points_in_space(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses, points = _points("left")
    holes = points.copy()
    holes[1, 8] = np.nan
    holes[3] = np.nan
    source = tmp_path / "hand.npy"
    np.save(source, holes)
    assert _run(source, "--out", tmp_path / "out", "--no-fit-shape") == 0
    said = capsys.readouterr().out
    assert (
        "3 of 4 frames fitted, 1 too few points; left hand, the better fit (0.00 mm in root mean square, else" in said
    )
    with np.load(tmp_path / "out" / "keypoints_fit.npz") as result:
        assert result["status"].tolist() == ["fitted", "fitted", "fitted", "too few points"]
        assert result["frame"].tolist() == [0, 1, 2, 3]
        np.testing.assert_allclose(result["pose"][[0, 2]], poses[[0, 2]], atol=1e-4)
        np.testing.assert_allclose(result["keypoints3d"][[0, 2]], points[[0, 2]], atol=1e-6)
        assert np.isnan(result["pose"][3]).all()
        assert np.isnan(result["residual"][1, 8])
        assert result["dof_names"].shape == (36,)
        assert result["keypoints3d_cov"].shape == (4, 21, 3, 3)
        assert "keypoints2d" not in result
        header = json.loads(str(result["header"]))
    assert (header["side"], header["camera"], header["pose_space"]) == ("left", None, "dof27")
    hand = load_hand(tmp_path / "out" / "hand.json", load_hand_model().shape_space.names)
    assert hand.side == "left"
    default = load_hand_model().shape_space.default.tolist()
    np.testing.assert_allclose(list(hand.values.values()), default, atol=1e-15)
    assert hand.provenance["shape_fitted"] is False


def test_a_folder_of_openpose_with_a_camera_and_a_known_hand(tmp_path: Path) -> None:
    _, points = _points("left")
    camera = replace(assumed_camera(640, 480), is_assumed=False)
    pixels = camera.project(torch.from_numpy(points)).numpy()
    save_cameras([camera], tmp_path / "cameras.json")
    np.save(tmp_path / "space.npy", points)
    assert _run(tmp_path / "space.npy", "--out", tmp_path / "known", "--side", "left", "--no-fit-shape") == 0
    folder = _openpose(tmp_path / "json", pixels)
    files = ("--camera", tmp_path / "cameras.json", "--hand", tmp_path / "known" / "hand.json")
    assert _run(folder, "--out", tmp_path / "out", *files) == 0
    with np.load(tmp_path / "out" / "keypoints_fit.npz") as result:
        assert result["frame"].tolist() == [8, 9, 10, 11]
        assert result["status"].tolist() == ["fitted"] * 4
        assert float(np.nanmean(result["residual"])) < 6.0
        np.testing.assert_allclose(result["keypoints2d"], pixels, atol=20.0)
        error = np.linalg.norm(result["keypoints3d"] - points, axis=-1).mean(-1)
        assert float(np.median(error)) < 0.03
        assert json.loads(str(result["header"]))["camera"]["is_assumed"] is False


def test_mediapipe_with_the_size_of_the_pictures(tmp_path: Path) -> None:
    _, points = _points("left")
    pixels = assumed_camera(640, 480).project(torch.from_numpy(points)).numpy()
    fractions = (pixels + 0.5) / (640, 480)
    frames = [
        {
            "hand_landmarks": [[{"x": x, "y": y, "z": 0.0} for x, y in hand]],
            "handedness": [[{"category_name": "Right", "score": 0.9}]],  # as in a mirror: a left hand
        }
        for hand in fractions.tolist()
    ]
    source = tmp_path / "hands.json"
    source.write_text(json.dumps(frames))
    assert _run(source, "--out", tmp_path / "out", "--size", "640x480", "--no-fit-shape") == 0
    with np.load(tmp_path / "out" / "keypoints_fit.npz") as result:
        header = json.loads(str(result["header"]))
        assert header["side"] == "left"
        assert header["camera"]["is_assumed"] is True
        assert float(np.nanmean(result["residual"])) < 6.0


def test_arrays_of_a_detector_in_space_and_in_pictures(tmp_path: Path) -> None:
    """World landmarks without a camera, points of the pictures with one; frames without a hand stay empty."""
    _, points = _points("left")
    world = points - points.mean(1, keepdims=True)
    pixels = assumed_camera(640, 480).project(torch.from_numpy(points)).numpy()
    label = np.array(["Right"] * len(points))  # as in a mirror: a left hand
    world[1] = pixels[1] = np.nan
    label[1] = ""
    names = np.array([f"{i}.png" for i in range(len(points))])
    source = tmp_path / "mediapipe.npz"
    np.savez(source, points_px=pixels, world=world, label=label, score=np.full(len(points), 0.9), image=names)
    assert _run(source, "--out", tmp_path / "space", "--no-fit-shape") == 0
    assert _run(source, "--out", tmp_path / "picture", "--no-fit-shape", "--size", "640x480") == 0
    good = [0, 2, 3]
    for folder in ("space", "picture"):
        with np.load(tmp_path / folder / "keypoints_fit.npz") as result:
            assert result["status"].tolist() == ["fitted", "too few points", "fitted", "fitted"]
            assert json.loads(str(result["header"]))["side"] == "left"
            assert result["image"].tolist() == names.tolist()
            if folder == "space":
                np.testing.assert_allclose(result["keypoints3d"][good], world[good], atol=1e-6)
            else:
                assert result["keypoints3d"][good, 0, 2].min() > 0.2  # before the camera
                assert float(np.nanmean(result["residual"])) < 6.0


def test_several_cameras_with_standard_deviations(tmp_path: Path) -> None:
    """Two cameras tell the place in their common world; a point that says it is badly known does not count."""
    _, points = _points("left")
    cameras, files = [], []
    for view in range(2):
        turn = rotation_from_vector(torch.tensor((0.0, 0.9 * view, 0.0), dtype=torch.float64))
        middle = torch.tensor((0.0, 0.0, 0.5), dtype=torch.float64)
        one = replace(assumed_camera(640, 480), name=str(view), rotation=turn, translation=middle - turn @ middle)
        pixels = one.project(torch.from_numpy(points)).numpy()
        pixels[:, 8] += 60.0
        std = np.full((len(points), 21), 1.0)
        std[:, 8] = 200.0
        cameras.append(one)
        files.append(tmp_path / f"view_{view}.npz")
        np.savez(files[-1], points_px=pixels, std_px=std, side="left")
    save_cameras(cameras, tmp_path / "cameras.json")
    options = ("--camera", tmp_path / "cameras.json", "--no-fit-shape")
    assert _run(*files, "--out", tmp_path / "out", *options) == 0
    with np.load(tmp_path / "out" / "keypoints_fit.npz") as result:
        error = np.linalg.norm(result["keypoints3d"] - points, axis=-1)
        assert float(np.delete(error, 8, axis=1).mean()) < 0.004
        assert float(result["residual"][:, 8].min()) > 30.0
        assert [entry["name"] for entry in json.loads(str(result["header"]))["camera"]] == ["0", "1"]
    assert _run(files[0], "--out", tmp_path / "one", *options) == 2


def test_intrinsics_of_every_picture(tmp_path: Path) -> None:
    """Crops of one picture: the same hand at the same place, whatever was cut away; found by the pictures' names."""
    _, points = _points("right")
    one, names = assumed_camera(640, 480), np.array([f"{i}.png" for i in range(len(points))])
    corner = np.array([(0.0, 0.0), (100.0, 40.0), (30.0, 90.0), (60.0, 10.0)])
    intrinsics = np.repeat(one.intrinsics.numpy()[None], len(points), 0)
    intrinsics[:, :2, 2] -= corner
    pixels = one.project(torch.from_numpy(points)).numpy() - corner[:, None]
    world = points - points.mean(1, keepdims=True)
    np.savez(tmp_path / "seen.npz", points_px=pixels, world=world, image=names, side="right")
    np.savez(tmp_path / "cameras.npz", K=intrinsics[::-1], image=names[::-1])
    options = ("--camera", tmp_path / "cameras.npz", "--no-fit-shape")
    assert _run(tmp_path / "seen.npz", "--out", tmp_path / "out", *options) == 0
    with np.load(tmp_path / "out" / "keypoints_fit.npz") as result:
        assert float(np.linalg.norm(result["keypoints3d"] - points, axis=-1).mean()) < 0.01


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"std_px": np.full((21,), -1.0)}, "std_px: expected numbers above 0"),
        ({"std_px": np.ones(20)}, "std_px: expected numbers of shape (4, 21) or that without frames"),
        ({"cov_px": np.zeros((4, 21, 2, 2))}, "cov_px: expected numbers above 0 (covariances: positive definite)"),
        ({"std_px": np.ones(21), "cov_px": np.ones((21, 2, 2))}, "expected at most one of cov_px and std_px, got both"),
    ],
)
def test_covariances_that_are_none(
    arrays: dict[str, np.ndarray], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, points = _points("right")
    np.savez(tmp_path / "seen.npz", points_px=1000 * points[..., :2], **arrays)  # pyright: ignore[reportArgumentType]
    assert _run(tmp_path / "seen.npz", "--out", tmp_path / "out", "--size", "640x480") == 2
    assert message in capsys.readouterr().err


def test_any_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, points = _points("right")
    np.save(tmp_path / "mm.npy", 1000 * points)
    assert _run(tmp_path / "mm.npy", "--out", tmp_path / "out", "--units", "any", "--side", "right") == 0
    with np.load(tmp_path / "out" / "keypoints_fit.npz") as result:
        assert float(result["scale"]) == pytest.approx(0.001, rel=0.02)
    assert "m per unit" in capsys.readouterr().out
    assert _run(tmp_path / "mm.npy", "--out", tmp_path / "other") == 2
    said = capsys.readouterr().err
    assert "expected metres (0.03 to 0.2 from the wrist to the middle knuckle), got 83" in said
    assert not (tmp_path / "other").exists()


def test_nothing_good_is_replaced_by_accident(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, points = _points("right")
    np.save(tmp_path / "hand.npy", points)
    out = tmp_path / "out"
    assert _run(tmp_path / "hand.npy", "--out", out, "--side", "right", "--no-fit-shape") == 0
    before = (out / "keypoints_fit.npz").read_bytes()
    capsys.readouterr()
    assert _run(tmp_path / "hand.npy", "--out", out) == 2
    assert (
        "holds keypoints_fit.npz and hand.json already; give another folder, or --overwrite" in capsys.readouterr().err
    )
    nothing = np.full((3, 21, 3), np.nan)
    nothing[:, :4] = points[:3, :4]
    np.save(tmp_path / "nothing.npy", nothing)
    assert _run(tmp_path / "nothing.npy", "--out", out, "--overwrite", "--side", "right") == 2
    assert "expected a frame that can be fitted, got none (too few points)" in capsys.readouterr().err
    assert (out / "keypoints_fit.npz").read_bytes() == before
    assert _run(tmp_path / "hand.npy", "--out", out, "--overwrite", "--side", "left", "--no-fit-shape") == 0
    assert (out / "keypoints_fit.npz").read_bytes() != before


WRONG: dict[str, tuple[list[str], str]] = {
    "no camera": (["px.npy", "--out", "out"], "holds points of a picture: expected --camera or --size, got neither"),
    "camera in space": (["m.npy", "--out", "out", "--size", "640x480"], "--size: expected points of a picture with it"),
    "size": (
        ["px.npy", "--out", "out", "--size", "640"],
        "--size: expected WIDTHxHEIGHT in px such as 1280x720, got '640'",
    ),
    "space": (["m.npy", "--out", "out", "--space", "planar"], "--space: expected one of dof26, dof27"),
    "missing": (["none.npy", "--out", "out"], "none.npy: no such file or folder"),
    "file": (["m.npy", "--out", "m.npy"], "m.npy: expected a folder for the results, got a file"),
    "hand": (["m.npy", "--out", "out", "--hand", "bad.json"], "bad.json: expected a hand file"),
    "cameras": (["px.npy", "--out", "out", "--camera", "bad.json"], 'bad.json: expected {"cameras": [...]}'),
    "both": (
        ["px.npy", "--out", "out", "--camera", "bad.json", "--size", "2x2"],
        "--size: expected it only without --camera",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_input(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    _, points = _points("right")
    np.save("m.npy", points[:1])
    np.save("px.npy", 1000 * points[:1, :, :2])
    Path("bad.json").write_text("{}")
    arguments, message = WRONG[name]
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith("torchhand fit_keypoints: error: ")
    assert message in said
    assert said.count("\n") == 1
    assert not Path("out").exists()


def test_help_has_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    assert "torchhand fit_keypoints hands.json --out out/hands" in capsys.readouterr().out


@pytest.mark.parametrize("options", [[], ["--units", "any"], ["--units", "px", "--size", "640x480"]])
def test_points_that_are_no_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str]) -> None:
    dice = np.random.default_rng(0)
    points = 0.05 * dice.standard_normal((4, 21, 3)) + (0.0, 0.0, 0.5)
    if "px" in options:
        points = 320 + 60 * dice.standard_normal((4, 21, 2))
    np.save(tmp_path / "points.npy", points)
    code = _run(tmp_path / "points.npy", "--out", tmp_path / "out", "--side", "left", "--no-fit-shape", *options)
    error = capsys.readouterr().err
    assert code == 2, error
    assert "points.npy: expected points of a hand, got others: the best hand leaves" in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("place", [(5000.0, -3000.0), (1290.0, 100.0), (100.0, -490.0), (1e7, 1e7)])
def test_points_farther_outside_one_camera_s_picture_than_it_is_large_are_left_out(
    place: tuple[float, float], tmp_path: Path
) -> None:
    _, points = _points("left")
    pixels = assumed_camera(640, 480).project(torch.from_numpy(points)).numpy()
    holes, wrong = pixels.copy(), pixels.copy()
    holes[1, 8], wrong[1, 8] = np.nan, place
    found = []
    for name, given in (("holes", holes), ("wrong", wrong)):
        np.save(tmp_path / f"{name}.npy", given)
        options = ("--size", "640x480", "--side", "left", "--no-fit-shape", "--no-report")
        assert _run(tmp_path / f"{name}.npy", "--out", tmp_path / name, *options) == 0
        with np.load(tmp_path / name / "keypoints_fit.npz") as result:
            found.append((result["pose"], result["residual"]))
    np.testing.assert_array_equal(found[1][0], found[0][0])
    np.testing.assert_array_equal(found[1][1], found[0][1])


def test_points_a_little_outside_one_camera_s_picture_count(tmp_path: Path) -> None:
    _, points = _points("left")
    camera = assumed_camera(640, 480)
    moved = torch.from_numpy(points) + torch.tensor((0.25, 0.0, 0.0), dtype=torch.float64)
    pixels = camera.project(moved).numpy()
    assert (pixels > (639.5, 479.5)).any(-1).any()
    np.save(tmp_path / "points.npy", pixels)
    options = ("--size", "640x480", "--side", "left", "--no-fit-shape", "--no-report")
    assert _run(tmp_path / "points.npy", "--out", tmp_path / "out", *options) == 0
    with np.load(tmp_path / "out" / "keypoints_fit.npz") as result:
        assert np.isfinite(result["residual"]).all()


def test_an_array_of_all_cameras_with_a_calibration_of_aniposelib(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Unit by the hand's size; a view of another hand, points outside and a missing view do no harm."""
    _, points = _points("left")
    tables, views = [], []
    for view in range(3):
        vector = torch.tensor((0.0, 0.6 * view, 0.1), dtype=torch.float64)
        turn, middle = rotation_from_vector(vector), torch.tensor((0.0, 0.0, 0.5), dtype=torch.float64)
        one = replace(assumed_camera(640, 480), rotation=turn, translation=middle - turn @ middle)
        tables.append(
            f'[cam_{view}]\nname = "{view}"\nsize = [640, 480]\nmatrix = {one.intrinsics.tolist()}\n'
            f"distortions = [0.0, 0.0, 0.0, 0.0, 0.0]\nrotation = {vector.tolist()}\n"
            f"translation = {(1000 * one.translation).tolist()}\n"
        )
        views.append(one.project(torch.from_numpy(points)).numpy())
    seen = np.stack(views)
    seen[1, 2] += (90.0, 40.0)  # another hand
    seen[0, 1, 8] = (900.0, 50.0)
    seen[2, 0] = -1.0
    (tmp_path / "calibration.toml").write_text("\n".join(tables) + "\n[metadata]\n")
    np.save(tmp_path / "seen.npy", seen)
    options = ("--cameras", tmp_path / "calibration.toml", "--side", "left", "--no-fit-shape")
    assert _run(tmp_path / "seen.npy", "--out", tmp_path / "out", *options) == 0
    assert "the cameras' places are taken in mm" in capsys.readouterr().out
    with np.load(tmp_path / "out" / "keypoints_fit.npz") as result:
        error = np.linalg.norm(result["keypoints3d"] - points, axis=-1)
        assert float(error.max()) < 0.01
    assert _run(tmp_path / "seen.npy", "--out", tmp_path / "two", *options, "--views", "0,2") == 0
    assert _run(tmp_path / "seen.npy", "--out", tmp_path / "three", *options, "--views", "0,3") == 2
    assert "--views: expected numbers from 0 to 2, each once" in capsys.readouterr().err
    np.save(tmp_path / "wrong.npy", seen[:, :, :20])
    assert _run(tmp_path / "wrong.npy", "--out", tmp_path / "four", *options) == 2
    assert "expected an array (cameras, frames, 21, 2), got (3, 4, 20, 2)" in capsys.readouterr().err


def test_rough_cameras_are_refined_and_refused_where_the_hand_does_not_tell_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, points = _points("right")
    time = np.linspace(0, 6, 32)
    way = 0.07 * np.stack((np.sin(time), np.cos(2 * time), np.sin(1.5 * time)), -1)
    moving = torch.from_numpy(points[np.arange(32) % len(points)] + way[:, None])
    turn = rotation_from_vector(torch.tensor((0.1, 0.8, 0.0), dtype=torch.float64))
    middle = torch.tensor((0.0, 0.0, 0.5), dtype=torch.float64)
    first = replace(assumed_camera(640, 480), name="left")
    second = replace(first, rotation=turn, translation=middle - turn @ middle, name="right")
    rough = replace(second, rotation=rotation_from_vector(torch.tensor((0.0, 0.03, 0.0)).double()) @ turn)
    pixels = np.stack([camera.project(moving).numpy() for camera in (first, second)])
    np.save(tmp_path / "rig.npy", pixels)
    save_cameras([first, rough], tmp_path / "cameras.json")
    source = (tmp_path / "rig.npy", "--camera", tmp_path / "cameras.json", "--side", "right", "--smooth", "False")
    assert _run(*source, "--refine-cameras", "--out", tmp_path / "out") == 0
    assert "cameras off by: right 1." in capsys.readouterr().out
    found = load_rig(tmp_path / "out" / "cameras.json")[1]
    off = vector_from_rotation(found.rotation @ turn.mT).norm().rad2deg()
    assert float(off) < 0.3
    np.save(tmp_path / "rig.npy", pixels[:, :12])
    assert _run(*source, "--refine-cameras", "--out", tmp_path / "out2") == 2
    assert "expected a hand whose motion tells" in capsys.readouterr().err
    assert not (tmp_path / "out2").exists()
    np.save(tmp_path / "space.npy", points)
    assert _run(tmp_path / "space.npy", "--refine-cameras", "--out", tmp_path / "out3") == 2
    assert "expected points of two pinhole cameras" in capsys.readouterr().err


def test_a_device_gives_what_the_processor_gives(
    tmp_path: Path, device: torch.device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(devices, "_accelerators", lambda: [device.type])
    source = tmp_path / "hand.npy"
    np.save(source, _points("left")[1][:1])
    for name in ("cpu", device.type):
        arguments = ("--out", tmp_path / name, "--side", "left", "--no-fit-shape", "--no-report", "--device", name)
        assert _run(source, *arguments) == 0
    with (
        np.load(tmp_path / "cpu" / "keypoints_fit.npz") as expected,
        np.load(tmp_path / device.type / "keypoints_fit.npz") as found,
    ):
        assert found["status"].tolist() == ["fitted"]
        for name in ("pose", "pose_std", "keypoints3d"):
            np.testing.assert_allclose(found[name], expected[name], atol=1e-6)


def test_a_device_that_is_not_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(devices, "_accelerators", list)
    np.save(tmp_path / "hand.npy", _points()[1])
    assert _run(tmp_path / "hand.npy", "--out", tmp_path / "out", "--device", "cuda") == 2
    said = capsys.readouterr().err
    assert said == "torchhand fit_keypoints: error: --device: expected cpu on this machine, got 'cuda'\n"
    assert not (tmp_path / "out").exists()
