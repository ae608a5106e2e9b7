"""The hypothesis study on one small simulated picture: starts as ordered, nearer to the truth after registration, and
the same whenever a batch is run."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.fit import SolveStatus, Stage
from torchhand.fit.contour import ContourSettings
from torchhand.fit.detect import facing_rotation
from torchhand.geometry import assumed_camera
from torchhand.hand import DOFS, HandPose, posture
from torchhand.study import PerturbationSettings
from torchhand.study.hypotheses.case_study import CaseStudy, StudyBatch, StudyCase, plan_batches
from torchhand.study.hypotheses.record import Hypotheses
from torchhand.study.hypotheses.settings import HypothesisStudySettings
from torchhand.view import HandProjector

MODEL = load_hand_model()
QUICK = (Stage(gross_m=0.0093, rounds=2, iterations=3),)
SETTINGS = HypothesisStudySettings(
    starts=20,
    batch=10,
    perturbation=PerturbationSettings(angle_deg=10.0, translation_mm=8.0, rotation_deg=8.0, levels=2),
    points_per_generator=6,
    points_per_arc=6,
    schedule=QUICK,
    contour=ContourSettings(boundary_points=96),
)
BATCH = StudyBatch(index=1, case=0, first=10, count=10)


@pytest.fixture(scope="module")
def case() -> StudyCase:
    """A right hand's back, 160 × 128."""
    camera = assumed_camera(160, 128)
    kinematics = MODEL.kinematics(dtype=torch.float64)
    pose, reference = posture("open", dtype=torch.float64), facing_rotation("back")
    pose[:3] = torch.tensor((0.0, 0.08, 0.42))
    projector = HandProjector(kinematics, camera)
    return StudyCase(
        frame=3,
        image=torch.zeros(128, 160, 3, dtype=torch.uint8),
        mask=projector.silhouette(pose, reference),
        camera=camera,
        side="right",
        shape=kinematics.default_shape,
        pose=HandPose.of(pose, reference),
    )


@pytest.fixture(scope="module")
def study(case: StudyCase) -> CaseStudy:
    return CaseStudy(case, MODEL, SETTINGS)


@pytest.fixture(scope="module")
def found(study: CaseStudy) -> Hypotheses:
    return study.run(BATCH, 5)


def assert_same(one: Hypotheses, other: Hypotheses) -> None:
    for f in fields(Hypotheses):
        np.testing.assert_array_equal(getattr(one, f.name), getattr(other, f.name), err_msg=f.name)


def test_starts_are_shared_out() -> None:
    plan = plan_batches(replace(SETTINGS, starts=32), 3)
    assert [(batch.index, batch.case, batch.first, batch.count) for batch in plan] == [
        *((0, 0, 0, 10), (1, 0, 10, 1)),
        *((2, 1, 0, 10), (3, 1, 10, 1)),
        (4, 2, 0, 10),
    ]
    with pytest.raises(ValueError, match="cases: expected 1 to 20, one start each, got 21"):
        plan_batches(SETTINGS, 21)


def test_starts_are_as_far_off_as_ordered(found: Hypotheses, study: CaseStudy) -> None:
    assert found.level.tolist() == [1, 2] * 5
    assert set(found.frame) == {3}
    size = found.level / 2
    turn = np.linalg.norm(found.perturbation[:, 3:6], axis=1)
    assert (np.abs(found.perturbation[:, :3]) <= 8e-3 * size[:, None]).all()
    assert (turn <= np.radians(8) * size).all()
    assert (np.abs(found.perturbation[:, 6:]) <= np.radians(10) * size[:, None]).all()
    np.testing.assert_allclose(found.start_rotation_deg, np.degrees(turn), rtol=1e-9)
    moved = study.space.basis[6:].numpy()
    joints = np.abs(found.perturbation @ moved.T)[:, moved.any(-1)]
    np.testing.assert_allclose(found.start_angle_deg, np.degrees(joints.mean(1)), rtol=1e-9)


def test_registration_brings_them_nearer(found: Hypotheses) -> None:
    assert (found.status <= SolveStatus.STALLED.value).all()
    large = found.level == 2
    assert np.median(found.keypoint_mm[large]) < 0.6 * np.median(found.start_keypoint_mm[large])
    assert np.median(found.angle_deg[large]) < np.median(found.start_angle_deg[large])
    assert np.median(found.contour_px) < 0.6
    assert ((found.iterations >= 1) & (found.iterations <= 6)).all()


def test_poses_are_those_of_the_errors(found: Hypotheses, study: CaseStudy, case: StudyCase) -> None:
    kinematics = study.kinematics
    truth = kinematics(case.pose.dofs, root_reference=case.pose.reference).keypoints
    points = kinematics(torch.from_numpy(found.pose)).keypoints  # the rotation vector is the whole rotation
    missed = 1e3 * (points - truth).norm(dim=-1).mean(-1)
    np.testing.assert_allclose(found.keypoint_mm, missed.numpy(), atol=1e-4)  # rotations are of single precision


