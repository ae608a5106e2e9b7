"""A hand found in a hull without a guess."""

from typing import Any

import pytest
import torch

from torchhand.fit import Stage
from torchhand.fit.hull.fitter import HullFitter
from torchhand.fit.hull.settings import TRACKING, HullSettings, HullStartSettings
from torchhand.fit.hull.start import find_in_hull, hypotheses, with_other_fingers
from torchhand.fit.hull.target import HullTarget
from torchhand.hand import DOFS, HandPose, named_pose_space

SPACE = named_pose_space("dof36")
QUICK = HullStartSettings(places=1, rolls=6, postures=("open", "point"), coarse=12, fine=2, finger_rounds=1)


def fitter(rig: Any) -> HullFitter:
    return HullFitter(hand=rig.hand, space=SPACE, settings=HullSettings(vertices=250), joints=rig.joints)


@pytest.mark.parametrize("seed", [8])
def test_finds_people_turned_any_way(rig: Any, seed: int) -> None:
    pose, shape = rig.person(seed, turn=1.5)
    found = find_in_hull(rig.target(pose, shape, points=250), fitter(rig), shape[None], QUICK)
    costs = [float(one.found.cost) for one in found]
    assert costs == sorted(costs)
    assert rig.error_mm(found[0].found.pose, pose, shape) <= 3


def test_tells_the_size(rig: Any) -> None:
    pose, shape = rig.person(10)
    names = rig.model.shape_space.names
    sizes = shape.repeat(2, 1)
    sizes[0, [names.index("hand_length"), names.index("hand_breadth")]] *= 0.87
    few = HullStartSettings(places=1, rolls=6, postures=("open",), coarse=6, fine=2, finger_rounds=0)
    found = find_in_hull(rig.target(pose, shape, points=200), fitter(rig), sizes, few)
    assert found[0].size == 1
    assert {one.size for one in found} == {0, 1}


def test_a_finger_in_the_wrong_place_is_found(rig: Any) -> None:
    """A fit that ends with its index folded over the palm gets out by trying the digits in turn."""
    pose, shape = rig.person(4)
    target = rig.target(pose, shape, points=250)
    own = HullFitter(
        hand=rig.hand,
        space=SPACE,
        shape=shape,
        settings=HullSettings(vertices=200),
        schedule=(Stage(gross_m=0.008, rounds=1, method="gauss_newton"), *TRACKING),
        joints=rig.joints,
    )
    start = pose.dofs.clone()
    folded = [DOFS.index(f"index_{joint}") for joint in ("mcp_fe", "pip_fe", "dip_fe")]
    start[folded] = torch.tensor((85.0, 100.0, 60.0), dtype=torch.float64).deg2rad()
    wrong = own(target, HandPose(dofs=start, reference=pose.reference))
    right = with_other_fingers(target, wrong, own, 1)
    assert rig.error_mm(wrong.pose, pose, shape) > 4
    assert rig.error_mm(right.pose, pose, shape) < 2
    assert float(right.cost) < float(wrong.cost)


def test_hypotheses_put_the_palm_into_the_largest_ball(rig: Any) -> None:
    pose, shape = rig.person(4)
    target = rig.target(pose, shape)
    found = hypotheses(target, rig.hand, shape, HullStartSettings(places=1, rolls=3, postures=("flat", "fist")))
    assert len(found) == 14 * 3 * 2
    references = found.reference
    identity = torch.eye(3, dtype=torch.float64).expand_as(references)
    assert torch.allclose(references @ references.mT, identity, atol=1e-9)
    assert float(torch.linalg.det(references).min()) == pytest.approx(1)
    deepest = target.inner[target.depth.argmax()]
    keypoints = rig.keypoints(found, shape)
    palm = keypoints[:, 0] + 0.6 * (keypoints[:, 9] - keypoints[:, 0])
    assert torch.allclose(palm, deepest.expand_as(palm), atol=1e-9)
    distance = (references[:, None] - references).flatten(2).norm(dim=-1)
    assert int((distance < 1e-6).sum()) == 2 * len(found)  # each with the two postures


def test_no_hull_gives_nothing(rig: Any) -> None:
    empty = torch.zeros(0, 3, dtype=torch.float64)
    pose, shape = rig.person(4)
    field = rig.target(pose, shape).field
    target = HullTarget(field=field, points=empty, normals=empty, inner=empty, depth=empty[:, 0])
    assert find_in_hull(target, fitter(rig), rig.hand.shape[None]) == []
