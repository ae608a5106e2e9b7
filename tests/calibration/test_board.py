"""Boards drawn, warped, and found again at the right corners."""

import cv2
import numpy as np
import pytest
import torch

from torchhand.calibration.board import Board, dictionaries, draw_board, find_board, other_board
from torchhand.image import WORKING_PIXELS

SQUARE_PX = 36
CHESSBOARD = Board(kind="chessboard", columns=7, rows=6, square=0.03)
CHARUCO = Board(kind="charuco", columns=6, rows=4, square=0.04)


def shown(
    board: Board, *, turn_deg: float = 0.0, noise: float = 2.0, square_px: int = SQUARE_PX
) -> tuple[torch.Tensor, np.ndarray]:
    """A slanted picture of the board, and where its corners are."""
    drawn = 20 + draw_board(board, square_px).numpy().astype(np.float32) * (200 / 255)
    height, width = drawn.shape
    slant = np.array([[0.95, 0.06, 20.0], [0.08, 0.9, 10.0], [2e-4, 1e-4, 1.0]])
    turn = np.vstack((cv2.getRotationMatrix2D((width / 2, height / 2), turn_deg, 0.9), (0, 0, 1)))
    warp = slant @ turn
    large = np.diag((2.0, 2.0, 1.0))
    large[:2, 2] = 0.5
    fine = cv2.warpPerspective(drawn, large @ warp, (2 * width, 2 * height), borderValue=200)
    seen = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)
    seen = seen + np.random.default_rng(0).normal(0, noise, seen.shape)
    first = (2 if board.kind == "chessboard" else 1) * square_px - 0.5
    flat = first + board.points().numpy()[:, :2] / board.square * square_px
    points = cv2.perspectiveTransform(flat[:, None], warp).reshape(-1, 2)
    grey = np.clip(np.rint(seen), 0, 255).astype(np.uint8)
    return torch.from_numpy(grey)[..., None].expand(-1, -1, 3).contiguous(), points


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 180.0, 230.0])
@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO], ids=["chessboard", "charuco"])
def test_corners_are_found_whichever_way_the_board_is_held(board: Board, turn_deg: float) -> None:
    image, points = shown(board, turn_deg=turn_deg)
    found = find_board(image, board)
    assert found is not None
    assert len(found.ids) >= 0.8 * board.corners
    error = np.linalg.norm(found.points_px.numpy() - points[found.ids.numpy()], axis=1)
    # Only few pixels around a ChArUco corner are free of the markers' edges.
    assert np.sqrt((error**2).mean()) < (0.1 if board.kind == "chessboard" else 0.16)
    assert error.max() < 0.4


@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO], ids=["chessboard", "charuco"])
def test_large_pictures_are_searched_at_a_bounded_size_and_refined_at_their_own(
    board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, points = shown(board, square_px=320)
    assert image.shape[0] * image.shape[1] > 2 * WORKING_PIXELS
    sizes = []
    search, detector = cv2.findChessboardCornersSB, cv2.aruco.CharucoDetector

    class Watched:
        def __init__(self, board: cv2.aruco.CharucoBoard) -> None:
            self.detector = detector(board)

        def detectBoard(self, grey: np.ndarray) -> tuple:
            sizes.append(grey.size)
            return self.detector.detectBoard(grey)

    monkeypatch.setattr(
        cv2, "findChessboardCornersSB", lambda grey, *a, **k: sizes.append(grey.size) or search(grey, *a, **k)
    )
    monkeypatch.setattr(cv2.aruco, "CharucoDetector", Watched)
    found = find_board(image, board)
    assert found is not None
    assert len(found.ids) >= 0.8 * board.corners
    assert len(sizes) == 1
    assert sizes[0] <= 1.001 * WORKING_PIXELS
    error = np.linalg.norm(found.points_px.numpy() - points[found.ids.numpy()], axis=1)
    assert np.sqrt((error**2).mean()) < 0.1, "px of the whole picture, some two to one of the searched one"


def test_hidden_part() -> None:
    image, points = shown(CHARUCO)
    image[:, 2 * image.shape[1] // 3 :] = 128
    found = find_board(image, CHARUCO)
    assert found is not None
    assert 6 <= len(found.ids) < CHARUCO.corners
    assert np.abs(found.points_px.numpy() - points[found.ids.numpy()]).max() < 0.4
    image, _ = shown(CHESSBOARD)
    image[:, image.shape[1] // 2 :] = 128
    assert find_board(image, CHESSBOARD) is None


def test_corners_on_one_line_are_no_board() -> None:
    board = Board(kind="charuco", columns=12, rows=3, square=0.02)
    image, points = shown(board, noise=0.0)
    below = int(points[:11, 1].max()) + SQUARE_PX // 3
    assert find_board(image, board) is not None
    image[below:] = 200
    assert find_board(image, board) is None


def test_other_boards_are_told() -> None:
    image, _ = shown(CHESSBOARD)
    wrong = Board(kind="chessboard", columns=8, rows=7)
    assert find_board(image, wrong) is None
    assert other_board(image, wrong) in ("a chessboard of 7x6 squares", "a chessboard of 6x7 squares")
    assert other_board(image, CHESSBOARD) is None
    image, _ = shown(CHARUCO)
    other = Board(kind="charuco", columns=6, rows=4, dictionary="DICT_5X5_50")
    assert find_board(image, other) is None
    assert (other_board(image, other) or "").startswith("markers of DICT_4X4")
    smaller = Board(kind="charuco", columns=4, rows=3)
    assert "marker 11, which a board of 4x3 squares does not have" in (other_board(image, smaller) or "")
    assert other_board(torch.full((200, 300, 3), 90, dtype=torch.uint8), CHESSBOARD) is None


@pytest.mark.parametrize("sigma", [2.0, 4.0, 8.0])
def test_clutter_is_no_other_chessboard(sigma: float) -> None:
    for seed in range(5):
        noise = np.random.default_rng(seed).standard_normal((240, 320)).astype(np.float32)
        spots = cv2.GaussianBlur(noise, (0, 0), sigma)
        grey = torch.from_numpy((128 + 60 * spots / spots.std()).clip(0, 255).astype(np.uint8))
        assert other_board(grey[..., None].expand(-1, -1, 3), Board(columns=9, rows=6)) is None


def test_points_are_a_grid_in_metres() -> None:
    points = CHESSBOARD.points()
    assert points.shape == (CHESSBOARD.corners, 3)
    assert points[0].tolist() == [0.0, 0.0, 0.0]
    assert points[1].tolist() == pytest.approx([0.03, 0.0, 0.0])
    assert points[6].tolist() == pytest.approx([0.0, 0.03, 0.0])
    assert CHARUCO.points()[0].tolist() == pytest.approx([0.04, 0.04, 0.0])


def test_symmetry() -> None:
    assert not CHESSBOARD.is_symmetric
    assert Board(columns=7, rows=7).is_symmetric
    assert not Board(kind="charuco", columns=6, rows=6).is_symmetric


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"columns": 2}, "columns: expected 3 to 100 squares, got 2"),
        ({"square": 0.0}, "square: expected a length above 0"),
        ({"marker": 1.0}, "marker: expected a share"),
        ({"kind": "charuco", "dictionary": "DICT_1X1"}, "dictionary: expected one of DICT_4X4"),
        ({"kind": "charuco", "columns": 12, "rows": 10}, "DICT_4X4_50 holds 50 markers, the board needs 60"),
    ],
)
def test_wrong_boards(changes: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Board(**changes)
    assert "DICT_4X4_50" in dictionaries()
