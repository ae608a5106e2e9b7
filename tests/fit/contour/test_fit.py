"""Registration on contours: a known pose recovered from perturbed starts, with both surfaces and all optimisers;
failures as statuses."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import (
    ConstraintPrior,
    GaussianPrior,
    Observation,
    PosturePrior,
    PostureResiduals,
    Problem,
    Schedule,
    Solutions,
    SolveStatus,
    Stage,
    free_bounds,
    solve,
)
from torchhand.fit.contour.observation import ContourObservation
from torchhand.fit.contour.picture import PictureContours, picture_contours
from torchhand.fit.contour.settings import SEARCH, TRACKING, ContourSettings
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, HandPose, PoseConstraints, PoseSpace, named_pose_space, pose_space
from torchhand.hand.limits import clamp_to_limits
from torchhand.view import Contours, MeshContours, PrimitiveContours, mesh_silhouette, outline_table

SPACE = named_pose_space("dof26")
TABLE = outline_table(8, 8, without=("palm_wrist",))
DEGREE = math.pi / 180


class Case:
    """An open hand in a picture of 320 × 256, its truth within the space, and starts around it."""

    def __init__(self, studio: Any, *, posed: str = "open", view: str = "palm", side: str = "right") -> None:
        placed = studio.placed(posed=posed, view=view, side=side, camera=studio.camera(320, 256))
        self.model = load_hand_model()
        dofs = clamp_to_limits(SPACE.dof(SPACE.free(placed.pose)), self.model.skeleton)
        self.placed = replace(placed, pose=dofs)
        self.truth = HandPose.of(dofs, placed.root_reference)
        self.contours = PrimitiveContours(self.placed.projector, TABLE)

    def starts(self, count: int, *, deg: float = 8.0, mm: float = 6.0, seed: int = 3) -> HandPose:
        generator = torch.Generator().manual_seed(seed)

        def uniform(*size: int) -> Tensor:
            return 2 * torch.rand(*size, generator=generator, dtype=torch.float64) - 1

        free = SPACE.free(self.truth.dofs) + torch.cat(
            (mm * 1e-3 * uniform(count, 3), torch.zeros(count, 3), deg * DEGREE * uniform(count, 20)), -1
        )
        free = free.clamp(*free_bounds(SPACE, self.model.skeleton))
        turned = rotation_from_vector(deg * DEGREE * uniform(count, 3) / math.sqrt(3)) @ self.truth.reference
        return HandPose.of(SPACE.dof(free), turned)

    def expected(self, starts: HandPose, deg: float = 8.0) -> GaussianPrior:
        std = torch.full((SPACE.size,), deg * DEGREE, dtype=torch.float64)
        std[:3], std[3:6] = 0.02, 0.2
        return GaussianPrior.of_std(starts, std, SPACE)

    def problem(
        self,
        picture: PictureContours,
        priors: tuple[Observation, ...] = (),
        *,
        space: PoseSpace = SPACE,
        contours: Contours | None = None,
        settings: ContourSettings | None = None,
    ) -> Problem:
        observation = ContourObservation(
            picture=picture, contours=contours or self.contours, settings=settings or ContourSettings()
        )
        return Problem(
            space=space,
            skeleton=self.model.skeleton,
            shape=self.contours.shape,
            observations=(observation,),
            priors=priors,
        )

    def fitted(self, picture: PictureContours, count: int, schedule: Schedule = SEARCH) -> Solutions:
        """With all that a tracker knows, but the posture."""
        starts = self.starts(count)
        priors = (ConstraintPrior(constraints=PoseConstraints(self.model.skeleton)), self.expected(starts))
        return solve(self.problem(picture, priors), starts, schedule)

    def errors(self, hands: HandPose) -> tuple[Tensor, Tensor]:
        """Mean joint error in degrees, mean keypoint error in mm."""
        kinematics, placed, truth = self.placed.kinematics, self.placed, self.truth
        used = SPACE.basis[6:].any(-1)
        angles = (hands.dofs - truth.dofs)[..., 6:][..., used].abs().mean(-1) / DEGREE
        points, true = (
            kinematics(one.dofs, placed.shape, root_reference=one.reference).keypoints for one in (hands, truth)
        )
        return angles, 1e3 * (points - true).norm(dim=-1).mean(-1)


def contour_px(found: Solutions) -> Tensor:
    return found.explained_by("contour").distance


@pytest.fixture(scope="module")
def case(studio: Any) -> Case:
    return Case(studio)


@pytest.fixture(scope="module")
def picture(case: Case) -> PictureContours:
    return picture_contours(case.placed.mask, SEARCH)


def test_recovers_a_known_pose_from_perturbed_starts(case: Case, picture: PictureContours) -> None:
    """What a silhouette tells comes back; flexion towards the camera is left to what was expected."""
    found = case.fitted(picture, 12)
    angles, points = case.errors(found.pose)
    begun = case.errors(case.starts(12))
    assert float((points < 5).double().mean()) >= 0.75
    assert float(points.median()) < 0.4 * float(begun[1].median())
    assert float(angles.median()) < 0.85 * float(begun[0].median())
    assert float(contour_px(found).median()) < 0.6
    best = found.select(found.best)
    assert float(case.errors(best.pose)[1]) < 4
    assert best.status.shape == ()


def test_best_stays_at_the_truth(case: Case, picture: PictureContours) -> None:
    found = solve(case.problem(picture), case.truth, SEARCH)
    assert float(contour_px(found)) < 0.6
    assert float(found.explained_by("contour").fraction) > 0.95
    assert float(case.errors(found.pose)[1]) < 5
    assert found.status in (SolveStatus.CONVERGED, SolveStatus.STALLED)
    assert float(found.pose.dofs[3:6].abs().max()) == 0
    assert float(torch.linalg.eigvalsh(found.covariance).min()) > 0


@pytest.mark.parametrize("side", ["left", "right"])
def test_either_hand_from_its_back(side: str, studio: Any) -> None:
    case = Case(studio, view="back", side=side, posed="four")
    found = case.fitted(picture_contours(case.placed.mask, SEARCH), 6)
    assert float(case.errors(found.select(found.best).pose)[1]) < 5


@pytest.mark.parametrize(("method", "left"), [("gradient_descent", 0.75), ("gauss_newton", 0.6)])
def test_other_optimisers_go_the_same_way(method: Any, left: float, case: Case) -> None:
    schedule = (
        Stage(gross_m=0.0112, rounds=3, iterations=3, method=method),
        Stage(gross_m=0.0056, rounds=2, iterations=3, method=method),
    )
    found = case.fitted(picture_contours(case.placed.mask, schedule), 4, schedule)
    begun = case.errors(case.starts(4))[1]
    assert float(case.errors(found.pose)[1].median()) < left * float(begun.median())


def test_the_mesh_fits_its_own_silhouette(case: Case) -> None:
    hand = case.model.hand(dtype=torch.float64)
    contours = MeshContours(hand, case.placed.camera, case.placed.shape, max_points=200)
    state = hand(case.truth.dofs, root_reference=case.truth.reference)
    mask = mesh_silhouette(state.vertices, state.faces, case.placed.camera, is_closed=True)
    starts = case.starts(3, deg=5, mm=4)
    problem = case.problem(picture_contours(mask, TRACKING), (case.expected(starts, 5.0),), contours=contours)
    found = solve(problem, starts, TRACKING)
    assert float(case.errors(found.pose)[1].median()) < 0.5 * float(case.errors(starts)[1].median())
    assert float(contour_px(found).median()) < 0.7


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_hypotheses_are_a_batch_of_any_shape(batch: tuple[int, ...], case: Case, picture: PictureContours) -> None:
    """Equal to one by one, and in any number of pieces."""
    count = math.prod(batch)
    starts = case.starts(count)
    found = solve(case.problem(picture, (case.expected(starts),)), starts.reshape(*batch), SEARCH, at_once=4)
    assert found.status.shape == batch
    assert found.covariance.shape == (*batch, SPACE.size, SPACE.size)
    for i in range(count):
        alone = solve(case.problem(picture, (case.expected(starts[i]),)), starts[i], SEARCH)
        torch.testing.assert_close(found.pose.reshape(-1)[i].dofs, alone.pose.dofs, atol=1e-9, rtol=0)
        torch.testing.assert_close(found.cost.reshape(-1)[i], alone.cost, atol=0, rtol=1e-9)


def test_failed_hypotheses_beside_good_ones(case: Case, picture: PictureContours) -> None:
    """Not finite, behind the camera, far outside the picture: a status each, and no harm to their neighbours."""
    starts = case.starts(5)
    starts.dofs[1, 0] = torch.nan
    starts.dofs[2, 2] = -0.4
    starts.dofs[3, 0] += 30.0
    found = solve(case.problem(picture, (case.expected(starts),)), starts, SEARCH)
    assert found.status[1] == found.status[2] == SolveStatus.FAILED
    assert bool(found.cost[1:3].isinf().all())
    assert bool(found.covariance[1:3].isnan().all())
    torch.testing.assert_close(found.pose.dofs[2], starts.dofs[2] * (torch.arange(36) // 3 != 1))
    good = torch.tensor([0, 4])
    alone = solve(case.problem(picture, (case.expected(starts[good]),)), starts[good], SEARCH)
    assert bool((alone.cost[:, None] < found.cost[[1, 2, 3]]).all())
    torch.testing.assert_close(found.pose.dofs[good], alone.pose.dofs, atol=1e-9, rtol=0)
    assert found.best in good


def test_an_empty_silhouette_is_no_data(case: Case) -> None:
    empty = picture_contours(torch.zeros(256, 320, dtype=torch.bool), SEARCH)
    found = solve(case.problem(empty), case.starts(2), SEARCH)
    assert found.status.tolist() == [SolveStatus.NO_DATA] * 2


def test_coverage_draws_a_folded_finger_out(case: Case) -> None:
    """A finger folded before the palm: without the second side it stays."""
    dofs = case.truth.dofs.clone()
    for name in ("index_pip_fe", "index_mcp_fe"):
        dofs[DOFS.index(name)] = 35 * DEGREE
    start, found = HandPose.of(SPACE.dof(SPACE.free(dofs)), case.truth.reference), {}
    for weight in (0.0, 60.0):
        settings = ContourSettings(coverage_weight=weight)
        picture = picture_contours(case.placed.mask, SEARCH, settings)
        found[weight] = solve(case.problem(picture, settings=settings), start, SEARCH)
    assert float(contour_px(found[60.0])) < 0.8
    bent = {weight: float(one.pose.dofs[DOFS.index("index_pip_fe")]) for weight, one in found.items()}
    assert bent[60.0] < 0.5 * bent[0.0]


def test_limits_hold_and_small_spaces_keep_the_rest(case: Case, picture: PictureContours) -> None:
    found = case.fitted(picture, 4)
    skeleton, truth = case.model.skeleton, case.truth
    assert bool((found.pose.dofs[:, 6:] >= skeleton.lower - 1e-9).all())
    assert bool((found.pose.dofs[:, 6:] <= skeleton.upper + 1e-9).all())
    planar = pose_space("planar", ("root_tx", "root_ty", "root_rz")).about(truth.dofs)
    step = torch.zeros(36, dtype=torch.float64)
    step[[0, 1, 5]] = torch.tensor((0.006, -0.004, 0.05), dtype=torch.float64)
    moved = solve(case.problem(picture, space=planar), truth.retract(step), SEARCH)
    torch.testing.assert_close(moved.pose.dofs[6:], skeleton.within_limits(truth.dofs[6:]))
    left = truth.step_to(moved.pose)
    assert float(left[:2].norm()) < 1e-3
    assert float(left[3:6].norm()) < 0.01


def test_a_space_s_own_rotation_means_nothing(case: Case, picture: PictureContours) -> None:
    """The root turns about its reference: a space through a turned pose gives what one through the pose does."""
    starts = case.starts(2)
    turned = SPACE.constant.clone()
    turned[3:6] = torch.tensor((0.3, -0.2, 0.4), dtype=torch.float64)
    one, other = (
        solve(case.problem(picture, (case.expected(starts),), space=space), starts, TRACKING)
        for space in (SPACE, SPACE.about(turned))
    )
    torch.testing.assert_close(one.pose.dofs, other.pose.dofs, atol=1e-9, rtol=0)
    torch.testing.assert_close(one.pose.reference, other.pose.reference, atol=1e-9, rtol=0)


def test_prior_draws_towards_likely_postures(case: Case, picture: PictureContours) -> None:
    """With little contour to go by, the posture prior decides about flexion."""
    postures = PostureResiduals.of(case.model.prior().postures)
    starts = case.starts(4, deg=15)
    free = solve(case.problem(picture), starts, SEARCH)
    drawn = solve(case.problem(picture, (PosturePrior(postures=postures),)), starts, SEARCH)

    def energy(found: Solutions) -> float:
        dofs = found.pose.dofs
        return float(postures.of_joints(dofs, postures.likeliest(dofs))[0].square().sum(-1).mean())

    assert energy(drawn) < 0.7 * energy(free)


def test_gradients_flow_after_a_registration(studio: Any) -> None:
    """Results are plain tensors, and nothing that is shared was made for inference only."""
    case = Case(studio)
    hand = case.model.hand(dtype=torch.float64)
    mesh = MeshContours(hand, case.placed.camera, case.placed.shape, max_points=50)
    picture = picture_contours(case.placed.mask, TRACKING)
    for contours in (case.contours, mesh):
        found = solve(case.problem(picture, contours=contours), case.truth, TRACKING)
        dofs = found.pose.dofs.clone().requires_grad_()
        points = case.contours.projector.outline_px(dofs, found.pose.reference, TABLE)
        skin = hand(dofs, root_reference=found.pose.reference).vertices
        (points.square().sum() + skin.sum() + (found.covariance * dofs[0]).sum()).backward()
        assert dofs.grad is not None
        assert bool(dofs.grad.isfinite().all())
