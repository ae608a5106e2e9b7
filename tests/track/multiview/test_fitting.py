import pytest
import torch

from torchhand.fit.hull import SEARCH, HullFitter, HullStartSettings, finger_proposals
from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandPose
from torchhand.track.multiview.fitting import FrameFitter, HullFit, best_of
from torchhand.track.multiview.settings import RigSettings

SETTINGS = RigSettings(
    start=HullStartSettings(places=1, rolls=8, postures=("open", "point"), coarse=12, fine=2, finger_rounds=0)
)


@pytest.fixture(scope="module")
def fitter(rig_hand, rig) -> FrameFitter:
    return FrameFitter(rig_hand, rig, SETTINGS)


def _error_mm(rig_hand, fit: HullFit | None, pose) -> float:
    assert fit is not None
    found = rig_hand.kinematics(fit.pose.dofs, root_reference=fit.pose.reference).keypoints
    truth = rig_hand.kinematics(pose[0], root_reference=pose[1]).keypoints
    return 1e3 * float((found - truth).norm(dim=-1).mean())


def test_hand_that_turned_fast_about_its_forearm_is_followed(fitter, rig_hand, pose_at, masks_of):
    pose, reference = pose_at("point")
    masks, shape = masks_of((pose, reference)), rig_hand.kinematics.default_shape
    about = reference @ torch.tensor((0.0, 1.0, 0.0), dtype=torch.float64)
    before = HandPose(dofs=pose, reference=rotation_from_vector(1.1 * about) @ reference)
    with torch.inference_mode():
        hull = fitter.hull_about(before, shape, masks)
        near = fitter.fit_from(hull, [before], shape, masks)
        turned = fitter.vary_orientation(hull, before, shape, masks)
    assert _error_mm(rig_hand, turned, (pose, reference)) < 5.0
    assert turned.score > near.score + 0.05


def test_digit_is_found_though_the_hand_is_some_way_off(fitter, rig_hand, pose_at, masks_of):
    pose, reference = pose_at("point")
    masks, shape = masks_of((pose, reference)), rig_hand.kinematics.default_shape
    fist = torch.cat((pose[:6], pose_at("fist")[0][6:]))
    fist[:3] += torch.tensor((0.006, -0.006, 0.004))
    about = reference @ torch.tensor((0.0, 0.35, 0.1), dtype=torch.float64)
    before = HandPose(dofs=fist, reference=rotation_from_vector(about) @ reference)
    with torch.inference_mode():
        hull = fitter.hull_about(before, shape, masks)
        found = fitter.vary_fingers(hull, before, [], shape, masks)
    assert _error_mm(rig_hand, found, (pose, reference)) < 4.0


def test_large_steps_are_taken_only_where_small_ones_are_not_enough(fitter, rig_hand, pose_at, masks_of, monkeypatch):
    pose, reference = pose_at("point")
    masks, shape = masks_of((pose, reference)), rig_hand.kinematics.default_shape
    start = HandPose(dofs=pose + torch.eye(36, dtype=torch.float64)[0] * 0.004, reference=reference)
    call, schedules = HullFitter.__call__, []

    def noted(self, *arguments):
        schedules.append(self.schedule)
        return call(self, *arguments)

    monkeypatch.setattr(HullFitter, "__call__", noted)
    with torch.inference_mode():
        hull = fitter.hull_about(start, shape, masks)
        near = fitter.refine(hull, start, shape, masks, is_enough=lambda fit: fit.score > 0.9)
        assert SEARCH not in schedules
        assert _error_mm(rig_hand, near, (pose, reference)) < 4.0
        fitter.refine(hull, start, shape, masks, is_enough=lambda fit: fit.score > 1.0)
    assert schedules.count(SEARCH) == 1


