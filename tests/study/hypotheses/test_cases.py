"""Pictures of a study: large ones are worked on at a bounded size, with a camera to match."""

from pathlib import Path

import cv2
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files import load_hand_model, read_picture
from torchhand.geometry import assumed_camera
from torchhand.hand import HandPose
from torchhand.image import WORKING_PIXELS
from torchhand.simulate import SceneSettings, render_sequence, scripted_motion
from torchhand.study.hypotheses import Given, HypothesisStudySettings, cases_of

TIMES = 4


@pytest.fixture(scope="module")
def photograph(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An open hand in 2560 × 1920 px, and its mask beside it."""
    folder = tmp_path_factory.mktemp("large")
    camera, generator = assumed_camera(640, 480), torch.Generator().manual_seed(0)
    kinematics = load_hand_model().kinematics("right", dtype=torch.float64)
    motion = scripted_motion("planar", 1, kinematics, camera, generator)
    (frame,) = render_sequence(kinematics, motion, camera, SceneSettings(), generator)
    for name, pixels in (("hand.png", frame.image), ("mask.png", frame.mask[..., None].expand(-1, -1, 3) * 255)):
        large = pixels.to(torch.uint8).repeat_interleave(TIMES, 0).repeat_interleave(TIMES, 1)
        cv2.imwrite(str(folder / name), large.numpy()[..., ::-1])
    return folder / "hand.png"


def test_a_large_photograph_is_studied_at_a_bounded_size(photograph: Path) -> None:
    given = Given(source=photograph, frames=(0,), mask=photograph.with_name("mask.png"))
    (case,) = cases_of(given, HypothesisStudySettings(), 0).cases
    assert case.camera.width * case.camera.height <= WORKING_PIXELS < 2560 * 1920
    assert case.image.shape[:2] == case.mask.shape == (case.camera.height, case.camera.width)
    # The same hand in the picture as it was before it was enlarged, up to what a silhouette leaves open.
    assert float(case.pose.dofs[2]) == pytest.approx(float(_found_small(photograph).dofs[2]), rel=0.03)


def _found_small(photograph: Path) -> HandPose:
    small = photograph.with_name("small.png")
    mask = photograph.with_name("small_mask.png")
    for source, target in ((photograph, small), (photograph.with_name("mask.png"), mask)):
        cv2.imwrite(str(target), read_picture(source).numpy()[::TIMES, ::TIMES, ::-1])
    (case,) = cases_of(Given(source=small, frames=(0,), mask=mask), HypothesisStudySettings(), 0).cases
    assert case.camera.width == 640
    return case.pose


def test_a_mask_of_another_size_is_told_in_pixels_of_the_photograph(photograph: Path, tmp_path: Path) -> None:
    mask = tmp_path / "mask.png"
    cv2.imwrite(str(mask), read_picture(photograph).numpy()[:100, :200, ::-1])
    with pytest.raises(InputError, match=r"mask\.png: expected a mask of 2560x1920 px, .* got 200x100"):
        cases_of(Given(source=photograph, frames=(0,), mask=mask), HypothesisStudySettings(), 0)
