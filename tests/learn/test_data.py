"""Random hands before random cameras: what the settings promise."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.hand import HandPrior
from torchhand.learn.data import HandPool, SampleSettings, draw_samples, hand_pool

EXACT = SampleSettings(scale=0.0, definition=0.0, noise=0.0, focal=0.0, missing=0.0)


@pytest.fixture(scope="module")
def pool() -> HandPool:
    model = load_hand_model()
    return hand_pool(
        HandPrior(model.skeleton, model.shape_space, dtype=torch.float64), model, 64, torch.Generator().manual_seed(3)
    )


def _draw(pool: HandPool, settings: SampleSettings, *, count: int = 2000, seed: int = 0) -> Any:
    rows = torch.arange(count) % len(pool)
    return draw_samples(pool, rows, settings, torch.Generator().manual_seed(seed))


def test_the_pool_holds_hands_of_the_prior(pool: HandPool) -> None:
    model = load_hand_model()
    prior = HandPrior(model.skeleton, model.shape_space, dtype=torch.float64)
    pose = torch.cat((torch.zeros(64, 6), pool.joints), -1).double()
    frames = model.kinematics(dtype=torch.float64)(pose, pool.shape.double())
    torch.testing.assert_close(pool.keypoints.double(), frames.keypoints, atol=1e-6, rtol=0)
    assert float(prior.constraints.violation(pose).worst.max()) < 1e-6
    torch.testing.assert_close(pool.bones[:, 0].double(), frames.rotation[:, 0], atol=1e-6, rtol=0)
    # A fingertip lies on the y axis of its bone, out from the joint before.
    along = (pool.keypoints[:, 8] - pool.keypoints[:, 7]) / (pool.keypoints[:, 8] - pool.keypoints[:, 7]).norm(
        dim=-1, keepdim=True
    )
    torch.testing.assert_close(along, pool.bones[:, 8, :, 1], atol=1e-5, rtol=0)


def test_without_errors_the_points_are_the_projections(pool: HandPool) -> None:
    samples = _draw(pool, EXACT)
    torch.testing.assert_close(
        samples.points_plane, samples.keypoints[..., :2] / samples.keypoints[..., 2:], atol=1e-6, rtol=0
    )
    assert bool(samples.seen.all())
    own = pool.keypoints[torch.arange(2000) % 64]
    for i, j in ((0, 12), (4, 20), (5, 17)):
        torch.testing.assert_close(
            (samples.keypoints[:, i] - samples.keypoints[:, j]).norm(dim=-1), (own[:, i] - own[:, j]).norm(dim=-1)
        )
    assert torch.equal(samples.joints, pool.joints[torch.arange(2000) % 64])


def test_hands_stand_where_the_settings_say(pool: HandPool) -> None:
    settings = replace(EXACT, palm=1.0, tilt_deg=40.0, distance=(0.4, 0.8), off_axis_deg=20.0)
    points = _draw(pool, settings).keypoints
    middle = points.mean(1)
    distance = middle.norm(dim=-1)
    assert 0.399 < float(distance.min()) < 0.41
    assert 0.79 < float(distance.max()) < 0.801
    off_axis = torch.rad2deg(torch.acos(middle[:, 2] / distance))
    assert 19 < float(off_axis.max()) < 20.01
    # Out of the back of the hand.
    out = torch.linalg.cross(points[:, 9] - points[:, 0], points[:, 5] - points[:, 17])
    tilt = torch.rad2deg(torch.acos(torch.nn.functional.normalize(out, dim=-1)[:, 2]))
    assert 35 < float(tilt.max()) < 60  # knuckles do not lie in the plane of the hand frame
    back = _draw(pool, replace(settings, palm=0.0)).keypoints
    out = torch.linalg.cross(back[:, 9] - back[:, 0], back[:, 5] - back[:, 17])
    assert bool((out[:, 2] < 0).all())
    roll = torch.atan2(*(points[:, 9] - points[:, 0])[:, :2].unbind(-1))
    assert float(torch.cat((roll.sin(), roll.cos())).mean().abs()) < 0.05


@pytest.mark.parametrize(("keypoint", "mm"), [(1, (9, 9, 9)), (7, (4, 6, 4)), (20, (4, 6, 4))])
def test_definitions_differ_by_what_is_said(keypoint: int, mm: tuple[float, ...], pool: HandPool) -> None:
    """Seen from two places by the same seed, the points that other makers would mean can be found again."""
    settings = replace(EXACT, definition=1.0, off_axis_deg=0.0, tilt_deg=0.0)
    exact, other = (_draw(pool, s, count=4000) for s in (replace(settings, definition=0.0), settings))
    depth = exact.keypoints[:, keypoint, 2:]
    shift = (other.points_plane - exact.points_plane)[:, keypoint] * depth
    sideways = float(shift.square().mean().sqrt()) * 1000
    assert 0.9 * min(mm) < sideways < 1.1 * max(mm)


def test_noise_focal_error_and_scale(pool: HandPool) -> None:
    exact = _draw(pool, EXACT)
    size = (exact.points_plane - exact.points_plane.mean(1, keepdim=True)).square().sum(-1).mean(1).sqrt()
    noisy = _draw(pool, replace(EXACT, noise=0.1)).points_plane - exact.points_plane
    fraction = (noisy / size[:, None, None]).std(dim=(1, 2))
    assert float(fraction.mean()) == pytest.approx(0.05, rel=0.1)
    assert float(fraction.max()) < 0.17
    focal = _draw(pool, replace(EXACT, focal=0.05)).points_plane / exact.points_plane
    assert float(focal[:, 0, 0].log().std()) == pytest.approx(0.05, rel=0.1)
    torch.testing.assert_close(focal, focal[:, :1, :1].expand_as(focal), atol=1e-3, rtol=1e-3)
    scaled = _draw(pool, replace(EXACT, scale=0.05)).keypoints
    lengths = [(points[:, 0] - points[:, 12]).norm(dim=-1) for points in (scaled, exact.keypoints)]
    assert float((lengths[0] / lengths[1]).log().std()) == pytest.approx(0.05, rel=0.1)


def test_missing_points(pool: HandPool) -> None:
    seen = _draw(pool, replace(EXACT, missing=0.1), count=5000).seen
    assert float((~seen[:, [0, 1, 5, 9]]).double().mean()) == pytest.approx(0.1, abs=0.015)
    gone = (~seen[:, 6:9]).all(1).double().mean()
    assert float(gone) == pytest.approx(0.1 / 5 + 0.1**3, abs=0.01)
    assert int(seen.sum(1).min()) >= 13


def test_the_same_seed_gives_the_same_samples(pool: HandPool) -> None:
    one, same, other = (_draw(pool, SampleSettings(), count=50, seed=seed) for seed in (1, 1, 2))
    assert torch.equal(one.points_plane, same.points_plane)
    assert torch.equal(one.seen, same.seen)
    assert not torch.equal(one.points_plane, other.points_plane)
    assert bool(one.points_plane.isfinite().all())
    part = one.part(slice(10, 20))
    assert torch.equal(part.keypoints, one.keypoints[10:20])


def test_hands_close_by_stay_before_the_camera(pool: HandPool) -> None:
    settings = SampleSettings(distance=(0.1, 0.1), tilt_deg=90.0, off_axis_deg=60.0)
    samples = _draw(pool, settings)
    assert float(samples.keypoints[..., 2].min()) > 0.049
    assert bool(samples.points_plane.isfinite().all())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"palm": 1.5}, "palm: expected 0 to 1, got 1.5"),
        ({"tilt_deg": 120.0}, "tilt_deg: expected 0 to 90, got 120.0"),
        ({"noise": math.nan}, "noise: expected 0 to 0.3, got nan"),
        ({"distance": (1.0, 0.5)}, "distance: expected two numbers from 0.1 to 100, the smaller first"),
    ],
)
def test_wrong_settings_are_named(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SampleSettings(**change)
