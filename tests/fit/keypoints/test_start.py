"""First poses: the rigid placement against its definition, closed-form angles, and views of a picture."""

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import Equations, PosedHands, free_bounds
from torchhand.fit.keypoints.observation import PictureKeypoints
from torchhand.fit.keypoints.points import KeypointSettings
from torchhand.fit.keypoints.prior import (
    NaturalPrior,
    limit_information,
    missing_fraction,
    natural_posture,
    points_of_dofs,
)
from torchhand.fit.keypoints.start import palm_weight, rigid_placement, start_in_space
from torchhand.fit.keypoints.views import other_ways, starts_in_picture, viewing_directions
from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.hand import DOFS, PALM, HandKinematics, HandPose, Side, named_pose_space, posture

DOUBLE = torch.float64


def _hand(side: Side = "right") -> HandKinematics:
    return load_hand_model().kinematics(side, dtype=DOUBLE)


def _poses(kinematics: HandKinematics, count: int, generator: torch.Generator) -> Tensor:
    space = named_pose_space("dof27")
    lower, upper = free_bounds(space, kinematics.skeleton)
    fraction = 0.05 + 0.9 * torch.rand(count, space.size, generator=generator, dtype=DOUBLE)
    return space.dof(torch.where(lower.isfinite(), lower + fraction * (upper - lower), 2 * fraction - 1))


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_placement_recovers_a_similarity(batch: tuple[int, ...], generator: torch.Generator) -> None:
    source = torch.randn(*batch, 7, 3, generator=generator, dtype=DOUBLE)
    weight = torch.rand(*batch, 7, generator=generator, dtype=DOUBLE)
    weight[..., 3] = 0.0
    rotation = rotation_from_vector(torch.randn(*batch, 3, generator=generator, dtype=DOUBLE))
    translation = torch.randn(*batch, 3, generator=generator, dtype=DOUBLE)
    target = source @ rotation.mT + translation[..., None, :]
    target[..., 3, :] = 99.0  # has no weight
    found = rigid_placement(source, target, weight)
    torch.testing.assert_close(found[0], rotation, atol=1e-12, rtol=0)
    torch.testing.assert_close(found[1], translation, atol=1e-12, rtol=0)
    torch.testing.assert_close(found[2], torch.ones(batch, dtype=DOUBLE), atol=1e-12, rtol=0)
    assert float((rigid_placement(source, 1.3 * target, weight)[2] - 1.3).abs().max()) < 1e-12


def test_a_mirror_image_is_no_rotation(generator: torch.Generator) -> None:
    source = torch.randn(6, 3, generator=generator, dtype=DOUBLE)
    rotation, _, _ = rigid_placement(
        source, source * torch.tensor((1.0, 1.0, -1.0)).to(DOUBLE), torch.ones(6).to(DOUBLE)
    )
    assert float(torch.linalg.det(rotation)) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("side", ["right", "left"])
def test_closed_form_angles_of_exact_points(side: Side, generator: torch.Generator) -> None:
    """Nearly exact: `posture` bends the palm by 2°, and the thumb's two CMC axes are not perpendicular."""
    kinematics = _hand(side)
    truth = _poses(kinematics, 200, generator)
    shape = kinematics.default_shape
    points = kinematics(truth).keypoints
    known = torch.ones(200, 21, dtype=torch.bool)
    start, size = start_in_space(kinematics, points, known, shape, natural_posture().mean)
    pose, reference = start.dofs, start.reference
    fingers = [i for i, dof in enumerate(DOFS) if i >= 6 and not dof.startswith("thumb") and "_cmc" not in dof]
    error = (pose - truth)[:, fingers].abs().rad2deg()
    assert float(error.median()) < 0.5
    assert float(error.quantile(0.95)) < 6.0
    thumb = [i for i, dof in enumerate(DOFS) if dof.startswith("thumb") and not dof.endswith("_tw")]
    assert float((pose - truth)[:, thumb].abs().rad2deg().median()) < 6.0
    turned = reference @ rotation_from_vector(truth[:, 3:6]).mT
    assert float((turned.diagonal(dim1=-2, dim2=-1).sum(-1) - 1).min()) > 2 * 0.998
    torch.testing.assert_close(size, torch.ones(200, dtype=DOUBLE), atol=0.02, rtol=0)


