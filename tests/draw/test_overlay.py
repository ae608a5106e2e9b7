"""One frame of the overlay: contour, second view, status."""

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.draw.overlay import (
    CONTOUR_COLOUR,
    KEYPOINT_COLOUR,
    STATUS_COLOURS,
    UNDETERMINED_COLOUR,
    draw_overlay,
    overlay_size,
)
from torchhand.draw.second_view import PAPER
from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera
from torchhand.hand import HandPose, posture
from torchhand.simulate import facing
from torchhand.view import HandProjector

WIDTH, HEIGHT = 240, 192
GREY = 90


def _projector(dtype: torch.dtype = torch.float64) -> HandProjector:
    camera = assumed_camera(WIDTH, HEIGHT, horizontal_fov_deg=48.0, dtype=dtype)
    return HandProjector(load_hand_model().kinematics("right", dtype=dtype), camera)


def _pose(name: str = "open", dtype: torch.dtype = torch.float64) -> Tensor:
    pose = posture(name, dtype=dtype)
    pose[:3] = torch.tensor((0.0, 0.09, 0.45))
    return pose


def _picture(width: int = WIDTH, height: int = HEIGHT) -> Tensor:
    return torch.full((height, width, 3), GREY, dtype=torch.uint8)


def _near(image: Tensor, colour: tuple[int, int, int], tolerance: int = 60) -> Tensor:
    return (image.int() - torch.tensor(colour, dtype=torch.int32)).abs().amax(-1) <= tolerance


def _grown(mask: Tensor, px: int) -> Tensor:
    return torch.from_numpy(cv2.dilate(mask.numpy().astype(np.uint8), np.ones((2 * px + 1,) * 2, np.uint8))).bool()


