from dataclasses import replace
from itertools import combinations

import pytest
import torch

from torchhand.track.multiview.hulls import Hull, Hulls
from torchhand.track.multiview.settings import HullOctreeSettings
from torchhand.volume import HullField


def _inside_fraction(target, points) -> float:
    value, _ = target.field.sample(points)
    return float((value < 0.003).double().mean())


def _pitch(hull: Hull) -> float:
    assert hull.target is not None
    assert isinstance(hull.target.field, HullField)
    return hull.target.field.pitch


@pytest.fixture(scope="module")
def skin(rig_hand, pose_at):
    pose, reference = pose_at()
    return rig_hand(pose, root_reference=reference).vertices


def test_hull_holds_the_hand_anywhere_and_near(rig, pose_at, masks_of, skin):
    hulls, masks = Hulls(rig, HullOctreeSettings(tracked_side=0.512)), masks_of(pose_at())
    whole, near = hulls.anywhere(masks), hulls.near(masks, skin.mean(0))
    for hull in (whole, near):
        assert hull.views == (0, 1, 2, 3)
        assert _inside_fraction(hull.target, skin) > 0.97
    assert _pitch(near) == pytest.approx(0.512 / 2**7)


def test_a_hand_that_leaves_one_of_two_pictures_is_where_the_other_sees_it(rig, pose_at, masks_of, skin):
    front, side = masks_of(pose_at())[:2]
    middle = int(side.any(0).nonzero().double().mean())
    cut = replace(rig[1], width=middle)
    is_beyond = cut.project(skin)[:, 0] > middle + 2
    assert 0.3 < float(is_beyond.double().mean()) < 0.7

    def held(cameras, masks, **settings) -> float:
        hull = Hulls(cameras, HullOctreeSettings(**settings)).near(masks, skin.mean(0))
        return _inside_fraction(hull.target, skin[is_beyond])

    assert held([rig[0], cut], [front, side[:, :middle]]) > 0.97
    assert held([rig[0], cut], [front, side[:, :middle]], min_views=2) < 0.1
    assert held(rig[:2], [front, side]) > 0.97


def test_hull_away_from_the_hand_is_none(rig, pose_at, masks_of):
    hulls = Hulls(rig, HullOctreeSettings(tracked_side=0.1))
    hull = hulls.near(masks_of(pose_at()), torch.tensor((0.25, -0.2, 0.2), dtype=torch.float64))
    assert hull.target is None
    assert hull.reason == "the silhouettes of the views do not meet"


def test_one_view_that_shows_something_else_is_left_out(rig, pose_at, masks_of, skin):
    masks = masks_of(pose_at())
    masks[1] = torch.zeros_like(masks[1])
    masks[1][5:25, 5:25] = True
    hull = Hulls(rig, HullOctreeSettings()).anywhere(masks)
    assert hull.views == (0, 2, 3)
    assert _inside_fraction(hull.target, skin) > 0.97


def test_views_without_silhouette_do_not_carve(rig, pose_at, masks_of, skin):
    hulls = Hulls(rig, HullOctreeSettings())
    for first, second in combinations(range(4), 2):
        masks = masks_of(pose_at())
        masks[first], masks[second] = None, torch.zeros_like(masks[second])
        hull = hulls.anywhere(masks)
        assert set(hull.views) == {0, 1, 2, 3} - {first, second}
        assert hull.target is None or _inside_fraction(hull.target, skin) > 0.97


def test_too_few_views_are_told(rig, pose_at, masks_of):
    hulls, masks = Hulls(rig, HullOctreeSettings(), min_views=3), masks_of(pose_at())
    hull = hulls.anywhere([masks[0], masks[1], None, torch.zeros_like(masks[3])])
    assert hull.target is None
    assert hull.reason == "a silhouette in 2 of 4 views (1 missing), 3 are needed"


def test_silhouettes_that_do_not_meet(rig, pose_at, masks_of):
    low, high = masks_of(pose_at(place=(0.0, 0.16, 0.0))), masks_of(pose_at(place=(0.12, -0.02, 0.0)))
    hull = Hulls(rig[:2], HullOctreeSettings()).anywhere([torch.zeros_like(low[0]) | low[0], _moved(high[1])])
    assert hull.target is None
    assert hull.reason == "the silhouettes of the views do not meet"


def _moved(mask):
    """To the picture's upper edge."""
    moved = torch.zeros_like(mask)
    moved[:20, 100:140] = True
    return moved


def test_given_cube(rig, pose_at, masks_of, skin):
    settings = HullOctreeSettings(side=0.4, centre=(0.0, 0.0, 0.0), tracked_side=None, level=6)
    hull = Hulls(rig, settings).near(masks_of(pose_at()), torch.full((3,), torch.nan, dtype=torch.float64))
    assert _pitch(hull) == pytest.approx(0.4 / 64)


@pytest.mark.parametrize(
    ("name", "value"), [("level", 0), ("side", -1.0), ("tracked_side", 0.0), ("margin_px", -1), ("min_views", 0)]
)
def test_settings_refuse(name, value):
    with pytest.raises(ValueError, match=f"octree.{name}"):
        HullOctreeSettings(**{name: value})
