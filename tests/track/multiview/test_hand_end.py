"""The hand told from the arm in two pictures of a stick that reaches in from their borders."""

import pytest
import torch
from torch import Tensor

from torchhand.fit.hull import silhouette_rays
from torchhand.geometry import Camera
from torchhand.simulate import named_rig
from torchhand.track.multiview.hand_end import HandEnd
from torchhand.track.multiview.hulls import Hulls
from torchhand.track.multiview.settings import HullOctreeSettings

TOP = -0.1  # height of the stick's upper end; y is down
LENGTH = 0.08  # of the "hand" at that end, metres
REACH = 1.25 * LENGTH


@pytest.fixture(scope="module")
def cameras() -> list[Camera]:
    """From the front and from the side."""
    return named_rig("frame2", size=(320, 240))


def _along(heights: Tensor) -> Tensor:
    """Places on the stick's axis."""
    return torch.stack((torch.zeros_like(heights), heights, torch.zeros_like(heights)), -1)


def _stick(camera: Camera, lower: float) -> Tensor:
    """Silhouette of an upright stick 4 cm thick, from its upper end down to a height."""
    ends = camera.project(_along(torch.tensor((TOP, lower), dtype=torch.float64)))
    x, y = torch.arange(camera.width)[None], torch.arange(camera.height)[:, None]
    half_px = 0.02 * float(camera.intrinsics[0, 0]) / 0.4
    return ((x - ends[0, 0]).abs() < half_px) & (y >= ends[0, 1]) & (y <= ends[1, 1])


def test_only_the_end_away_from_the_border_may_be_the_hand(cameras):
    end = HandEnd(cameras, [_stick(camera, 0.5) for camera in cameras], LENGTH)
    heights = torch.linspace(TOP + 0.002, 0.15, 60, dtype=torch.float64)
    depth = heights - TOP
    may_be = end(_along(heights))
    assert bool(may_be[depth < REACH - 0.01].all())
    assert not bool(may_be[depth > REACH + 0.01].any())


def test_what_does_not_reach_the_border_is_kept_whole(cameras):
    end = HandEnd(cameras, [_stick(camera, 0.1) for camera in cameras], LENGTH)
    assert bool(end(_along(torch.linspace(TOP, 0.1, 20, dtype=torch.float64))).all())


def test_views_that_are_missing_tell_nothing(cameras):
    heights = _along(torch.tensor((TOP + 0.01, 0.12), dtype=torch.float64))
    mask = _stick(cameras[0], 0.5)
    assert HandEnd(cameras, [None, None], LENGTH)(heights).tolist() == [True, True]
    assert HandEnd(cameras, [mask, None], LENGTH)(heights).tolist() == [True, False]


def test_rays_of_the_hand_are_chosen_in_every_view(cameras):
    masks = [_stick(camera, 0.5) for camera in cameras]
    rays = silhouette_rays(cameras, masks, torch.zeros(3, dtype=torch.float64), count=400)
    assert rays is not None
    chosen = HandEnd(cameras, masks, LENGTH).rays(rays, 60)
    assert len(chosen.views) == 2
    assert 40 <= len(chosen.points) <= 60
    assert float(chosen.points[:, 1].max()) < TOP + REACH + 0.02 < float(rays.points[:, 1].max())
    assert len(chosen.points) == sum(len(view.plane) for view in chosen.views)


def test_hull_of_the_hand_leaves_the_arm_out(cameras):
    masks = [_stick(camera, 0.5) for camera in cameras]
    hulls = Hulls(cameras, HullOctreeSettings())
    whole, hand = hulls.anywhere(masks).target, hulls.anywhere(masks, hand_length=LENGTH).target
    assert whole is not None
    assert hand is not None
    assert float(whole.inner[:, 1].max()) > TOP + REACH + 0.05
    assert TOP + REACH - 0.02 < float(hand.inner[:, 1].max()) < TOP + REACH + 0.02
    assert float(hand.points[:, 1].max()) < TOP + REACH + 0.02
    assert hand.rays is not None
    assert float(hand.rays.points[:, 1].max()) < TOP + REACH + 0.02


def test_a_view_that_does_not_meet_the_others_has_no_say(cameras):
    """Three views, of which one shows something else, from its border on."""
    three = [*cameras, named_rig("ring3", size=(320, 240))[1]]
    masks = [_stick(camera, 0.5) for camera in three]
    masks[2] = torch.zeros_like(masks[2])
    masks[2][:25, 5:25] = True
    hull = Hulls(three, HullOctreeSettings()).anywhere(masks, hand_length=LENGTH)
    assert hull.views == (0, 1)
    assert hull.target is not None
    assert TOP + REACH - 0.02 < float(hull.target.inner[:, 1].max()) < TOP + REACH + 0.02
