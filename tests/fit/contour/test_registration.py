"""Registration: a known pose recovered from perturbed starts, with both surfaces and both optimisers; failures as
statuses."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import Expectation, PostureResiduals, free_bounds
from torchhand.fit.contour.judged import covariance_of
from torchhand.fit.contour.picture_contours import PictureContours, picture_contours
from torchhand.fit.contour.registration import register
from torchhand.fit.contour.result import Registration, RegistrationStatus
from torchhand.fit.contour.settings import TRACKING_LEVELS, RegistrationLevel, RegistrationSettings
from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand import DOFS, PoseConstraints, named_pose_space, pose_space
from torchhand.hand.limits import clamp_to_limits
from torchhand.view import MeshContours, PrimitiveContours, outline_table

SPACE = named_pose_space("dof26")
TABLE = outline_table(8, 8, without=("palm_wrist",))
DEGREE = math.pi / 180


class Case:
    """An open hand in a picture of 320 × 256, its truth within the space, and starts around it."""

    def __init__(self, studio: Any, *, posed: str = "open", view: str = "palm", side: str = "right") -> None:
        placed = studio.placed(posed=posed, view=view, side=side, camera=studio.camera(320, 256))
        self.model = load_hand_model()
        self.truth = clamp_to_limits(SPACE.dof(SPACE.free(placed.pose)), self.model.skeleton)
        self.placed = replace(placed, pose=self.truth)
        self.reference = placed.root_reference
        self.contours = PrimitiveContours(self.placed.projector, TABLE, SPACE.basis)

    def starts(self, count: int, *, deg: float = 8.0, mm: float = 6.0, seed: int = 3) -> tuple[Tensor, Tensor]:
        generator = torch.Generator().manual_seed(seed)

        def uniform(*size: int) -> Tensor:
            return 2 * torch.rand(*size, generator=generator, dtype=torch.float64) - 1

        free = SPACE.free(self.truth) + torch.cat(
            (mm * 1e-3 * uniform(count, 3), torch.zeros(count, 3), deg * DEGREE * uniform(count, 20)), -1
        )
        free = free.clamp(*free_bounds(SPACE, self.model.skeleton))
        turned = rotation_from_vector(deg * DEGREE * uniform(count, 3) / math.sqrt(3)) @ self.reference
        return SPACE.dof(free), turned

    def expected(self, pose: Tensor, reference: Tensor, deg: float = 8.0) -> Expectation:
        std = torch.full((SPACE.size,), deg * DEGREE, dtype=torch.float64)
        std[:3], std[3:6] = 0.02, 0.2
        return Expectation.from_std(SPACE.free(pose), reference, std)

    def errors(self, found: Registration) -> tuple[Tensor, Tensor]:
        """Mean joint error in degrees, mean keypoint error in mm."""
        kinematics, placed = self.placed.kinematics, self.placed
        used = SPACE.basis[6:].any(-1)
        angles = (found.pose - self.truth)[..., 6:][..., used].abs().mean(-1) / DEGREE
        points = kinematics(found.pose, placed.shape, root_reference=found.root_reference).keypoints
        truth = kinematics(self.truth, placed.shape, root_reference=self.reference).keypoints
        return angles, 1e3 * (points - truth).norm(dim=-1).mean(-1)


@pytest.fixture(scope="module")
def case(studio: Any) -> Case:
    return Case(studio)


@pytest.fixture(scope="module")
def picture(case: Case) -> PictureContours:
    return picture_contours(case.placed.mask)


def fitted(case: Case, picture: PictureContours, count: int, settings: RegistrationSettings | None = None) -> Any:
    pose, reference = case.starts(count)
    return register(
        picture,
        case.contours,
        SPACE,
        pose,
        reference,
        settings,
        constraints=PoseConstraints(case.model.skeleton),
        expected=case.expected(pose, reference),
    )


def test_recovers_a_known_pose_from_perturbed_starts(case: Case, picture: PictureContours) -> None:
    """What a silhouette tells comes back; flexion towards the camera is left to what was expected."""
    found = fitted(case, picture, 12)
    angles, points = case.errors(found)
    begun = case.errors(replace_pose(found, *case.starts(12)))
    assert float((points < 5).double().mean()) >= 0.75
    assert float(points.median()) < 0.4 * float(begun[1].median())
    assert float(angles.median()) < 0.85 * float(begun[0].median())
    assert float(found.contour_px.median()) < 0.6
    best = found.select(found.best)
    assert float(case.errors(best)[1]) < 4
    assert best.status.shape == ()


def replace_pose(found: Registration, pose: Tensor, reference: Tensor) -> Registration:
    return replace(found, pose=pose, root_reference=reference)


def test_best_stays_at_the_truth(case: Case, picture: PictureContours) -> None:
    found = register(picture, case.contours, SPACE, case.truth, case.reference)
    assert float(found.contour_px) < 0.6
    assert float(case.errors(found)[1]) < 5
    assert found.status in (RegistrationStatus.CONVERGED, RegistrationStatus.STALLED)
    assert float(found.pose[3:6].abs().max()) == 0
    eigenvalues = torch.linalg.eigvalsh(found.covariance)
    assert float(eigenvalues.min()) > 0


@pytest.mark.parametrize("side", ["left", "right"])
def test_either_hand_from_its_back(side: str, studio: Any) -> None:
    case = Case(studio, view="back", side=side, posed="four")
    found = fitted(case, picture_contours(case.placed.mask), 6)
    assert float(case.errors(found.select(found.best))[1]) < 5


def test_descent_goes_the_same_way(case: Case, picture: PictureContours) -> None:
    levels = (
        RegistrationLevel(robust_share=0.06, rounds=2, iterations=3),
        RegistrationLevel(robust_share=0.03, rounds=1, iterations=3),
    )
    settings = RegistrationSettings(levels=levels, method="descent")
    found = fitted(case, picture_contours(case.placed.mask, settings), 4, settings)
    begun = case.errors(replace_pose(found, *case.starts(4)))[1]
    assert float(case.errors(found)[1].median()) < 0.75 * float(begun.median())


def test_the_mesh_fits_its_own_silhouette(case: Case, studio: Any) -> None:
    hand = case.model.hand(dtype=torch.float64)
    contours = MeshContours(hand, case.placed.camera, SPACE.basis, case.placed.shape, points=200)
    from torchhand.view import mesh_silhouette

    state = hand(case.truth, root_reference=case.reference)
    mask = mesh_silhouette(state.vertices, state.faces, case.placed.camera, is_closed=True)
    settings = RegistrationSettings(levels=TRACKING_LEVELS)
    pose, reference = case.starts(3, deg=5, mm=4)
    found = register(
        picture_contours(mask, settings),
        contours,
        SPACE,
        pose,
        reference,
        settings,
        expected=case.expected(pose, reference, 5.0),
    )
    begun = case.errors(replace_pose(found, pose, reference))[1]
    assert float(case.errors(found)[1].median()) < 0.5 * float(begun.median())
    assert float(found.contour_px.median()) < 0.7


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_hypotheses_are_a_batch_of_any_shape(batch: tuple[int, ...], case: Case, picture: PictureContours) -> None:
    """Equal to one by one, and in any number of pieces."""
    count = math.prod(batch)
    pose, reference = case.starts(count)
    settings = RegistrationSettings(hypotheses_at_once=4)
    shaped = pose.reshape(*batch, 36), reference.reshape(*batch, 3, 3)
    expected = case.expected(*shaped)
    found = register(picture, case.contours, SPACE, *shaped, settings, expected=expected)
    assert found.status.shape == batch
    assert found.covariance.shape == (*batch, SPACE.size, SPACE.size)
    for i in range(0, count, 4):  # the hand's size in the picture is judged over all that go together
        together = slice(i, i + 4)
        own = case.expected(pose[together], reference[together])
        part = register(picture, case.contours, SPACE, pose[together], reference[together], settings, expected=own)
        torch.testing.assert_close(found.pose.reshape(-1, 36)[together], part.pose, atol=1e-6, rtol=0)


def test_failed_hypotheses_beside_good_ones(case: Case, picture: PictureContours) -> None:
    """Not finite, behind the camera, far outside the picture: a status each, and no harm to their neighbours."""
    pose, reference = case.starts(5)
    pose[1, 0] = torch.nan
    pose[2, 2] = -0.4
    pose[3, 0] += 30.0
    found = register(picture, case.contours, SPACE, pose, reference, expected=case.expected(pose, reference))
    assert found.status[1] == found.status[2] == RegistrationStatus.FAILED
    assert bool(found.cost[1:3].isinf().all())
    assert bool(found.covariance[1:3].isnan().all())
    torch.testing.assert_close(found.pose[2], pose[2] * (torch.arange(36) // 3 != 1))
    good = [0, 4]
    alone = register(
        picture,
        case.contours,
        SPACE,
        pose[good],
        reference[good],
        expected=case.expected(pose[good], reference[good]),
    )
    assert bool((alone.cost[:, None] < found.cost[[1, 2, 3]]).all())
    torch.testing.assert_close(found.pose[good], alone.pose, atol=1e-3, rtol=0)
    assert found.best in good


def test_empty_contours_are_a_status(case: Case) -> None:
    empty = picture_contours(torch.zeros(256, 320, dtype=torch.bool))
    pose, reference = case.starts(2)
    found = register(empty, case.contours, SPACE, pose, reference)
    assert found.status.tolist() == [RegistrationStatus.NO_CONTOUR] * 2
    turned = rotation_from_vector(pose[:, 3:6]) @ reference
    torch.testing.assert_close(found.root_reference, turned)
    torch.testing.assert_close(found.pose[:, 6:], pose[:, 6:])
    none = register(empty, case.contours, SPACE, pose[:0], reference[:0])
    assert none.pose.shape == (0, 36)


def test_coverage_draws_a_folded_finger_out(case: Case) -> None:
    """A finger folded before the palm: without the second side it stays."""
    pose = case.truth.clone()
    for name in ("index_pip_fe", "index_mcp_fe"):
        pose[DOFS.index(name)] = 35 * DEGREE
    pose = SPACE.dof(SPACE.free(pose))
    missed = {}
    for weight in (0.0, 60.0):
        settings = RegistrationSettings(coverage_weight=weight)
        found = register(
            picture_contours(case.placed.mask, settings), case.contours, SPACE, pose, case.reference, settings
        )
        missed[weight] = float(found.contour_px)
    assert missed[60.0] < 0.8


def test_limits_hold_and_small_spaces_keep_the_rest(case: Case, picture: PictureContours) -> None:
    found = fitted(case, picture, 4)
    skeleton = case.model.skeleton
    assert bool((found.pose[:, 6:] >= skeleton.lower - 1e-9).all())
    assert bool((found.pose[:, 6:] <= skeleton.upper + 1e-9).all())
    planar = pose_space("planar", ("root_tx", "root_ty", "root_rz")).about(case.truth)
    contours = PrimitiveContours(case.placed.projector, TABLE, planar.basis)
    start = case.truth.clone()
    start[:2] += torch.tensor((0.006, -0.004), dtype=torch.float64)
    turn = rotation_from_vector(torch.tensor((0.0, 0.0, 0.05), dtype=torch.float64))
    moved = register(picture, contours, planar, start, turn @ case.reference)
    torch.testing.assert_close(moved.pose[6:], skeleton.within_limits(case.truth[6:]))
    assert float((moved.pose[:2] - case.truth[:2]).norm()) < 1e-3
    assert float(vector_from_rotation(moved.root_reference @ case.reference.T).norm()) < 0.01


def test_a_space_s_own_rotation_means_nothing(case: Case, picture: PictureContours) -> None:
    """The root turns about its reference: a space through a turned pose gives what one through the pose does."""
    pose, reference = case.starts(2)
    turned = case.truth.clone()
    turned[3:6] = torch.tensor((0.3, -0.2, 0.4), dtype=torch.float64)
    spaces = [SPACE.about(case.truth), SPACE.about(turned)]
    one, other = (register(picture, case.contours, space, pose, reference) for space in spaces)
    torch.testing.assert_close(other.pose, one.pose, atol=1e-9, rtol=0)
    torch.testing.assert_close(other.root_reference, one.root_reference, atol=1e-9, rtol=0)


def test_prior_draws_towards_likely_postures(case: Case, picture: PictureContours) -> None:
    """With little contour to go by, the posture prior decides about flexion."""
    prior = PostureResiduals.of(case.model.prior().postures)
    pose, reference = case.starts(4, deg=15)
    free = register(picture, case.contours, SPACE, pose, reference)
    held = register(picture, case.contours, SPACE, pose, reference, prior=prior)

    def energy(found: Registration) -> float:
        kinds = prior.likeliest(found.pose)
        return float(prior.residual(found.pose, kinds, SPACE.basis)[0].square().sum(-1).mean())

    assert energy(held) < 0.7 * energy(free)


def test_other_levels_than_the_settings_are_refused(case: Case, picture: PictureContours) -> None:
    with pytest.raises(ValueError, match="picture: expected 2 levels as in the settings, got 3"):
        register(
            picture, case.contours, SPACE, case.truth, case.reference, RegistrationSettings(levels=TRACKING_LEVELS)
        )


def test_bounds_of_free_parameters(case: Case) -> None:
    skeleton = case.model.skeleton
    lower, upper = free_bounds(SPACE, skeleton)
    assert bool(lower[:6].isinf().all())
    assert bool((lower[6:] < upper[6:]).all())
    rows = [DOFS.index(name) - 6 for name in SPACE.free_names[6:]]
    torch.testing.assert_close(lower[6:], skeleton.lower[rows])  # those of the thumb's CMC, not of the MCP tied to it
    torch.testing.assert_close(upper[6:], skeleton.upper[rows])


def test_gradients_flow_after_a_registration(studio: Any) -> None:
    """Results are plain tensors, and nothing that is shared was made for inference only."""
    case = Case(studio)
    hand = case.model.hand(dtype=torch.float64)
    mesh = MeshContours(hand, case.placed.camera, SPACE.basis, case.placed.shape, points=50)
    for contours in (case.contours, mesh):
        found = register(picture_contours(case.placed.mask), contours, SPACE, case.truth, case.reference)
        pose = found.pose.clone().requires_grad_()
        projector = case.contours.projector
        points = projector.outline_px(pose, found.root_reference, TABLE)
        skin = hand(pose, root_reference=found.root_reference).vertices
        (points.square().sum() + skin.sum() + (found.covariance * pose[0]).sum()).backward()
        assert pose.grad is not None
        assert bool(pose.grad.isfinite().all())


def test_a_hypothesis_that_nothing_determines_has_no_covariance(generator: torch.Generator) -> None:
    factor = torch.randn(4, 5, 5, generator=generator, dtype=torch.float64)
    matrix = factor @ factor.mT + torch.eye(5, dtype=torch.float64)
    matrix[1, 2], matrix[1, :, 2] = 0.0, 0.0  # singular
    matrix[2, 0, 0] = torch.nan
    found = covariance_of(matrix, torch.tensor([True, True, False, True]))
    assert bool(found[1:3].isnan().all())
    torch.testing.assert_close(found[[0, 3]], torch.linalg.inv(matrix[[0, 3]]), atol=1e-9, rtol=1e-9)
