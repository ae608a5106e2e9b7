"""Calibration boards: chessboards and ChArUco boards, found in pictures to a fraction of a pixel, and drawn."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from torchhand.image import WORKING_PIXELS, PicturePart

_CHESSBOARD_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
_CHARUCO_SHIFT = 0.0 if int(cv2.__version__.split(".")[0]) >= 5 else 0.5  # px: OpenCV 4 counts from a pixel's corner
_MIN_CORNERS = 6  # of a ChArUco board that is partly hidden
_REACH, _MAX_REACH_PX = 0.25, 8  # of the refinement of a corner, relative to a square's side
_SMALLEST = 3  # squares per side of the smallest board that can be told from clutter
_SMALLEST_OTHER = 5
"""Squares per side of the smallest chessboard that is told where another one is looked for. Of 419 photographs of hands
without a board 71 % seem to show one of 4xN squares, the smallest that OpenCV looks for, and none a larger one."""


@dataclass(frozen=True, kw_only=True)
class Board:
    """A flat board of black and white squares; its frame has x along the rows, y down the columns, z into the board.

    The origin is a chessboard's inner corner next to its black corner square, and the outer corner of a ChArUco board's
    first square.
    """

    kind: Literal["chessboard", "charuco"] = "chessboard"
    columns: int = 9
    """Squares, not inner corners; 3 or more."""
    rows: int = 6
    square: float = 0.025
    """Side of a square, metres."""
    marker: float = 0.75
    """Side of a ChArUco marker relative to its square, between 0 and 1."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's name of the ChArUco markers."""

    def __post_init__(self) -> None:
        for name in ("columns", "rows"):
            if not _SMALLEST <= getattr(self, name) <= 100:
                raise ValueError(f"{name}: expected {_SMALLEST} to 100 squares, got {getattr(self, name)}")
        if not 0 < self.square < float("inf"):
            raise ValueError(f"square: expected a length above 0 metres, got {self.square}")
        if not 0 < self.marker < 1:
            raise ValueError(f"marker: expected a share of the square between 0 and 1, got {self.marker}")
        if self.kind == "charuco":
            if self.dictionary not in dictionaries():
                raise ValueError(f"dictionary: expected one of {', '.join(dictionaries())}, got {self.dictionary!r}")
            count = self.columns * self.rows // 2
            available = len(_dictionary(self.dictionary).bytesList)
            if count > available:
                raise ValueError(f"dictionary: {self.dictionary} holds {available} markers, the board needs {count}")

    @property
    def corners(self) -> int:
        """Number of inner corners."""
        return (self.columns - 1) * (self.rows - 1)

    @property
    def is_symmetric(self) -> bool:
        """Whether the board looks the same upside down, so that several cameras may number its corners differently."""
        return self.kind == "chessboard" and (self.columns + self.rows) % 2 == 0

    def points(self) -> Float[Tensor, "corners 3"]:
        """Inner corners in the board's frame, row by row, metres, float64."""
        shift = 0.0 if self.kind == "chessboard" else 1.0
        y, x = torch.meshgrid(
            torch.arange(self.rows - 1, dtype=torch.float64) + shift,
            torch.arange(self.columns - 1, dtype=torch.float64) + shift,
            indexing="ij",
        )
        return self.square * torch.stack((x, y, torch.zeros_like(x)), -1).flatten(0, 1)


@dataclass(frozen=True, kw_only=True)
class BoardCorners:
    """What was found of a board in one picture."""

    ids: Int[Tensor, "found"]
    """Numbers of the inner corners, in the order of `Board.points`."""
    points_px: Float[Tensor, "found 2"]


