"""Two made-up results of one recording: how many angles contradict each other."""

from dataclasses import replace

import numpy as np
import pytest

from torchhand.errors import InputError
from torchhand.evaluate import stability
from torchhand.files import Track
from torchhand.hand import DOFS

FRAMES = 8
PIP, DIP, HELD = (DOFS.index(name) for name in ("index_pip_fe", "index_dip_fe", "ring_pip_fe"))


@pytest.fixture
def track() -> Track:
    """Two free angles, each known to 3°."""
    std = np.zeros((FRAMES, 36))
    std[:, [PIP, DIP]] = np.deg2rad(3.0)
    return Track(
        frame=np.arange(FRAMES),
        status=np.array(["tracked"] * FRAMES),
        pose=np.zeros((FRAMES, 36)),
        pose_std=std,
        keypoints3d=np.full((FRAMES, 21, 3), np.nan),
        keypoints2d=None,
        keypoints3d_cov=np.full((FRAMES, 21, 3, 3), np.nan),
        seconds=np.zeros(FRAMES),
        dof_names=DOFS,
        units="metres",
        convention="OpenCV",
        header={},
    )


def _moved(track: Track, degrees: dict[int, list[float]]) -> Track:
    pose, std = track.pose.copy(), track.pose_std.copy()
    for dof, angles in degrees.items():
        pose[:, dof] = np.deg2rad(angles)
    std[:, [PIP, DIP]] = np.deg2rad(4.0)  # with the other's 3°: 5°
    return replace(track, pose=pose, pose_std=std)


def test_angles_are_apart_beyond_three_of_their_combined_deviations(track: Track) -> None:
    other = _moved(track, {PIP: [0, 14.9, -14.9, 15.1, -15.1, 0, 0, 40], HELD: [90.0] * FRAMES})
    found = stability(track, other)
    assert set(found.joints) == {"index_pip_fe", "index_dip_fe"}
    assert found.joints["index_pip_fe"].fraction_apart == pytest.approx(3 / 8)
    assert found.joints["index_dip_fe"].fraction_apart == 0
    assert found.whole.fraction_apart == pytest.approx(3 / 16)
    assert found.joints["index_pip_fe"].median_deg == pytest.approx(14.9)
    assert found.whole.median_deg == 0
    assert found.whole.percentile95_deg == pytest.approx(np.percentile([0] * 11 + [14.9] * 2 + [15.1] * 2 + [40], 95))
    assert (found.frames, found.frames_in_one) == (8, 0)


def test_frames_are_matched_by_number_and_lost_ones_are_counted(track: Track) -> None:
    other = _moved(track, {PIP: [30.0] * FRAMES})
    other = replace(other, frame=other.frame + 4)  # 4 to 11: four in common
    other.pose[0] = np.nan
    track.pose[7] = np.nan
    found = stability(track, other)
    assert (found.frames, found.frames_in_one) == (2, 2)
    assert found.joints["index_pip_fe"].fraction_apart == 1


def test_results_that_cannot_be_compared_are_refused(track: Track) -> None:
    with pytest.raises(InputError, match="expected frames with a hand in both results, got none in 0 common frames"):
        stability(track, replace(track, frame=track.frame + FRAMES))
    with pytest.raises(InputError, match="expected joint angles that were free"):
        stability(track, replace(track, pose_std=np.zeros((FRAMES, 36))))
    with pytest.raises(InputError, match="dof_names: expected the 30 joint angles"):
        stability(track, replace(track, dof_names=tuple(f"dof{i}" for i in range(36))))
