"""The range of motion of a made-up track: its extremes, their frames and their standard deviations."""

from dataclasses import replace

import numpy as np
import pytest

from torchhand.errors import InputError
from torchhand.evaluate.without_truth.range_of_motion import range_of_motion
from torchhand.files import Track
from torchhand.hand import DOFS

FRAMES = 6


@pytest.fixture
def track() -> Track:
    """An index finger that closes by 10° a joint and frame, frame 4 lost, frame t known to t + 1 degrees; the middle
    finger's angles are held."""
    pose, std = np.zeros((FRAMES, 36)), np.zeros((FRAMES, 36))
    step = np.arange(FRAMES)
    for joint in ("mcp", "pip", "dip"):
        pose[:, DOFS.index(f"index_{joint}_fe")] = np.deg2rad(10.0 * step - 5)
        std[:, DOFS.index(f"index_{joint}_fe")] = np.deg2rad(1.0 + step)
    pose[4], std[4] = np.nan, np.nan
    nothing = np.full((FRAMES, 21, 3), np.nan)
    return Track(
        frame=10 + step,
        status=np.array(["tracked"] * 4 + ["lost", "recovered"]),
        pose=pose,
        pose_std=std,
        keypoints3d=nothing,
        keypoints2d=None,
        keypoints3d_cov=np.full((FRAMES, 21, 3, 3), np.nan),
        seconds=np.zeros(FRAMES),
        dof_names=DOFS,
        units="metres",
        convention="OpenCV",
        header={},
    )


def test_extremes_carry_their_frame_and_their_standard_deviation(track: Track) -> None:
    found = range_of_motion(track)
    index = found["index_pip_fe"]
    assert (index.smallest_frame, index.largest_frame) == (10, 15)
    assert index.smallest_deg == pytest.approx(-5)
    assert index.largest_deg == pytest.approx(45)
    assert index.smallest_std_deg == pytest.approx(1)
    assert index.largest_std_deg == pytest.approx(6)
    assert index.range_deg == pytest.approx(50)


def test_the_flexion_of_a_digit_is_summed_over_its_joints(track: Track) -> None:
    total = range_of_motion(track)["index_total_flexion"]
    assert total.range_deg == pytest.approx(150)
    assert total.largest_std_deg == pytest.approx(6 * np.sqrt(3))


def test_angles_that_were_held_are_left_out(track: Track) -> None:
    assert set(range_of_motion(track)) == {"index_mcp_fe", "index_pip_fe", "index_dip_fe", "index_total_flexion"}


def test_tracks_without_angles_are_refused(track: Track) -> None:
    with pytest.raises(InputError, match="expected at least one tracked frame, got none in 6 frames"):
        range_of_motion(replace(track, pose=np.full_like(track.pose, np.nan)))
    with pytest.raises(InputError, match="dof_names: expected the 30 joint angles"):
        range_of_motion(replace(track, dof_names=tuple(f"dof{number}" for number in range(36))))