def test_a_batch_is_the_same_whenever_it_is_run(found: Hypotheses, case: StudyCase, study: CaseStudy) -> None:
    other = StudyBatch(index=0, case=0, first=0, count=10)
    first = study.run(other, 5)
    assert_same(study.run(BATCH, 5), found)
    again = CaseStudy(case, MODEL, SETTINGS)
    assert_same(again.run(BATCH, 5), found)
    for another in (first, study.run(BATCH, 6)):
        assert not (another.perturbation[:, :6] == found.perturbation[:, :6]).any()


def test_what_the_registration_knows_makes_a_difference(found: Hypotheses, case: StudyCase) -> None:
    for change in ({"has_prior": False}, {"has_start_prior": False}):
        other = CaseStudy(case, MODEL, replace(SETTINGS, **change)).run(BATCH, 5)
        np.testing.assert_array_equal(other.perturbation, found.perturbation)
        assert np.abs(other.angle_deg - found.angle_deg).min() > 1e-3
        assert other.angle_deg.mean() > found.angle_deg.mean()


def test_the_mesh_and_the_other_optimiser(case: StudyCase) -> None:
    few = replace(BATCH, count=4)
    for settings in (
        replace(SETTINGS, surface="mesh", mesh_points=150),
        replace(SETTINGS, schedule=tuple(replace(stage, method="gradient_descent") for stage in QUICK)),
    ):
        study = CaseStudy(case, MODEL, settings)
        found = study.run(few, 5)
        assert np.median(found.keypoint_mm / found.start_keypoint_mm) < 1


def test_the_reference_lies_in_every_space(case: StudyCase) -> None:
    """What a space ties or holds is as in the reference, so that it is exact."""
    bent = case.pose.dofs.clone()
    bent[DOFS.index("index_dip_fe")] = 0.4  # not two thirds of the PIP's
    bent[DOFS.index("index_mcp_tw")] = 0.05  # not free
    turned = bent.clone()
    turned[3:6] = torch.tensor((0.1, 0.2, -0.1))
    for dofs in (bent, turned):
        study = CaseStudy(replace(case, pose=HandPose.of(dofs, case.pose.reference)), MODEL, SETTINGS)
        expected = MODEL.kinematics(dtype=torch.float64)(dofs, root_reference=case.pose.reference).keypoints
        centre = study.space.dof(torch.zeros(study.space.size).double())
        keypoints = study.kinematics(centre, root_reference=study.case.pose.reference).keypoints
        torch.testing.assert_close(keypoints, expected, atol=1e-12, rtol=0)


def test_overlap_of_the_reference(case: StudyCase, study: CaseStudy) -> None:
    assert study.overlap == 1
    moved = case.pose.retract(0.02 * torch.nn.functional.one_hot(torch.tensor(0), 36).double())
    assert 0.3 < CaseStudy(replace(case, pose=moved), MODEL, SETTINGS).overlap < 0.9


def test_a_reference_is_put_where_registration_wants_it(case: StudyCase) -> None:
    step = torch.zeros(36, dtype=torch.float64)
    step[:2], step[5] = 0.004, 0.05
    wrong = replace(case, pose=case.pose.retract(step))
    study = CaseStudy(wrong, MODEL, SETTINGS)
    refined = study.refined(6, 0)
    kinematics = study.kinematics

    def missed(one: StudyCase) -> float:
        points, truth = (kinematics(c.pose.dofs, root_reference=c.pose.reference).keypoints for c in (one, case))
        return float((points - truth).norm(dim=-1).mean())

    assert missed(refined) < 0.5 * missed(wrong)
    again = study.refined(6, 0)
    assert torch.equal(again.pose.dofs, refined.pose.dofs)
    assert torch.equal(again.pose.reference, refined.pose.reference)


def test_failures_hold_no_stale_numbers(case: StudyCase) -> None:
    behind = replace(case.pose, dofs=case.pose.dofs.clone())
    behind.dofs[2] = -0.4
    empty = torch.zeros_like(case.mask)
    for wrong, status in ((replace(case, pose=behind), "FAILED"), (replace(case, mask=empty), "NO_DATA")):
        found = CaseStudy(wrong, MODEL, SETTINGS).run(replace(BATCH, count=3), 5)
        assert found.status.tolist() == [SolveStatus[status].value] * 3
        assert not found.is_registered.any()
        assert not found.is_success(180.0).any()
        assert np.isinf(found.cost).all()
        for name in ("angle_deg", "keypoint_mm", "rotation_deg", "contour_px", "pose"):
            assert np.isnan(getattr(found, name)).all(), name


@pytest.mark.gpu
def test_on_a_gpu(case: StudyCase, found: Hypotheses) -> None:
    there = CaseStudy(case, MODEL, SETTINGS, device="cuda").run(BATCH, 5)
    np.testing.assert_array_equal(there.perturbation, found.perturbation)
    np.testing.assert_allclose(there.start_angle_deg, found.start_angle_deg, atol=1e-9)
    assert np.median(np.abs(there.angle_deg - found.angle_deg)) < 0.1
