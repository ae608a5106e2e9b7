"""The command from rendered pictures of a board to cameras.json, and one clear line for every bad calibration."""

import functools
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from tests.studio import Studio
from torchhand.calibration import Board, Pose, draw_board, find_board
from torchhand.cli import calibrate
from torchhand.cli.calibrate import main
from torchhand.files import load_cameras, load_rig, open_rig, read_picture, rig_notes
from torchhand.geometry import Camera, rotation_from_vector, undistort, vector_from_rotation

WIDTH, HEIGHT = 400, 300
FRAMES = 8
SQUARE_PX = 32  # of the board's texture
CHESSBOARD = Board(kind="chessboard", columns=7, rows=6, square=0.03)
CHARUCO = Board(kind="charuco", columns=6, rows=4, square=0.042)
CHESSBOARD_FLAGS = ("--board", "chessboard", "--squares", "7x6", "--square-mm", "30", "--distortion", "4")
CHARUCO_FLAGS = ("--board", "charuco", "--squares", "6x4", "--square-mm", "42", "--distortion", "4")


def _camera(name: str, turn: tuple[float, float, float], focal: float) -> Camera:
    """0.55 m from the origin, looking at it."""
    return Camera(
        intrinsics=torch.tensor([[focal, 0, 202.0], [0, focal - 2, 147.0], [0, 0, 1]], dtype=torch.float64),
        rotation=rotation_from_vector(torch.tensor(turn, dtype=torch.float64)),
        translation=torch.tensor((0.0, 0.0, 0.55), dtype=torch.float64),
        distortion=torch.tensor([-0.15, 0.06, 0.001, -0.001], dtype=torch.float64),
        width=WIDTH,
        height=HEIGHT,
        name=name,
    )


CAMERAS = [
    _camera("cam0", (0.0, 0.0, 0.0), 400.0),
    _camera("cam1", (0.05, 0.55, 0.1), 410.0),
    _camera("cam2", (-0.5, -0.1, -0.05), 390.0),
]


def _board_pose(index: int, board: Board) -> Pose:
    """Tilted in turn to all sides, moved over the picture."""
    angle = 2.4 * index
    vector = 0.4 * torch.tensor((math.cos(angle), math.sin(angle), 0.3 * math.sin(3 * angle)), dtype=torch.float64)
    rotation = rotation_from_vector(vector)
    place = torch.tensor((0.07 * math.cos(1.7 * index), 0.045 * math.sin(2.3 * index), 0.04 * math.sin(index)))
    return Pose(rotation=rotation, translation=place.double() - rotation @ board.points().mean(0))


@functools.cache
def _plane(name: str) -> torch.Tensor:
    """Directions of four rays per pixel of the named camera."""
    camera = next(camera for camera in CAMERAS if camera.name == name)
    y, x = ((torch.arange(2 * size, dtype=torch.float64) - 0.5) / 2 for size in (HEIGHT, WIDTH))
    points = torch.stack(torch.meshgrid(x, y, indexing="xy"), -1)
    straight = (points - camera.intrinsics[:2, 2]) / camera.intrinsics[:2, :2].diagonal()
    return undistort(straight, camera.distortion, steps=4)


