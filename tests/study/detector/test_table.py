"""The table of a detector's errors: what was put into made-up detections comes out, and no recording decides it."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.hand import posture
from torchhand.study.detector import DetectedRecording, DetectorErrors, detector_errors, error_table

DOUBLE = torch.float64
KINEMATICS = load_hand_model().kinematics("right", dtype=DOUBLE)
CAMERA = assumed_camera(640, 480, horizontal_fov_deg=50.0)
TIP, BEYOND, STD = 8, 0.006, 0.004


def _points(frames: int, generator: torch.Generator) -> Tensor:
    poses = posture("open", dtype=torch.float64).to(DOUBLE).repeat(frames, 1)
    poses[:, 3:6] = 0.7 * torch.randn(frames, 3, generator=generator, dtype=DOUBLE)
    poses[:, 6:] += 0.1 * torch.rand(frames, 30, generator=generator, dtype=DOUBLE)
    turn = rotation_from_vector(torch.tensor((math.pi / 2, 0.0, 0.0), dtype=DOUBLE))
    points = KINEMATICS(poses, KINEMATICS.default_shape).keypoints @ turn.T
    return points + torch.tensor((0.0, 0.0, 0.6), dtype=DOUBLE)


def _recording(seed: int, *, std: float = STD, scale: float = 1.0) -> DetectedRecording:
    """A tip that lies beyond the true one by a known length, and noise at the hand; scale: of the hand."""
    generator = torch.Generator().manual_seed(seed)
    truth = scale * _points(400, generator)
    bone = truth[:, TIP] - truth[:, TIP - 1]
    seen = truth.clone()
    seen[:, TIP] += scale * BEYOND * bone / bone.norm(dim=-1, keepdim=True)
    noise = scale * std * torch.randn(seen.shape, generator=generator, dtype=DOUBLE)
    noise[..., 2] = 0
    return DetectedRecording(
        name=f"recording {seed}",
        side="right",
        camera=CAMERA,
        truth=truth,
        points_px=CAMERA.project(seen + noise),
        points=2.0 * (truth - truth.mean(1, keepdim=True)) @ rotation_from_vector(torch.full((3,), 0.2, dtype=DOUBLE)),
    )


@pytest.mark.parametrize("scale", [0.8, 1.2])
def test_offset_and_spread_are_those_of_a_hand_of_our_size(scale: float) -> None:
    errors = detector_errors(_recording(1, scale=scale))
    offset, variance = errors.offset, errors.variance(errors.offset)
    assert float(offset[TIP]) == pytest.approx(BEYOND, abs=1e-3)
    others = [i for i in range(21) if i != TIP]
    assert float(offset[others].abs().max()) < 1e-3
    assert float(variance.sqrt().mean()) == pytest.approx(STD, rel=0.05)


def test_angles_do_not_depend_on_place_size_and_direction() -> None:
    errors = detector_errors(_recording(2)).angles
    told = errors.isfinite()
    assert int(told.any(0).sum()) >= 20
    assert float(errors[told].abs().max()) < 1e-6


def test_a_recording_that_is_worse_than_the_table_of_the_others_says_so() -> None:
    recordings = [detector_errors(_recording(seed, std=STD if seed < 4 else 2 * STD)) for seed in range(1, 5)]
    held_out = error_table(recordings)["held_out"]
    assert [held_out[f"recording {seed}"]["points"] for seed in (1, 2, 3)] == pytest.approx([1, 1, 1], abs=0.1)
    assert held_out["recording 4"]["points"] == pytest.approx(2.0, abs=0.1)


def test_the_table_is_that_of_the_median_recording() -> None:
    recordings = [detector_errors(_recording(seed, std=std)) for seed, std in ((1, 0.002), (2, 0.004), (3, 0.02))]
    table = error_table(recordings)
    assert table["points"]["index_tip"]["std_m"] == pytest.approx(0.004, rel=0.1)
    assert table["points"]["index_tip"]["along_m"] == pytest.approx(BEYOND, abs=1.5e-3)


def test_too_few_recordings_are_refused() -> None:
    one = DetectorErrors(
        name="one",
        frames=1,
        across=torch.zeros(1, 21, 2, dtype=DOUBLE),
        bones=torch.zeros(1, 21, 2, dtype=DOUBLE),
        angles=torch.zeros(1, 30, dtype=DOUBLE),
    )
    with pytest.raises(ValueError, match="expected 3 or more recordings, got 2"):
        error_table([one, one])


def _errors(angles: Tensor) -> DetectorErrors:
    frames = len(angles)
    nothing = torch.zeros(frames, 21, 2, dtype=DOUBLE)
    return DetectorErrors(name=f"{frames} frames", frames=frames, across=nothing, bones=nothing + 1, angles=angles)


def test_how_long_errors_last_is_told_by_successive_frames() -> None:
    generator = torch.Generator().manual_seed(3)
    lasting = [torch.randn(30, generator=generator, dtype=DOUBLE)]
    for _ in range(1999):
        lasting.append(0.9 * lasting[-1] + (1 - 0.81) ** 0.5 * torch.randn(30, generator=generator, dtype=DOUBLE))
    angles = 0.5 + torch.stack(lasting)  # what never changes is no error that lasts
    angles[::7, 3] = torch.nan
    angles[:, 5] = torch.nan
    errors = _errors(angles)
    assert errors.angle_correlation == pytest.approx(0.9, abs=0.02)
    single = _errors(torch.zeros(1, 30, dtype=DOUBLE))
    assert math.isnan(single.angle_correlation)
    assert error_table([errors, errors, single])["angle_correlation"] == pytest.approx(0.9, abs=0.02)
    assert error_table([single, single, single])["angle_correlation"] == 0.0