def test_missing_points_take_the_posture_given(generator: torch.Generator) -> None:
    kinematics = _hand()
    points = kinematics(_poses(kinematics, 20, generator)).keypoints
    known = torch.ones(20, 21, dtype=torch.bool)
    known[:, 6:9] = False
    natural = natural_posture().mean
    start, _ = start_in_space(kinematics, points, known, kinematics.default_shape, natural)
    pose = start.dofs
    index = [DOFS.index(f"index_{joint}") for joint in ("mcp_fe", "mcp_aa", "pip_fe", "dip_fe")]
    torch.testing.assert_close(pose[:, index], natural[index].expand(20, -1), atol=0, rtol=0)
    assert pose.isfinite().all()


def test_the_palm_places_the_hand_where_it_is_seen() -> None:
    known = torch.ones(2, 21, dtype=torch.bool)
    known[1, [5, 9, 13]] = False
    weight = palm_weight(known)
    assert weight[0, list(PALM)].tolist() == [1.0] * 5
    assert float(weight[0, 4]) < 0.01
    assert weight[1, [0, 4, 17]].tolist() == [1.0] * 3
    assert weight[1, [5, 9, 13]].tolist() == [0.0] * 3


def test_what_a_missing_point_leaves_open() -> None:
    confidence = torch.ones(21, dtype=DOUBLE)
    confidence[8], confidence[17] = 0.0, 0.4
    fraction = missing_fraction(confidence)
    open_angles = [DOFS[i] for i in fraction.nonzero()[:, 0].tolist()]
    assert {"index_dip_fe", "little_mcp_fe", "little_mcp_aa", "little_cmc_fe"} <= set(open_angles)
    assert not any(name.startswith(("root", "thumb", "middle", "ring")) for name in open_angles)
    assert float(fraction[DOFS.index("index_dip_fe")]) == 1.0
    assert float(fraction[DOFS.index("little_mcp_fe")]) == pytest.approx(0.6)
    assert "index_mcp_fe" not in open_angles
    assert points_of_dofs()[DOFS.index("index_mcp_tw")] == (0, 5, 6, 7)
    assert points_of_dofs()[DOFS.index("thumb_ip_fe")] == (2, 3, 4)


def test_the_natural_posture_is_a_posture() -> None:
    kinematics = _hand()
    natural = natural_posture()
    joints = natural.mean[6:]
    assert bool(((joints >= kinematics.skeleton.lower) & (joints <= kinematics.skeleton.upper)).all())
    assert float(torch.linalg.eigvalsh(natural.precision[6:, 6:]).min()) > 0
    assert not natural.precision[:6].any()
    std = torch.linalg.inv(natural.precision[6:, 6:]).diagonal().sqrt().rad2deg()
    assert float(std.min()) > 2
    assert float(std.max()) < 45
    uniform = limit_information(kinematics.skeleton)
    width = float(kinematics.skeleton.upper[0] - kinematics.skeleton.lower[0])
    assert float(uniform[6]) == pytest.approx(12 / width**2)
    assert not uniform[:6].any()


def test_directions_look_at_the_hand_from_all_around() -> None:
    views = viewing_directions()
    torch.testing.assert_close(views @ views.mT, torch.eye(3, dtype=DOUBLE).expand_as(views), atol=1e-12, rtol=0)
    axes = views[:, 2]  # the optical axis in the hand frame
    assert len(views) == 42
    sphere = torch.randn(500, 3, generator=torch.Generator().manual_seed(0), dtype=DOUBLE)
    nearest = (sphere / sphere.norm(dim=-1, keepdim=True) @ axes.T).amax(-1)
    assert float(nearest.min()) > 0.85


