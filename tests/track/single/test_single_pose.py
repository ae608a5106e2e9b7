"""Single pictures: simulated hands in closed postures with a detector's points, silhouettes alone, and no hands."""

from dataclasses import replace
from functools import cache
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.studio import StagedHand, Studio
from torchhand.fit import Solutions, SolveStatus
from torchhand.fit.detect import align_posture
from torchhand.fit.keypoints import RelativeKeypoints
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandPose, named_pose_space, posture
from torchhand.track import HandKeypoints, View
from torchhand.track.single import SinglePoseFitter, SinglePoseSettings
from torchhand.track.single.evidence import SILENCE, hand_odds
from torchhand.track.single.registration import PictureProblem, mixture

FLEXIONS = [i for i, n in enumerate(DOFS) if n.endswith(("mcp_fe", "pip_fe")) and not n.startswith("thumb")]


@cache
def fitter(side: str = "right", **settings: Any) -> SinglePoseFitter:
    return SinglePoseFitter(Studio().kinematics(side), SinglePoseSettings(**settings))


def staged(name: str, *, side: str = "right") -> StagedHand:
    placed = Studio().placed(size=0.8, side=side) if side != "right" else Studio().placed(size=0.8)
    angles = placed.kinematics.skeleton.within_limits(posture(name, dtype=torch.float64)[6:]).to(placed.pose)
    return replace(placed, pose=torch.cat((placed.pose[:6], angles)))