def _render(camera: Camera, board: Board, pose: Pose, noise: np.random.Generator) -> np.ndarray:
    """The board by ray casting, four rays per pixel, with a little blur and noise; BGR."""
    plane = _plane(camera.name)
    seen = Pose(rotation=camera.rotation, translation=camera.translation) @ pose
    plane_from_board = torch.stack((seen.rotation[:, 0], seen.rotation[:, 1], seen.translation), -1)
    on_board = torch.cat((plane, torch.ones_like(plane[..., :1])), -1) @ torch.linalg.inv(plane_from_board).T
    on_board = on_board[..., :2] / on_board[..., 2:]
    first = (2 if board.kind == "chessboard" else 1) * SQUARE_PX - 0.5
    texture = (first + on_board / board.square * SQUARE_PX).float().numpy()
    drawn = 20 + draw_board(board, SQUARE_PX).numpy().astype(np.float32) * (200 / 255)
    fine = cv2.remap(drawn, texture[..., 0], texture[..., 1], cv2.INTER_LINEAR, borderValue=110)
    picture = cv2.GaussianBlur(cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    picture = picture + noise.normal(0, 2, picture.shape)
    return cv2.cvtColor(np.clip(np.rint(picture), 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)


def _write(folder: Path, board: Board, cameras: list[Camera], frames: int) -> Path:
    noise = np.random.default_rng(0)
    for i, camera in enumerate(cameras):
        (folder / f"view_{i}").mkdir(parents=True)
        for frame in range(frames):
            image = _render(camera, board, _board_pose(frame, board), noise)
            cv2.imwrite(str(folder / f"view_{i}" / f"{frame:04d}.png"), image)
    return folder


@pytest.fixture(scope="module")
def chessboards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _write(tmp_path_factory.mktemp("chessboards"), CHESSBOARD, CAMERAS, FRAMES)


@pytest.fixture(scope="module")
def charucos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _write(tmp_path_factory.mktemp("charucos"), CHARUCO, CAMERAS[:2], FRAMES)


@pytest.fixture(autouse=True)
def search_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Searching a picture takes a tenth of a second: what was found in one is kept for the other tests."""

    def find(image: torch.Tensor, board: Board):
        key = (image.numpy().tobytes(), board)
        if key not in _FOUND:
            _FOUND[key] = find_board(image, board)
        return _FOUND[key]

    monkeypatch.setattr(calibrate, "find_board", find)


_FOUND: dict = {}


@pytest.fixture
def some_of(chessboards: Path, tmp_path: Path) -> Callable[..., Path]:
    """some_of([0, 1, 2], [3, 4, 5]) is a folder with these frames of the first and the second camera."""

    def make(*frames: list[int]) -> Path:
        folder = tmp_path / "some"
        for i, wanted in enumerate(frames):
            (folder / f"view_{i}").mkdir(parents=True)
            for frame in wanted:
                name = f"{frame:04d}.png"
                shutil.copy(chessboards / f"view_{i}" / name, folder / f"view_{i}" / name)
        return folder

    return make


def run(folder: Path, out: Path, *more: str, flags: tuple[str, ...] = CHESSBOARD_FLAGS) -> int:
    return main([str(folder), "--out", str(out / "cameras.json"), *flags, *more])


def errors(found: Camera, true: Camera, first: Camera) -> tuple[float, float, float]:
    """Largest error of K, px; of the rotation, degrees; of the translation, mm; in the frame of the first camera."""
    world = Pose(rotation=first.rotation, translation=first.translation).inverse()
    expected = Pose(rotation=true.rotation, translation=true.translation) @ world
    turn = vector_from_rotation(found.rotation @ expected.rotation.T).norm()
    return (
        float((found.intrinsics - true.intrinsics).abs().max()),
        math.degrees(float(turn)),
        1000 * float((found.translation - expected.translation).norm()),
    )


def test_chessboards_give_the_cameras(chessboards: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(chessboards, tmp_path) == 0
    cameras = load_cameras(tmp_path / "cameras.json")
    assert [camera.name for camera in cameras] == ["view_0", "view_1", "view_2"]
    for found, true in zip(cameras, CAMERAS, strict=True):
        lens, turn, shift = errors(found, true, CAMERAS[0])
        print(f"{found.name}: K {lens:.2f} px, {turn:.3f} deg, {shift:.2f} mm")
        assert lens < 2.0
        assert turn < 0.4
        assert shift < 2.0
    printed = capsys.readouterr().out
    assert "view_0 and view_1 8" in printed
    report = tmp_path / "cameras_report"
    assert sorted(path.name for path in report.iterdir()) == ["report.txt", "view_0.png", "view_1.png", "view_2.png"]
    text = (report / "report.txt").read_text()
    rms = float(text.rpartition("all corners: ")[2].split()[0])
    assert rms < 0.15
    assert text.strip() in printed
    assert len(np.unique(read_picture(report / "view_1.png").numpy().reshape(-1, 3), axis=0)) > 50
    # The result is a rig whose recording can be opened.
    rig = load_rig(tmp_path)
    assert rig_notes(rig) == []
    with open_rig(chessboards, rig) as source:
        assert [frame.problems for frame in source] == [(None, None, None)] * FRAMES


def test_charucos_in_the_frame_of_the_board(charucos: Path, tmp_path: Path) -> None:
    assert run(charucos, tmp_path, "--world", "board", "--world-picture", "2", flags=CHARUCO_FLAGS) == 0
    pose = _board_pose(2, CHARUCO)
    points = CHARUCO.points()
    for found, true in zip(load_cameras(tmp_path / "cameras.json"), CAMERAS[:2], strict=True):
        expected = true.project(points @ pose.rotation.T + pose.translation)
        assert float((found.project(points) - expected).norm(dim=-1).max()) < 0.4
        assert float((found.intrinsics - true.intrinsics).abs().max()) < 3.0


def test_one_camera_from_a_folder_of_pictures(chessboards: Path, tmp_path: Path) -> None:
    assert run(chessboards / "view_1", tmp_path) == 0
    (camera,) = load_cameras(tmp_path / "cameras.json")
    assert float((camera.intrinsics - CAMERAS[1].intrinsics).abs().max()) < 3.0
    torch.testing.assert_close(camera.rotation, torch.eye(3).double(), atol=1e-12, rtol=0.0)


def test_offset_of_cameras_that_start_apart(
    some_of: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The second camera's pictures carry numbers one too high."""
    folder = some_of(list(range(FRAMES)), list(range(FRAMES)))
    for frame in reversed(range(FRAMES)):
        (folder / "view_1" / f"{frame:04d}.png").rename(folder / "view_1" / f"{frame + 1:04d}.png")
    assert run(folder, tmp_path) == 2
    message = capsys.readouterr().err
    assert "not of the same time (give an offset)" in message
    assert not (tmp_path / "cameras.json").exists()
    assert run(folder, tmp_path, "--offset", "view_1=1") == 0
    found = load_cameras(tmp_path / "cameras.json")[1]
    assert errors(found, CAMERAS[1], CAMERAS[0])[2] < 2.0


def test_bad_calibration_is_refused_or_forced(
    some_of: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = some_of([0, 1, 2, 3])
    assert run(folder, tmp_path) == 2
    message = capsys.readouterr().err
    assert "view_0: the board was found in 4 pictures, expected 6 or more" in message
    assert message.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["some"]
    assert run(folder, tmp_path, "--force") == 0
    assert "warning: view_0: the board was found in 4 pictures" in (tmp_path / "cameras_report/report.txt").read_text()
    assert len(load_cameras(tmp_path / "cameras.json")) == 1


def test_limit_of_the_error_is_the_users(
    some_of: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(some_of(list(range(FRAMES))), tmp_path, "--max-rms", "0.001") == 2
    assert "px, expected 0.001 or less" in capsys.readouterr().err


def test_unconnected_cameras_are_named(
    some_of: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(some_of([0, 1, 2, 3], [0, 1, 2, 3], [4, 5, 6, 7]), tmp_path) == 2
    assert "view_0, view_1 | view_2" in capsys.readouterr().err


def test_wrong_number_of_squares_is_told(
    some_of: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ("--board", "chessboard", "--squares", "8x7", "--square-mm", "30")
    assert run(some_of([0, 1]), tmp_path, flags=flags) == 2
    message = capsys.readouterr().err
    assert (
        "view_0: expected a chessboard of 8x7 squares in 6 pictures or more, found it in 0; its pictures show a"
        in message
    )
    assert "7x6" in message or "6x7" in message


def test_pictures_without_a_board_are_told_without_another_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "hands"
    folder.mkdir()
    for number in range(3):
        cv2.imwrite(str(folder / f"{number}.png"), Studio().placed(size=0.7 + 0.1 * number).picture().numpy())
    assert run(folder, tmp_path, flags=("--squares", "9x6")) == 2
    assert capsys.readouterr().err == (
        "torchhand calibrate: error: cam0: expected a chessboard of 9x6 squares in 6 pictures or more, found it in 0;"
        " check the pictures, --board and --squares\n"
    )


def test_wrong_markers_are_told(charucos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(charucos, tmp_path, "--dictionary", "DICT_5X5_50", flags=CHARUCO_FLAGS) == 2
    assert "its pictures show markers of DICT_4X4_" in capsys.readouterr().err


def test_older_results_are_kept_unless_told(
    some_of: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "cameras.json"
    out.write_text("kept")
    folder = some_of(list(range(FRAMES)))
    assert run(folder, tmp_path) == 2
    assert "exists already" in capsys.readouterr().err
    assert out.read_text() == "kept"
    assert run(folder, tmp_path, "--overwrite") == 0
    assert json.loads(out.read_text())["cameras"][0]["name"] == "view_0"


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--squares", "9"), "--squares: expected COLUMNSxROWS"),
        (("--square-mm", "0"), "--square-mm: expected 1 to 1000"),
        (("--squares", "2x6"), "columns: expected 3 to 100 squares, got 2"),
        (("--dictionary", "DICT_9X9", "--board", "charuco"), "expected one of DICT_4X4"),
        (("--offset", "view_1"), "expected NAME=FRAMES"),
        (("--offset", "view_9=1"), "'view_9' is no camera"),
        (("--squares", "7x7"), "look the same upside down"),
        (("--world-picture", "3"), "expected --world board"),
    ],
)
def test_wrong_arguments(
    chessboards: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...], words: str
) -> None:
    assert run(chessboards, tmp_path, *more, flags=()) == 2
    assert words in capsys.readouterr().err


def test_missing_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path / "nowhere", tmp_path) == 2
    assert "nowhere: no such folder" in capsys.readouterr().err
    assert main([]) == 2
    assert "expected INPUT and --out FILE, or --print-board FILE" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["chessboard", "charuco"])
def test_printed_board_is_the_one_that_is_found(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "board.png"
    assert main(["--print-board", str(path), "--board", kind, "--squares", "7x6"]) == 0
    board = Board(kind="charuco" if kind == "charuco" else "chessboard", columns=7, rows=6)
    found = find_board(read_picture(path), board)
    assert found is not None
    assert len(found.ids) == board.corners
    assert main(["--print-board", str(path), "--squares", "7x6"]) == 2
