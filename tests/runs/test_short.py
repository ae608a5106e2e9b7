"""The short way finds what the long way finds, and says in one line what it cannot use."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.steps import assert_equal, right_hand
from tests.steps import run as stepped
from tests.studio import Studio
from torchhand.errors import InputError
from torchhand.files import open_source, save_cameras, write_video
from torchhand.geometry import assumed_camera
from torchhand.runs.pictures import fit_pose
from torchhand.runs.request import settings_of
from torchhand.runs.short import fit_hand, track
from torchhand.track import Tracker


def test_the_estimates_are_those_of_a_tracker_that_steps_through_the_pictures(tmp_path: Path) -> None:
    film = Studio().film("planar", 3, pace=6.0)
    path = tmp_path / "video.mp4"
    with write_video(path, width=film.camera.width, height=film.camera.height) as video:
        for image in film.images:
            video.write(image)
    settings = settings_of("contour_planar")
    camera = assumed_camera(film.camera.width, film.camera.height)
    found = list(track(path, settings=settings))
    tracker = Tracker(right_hand(), camera, settings)
    frames = open_source(path)
    _, expected = stepped(tracker, [frame.image for frame in frames])
    frames.close()
    assert [one.status for one in found] == ["tracked"] * 3
    for one, other in zip(found, expected, strict=True):
        assert_equal(one, other)
    save_cameras([camera], tmp_path / "cameras.json")
    for given in (camera, tmp_path / "cameras.json", str(tmp_path / "cameras.json")):
        assert_equal(next(track(path, settings=settings, camera=given)), expected[0])


def test_a_camera_is_one_or_its_file_and_of_such_pictures(tmp_path: Path) -> None:
    grey, other = torch.full((120, 160, 3), 90, dtype=torch.uint8), assumed_camera(320, 240)
    save_cameras([other], tmp_path / "cameras.json")
    for fit in (fit_hand, fit_pose):
        with pytest.raises(InputError, match=r"^camera: expected a camera of 160x120 px.* got 320x240"):
            fit(grey, camera=other)
        with pytest.raises(InputError, match=r"cameras.json: expected a camera of 160x120 px.* got 320x240"):
            fit(grey, camera=tmp_path / "cameras.json")


def test_a_picture_without_a_hand_is_refused() -> None:
    with pytest.raises(InputError, match="picture: "):
        fit_hand(torch.full((120, 160, 3), 90, dtype=torch.uint8))
    with pytest.raises(InputError, match=r"nowhere\.jpg"):
        fit_hand("nowhere.jpg")
    with pytest.raises(InputError, match=r"nowhere\.mp4"):
        list(track("nowhere.mp4"))


def test_the_package_of_the_trackers_is_the_short_way_too() -> None:
    """`torchhand.track(...)`, whether or not the package of that name has been imported before."""
    for before in ("", "import torchhand.track.scene; "):
        code = f"import torchhand; {before}next(iter(torchhand.track('nowhere.mp4')))"
        found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert "InputError" in found.stderr
        assert "nowhere.mp4" in found.stderr


def test_a_picture_may_be_an_array_and_must_be_rgb() -> None:
    grey = np.full((120, 160, 3), 90, dtype=np.uint8)
    fixed = grey.copy()
    fixed.flags.writeable = False
    for picture in (grey, grey[:, ::-1], fixed):
        with pytest.raises(InputError, match="picture: no hand"):
            fit_hand(picture)
    for wrong in (grey[..., 0], grey[..., :2], grey[:0], grey / 255, torch.from_numpy(grey).float()):
        for fit in (fit_hand, fit_pose):
            with pytest.raises(InputError, match=r"picture: expected RGB, uint8 \(height, width, 3\), got"):
                fit(wrong)


def test_what_is_no_array_is_no_picture() -> None:
    """In a process of its own, in which no types are checked, as a user has it."""
    code = "import torchhand; torchhand.fit_hand([[1]])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    told = found.stderr.strip().splitlines()[-1]
    assert told.endswith("InputError: picture: expected RGB, uint8 (height, width, 3), got list")
