"""What of the silhouettes the skin must explain: cost across the skin, the forearm, what is told of it."""

import math
from typing import Any

import torch

from torchhand.fit import PosedHands, Stage
from torchhand.fit.hull.coverage import CoverageObservation
from torchhand.fit.hull.settings import HullSettings
from torchhand.fit.hull.skin import SkinPoints
from torchhand.fit.hull.target import HullTarget
from torchhand.fit.hull.vertices import SkinVertices
from torchhand.hand import HandPose


def vertices_of(rig: Any, **settings: Any) -> SkinVertices:
    return SkinVertices.of(SkinPoints(rig.hand), HullSettings(**settings))


def surface(rig: Any, points: torch.Tensor, normals: torch.Tensor, vertices: SkinVertices) -> CoverageObservation:
    field = rig.target(rig.person(1)[0]).field
    target = HullTarget(field=field, points=points, normals=normals, inner=points, depth=points[:, 0])
    return CoverageObservation(target=target, vertices=vertices)


def test_cost_is_that_of_the_distance_across_the_skin(rig: Any) -> None:
    """Points 1 mm outside the skin and 0.3 mm beside their vertices: sliding is free."""
    skin = vertices_of(rig, surface_weight=40.0, std_m=0.002)
    one = PosedHands(pose=HandPose.stack([rig.person(3)[0]]), shape=rig.hand.shape)
    skin_places = rig.vertices(one.pose)[0]
    normals = skin.skin.normals(skin_places[None])[0]
    height = (skin_places - one.pose.dofs[0, :3]) @ one.pose.reference[0, :, 1]
    chosen = (height > 0.02).nonzero()[::40, 0]
    along = torch.linalg.cross(normals[chosen], torch.ones(3, dtype=torch.float64).expand(len(chosen), 3))
    along = torch.nn.functional.normalize(along, dim=-1)
    points = skin_places[chosen] + 0.001 * normals[chosen] + 0.0003 * along
    factor = surface(rig, points, normals[chosen], skin).associate(one, Stage(gross_m=0.004))
    assert torch.equal(factor.match[0], chosen)
    found = factor.equations(one)
    squared = (0.001 / 0.004) ** 2
    expected = 0.5 * 40 / 0.002**2 * 0.004**2 * squared / (1 + squared)
    torch.testing.assert_close(found.cost, torch.tensor([expected], dtype=torch.float64))
    [explanation] = factor.explained()
    torch.testing.assert_close(explanation.distance, torch.tensor([0.001], dtype=torch.float64))
    assert explanation.fraction.tolist() == [1.0]


def test_what_lies_beside_all_skin_is_not_explained(rig: Any) -> None:
    """Far along the surface there is no skin, though it is near across it."""
    skin = vertices_of(rig)
    one = PosedHands(pose=HandPose.stack([rig.person(3)[0]]), shape=rig.hand.shape)
    places = rig.vertices(one.pose)[0]
    normals = skin.skin.normals(places[None])[0]
    tip = int(((places - one.pose.dofs[0, :3]) @ one.pose.reference[0, :, 1]).argmax())
    across = torch.nn.functional.normalize(torch.linalg.cross(normals[tip], one.pose.reference[0, :, 0]), dim=-1)
    outward = normals[tip]
    for distance, fraction in ((0.001, 1.0), (0.03, 0.0)):
        points = (places[tip] + distance * outward)[None]
        factor = surface(rig, points, outward[None], skin).associate(one, Stage(gross_m=0.004))
        assert factor.explained()[0].fraction.tolist() == [fraction]
    assert float(across @ outward) < 1e-9


def test_points_beyond_the_wrist_do_not_count(rig: Any) -> None:
    one = PosedHands(pose=HandPose.stack([rig.person(3)[0]]), shape=rig.hand.shape)
    along = one.pose.reference[0, :, 1]
    points = one.pose.dofs[0, :3] - torch.tensor((0.02, 0.05), dtype=torch.float64)[:, None] * along
    normals = one.pose.reference[0, :, 0].expand(2, 3)
    counted = [
        int(
            (
                surface(rig, points, normals, vertices_of(rig, beyond_wrist_m=beyond)).associate(one, Stage()).weight
                > 0
            ).sum()
        )
        for beyond in (0.0, 0.03, 0.06)
    ]
    assert counted == [0, 1, 2]


def test_webs_count_less_with_an_exponent(rig: Any) -> None:
    """A vertex that two bones share in halves counts half as much with an exponent of 1."""
    pose = rig.person(3)[0]
    one = PosedHands(pose=HandPose.stack([pose]), shape=rig.hand.shape)
    target = rig.target(pose, points=100)
    plain, soft = (
        CoverageObservation(target=target, vertices=vertices_of(rig, rigidity_exponent=power)).associate(one, Stage())
        for power in (0.0, 1.0)
    )
    assert torch.equal(plain.match, soft.match)
    largest = rig.hand.skinning.weights.amax(0)[plain.match]
    torch.testing.assert_close(soft.weight, plain.weight * largest)
    assert float(largest.min()) < 0.9 < 1.0 == float(largest.max())


def test_edges_of_the_silhouettes_are_explained_by_the_hand_that_made_them(rig: Any) -> None:
    pose, shape = rig.person(4)
    target = rig.with_edges(rig.masks(pose, shape))
    bent = pose.dofs.clone()
    bent[6:] = rig.model.skeleton.within_limits(bent[6:] + math.radians(30))
    both = PosedHands(pose=HandPose.stack([pose, HandPose(dofs=bent, reference=pose.reference)]), shape=shape)
    vertices = SkinVertices.of(SkinPoints(rig.hand, shape), HullSettings())
    [explanation] = (
        CoverageObservation(target=target, vertices=vertices).associate(both, Stage(gross_m=0.01)).explained()
    )
    assert float(explanation.fraction[0]) > 0.97
    assert float(explanation.fraction[1]) < 0.8
    assert float(explanation.distance[0]) < 0.001 < 0.002 < float(explanation.distance[1])
