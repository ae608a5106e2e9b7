"""Models of qualities: fitted ones are the likeliest, their figures are of what they were not fitted to."""

import math

import pytest
import torch

from torchhand.devices import HOST
from torchhand.runs import settings_of
from torchhand.study.quality import FingerSample, calibrated, collect, collect_rigs, figures
from torchhand.study.quality.calibration import fitted, held_out
from torchhand.study.quality.sequences import sequence
from torchhand.track.quality import EVIDENCE


def _drawn(count: int, weights: torch.Tensor, bias: float) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    evidence = torch.randn(count, len(weights), generator=generator, dtype=torch.float64) * torch.tensor(
        (1.0, 3.0, 0.2)
    )
    chance = torch.rand(count, generator=generator, dtype=torch.float64)
    return evidence, chance < torch.sigmoid(bias + evidence @ weights)


def test_the_model_that_drew_the_samples_is_found() -> None:
    weights = torch.tensor((1.0, -0.5, 4.0), dtype=torch.float64)
    evidence, is_right = _drawn(20_000, weights, 0.7)
    model = fitted(evidence, is_right)
    assert model.bias == pytest.approx(0.7, abs=0.06)
    assert torch.allclose(model.weights, weights, atol=0.15)


def test_what_is_held_out_has_taught_nothing() -> None:
    """Right and wrong by chance cannot be told apart in sequences that were not fitted to, however few there are."""
    generator = torch.Generator().manual_seed(2)
    evidence = torch.randn(400, 30, generator=generator, dtype=torch.float64)
    is_right = torch.rand(400, generator=generator) < 0.5
    group = torch.arange(400) // 4
    assert figures(fitted(evidence, is_right)(evidence), is_right)["auc"] > 0.6
    assert abs(figures(held_out(evidence, is_right, group), is_right)["auc"] - 0.5) < 0.1


def test_figures_count_by_interval() -> None:
    told = torch.tensor((0.05, 0.6, 0.7, 0.95, 1.0), dtype=torch.float64)
    is_right = torch.tensor((False, True, False, True, True))
    found = figures(told, is_right)
    assert found["mean_right_number"] == {
        "0 to 0.1": [0.05, 0.0, 1],
        "0.5 to 0.75": [0.65, 0.5, 2],
        "0.9 to 1": [0.975, 1.0, 2],
    }
    assert found["right"] == 0.6
    assert found["auc"] == pytest.approx(5 / 6, abs=1e-3)


def test_too_few_samples_are_refused() -> None:
    one = FingerSample(evidence=torch.zeros(5, len(EVIDENCE)), error_m=torch.zeros(5), farthest_m=0.0, sequence=0)
    with pytest.raises(ValueError, match="expected"):
        calibrated([one])


@pytest.mark.slow
def test_collected_samples_are_of_tracked_hands() -> None:
    """One sequence, twice: the same, and of a size that a tracked hand may have."""
    first, again = (next(iter(collect(settings_of("contour_full"), 1, 0, frames=5))) for _ in range(2))
    assert len(first) > 5  # of both passes
    assert all(torch.equal(one.evidence, other.evidence) for one, other in zip(first, again, strict=True))
    assert all(0 < float(one.error_m.max()) < 0.3 for one in first)


@pytest.mark.slow
def test_samples_of_rigs_come_from_all_update_rules() -> None:
    settings = [settings_of(name) for name in ("hull_lm", "contour_full")]
    found = list(collect_rigs(settings, 4, 0, frames=2))
    assert [some[0].sequence for some in found if some] == [0, 1, 2, 3]
    assert all(0 < float(one.error_m.max()) < 0.3 for some in found for one in some)


@pytest.mark.parametrize("count", [1, 3])
def test_all_cameras_see_the_hand_where_the_first_one_does(count: int) -> None:
    own = sequence(torch.Generator().manual_seed(4), 1, cameras=count)
    [frame] = own.frames
    assert len(own.cameras) == len(frame.views) == count
    middle = frame.keypoints[9]  # knuckle of the middle finger
    places = torch.stack([camera.project(middle) for camera in own.cameras])
    depths = torch.stack([camera.cam_from_world(middle)[2] for camera in own.cameras])
    assert float((places - places[0]).norm(dim=-1).max()) < 25
    assert float((depths / depths[0] - 1).abs().max()) < 0.1
    sights = torch.stack([camera.rotation[2] for camera in own.cameras])
    assert bool(((sights @ sights.mT).tril(-1) < math.cos(math.radians(10.0))).all())


def test_a_detector_sees_the_hand_in_the_pictures_of_all_cameras() -> None:
    own = sequence(torch.Generator().manual_seed(4), 2, has_detector=True, cameras=3)
    alone = sequence(torch.Generator().manual_seed(4), 2, cameras=3)
    one, other = (some.frames[0].views[1].image for some in (own, alone))
    assert one is not None
    assert other is not None
    assert torch.equal(one, other)
    for frame in own.frames:
        for camera, view in zip(own.cameras, frame.views, strict=True):
            assert view.keypoints is not None
            assert view.keypoints.points is not None
            off = (view.keypoints.points_px - camera.project(frame.keypoints)).norm(dim=-1)
            assert float(off.max()) < 80  # an eighth of the picture's width
            seen = camera.cam_from_world(frame.keypoints)
            palm = (seen - seen[:1])[[5, 9, 13, 17]]
            assert float((view.keypoints.points[[5, 9, 13, 17]] - palm).norm(dim=-1).max()) < 0.03


@pytest.mark.slow
def test_a_device_gives_the_samples_of_the_processor(device: torch.device) -> None:
    own, there = (next(iter(collect(settings_of("contour_full"), 1, 0, where, frames=5))) for where in (HOST, device))
    assert len(own) == len(there)
    for one, other in zip(own, there, strict=True):
        torch.testing.assert_close(one.error_m, other.error_m, atol=1e-4, rtol=1e-2)
