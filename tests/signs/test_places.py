"""Where the tips are: against plain loops over balls, and over batch shapes."""

import math
from collections.abc import Callable

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.hand import CONE_NAMES, DOFS, FINGERS, Primitives, place_primitives, primitive_sizes
from torchhand.signs.places import thumb_asides, thumb_insides, tips_on_thumb

MODEL = load_hand_model()
KINEMATICS = MODEL.kinematics(dtype=torch.float64)


def _random() -> Primitives:
    generator = torch.Generator().manual_seed(3)
    pose = 0.6 * torch.rand(len(DOFS), generator=generator, dtype=torch.float64)
    return place_primitives(KINEMATICS(pose), primitive_sizes(MODEL.shape_space, KINEMATICS.default_shape))


def _ball(primitives: Primitives, cone: int, share: float) -> tuple[torch.Tensor, float]:
    sizes = primitives.sizes
    middle = primitives.cone_position[cone] + share * sizes.cone_length[cone] * primitives.cone_rotation[cone, :, 1]
    return middle, float(sizes.cone_start[cone, 0]) * (1 + share * (float(sizes.cone_end_scale[cone]) - 1))


def test_tips_on_thumb_is_the_deepest_ball() -> None:
    primitives = _random()
    for finger, depth in zip(FINGERS[1:], tips_on_thumb(primitives).tolist(), strict=True):
        tip, radius = _ball(primitives, CONE_NAMES.index(f"{finger}_distal"), 1.0)
        balls = [
            _ball(primitives, CONE_NAMES.index(f"thumb_{bone}"), k / 500)
            for bone in ("proximal", "distal")
            for k in range(501)
        ]
        assert depth == pytest.approx(max(radius + r - math.dist(tip, p) for p, r in balls), abs=1e-7)


def test_asides_and_insides_are_coordinates_in_the_bent_finger() -> None:
    primitives = _random()
    tip, _ = _ball(primitives, CONE_NAMES.index("thumb_distal"), 1.0)
    asides, insides = thumb_asides(primitives).tolist(), thumb_insides(primitives).tolist()
    for i, finger in enumerate(FINGERS[1:]):
        proximal, middle = (CONE_NAMES.index(f"{finger}_{bone}") for bone in ("proximal", "middle"))
        pip, _ = _ball(primitives, proximal, 1.0)
        in_proximal, in_middle = (primitives.cone_rotation[cone].T @ (tip - pip) for cone in (proximal, middle))
        assert asides[i] == pytest.approx(float(in_proximal[2]))
        assert insides[i] == pytest.approx(-max(float(in_proximal[0]), float(in_middle[0])))


@pytest.mark.parametrize("function", [tips_on_thumb, thumb_asides, thumb_insides])
def test_batches_are_loops(function: Callable[[Primitives], torch.Tensor]) -> None:
    generator = torch.Generator().manual_seed(3)
    poses = 0.6 * torch.rand(2, 3, len(DOFS), generator=generator, dtype=torch.float64)
    sizes = primitive_sizes(MODEL.shape_space, KINEMATICS.default_shape)
    one_by_one = [[function(place_primitives(KINEMATICS(pose), sizes)) for pose in row] for row in poses]
    whole = function(place_primitives(KINEMATICS(poses), sizes))
    assert torch.allclose(whole, torch.stack([torch.stack(row) for row in one_by_one]), rtol=0, atol=1e-14)