@pytest.mark.parametrize("name", ["open", "fist"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_contour_runs_along_the_outline_of_the_silhouette(name: str, dtype: torch.dtype) -> None:
    projector, pose, reference = _projector(dtype), _pose(name, dtype), facing("back").to(dtype)
    overlay = draw_overlay(_picture(), projector, HandPose.of(pose, reference), status="tracked", frame=7)
    drawn = _near(overlay[:HEIGHT, :WIDTH], CONTOUR_COLOUR, 110)
    drawn[:30] = False  # the line of text
    silhouette = projector.silhouette(pose, reference)
    inner = ~_grown(~silhouette, 1)
    edge = _grown(silhouette, 1) & ~inner
    edge[:30] = False
    assert not (drawn & ~_grown(silhouette, 2)).any()
    # Nearly every stretch of the silhouette's edge is drawn: no gaps of more than two pixels but at joints.
    assert (_grown(drawn, 2) & edge).sum() > 0.93 * edge.sum()
    if name == "open":  # every outline lies on the edge of an open hand but those of the palm and the thumb's ball
        assert (drawn & edge).sum() > 0.8 * drawn.sum()


def test_hidden_contours_are_not_drawn() -> None:
    """Fingers bent behind the palm leave no lines on the back of the hand."""
    projector, pose = _projector(), _pose("fist")
    overlay = draw_overlay(_picture(), projector, HandPose.of(pose, facing("back")), status="tracked", frame=0)
    points = projector.frames(pose, facing("back")).keypoints
    tips = projector.camera.project(points[[8, 12, 16]]).round().long()
    for x, y in tips.tolist():
        assert not _near(overlay[y - 3 : y + 4, x - 3 : x + 4], CONTOUR_COLOUR, 110).any()


def test_the_picture_stays_as_it_is_away_from_the_drawing() -> None:
    noise = torch.randint(0, 255, (HEIGHT, WIDTH, 3), generator=torch.Generator().manual_seed(0)).to(torch.uint8)
    before = noise.clone()
    projector, pose = _projector(), _pose()
    overlay = draw_overlay(noise, projector, HandPose.of(pose, facing("back")), status="tracked", frame=0)
    far = ~_grown(projector.silhouette(pose, facing("back")), 4)
    far[:30] = False
    assert torch.equal(overlay[:HEIGHT, :WIDTH][far], before[far])
    assert torch.equal(noise, before)  # the caller's picture is not drawn on


@pytest.mark.parametrize("status", ["lost", "no_hand"])
def test_a_lost_frame_has_neither_contour_nor_second_view(status: str) -> None:
    overlay = draw_overlay(_picture(), _projector(), None, status=status, frame=12)
    assert (overlay[30:HEIGHT, :WIDTH] == GREY).all()
    assert (overlay[:, WIDTH:] == torch.tensor(PAPER, dtype=torch.uint8)).all()


@pytest.mark.parametrize("status", STATUS_COLOURS)
def test_the_status_is_written_in_its_colour(status: str) -> None:
    overlay = draw_overlay(_picture(), _projector(), None, status=status, frame=12)
    line = overlay[:30, :WIDTH]
    assert _near(line, STATUS_COLOURS[status], 45).sum() > 8
    others = [colour for other, colour in STATUS_COLOURS.items() if other != status and other != "no_hand"]
    assert all(_near(line, colour, 25).sum() == 0 for colour in others)


def test_the_overlap_is_written_where_it_is_known() -> None:
    without, with_it = (
        draw_overlay(_picture(), _projector(), None, status="tracked", frame=3, iou=iou) for iou in (None, 0.875)
    )
    assert (without[:30] != with_it[:30]).any()
    assert torch.equal(without[30:], with_it[30:])


def test_keypoints_are_dots() -> None:
    points = torch.tensor(((50.0, 60.0), (120.25, 150.0), (float("nan"), 3.0)), dtype=torch.float64)
    points = torch.cat((points, torch.full((18, 2), 1e6, dtype=torch.float64)))  # far outside
    overlay = draw_overlay(_picture(), _projector(), None, status="tracked", frame=3, keypoints_px=points)
    dots = _near(overlay[:, :WIDTH], KEYPOINT_COLOUR, 100).nonzero()
    assert {(round(x / 50), round(y / 50)) for y, x in dots.tolist()} == {(1, 1), (2, 3)}


def test_the_second_view_shows_the_hand_beside_the_picture() -> None:
    overlay = draw_overlay(_picture(), _projector(), HandPose.of(_pose(), facing("back")), status="recovered", frame=0)
    is_hand = ~_near(overlay[:, WIDTH:], PAPER, 25)
    assert 0.05 < is_hand.double().mean() < 0.5
    border = torch.cat((is_hand[0], is_hand[-1], is_hand[:, 0], is_hand[:, -1]))
    assert not border.any()


@pytest.mark.parametrize(("width", "height"), [(360, 288), (641, 481), (64, 48), (48, 64), (30, 20)])
def test_sizes_are_even_and_as_announced(width: int, height: int) -> None:
    overlay = draw_overlay(
        _picture(width, height), _projector(), HandPose.of(_pose(), facing("back")), status="tracked", frame=10**6
    )
    assert tuple(overlay.shape) == (*overlay_size(width, height)[::-1], 3)
    assert overlay.shape[0] % 2 == 0
    assert overlay.shape[1] % 2 == 0
    assert overlay.shape[0] >= height
    assert overlay.shape[1] > width


def test_a_hand_half_behind_the_camera_is_drawn_without_failing() -> None:
    pose = _pose()
    pose[2] = 0.01
    overlay = draw_overlay(_picture(), _projector(), HandPose.of(pose, facing("palm")), status="tracked", frame=0)
    assert tuple(overlay.shape) == (*overlay_size(WIDTH, HEIGHT)[::-1], 3)
    assert _near(overlay[:, WIDTH:], PAPER, 25).double().mean() < 0.95  # the second view follows the hand


def test_an_unknown_status_is_named() -> None:
    with pytest.raises(ValueError, match="status: expected one of tracked, recovered, lost, no_hand, got 'found'"):
        draw_overlay(_picture(), _projector(), None, status="found", frame=0)


def test_fingers_that_are_not_determined_are_grey_and_told() -> None:
    projector, pose, reference = _projector(), _pose(), facing("back")
    points = projector.camera.project(projector.frames(pose, reference).keypoints)
    both = [
        draw_overlay(
            _picture(),
            projector,
            HandPose.of(pose, reference),
            status="tracked",
            frame=0,
            keypoints_px=points,
            undetermined=fingers,
        )[:HEIGHT, :WIDTH]
        for fingers in ((), ("index",))
    ]
    x, y = points[8].round().long().tolist()
    tip = (slice(y - 6, y + 7), slice(x - 6, x + 7))
    for colour in (CONTOUR_COLOUR, KEYPOINT_COLOUR):
        assert _near(both[0][tip], colour, 110).any()
        assert not _near(both[1][tip], colour, 60).any()
    assert _near(both[1][tip], UNDETERMINED_COLOUR, 40).sum() > 5
    other = tuple(slice(int(v) - 6, int(v) + 7) for v in points[20].flip(0))
    assert torch.equal(both[0][other], both[1][other])
    legend = both[1][-16:, :120] != both[0][-16:, :120]
    assert legend.any()
