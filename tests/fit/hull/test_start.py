"""A hand found in a hull without a guess."""

from typing import Any

import pytest
import torch

from torchhand.fit.hull.fit import HullFitter
from torchhand.fit.hull.points import HullTarget
from torchhand.fit.hull.settings import HULL_TRACKING_LEVELS, HullFitSettings, HullStartSettings
from torchhand.fit.hull.start import find_in_hull, hypotheses, with_other_fingers
from torchhand.hand import DOFS, named_pose_space

SPACE = named_pose_space("dof36")
QUICK = HullStartSettings(places=1, rolls=6, postures=("open", "point"), coarse=12, fine=2, finger_rounds=1)
FIT = HullFitSettings(vertices=250)


@pytest.mark.parametrize("seed", [8])
def test_finds_people_turned_any_way(rig: Any, seed: int) -> None:
    pose, reference, shape = rig.person(seed, turn=1.5)
    target = rig.target(pose, reference, shape, points=250)
    beliefs = {"constraints": rig.constraints, "prior": rig.prior}
    found = find_in_hull(target, rig.hand, SPACE, shape[None], QUICK, FIT, **beliefs)
    costs = [float(one.fit.cost) for one in found]
    assert costs == sorted(costs)
    best = found[0].fit
    assert rig.error_mm((best.pose, best.root_reference), (pose, reference), shape) <= 3


def test_tells_the_size(rig: Any) -> None:
    pose, reference, shape = rig.person(10)
    names = rig.model.shape_space.names
    sizes = shape.repeat(2, 1)
    sizes[0, [names.index("hand_length"), names.index("hand_breadth")]] *= 0.87
    target = rig.target(pose, reference, shape, points=200)
    few = HullStartSettings(places=1, rolls=6, postures=("open",), coarse=6, fine=2, finger_rounds=0)
    found = find_in_hull(target, rig.hand, SPACE, sizes, few, FIT, prior=rig.prior)
    assert found[0].size == 1
    assert {one.size for one in found} == {0, 1}


def test_a_finger_in_the_wrong_place_is_found(rig: Any) -> None:
    """A fit that ends with its index folded over the palm gets out by trying the digits in turn."""
    pose, reference, shape = rig.person(4)
    target = rig.target(pose, reference, shape, points=250)
    settings = HullFitSettings(vertices=200, levels=HULL_TRACKING_LEVELS)
    fitter = HullFitter(rig.hand, SPACE, settings, shape=shape, constraints=rig.constraints, prior=rig.prior)
    start = pose.clone()
    folded = [DOFS.index(f"index_{joint}") for joint in ("mcp_fe", "pip_fe", "dip_fe")]
    start[folded] = torch.tensor((85.0, 100.0, 60.0), dtype=torch.float64).deg2rad()
    wrong = fitter(target, start, reference)
    right = with_other_fingers(target, wrong, fitter, 1)
    before, after = (
        rig.error_mm((found.pose, found.root_reference), (pose, reference), shape) for found in (wrong, right)
    )
    assert before > 4
    assert after < 2
    assert float(right.cost) < float(wrong.cost)


def test_hypotheses_put_the_palm_into_the_largest_ball(rig: Any) -> None:
    pose, reference, shape = rig.person(4)
    target = rig.target(pose, reference, shape)
    settings = HullStartSettings(places=1, rolls=3, postures=("flat", "fist"))
    poses, references = hypotheses(target, rig.hand, shape, settings)
    assert len(poses) == 14 * 3 * 2
    identity = torch.eye(3, dtype=torch.float64).expand_as(references)
    assert torch.allclose(references @ references.mT, identity, atol=1e-9)
    assert float(torch.linalg.det(references).min()) == pytest.approx(1)
    deepest = target.inner[target.depth.argmax()]
    keypoints = rig.keypoints(poses, references, shape)
    palm = keypoints[:, 0] + 0.6 * (keypoints[:, 9] - keypoints[:, 0])
    assert torch.allclose(palm, deepest.expand_as(palm), atol=1e-9)
    apart = (references[:, None] - references).flatten(2).norm(dim=-1)
    assert int((apart < 1e-6).sum()) == 2 * len(poses)  # each with the two postures


def test_no_hull_gives_nothing(rig: Any) -> None:
    empty = torch.zeros(0, 3, dtype=torch.float64)
    pose, reference, shape = rig.person(4)
    field = rig.target(pose, reference, shape).field
    target = HullTarget(field=field, points=empty, normals=empty, inner=empty, depth=empty[:, 0])
    assert find_in_hull(target, rig.hand, SPACE, rig.hand.shape[None]) == []
