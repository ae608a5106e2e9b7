"""Self-penetration from the primitives: which postures touch, how depth grows, derivatives."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.hand.kinematics import DOFS, POSTURES, HandKinematics, Side, posture
from torchhand.hand.primitives.penetration import PenetrationSettings, penetration, penetration_penalty
from torchhand.hand.primitives.primitives import CONE_NAMES, Primitives, place_primitives
from torchhand.hand.primitives.sizing import primitive_sizes


def _placed(pose: Tensor, shape: Tensor | None = None, side: Side = "right") -> Primitives:
    kinematics: HandKinematics = load_hand_model().kinematics(side, dtype=torch.float64)
    sizes = primitive_sizes(kinematics.shape_space, kinematics.default_shape if shape is None else shape)
    return place_primitives(kinematics(pose, shape), sizes, is_left=side == "left")


def _bent(name: str, **angles_deg: float) -> Tensor:
    pose = posture(name, dtype=torch.float64)
    for dof, angle in angles_deg.items():
        pose[DOFS.index(dof)] = math.radians(angle)
    return pose


@pytest.mark.parametrize("name", POSTURES)
def test_named_postures_hardly_touch(name: str) -> None:
    """Open postures not at all; in a fist the primitives are some 3 mm deeper in each other than soft skin explains."""
    found = penetration(_placed(posture(name, dtype=torch.float64)))
    limit = 4e-3 if name == "fist" else 1e-3
    assert float(found.worst) < limit, found.describe()
    if name in ("open", "flat", "three", "four"):
        assert float(found.depth.max()) < 0
        assert float(penetration_penalty(_placed(posture(name, dtype=torch.float64)))) == 0
        assert found.describe() == "none"


def test_fingers_through_each_other_and_the_palm() -> None:
    """A finger bent beyond its limits enters the palm; one crossed into its neighbour meets it."""
    rolled = penetration(_placed(_bent("flat", middle_mcp_fe=110.0, middle_pip_fe=120.0, middle_dip_fe=60.0)))
    assert rolled.describe().startswith("middle_distal – palm by 8")
    assert float(rolled.worst) > 3e-3
    crossed = penetration(_placed(_bent("flat", index_mcp_aa=-20.0)))
    assert crossed.describe().startswith("index_")
    assert float(crossed.worst) > 5e-3


def test_depth_of_two_parallel_fingers() -> None:
    """Distance of the axes less the radii, from the keypoints themselves."""
    model = load_hand_model()
    pose = _bent("flat", index_mcp_aa=-3.0)
    found = penetration(_placed(pose))
    depth = float(found.depth[found.names.index("index_distal – middle_distal")])
    metric = model.shape_space.metric(model.shape_space.default)
    points = model.kinematics(dtype=torch.float64)(pose).keypoints
    index = points[7] + torch.linspace(0, 1, 300).double()[:, None] * (points[8] - points[7]) * 0.999
    middle = points[11] + torch.linspace(0, 1, 300).double()[:, None] * (points[12] - points[11]) * 0.999
    gap = float(torch.cdist(index, middle).min())
    thick = float(metric["index_dip_radius"] + metric["middle_dip_radius"])
    thin = float(metric["index_tip_radius"] + metric["middle_tip_radius"])
    assert thin - gap - 1e-3 < depth < thick - gap + 1e-3


def test_pairs() -> None:
    names = penetration(_placed(posture("flat", dtype=torch.float64))).names
    assert len(names) == len(set(names)) == 3 * 8 + 3 * 9 + 2 * 12 + 9 + 8
    assert "index_proximal – middle_proximal" not in names
    assert "index_proximal – ring_proximal" in names


def test_left_hand_is_the_mirror(generator: torch.Generator) -> None:
    poses = 0.4 * torch.randn(5, 36, generator=generator, dtype=torch.float64)
    right, left = (penetration(_placed(poses, side=side)).depth for side in ("right", "left"))
    torch.testing.assert_close(left, right, atol=1e-12, rtol=0)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches(generator: torch.Generator, batch: tuple[int, ...]) -> None:
    space = load_hand_model().shape_space
    poses = 0.4 * torch.randn(*batch, 36, generator=generator, dtype=torch.float64)
    shapes = space.default + space.std * torch.randn(*batch, 52, generator=generator, dtype=torch.float64)
    together = penetration(_placed(poses, shapes))
    flat = zip(poses.reshape(-1, 36), shapes.reshape(-1, 52), strict=True)
    loop = torch.stack([penetration(_placed(pose, shape)).depth for pose, shape in flat])
    torch.testing.assert_close(together.depth.reshape(loop.shape), loop, atol=1e-13, rtol=0)
    one_shape = penetration(_placed(poses)).depth
    again = torch.stack([penetration(_placed(pose)).depth for pose in poses.reshape(-1, 36)])
    torch.testing.assert_close(one_shape.reshape(again.shape), again, atol=1e-13, rtol=0)


def test_derivatives(generator: torch.Generator) -> None:
    space = load_hand_model().shape_space
    pose = (
        posture("fist", dtype=torch.float64) + 0.1 * torch.randn(36, generator=generator, dtype=torch.float64)
    ).requires_grad_()
    shape = space.default.clone().requires_grad_()
    weight = torch.randn(3, 92, generator=generator, dtype=torch.float64)

    def depths(pose: Tensor, shape: Tensor) -> Tensor:
        return weight @ penetration(_placed(pose, shape)).depth

    assert torch.autograd.gradcheck(depths, (pose, shape), atol=1e-6, fast_mode=True)
    assert torch.autograd.gradcheck(
        lambda p, s: penetration_penalty(_placed(p, s)), (pose, shape), atol=1e-4, fast_mode=True
    )


def test_the_middle_of_the_palm() -> None:
    """A fingertip put where the palm's axis is: half the palm's thickness deep, with a finite slope."""
    pose = _bent("fist").requires_grad_()
    placed = _placed(pose)
    centre = placed.cone_position[0] + 0.5 * placed.sizes.cone_length[0] * placed.cone_rotation[0, :, 1]
    tip = CONE_NAMES.index("index_distal")
    position = placed.position.clone()
    ends = placed.cone_rotation[tip, :, 1] * placed.sizes.cone_length[tip]
    position[tip] = centre.detach() - ends.detach() + 0 * position[tip]
    inside = penetration(Primitives(sizes=placed.sizes, rotation=placed.rotation, position=position))
    depth = inside.depth[inside.names.index("index_distal – palm")]
    half = 0.5 * 0.36 * 0.083
    assert half * 0.8 < float(depth.detach()) < 2.2 * half
    (gradient,) = torch.autograd.grad(depth, pose)
    assert bool(gradient.isfinite().all())


def test_what_settings_refuse() -> None:
    with pytest.raises(ValueError, match="softness: expected above 0, got 0"):
        PenetrationSettings(softness=0.0)
    with pytest.raises(ValueError, match=r"slack: expected 0 or more, got -0\.001"):
        PenetrationSettings(slack=-0.001)