def test_other_fingers_are_compared_after_two_steps(fitter, rig_hand, pose_at, masks_of, monkeypatch):
    """Two steps tell which digit is where the silhouettes show it: the cheapest hands alone are fitted to the end."""
    (pose, reference), shape = pose_at("point"), rig_hand.kinematics.default_shape
    masks = masks_of((pose, reference))
    before = HandPose(dofs=torch.cat((pose[:6], pose_at("fist")[0][6:])), reference=reference)
    call, steps_of_all, refined = HullFitter.__call__, [], []

    def noted(self, target, starts, *priors):
        found = call(self, target, starts, *priors)
        if len(starts) >= len(finger_proposals(before)):
            steps_of_all.append(int(found.iterations.max()))
        else:
            refined.append(len(starts))
        return found

    monkeypatch.setattr(HullFitter, "__call__", noted)
    with torch.inference_mode():
        found = fitter.vary_fingers(fitter.hull_about(before, shape, masks), before, [], shape, masks)
    assert max(steps_of_all) == 2
    assert max(refined) <= 0.5 * len(finger_proposals(before))
    assert _error_mm(rig_hand, found, (pose, reference)) < 4.0


def _before_arm(pose, rig_hand, rig, masks_of, views: int) -> tuple[list[torch.Tensor | None], torch.Tensor]:
    """Some of a posed hand's silhouettes with a forearm that leaves the pictures, most of whose hull is arm; and its
    keypoints."""
    masks, points = masks_of(pose), rig_hand.kinematics(pose[0], root_reference=pose[1]).keypoints
    along = torch.nn.functional.normalize(points[0] - points[9], dim=0)
    arm = points[0] + torch.arange(0.0, 0.4, 0.001, dtype=torch.float64)[:, None] * along
    for camera, mask in zip(rig[:views], masks[:views], strict=True):
        x, y = torch.arange(camera.width)[None], torch.arange(camera.height)[:, None]
        places, depths = camera.project(arm), camera.cam_from_world(arm)[:, 2]
        for (column, row), depth in zip(places.tolist(), depths.tolist(), strict=True):
            if depth > 0.1:
                radius = 0.028 * float(camera.intrinsics[0, 0]) / depth
                mask |= (x - column) ** 2 + (y - row) ** 2 < radius**2
    return [*masks[:views], *[None] * (len(rig) - views)], points


def test_search_finds_the_hand_at_the_end_of_an_arm(fitter, rig_hand, rig, pose_at, masks_of):
    pose, shape = pose_at("point"), rig_hand.kinematics.default_shape
    masks, _ = _before_arm(pose, rig_hand, rig, masks_of, views=3)
    with torch.inference_mode():
        found = fitter.search(fitter.hull_anywhere(shape, masks), shape, masks)
    assert _error_mm(rig_hand, found, pose) < 12.0


def test_two_views_of_an_arm_tell_the_hand_and_then_its_fingers(fitter, rig_hand, rig, pose_at, masks_of):
    """How far the fingers of the fist are bent hardly shows: the search leaves it open, finger proposals decide it."""
    pose, shape = pose_at("point"), rig_hand.kinematics.default_shape
    masks, points = _before_arm(pose, rig_hand, rig, masks_of, views=2)
    with torch.inference_mode():
        hull = fitter.hull_anywhere(shape, masks)
        found = fitter.search(hull, shape, masks)
        assert found is not None
        places = rig_hand.kinematics(found.pose.dofs, root_reference=found.pose.reference).keypoints
        varied = fitter.vary_fingers(hull, found.pose, [], shape, masks)
    seen = [0, 5, 6, 7, 8, 9, 13, 17]  # wrist, knuckles and the finger that points
    assert float((places - points).norm(dim=-1)[seen].max()) < 0.012
    assert _error_mm(rig_hand, varied, pose) < 12.0


def test_best_of_hands_that_explain_alike_is_the_one_of_lowest_cost(fitter, rig_hand, pose_at, masks_of):
    masks, shape = masks_of(pose_at()), rig_hand.kinematics.default_shape
    with torch.inference_mode():
        starts = [HandPose(dofs=p, reference=r) for p, r in (pose_at(), pose_at(turn=0.5))]
        hull = fitter.hull_about(starts[0], shape, masks)
        good, other = (fitter.fit_from(hull, [start], shape, masks) for start in starts)
        far = fitter.vary_fingers(hull, HandPose(dofs=pose_at("fist")[0], reference=pose_at()[1]), [], shape, masks)
    assert best_of([None, far, good]) is good
    assert good is not None
    assert other is not None
    assert best_of([other, good]) is min((good, other), key=lambda one: float(one.cost))
    assert best_of([None]) is None