@pytest.mark.parametrize("side", ["right", "left"])
def test_one_of_the_starts_in_a_picture_is_near(side: Side) -> None:
    kinematics, camera = _hand(side), assumed_camera(640, 480)
    pose = posture("open", dtype=torch.float64).repeat(5, 1)
    pose[:, :3] = torch.tensor((0.02, -0.03, 0.5), dtype=DOUBLE)
    generator = torch.Generator().manual_seed(4)
    pose[:, 3:6] = torch.randn(5, 3, generator=generator, dtype=DOUBLE)
    points = kinematics(pose).keypoints
    observed = PictureKeypoints(
        points_px=camera.project(points), kinematics=kinematics, camera=camera, settings=KeypointSettings()
    )
    starts = starts_in_picture(observed, kinematics.default_shape, natural_posture().mean, 6)
    assert starts.batch_shape == (5, 6)
    poses, references = starts.dofs, starts.reference
    turned = (references * rotation_from_vector(pose[:, 3:6])[:, None]).sum((-2, -1))  # 1 + 2 cos of the angle between
    assert bool((turned.amax(-1) > 1 + 2 * 0.9).all())
    assert float((poses[:, 0, 2] - 0.5).abs().max()) < 0.12
    placed = kinematics(poses[:, 0], root_reference=references[:, 0]).keypoints
    assert float((camera.project(placed) - observed.points_px).norm(dim=-1).mean()) < 40


def test_other_ways_bend_and_straighten_one_digit_each() -> None:
    poses = torch.stack((posture("point", dtype=torch.float64), posture("open", dtype=torch.float64)))
    ways = other_ways(HandPose.of(poses)).dofs
    assert ways.shape == (2, 6, 36)
    index, thumb = DOFS.index("index_pip_fe"), DOFS.index("thumb_ip_fe")
    torch.testing.assert_close(ways[:, 0], poses, atol=0, rtol=0)
    assert float(ways[0, 2, index]) > 1.5  # the straight index, bent
    assert float(ways[0, 3, DOFS.index("middle_pip_fe")]) == 0.0
    assert float(ways[1, 1, thumb]) > 1.0
    changed = (ways[:, 2] != ways[:, 0]).any(0).nonzero()[:, 0]
    assert all(DOFS[i].startswith("index") for i in changed.tolist())


def test_the_natural_prior_counts_as_far_as_it_holds(generator: torch.Generator) -> None:
    """Gradient and matrix are those of the cost; DOFs of no share feel nothing."""
    kinematics, natural = _hand(), natural_posture()
    pose = HandPose.of(_poses(kinematics, 3, generator))
    fraction = torch.rand(3, 36, generator=generator, dtype=DOUBLE)
    fraction[:, 10:14] = 0.0
    prior = NaturalPrior(posture=natural, fraction=fraction)

    def at(dofs: Tensor) -> Equations:
        hands = HandPose(dofs=dofs, reference=pose.reference)
        return prior.equations(PosedHands(pose=hands, shape=kinematics.default_shape))

    found, direction = at(pose.dofs), torch.randn(3, 36, generator=generator, dtype=DOUBLE)
    own = direction[:, found.first_dof :]
    slope = (found.gradient * own).sum(-1)
    bend = (own[:, None] @ found.matrix @ own[..., None]).flatten()
    torch.testing.assert_close(
        at(pose.dofs + direction).cost, found.cost + slope + 0.5 * bend, rtol=1e-9, atol=0
    )  # the cost is quadratic
    assert not found.gradient[:, 10 - found.first_dof : 14 - found.first_dof].any()
    torch.testing.assert_close(at(natural.mean.expand(3, -1)).cost, torch.zeros(3, dtype=DOUBLE), rtol=0, atol=1e-20)


def test_one_share_of_the_natural_prior_serves_all_hypotheses(generator: torch.Generator) -> None:
    kinematics, natural = _hand(), natural_posture()
    hands = PosedHands(pose=HandPose.of(_poses(kinematics, 3, generator)), shape=kinematics.default_shape)
    fraction = torch.rand(1, 36, generator=generator, dtype=DOUBLE)
    found = NaturalPrior(posture=natural, fraction=fraction).rows(torch.tensor([0, 0, 0])).equations(hands)
    expected = NaturalPrior(posture=natural, fraction=fraction.repeat(3, 1)).equations(hands)
    for name in ("cost", "gradient", "matrix"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), rtol=1e-12, atol=1e-12)
