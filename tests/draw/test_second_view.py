"""The hand alone, from beside the camera."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torchhand.draw.second_view import PAPER, draw_second_view
from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.hand import posture
from torchhand.simulate import facing
from torchhand.view import HandProjector

SIZE = 80
PROJECTOR = HandProjector(load_hand_model().kinematics("right", dtype=torch.float64), assumed_camera(200, 160))


def _is_hand(view: Tensor) -> Tensor:
    return (view.int() - torch.tensor(PAPER, dtype=torch.int32)).abs().amax(-1) > 25


def _pose(x: float = 0.0, y: float = 0.05, z: float = 0.45) -> Tensor:
    pose = posture("flat", dtype=torch.float64)
    pose[:3] = torch.tensor((x, y, z))
    return pose


def test_the_place_of_the_hand_does_not_matter() -> None:
    near, far = (draw_second_view(PROJECTOR, pose, facing("back"), SIZE) for pose in (_pose(), _pose(0.2, -0.1, 0.9)))
    assert (near.int() - far.int()).abs().max() <= 2


def test_the_camera_goes_round_the_hand() -> None:
    """A flat hand seen from its side is as thin as the hand is thick; turning the hand back undoes the turn."""
    widths = []
    for turn_deg in (0.0, 50.0, 90.0):
        view = _is_hand(draw_second_view(PROJECTOR, _pose(), facing("back"), SIZE, turn_deg=turn_deg))
        columns = view.any(0).nonzero()
        widths.append(int(columns.max() - columns.min()) + 1)
    assert widths[0] > 1.4 * max(widths[1:])
    back = rotation_from_vector(torch.tensor((0.0, -math.radians(50), 0.0), dtype=torch.float64)) @ facing("back")
    turned = _is_hand(draw_second_view(PROJECTOR, _pose(), back, SIZE))
    front = _is_hand(draw_second_view(PROJECTOR, _pose(), facing("back"), SIZE, turn_deg=0.0))
    assert (turned ^ front).double().mean() < 0.02


def test_the_hand_is_upright_and_whole() -> None:
    for view in ("back", "palm"):
        hand = _is_hand(draw_second_view(PROJECTOR, _pose(), facing(view), SIZE))
        rows = hand.any(1).nonzero()
        assert 0.6 * SIZE < rows.max() - rows.min() < 0.95 * SIZE
        assert hand[: SIZE // 3].sum() < hand[SIZE // 2 : SIZE // 2 + SIZE // 3].sum()  # fingers above, palm below


def test_a_placed_camera_gives_the_same_view() -> None:
    rotation = rotation_from_vector(torch.tensor((0.3, 0.8, -0.2), dtype=torch.float64))
    camera = replace(
        PROJECTOR.camera, rotation=rotation, translation=torch.tensor((0.1, 0.2, 0.3), dtype=torch.float64)
    )
    placed = HandProjector(PROJECTOR.kinematics, camera)
    pose = _pose()
    pose[:3] = rotation.T @ (pose[:3] - camera.translation)
    view = draw_second_view(placed, pose, rotation.T @ facing("back"), SIZE)
    expected = draw_second_view(PROJECTOR, _pose(), facing("back"), SIZE)
    assert (view.int() - expected.int()).abs().double().mean() < 0.1


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_either_precision(dtype: torch.dtype) -> None:
    kinematics = load_hand_model().kinematics("left", dtype=dtype)
    projector = HandProjector(kinematics, assumed_camera(200, 160, dtype=dtype))
    view = draw_second_view(projector, _pose().to(dtype), facing("back").to(dtype), SIZE)
    right = draw_second_view(PROJECTOR, _pose(), facing("back"), SIZE, turn_deg=-50.0)
    mirrored = _is_hand(right).flip(1)  # a left hand is the mirror image of the right one
    assert (_is_hand(view) ^ mirrored).double().mean() < 0.02


def test_the_skin_is_drawn_where_a_hand_is_given() -> None:
    hand = load_hand_model().hand(dtype=torch.float64)
    quadrics, skin = (draw_second_view(PROJECTOR, _pose(), facing("back"), SIZE, hand=h) for h in (None, hand))
    one, other = _is_hand(quadrics), _is_hand(skin)
    assert 0.8 < float((one & other).sum() / (one | other).sum()) < 1
    assert (quadrics != skin).any()
