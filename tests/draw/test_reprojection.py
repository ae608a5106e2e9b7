"""The picture of a calibration shows where corners were seen and how far they are off."""

import pytest
import torch

from torchhand.draw.reprojection import draw_reprojection

WIDTH, HEIGHT = 400, 300


def grid() -> torch.Tensor:
    """Corners in the left half of the picture."""
    return torch.cartesian_prod(torch.linspace(20, 180, 6), torch.linspace(20, 280, 6)).double()


def test_cells_without_corners_stay_white_and_errors_are_red() -> None:
    points = grid()
    residuals = torch.full_like(points, 0.02)
    is_low = points[:, 1] > 150
    residuals[is_low] = 0.4
    picture = draw_reprojection("cam0", points, residuals, WIDTH, HEIGHT)
    assert picture.dtype == torch.uint8
    columns = picture.shape[1]
    cells = picture[60:-30, columns // 2 + 10 :].float()
    inside = cells[:, : cells.shape[1] // 2 - 30]
    assert bool((cells[:, cells.shape[1] // 2 + 30 : -20] == 255).all())
    redness = (inside[..., 0] - inside[..., 2]).mean(1)
    assert float(redness[: len(redness) // 3].mean()) < -20
    assert float(redness[-len(redness) // 3 :].mean()) > 0


def test_arrows_point_where_corners_are_off() -> None:
    points = torch.tensor([[200.0, 150.0], [200.0, 50.0]], dtype=torch.float64)
    residuals = torch.tensor([[0.5, 0.0], [-0.5, 0.0]], dtype=torch.float64)
    picture = draw_reprojection("cam0", points, residuals, WIDTH, HEIGHT).float()
    panel = picture[44 : 44 + 420, 12 : 12 + 560]
    scale = 560 / WIDTH
    for (x, y), sign in zip(points.tolist(), (1, -1), strict=True):
        row, column = round((y + 0.5) * scale), round((x + 0.5) * scale)
        ahead = panel[row - 1 : row + 2, min(column, column + sign * 12) : max(column, column + sign * 12)]
        behind = panel[
            row - 1 : row + 2, min(column - sign * 4, column - sign * 12) : max(column - sign * 4, column - sign * 12)
        ]
        assert float(ahead.amin(-1).amin(0).max()) < 200  # drawn all the way
        assert float(behind.amin()) > 250


def test_exact_corners_can_be_drawn() -> None:
    picture = draw_reprojection("cam0", grid(), torch.zeros(36, 2).double(), WIDTH, HEIGHT)
    assert float((picture != 255).float().mean()) > 0.02


def test_no_corners() -> None:
    with pytest.raises(ValueError, match="points: expected one or more, got none"):
        draw_reprojection("cam0", torch.zeros(0, 2), torch.zeros(0, 2), WIDTH, HEIGHT)
