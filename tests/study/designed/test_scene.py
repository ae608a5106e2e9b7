"""What is wrong with what cameras see is wrong by as much as the trial says."""

import math

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.geometry import vector_from_rotation
from torchhand.study.designed.scene import RenderedHand, rendered_hand, seen_hand
from torchhand.study.designed.trial import Trial


@pytest.fixture(scope="module")
def rendered() -> RenderedHand:
    """Three cameras."""
    prior = load_hand_model().prior(dtype=torch.float64)
    return rendered_hand(0, Trial(cameras=3), "dof26", prior, seed=0)


def test_cameras_stand_around_the_hand(rendered: RenderedHand) -> None:
    """All see it in the middle, 45 degrees apart, and none at the edge."""
    first, second, third = (view.camera for view in rendered.views)
    for one, other, degrees in ((first, second, 45), (second, third, 45), (first, third, 90)):
        turn = vector_from_rotation(other.rotation @ one.rotation.mT).norm()
        assert math.degrees(float(turn)) == pytest.approx(degrees, abs=1e-6)
    for view in rendered.views:
        assert bool(view.mask.any())
        assert not bool(view.mask[[0, -1]].any() | view.mask[:, [0, -1]].any())
        torch.testing.assert_close(view.points_px.mean(0), torch.tensor((319.5, 239.5)).double(), atol=80, rtol=0)


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_an_occluder_hides_its_share_and_the_points_behind(
    rendered: RenderedHand, share: float, generator: torch.Generator
) -> None:
    whole = rendered.views[0]
    view = seen_hand(rendered, Trial(occlusion=share, point_std_mm=1e-9), generator).views[0]
    assert not bool((view.mask & ~whole.mask).any())
    assert 1 - float(view.mask.sum()) / float(whole.mask.sum()) == pytest.approx(share, abs=0.005)
    x, y = whole.points_px.round().long().unbind(-1)
    is_seen = view.points_px.isfinite().all(-1)
    assert bool(view.mask[y, x][is_seen & whole.mask[y, x]].all())
    assert not bool(view.mask[y, x][~is_seen].any())


def test_points_are_off_and_missed_as_told(rendered: RenderedHand, generator: torch.Generator) -> None:
    trial = Trial(dropout=0.3, point_std_mm=4.0)
    seen = [view for _ in range(40) for view in seen_hand(rendered, trial, generator).views]
    true = [view for _ in range(40) for view in rendered.views]
    missed = torch.stack([one.points_px for one in seen]) - torch.stack([one.points_px for one in true])
    is_there = missed.isfinite().all(-1)
    assert float((~is_there).double().mean()) == pytest.approx(0.3, abs=0.03)
    focal = torch.stack([one.camera.intrinsics[0, 0] for one in true])[:, None, None]
    metres = missed * torch.stack([one.depth for one in true])[..., None] / focal
    assert 1e3 * float(metres[is_there].std()) == pytest.approx(4.0, rel=0.05)


def test_blur_rounds_what_is_narrow_and_keeps_what_is_wide(rendered: RenderedHand, generator: torch.Generator) -> None:
    blurred = seen_hand(rendered, Trial(blur_px=8.0), generator).views[0].mask
    plain = rendered.views[0].mask
    rim = (blurred ^ plain).sum()
    assert 0 < float(rim) < 0.2 * float(plain.sum())


def test_calibrations_are_wrong_as_told_but_for_the_first_cameras_place(
    rendered: RenderedHand, generator: torch.Generator
) -> None:
    trial = Trial(focal_error=0.1, centre_error_px=7.0, camera_turn_deg=2.0)
    turns = []
    for _ in range(60):
        seen = seen_hand(rendered, trial, generator).views
        for view, true in zip(seen, (one.camera for one in rendered.views), strict=True):
            torch.testing.assert_close(view.camera.intrinsics[0, 0], 1.1 * true.intrinsics[0, 0])
            torch.testing.assert_close(view.camera.intrinsics[0, 2], true.intrinsics[0, 2] + 7.0)
            centres = [-one.rotation.mT @ one.translation for one in (view.camera, true)]
            torch.testing.assert_close(*centres, atol=1e-12, rtol=0)
        torch.testing.assert_close(seen[0].camera.rotation, rendered.views[0].camera.rotation)
        turns.append(vector_from_rotation(seen[1].camera.rotation @ rendered.views[1].camera.rotation.mT))
    assert math.degrees(float(torch.stack(turns).std())) == pytest.approx(2.0, rel=0.2)


def test_missing_views_are_left_out(rendered: RenderedHand, generator: torch.Generator) -> None:
    counts = [len(seen_hand(rendered, Trial(missing_views=0.5), generator).views) for _ in range(40)]
    assert set(counts) == {0, 1, 2, 3}
    assert sum(counts) / 120 == pytest.approx(0.5, abs=0.15)
