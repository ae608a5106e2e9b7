"""Square views: where they look, what is up in them, and which rays their pixels stand for."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.geometry import rotation_from_vector
from torchhand.propose.views import SquareViews, palm_middle, views_towards


def _rays(generator: torch.Generator, *batch: int) -> tuple[Tensor, Tensor, Tensor]:
    centre = torch.randn(*batch, 3, generator=generator, dtype=torch.float64) + torch.tensor((0.0, 0.0, 3.0))
    up = torch.randn(*batch, 3, generator=generator, dtype=torch.float64)
    return centre, up, 0.1 + torch.rand(batch, generator=generator, dtype=torch.float64)


def test_a_view_looks_at_its_centre_and_holds_up_upwards(generator: torch.Generator) -> None:
    centre, up, reach = _rays(generator, 50)
    views = views_towards(centre, up, reach)
    turn = views.cam_from_view
    torch.testing.assert_close(turn @ turn.mT, torch.eye(3).double().expand(50, 3, 3))
    torch.testing.assert_close(torch.linalg.det(turn), torch.ones(50).double())
    seen = (turn.mT @ centre[..., None]).squeeze(-1)
    torch.testing.assert_close(seen[:, :2], torch.zeros(50, 2).double(), atol=1e-12, rtol=0)
    assert bool((seen[:, 2] > 0).all())
    upwards = (turn.mT @ up[..., None]).squeeze(-1)
    torch.testing.assert_close(upwards[:, 0], torch.zeros(50).double(), atol=1e-12, rtol=0)
    assert bool((upwards[:, 1] < 0).all())


def test_up_along_the_axis_gives_some_rotation() -> None:
    centre = torch.tensor([[0.0, 0.0, 1.0], [0.3, 0.4, 1.2]]).double()
    turn = views_towards(centre, 2 * centre, torch.ones(2).double()).cam_from_view
    torch.testing.assert_close(turn @ turn.mT, torch.eye(3).double().expand(2, 3, 3))


def test_pixels_are_the_rays_of_a_turned_camera(generator: torch.Generator) -> None:
    centre, up, reach = _rays(generator)
    view, side = views_towards(centre, up, reach), 6
    for row, column in ((0, 0), (5, 2), (3, 5)):
        x_square, y_square = (2 * column + 1) / side - 1, (2 * row + 1) / side - 1
        square = torch.stack((x_square * reach, y_square * reach, torch.ones_like(reach)))
        x, y, z = view.cam_from_view @ square
        torch.testing.assert_close(view.plane(side)[row, column], torch.stack((x / z, y / z)))


def test_what_lies_behind_is_nowhere() -> None:
    about = rotation_from_vector(torch.tensor((0.0, math.radians(80.0), 0.0)))
    plane = SquareViews(cam_from_view=about, reach=torch.tensor(1.0)).plane(8)
    is_ahead = plane.isfinite().all(-1)
    assert bool(is_ahead[:, 0].all())
    assert not bool(is_ahead[:, -1].any())


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...], generator: torch.Generator) -> None:
    centre, up, reach = _rays(generator, *batch)
    whole = views_towards(centre, up, reach).plane(4)
    rows = zip(centre.reshape(-1, 3), up.reshape(-1, 3), reach.reshape(-1), strict=True)
    loop = torch.stack([views_towards(*row).plane(4) for row in rows])
    torch.testing.assert_close(whole.reshape(-1, 4, 4, 2), loop)


def test_the_palm_is_where_wrist_and_knuckles_are(generator: torch.Generator) -> None:
    points = torch.randn(21, 3, generator=generator)
    expected = (points[0] + points[5] + points[9] + points[13] + points[17]) / 5
    torch.testing.assert_close(palm_middle(points), expected)