def find_board(image: UInt8[Tensor, "height width 3"], board: Board) -> BoardCorners | None:
    """The inner corners seen of the board, float64; None where it is not there.

    A chessboard must be seen whole, with a light margin around; of one that is not symmetric the numbering starts
    next to the black one of two opposite corner squares. A ChArUco board may be hidden in part. Boards are searched in
    pictures of at most `torchhand.image.WORKING_PIXELS`, larger ones reduced; corners are refined at the full size.
    """
    grey = cv2.cvtColor(np.ascontiguousarray(image.numpy()), cv2.COLOR_RGB2GRAY)
    search, part = _searched(grey)
    if board.kind == "chessboard":
        found, corners = cv2.findChessboardCornersSB(
            search, (board.columns - 1, board.rows - 1), flags=_CHESSBOARD_FLAGS
        )
        if not found:
            return None
        grid = np.asarray(corners, dtype=np.float32).reshape(board.rows - 1, board.columns - 1, 2)
        if not board.is_symmetric and _begins_at_white(search, grid):
            grid = grid[::-1, ::-1]
        return BoardCorners(ids=torch.arange(board.corners), points_px=_refined(grey, part, grid.reshape(-1, 2)))
    corners, ids, _, _ = cv2.aruco.CharucoDetector(_charuco(board)).detectBoard(search)
    if ids is None or len(ids) < _MIN_CORNERS:
        return None
    numbers = torch.from_numpy(np.asarray(ids).reshape(-1).astype(np.int64))
    columns, rows = (numbers % (board.columns - 1)).unique(), (numbers // (board.columns - 1)).unique()
    if len(columns) < 2 or len(rows) < 2:  # on one line
        return None
    # OpenCV 4.11 leaves some a pixel off where 5 does not: refined here, alike for both.
    points = np.asarray(corners, dtype=np.float32).reshape(-1, 2) - np.float32(_CHARUCO_SHIFT)
    return BoardCorners(ids=numbers, points_px=_refined(grey, part, points, min(_REACH, 0.5 * (1 - board.marker))))


def other_board(image: UInt8[Tensor, "height width 3"], board: Board) -> str | None:
    """What the picture shows instead of the board, as far as it can be told: another number of squares or markers."""
    grey, _ = _searched(cv2.cvtColor(np.ascontiguousarray(image.numpy()), cv2.COLOR_RGB2GRAY))
    if board.kind == "chessboard":
        flags = _CHESSBOARD_FLAGS | cv2.CALIB_CB_LARGER
        minimum = (_SMALLEST, _SMALLEST)
        found, _, meta = cv2.findChessboardCornersSBWithMeta(grey, minimum, flags)
        if not found:
            return None
        rows, columns = (count + 1 for count in np.asarray(meta).shape[:2])
        is_told = min(rows, columns) >= _SMALLEST_OTHER and {rows, columns} != {board.rows, board.columns}
        return f"a chessboard of {columns}x{rows} squares" if is_told else None
    for name in (board.dictionary, *dictionaries()):
        _, ids, _ = cv2.aruco.ArucoDetector(_dictionary(name)).detectMarkers(grey)
        largest = -1 if ids is None else int(np.max(ids))
        if name == board.dictionary and largest >= board.columns * board.rows // 2:
            return f"marker {largest}, which a board of {board.columns}x{board.rows} squares does not have"
        if name != board.dictionary and ids is not None and len(ids) >= 4:
            return f"markers of {name}"
    return None


def draw_board(board: Board, square_px: int = 100) -> UInt8[Tensor, "height width"]:
    """The board as a grey picture to print, with a white margin of one square."""
    size = ((board.columns + 2) * square_px, (board.rows + 2) * square_px)
    if board.kind == "charuco":
        return torch.from_numpy(_charuco(board).generateImage(size, marginSize=square_px))
    row, column = torch.meshgrid(torch.arange(board.rows), torch.arange(board.columns), indexing="ij")
    squares = torch.where((row + column) % 2 == 0, 0, 255).to(torch.uint8)
    large = squares.repeat_interleave(square_px, 0).repeat_interleave(square_px, 1)
    return torch.nn.functional.pad(large, (square_px,) * 4, value=255)


@lru_cache(maxsize=1)
def dictionaries() -> tuple[str, ...]:
    """Names of the square markers' dictionaries that OpenCV has."""
    return tuple(name for name in dir(cv2.aruco) if name.startswith("DICT_") and name[5].isdigit())


@lru_cache(maxsize=4)
def _charuco(board: Board) -> Any:
    size = (board.columns, board.rows)
    return cv2.aruco.CharucoBoard(size, board.square, board.marker * board.square, _dictionary(board.dictionary))


def _dictionary(name: str) -> Any:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _begins_at_white(grey: np.ndarray, grid: np.ndarray) -> bool:
    """Whether the outermost square beyond the grid's first corner is brighter than the one beyond its last."""
    ends = []
    for corners in (grid, grid[::-1, ::-1]):
        middle = corners[0, 0] - 0.5 * (corners[0, 1] - corners[0, 0]) - 0.5 * (corners[1, 0] - corners[0, 0])
        ends.append(float(cv2.getRectSubPix(grey, (3, 3), (float(middle[0]), float(middle[1]))).mean()))
    return ends[0] > ends[1]


def _searched(grey: np.ndarray) -> tuple[np.ndarray, PicturePart]:
    """The picture in which boards are searched, and where it lies in the whole one."""
    height, width = grey.shape
    part = PicturePart.of((0, 0), (width, height), WORKING_PIXELS)
    return (grey if part.size == part.part else cv2.resize(grey, part.size, interpolation=cv2.INTER_AREA)), part


def _refined(
    grey: np.ndarray, part: PicturePart, corners: np.ndarray, reach: float = _REACH
) -> Float[Tensor, "found 2"]:
    """Corners (n, 2) of the searched picture in the whole one, moved to where the gradients around them meet, within
    `reach` of the smallest square's side.

    Between the markers of a ChArUco board there is little room: a marker's edges in the window pull a corner away.
    """
    whole = part.whole_px(corners).astype(np.float32)
    distances = np.linalg.norm(whole[:, None] - whole[None], axis=-1)
    np.fill_diagonal(distances, np.inf)
    half = int(np.clip(reach * distances.min(), 2, _MAX_REACH_PX / part.scale))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    points = np.array(whole, order="C").reshape(-1, 1, 2)
    found = cv2.cornerSubPix(grey, points, (half, half), (-1, -1), stop)
    return torch.from_numpy(np.asarray(found, dtype=np.float64).reshape(-1, 2))