def detected(placed: StagedHand, *, noise_px: float = 1.5) -> HandKeypoints:
    """As a detector would: noise, points in space about their own middle and in a size of their own."""
    noise = noise_px * torch.randn(21, 2, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    points = placed.projector.frames(placed.pose, placed.root_reference).keypoints
    return HandKeypoints(points_px=placed.keypoints_px + noise, points=0.9 * (points - points.mean(0)), score=0.9)


@pytest.mark.parametrize("name", ["fist", "point", "victory"])
def test_a_closed_hand_is_recovered_by_points_and_outline(name: str) -> None:
    placed = staged(name)
    found = fitter()(View(image=placed.picture(), keypoints=detected(placed)), placed.camera, shape=placed.shape)
    assert found.estimate.status == "tracked", found.estimate.reason
    assert found.estimate.pose is not None
    assert found.estimate.overlap is not None
    assert found.estimate.overlap > 0.85
    flexion = (found.estimate.pose - placed.pose)[FLEXIONS].abs()
    assert float(flexion.mean()) < 0.2  # radians; a detector's angles are believed to be off by 0.26 to 0.31


def test_the_outline_corrects_points_that_are_off() -> None:
    placed = staged("point")
    points = placed.projector.frames(placed.pose, placed.root_reference).keypoints
    seen = detected(placed)
    biased = replace(seen, points_px=seen.points_px + torch.tensor((4.0, -3.0), dtype=torch.float64))
    found = fitter()(View(image=placed.picture(), keypoints=biased), placed.camera, shape=placed.shape).estimate
    assert found.keypoints_px is not None
    away = (found.keypoints_px[0] - placed.keypoints_px).norm(dim=-1)
    assert float(away.mean()) < 3.0  # of 5
    assert len(points) == len(away)


def test_a_given_silhouette_takes_the_place_of_colours() -> None:
    placed = staged("victory")
    found = fitter()(View(mask=placed.mask, keypoints=detected(placed)), placed.camera, shape=placed.shape).estimate
    assert found.status == "tracked"
    assert found.pose is not None
    assert float((found.pose - placed.pose)[FLEXIONS].abs().mean()) < 0.2


def test_a_large_picture_gives_the_same_hand_as_a_small_one() -> None:
    placed = staged("point")
    view = View(mask=placed.mask, keypoints=detected(placed))
    large, small = (fitter(max_side_px=side)(view, placed.camera, shape=placed.shape).estimate for side in (640, 150))
    assert large.keypoints_px is not None
    assert small.keypoints_px is not None
    assert float((large.keypoints_px - small.keypoints_px).norm(dim=-1).mean()) < 2.0


def test_proportions_come_out_of_the_outline_where_they_are_not_known() -> None:
    placed = staged("open")
    names = placed.kinematics.shape_space.names
    broad = placed.shape.clone()
    broad[names.index("hand_breadth")] *= 1.1
    hand = replace(placed, shape=broad)
    found = fitter()(View(mask=hand.mask, keypoints=detected(hand)), hand.camera)
    breadth, length = names.index("hand_breadth"), names.index("hand_length")
    relative = [float(one[breadth] / one[length]) for one in (placed.shape, found.shape, broad)]
    assert relative[1] - relative[0] > 0.5 * (relative[2] - relative[0])


def test_girths_come_out_of_the_outline_where_a_detector_tells_the_posture() -> None:
    """So that an outline need not bend a thin hand's fingers."""
    placed = staged("open")
    names = placed.kinematics.shape_space.names
    girths = [i for i, name in enumerate(names) if name.endswith(("pip_radius", "dip_radius", "ip_radius"))]
    told = []
    for factor in (0.85, 1.15):
        own = placed.shape.clone()
        own[girths] *= factor
        hand = replace(placed, shape=own)
        found = fitter()(View(mask=hand.mask, keypoints=detected(hand)), hand.camera)
        told.append(float((found.shape[girths] / placed.shape[girths]).mean()))
    assert told[1] - told[0] > 0.02  # one pixel of a finger's breadth; 0 where nothing is told


def test_points_in_space_count_beside_the_posture_that_they_tell() -> None:
    """Each joint's bending and where every point lies are two readings of them: together they are nearer."""
    placed = staged("point")
    seen, generator = detected(placed), torch.Generator().manual_seed(7)
    assert seen.points is not None
    noisy = replace(seen, points=seen.points + 0.008 * torch.randn(21, 3, generator=generator, dtype=torch.float64))
    view = View(mask=placed.mask, keypoints=noisy)
    fitters = fitter(), _WithoutSpace(Studio().kinematics())
    found = [one(view, placed.camera, shape=placed.shape).estimate.pose for one in fitters]
    errors = [float((pose - placed.pose)[FLEXIONS].abs().mean()) for pose in found if pose is not None]
    assert errors[0] < errors[1]


@pytest.mark.parametrize("what", ["wall", "noise", "blob"])
def test_what_is_no_hand_is_refused_with_a_reason(what: str) -> None:
    camera = Studio().camera(160, 120)
    found = fitter_alone()(View(image=no_hand(what)), camera).estimate
    assert found.status == "no_hand"
    assert found.reason
    assert found.pose is None


def test_points_where_no_hand_is_are_not_believed() -> None:
    placed = staged("open")
    wall = torch.full((placed.camera.height, placed.camera.width, 3), 128, dtype=torch.uint8)
    found = fitter()(View(image=wall, keypoints=detected(placed)), placed.camera)
    assert found.estimate.status == "no_hand"


def test_a_view_of_another_size_than_the_camera_s_is_refused() -> None:
    with pytest.raises(ValueError, match=r"view\.mask: expected 200×160 px"):
        fitter()(View(mask=torch.zeros(10, 10, dtype=torch.bool)), Studio().camera())
    with pytest.raises(ValueError, match="a picture or a silhouette"):
        fitter()(View(), Studio().camera())


def no_hand(what: str) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    if what == "noise":
        return torch.randint(0, 256, (120, 160, 3), generator=generator, dtype=torch.uint8)
    picture = torch.full((120, 160, 3), 90, dtype=torch.uint8)
    if what == "blob":  # as a face: an ellipse of skin colour
        y, x = torch.meshgrid(torch.arange(120), torch.arange(160), indexing="ij")
        picture[((x - 80) / 30) ** 2 + ((y - 60) / 42) ** 2 < 1] = torch.tensor((205, 150, 125), dtype=torch.uint8)
    return picture


def aligned(mask: Tensor, image: Tensor | None, camera: Camera, shape: Tensor) -> HandPose:
    """Open hands over a silhouette."""
    found = align_posture(mask, camera, Studio().kinematics(), shape, posture("open", dtype=torch.float64), keep=3)
    return HandPose.stack([HandPose.of(one.pose, one.root_reference) for one in found])


@cache
def fitter_alone() -> SinglePoseFitter:
    return SinglePoseFitter(Studio().kinematics(), sources=(aligned,))


def test_an_open_hand_is_found_alone() -> None:
    placed = staged("open")
    found = fitter_alone()(View(image=placed.picture()), placed.camera, shape=placed.shape).estimate
    assert found.keypoints_px is not None, found.reason
    away = (found.keypoints_px[0] - placed.keypoints_px).norm(dim=-1)
    assert float(away.mean()) < 0.04 * placed.length_px


def test_what_looks_like_something_else_is_refused_unless_a_detector_tells_of_it() -> None:
    """No hand is so much likelier."""
    placed, strict = staged("open"), SinglePoseSettings(alone_odds=1e3)
    alone = SinglePoseFitter(Studio().kinematics(), strict, sources=(aligned,))
    view = View(image=placed.picture())
    refused = alone(view, placed.camera, shape=placed.shape).estimate
    assert refused.status == "no_hand"
    assert "more likely something else than a hand" in refused.reason
    seen = replace(view, keypoints=detected(placed))
    assert alone(seen, placed.camera, shape=placed.shape).estimate.status == "tracked"
    with pytest.raises(ValueError, match="alone_odds: expected a number below infinity"):
        SinglePoseSettings(alone_odds=float("inf"))


def test_a_detector_that_finds_no_hand_speaks_against_one() -> None:
    placed, by_default = staged("open"), fitter_alone()
    view = View(image=placed.picture())
    silent = replace(view, is_detector_silent=True)
    assert by_default(view, placed.camera, shape=placed.shape).estimate.status == "tracked"
    refused = by_default(silent, placed.camera, shape=placed.shape).estimate
    assert refused.status == "no_hand"
    assert refused.reason.startswith("the detector finds no hand")
    masked = replace(silent, mask=placed.mask)
    assert by_default(masked, placed.camera, shape=placed.shape).estimate.status == "tracked"
    for above, status in ((-0.1, "tracked"), (0.1, "no_hand")):
        settings = SinglePoseSettings(alone_odds=hand_odds().most + SILENCE + above)
        alone = SinglePoseFitter(Studio().kinematics(), settings, sources=(aligned,))
        assert alone(silent, placed.camera, shape=placed.shape).estimate.status == status


def test_the_network_s_view_corrects_a_detector_that_tells_a_fist_half_open() -> None:
    """Hardly anything of the outline of a fist shows its fingers; where no network can be asked they stay as told."""
    fist = staged("fist")
    half = replace(fist, pose=torch.cat((fist.pose[:6], 0.6 * fist.pose[6:])))
    view = View(image=fist.picture(), keypoints=replace(detected(fist), points=detected(half).points))
    fitters = fitter(), _WithoutNetwork(Studio().kinematics())
    found = [one(view, fist.camera, shape=fist.shape).estimate.pose for one in fitters]
    assert found[0] is not None
    assert found[1] is not None
    assert float(found[0][FLEXIONS].mean()) > float(found[1][FLEXIONS].mean()) + 0.02


class _WithoutSpace(SinglePoseFitter):
    def _problem(self, *given: Any) -> PictureProblem:
        made = super()._problem(*given)
        rest = tuple(one for one in made.observations if not isinstance(one, RelativeKeypoints))
        return replace(made, observations=rest)


class _WithoutNetwork(SinglePoseFitter):
    def _by_network(self, *_: Any) -> tuple[()]:
        return ()


def solutions(pose: HandPose, cost: list[float]) -> Solutions:
    space, count = named_pose_space("dof28"), len(cost)
    return Solutions(
        pose=pose,
        cost=torch.tensor(cost, dtype=torch.float64),
        misfit=torch.tensor(cost, dtype=torch.float64),
        status=torch.full((count,), SolveStatus.CONVERGED.value),
        iterations=torch.zeros(count, dtype=torch.long),
        covariance=1e-4 * torch.eye(space.size, dtype=torch.float64).repeat(count, 1, 1),
        explained=(),
    )


def test_hands_that_explain_the_same_leave_their_difference_open() -> None:
    space = named_pose_space("dof28")
    dofs = torch.stack([posture("open", dtype=torch.float64), posture("open", dtype=torch.float64)]).double()
    bent = DOFS.index("index_pip_fe")
    dofs[1, bent] += 0.8
    column = space.free_names.index("index_pip_fe")
    best, covariance, modes = mixture(solutions(HandPose.of(dofs), [10.0, 10.0]), space)
    assert modes == 2
    torch.testing.assert_close(covariance[column, column].item(), 1e-4 + 0.5 * 0.8**2, rtol=1e-9, atol=0.0)
    torch.testing.assert_close(best.pose.dofs, dofs[0], rtol=0.0, atol=0.0)
    _, covariance, modes = mixture(solutions(HandPose.of(dofs), [10.0, 40.0]), space)
    assert modes == 1
    assert float(covariance[column, column]) < 1.01e-4


def test_hypotheses_that_end_at_one_hand_count_once() -> None:
    dofs = posture("open", dtype=torch.float64).double().repeat(3, 1)
    dofs[2, DOFS.index("index_pip_fe")] += 0.8
    space = named_pose_space("dof28")
    column = space.free_names.index("index_pip_fe")
    _, covariance, _ = mixture(solutions(HandPose.of(dofs), [10.0, 10.0, 10.0]), space)
    torch.testing.assert_close(covariance[column, column].item(), 1e-4 + 0.5 * 0.8**2, rtol=1e-9, atol=0.0)
