from dataclasses import replace

import pytest
import torch

from torchhand.fit.hull import HullShapeSettings, HullStartSettings
from torchhand.geometry import Rig
from torchhand.hand import HandPose
from torchhand.numerics import single_threaded
from torchhand.track import HandKeypoints
from torchhand.track.multiview.fitting import FrameFitter
from torchhand.track.multiview.hand_initialization import evenly_spaced_frames, initialize_hand
from torchhand.track.multiview.initialization import best_unit
from torchhand.track.multiview.proposer import HandProposer
from torchhand.track.multiview.scale import resized_pose, resized_shape, rough_units, size_factor, unit_by_points
from torchhand.track.multiview.settings import RigSettings
from torchhand.track.scene import Scene, View

SETTINGS = RigSettings(
    start=HullStartSettings(places=1, rolls=4, postures=("open",), coarse=6, fine=2, finger_rounds=0),
    shape=HullShapeSettings(rounds=3),
)


@pytest.mark.parametrize(
    ("count", "wanted", "expected"),
    [(12, 12, tuple(range(12))), (100, 4, (12, 37, 62, 87)), (3, 8, (0, 1, 2)), (5, 0, ()), (0, 4, ())],
)
def test_frames_are_spaced_evenly(count, wanted, expected):
    assert evenly_spaced_frames(count, wanted) == expected


def _scene(masks) -> Scene:
    views = tuple(View(mask=mask) for mask in masks)
    return Scene(views=views, masks=tuple(masks), probabilities=(None,) * len(masks), time_s=0.0)


def _proposer(fitter: FrameFitter) -> HandProposer:
    return HandProposer(kinematics=fitter.hand.kinematics, cameras=fitter.cameras)


@pytest.mark.parametrize("has_network", [True, False])
def test_hand_is_found_in_the_frames_that_show_it(has_network, rig_hand, rig, pose_at, masks_of):
    """By what the network proposes, or by a search in the hull."""
    fitter = FrameFitter(rig_hand, rig, SETTINGS)
    poses = [pose_at(), pose_at(turn=0.45)]
    empty = [torch.zeros_like(mask) for mask in masks_of(poses[0])]
    frames = [(3, _scene(masks_of(poses[0]))), (8, _scene(empty)), (9, _scene(masks_of(poses[1])))]
    done = []
    with torch.inference_mode():
        proposer = replace(_proposer(fitter), has_network=has_network)
        found = initialize_hand(fitter, iter(frames), proposer, done=done.append)
    assert done == [True, False, True]
    assert set(found.poses) == {3, 9}
    assert found.shape_frames == (3, 9)
    space = rig_hand.kinematics.shape_space
    deviation = (found.shape - space.default.to(found.shape)).abs() / space.std.to(found.shape)
    assert float(deviation.mean()) < 1.0
    for pose, (dofs, reference) in zip((found.poses[3], found.poses[9]), poses, strict=True):
        points = rig_hand.kinematics(pose.dofs, found.shape, root_reference=pose.reference).keypoints
        truth = rig_hand.kinematics(dofs, root_reference=reference).keypoints
        assert float((points - truth).norm(dim=-1).mean()) < 0.008


def test_hands_do_not_depend_on_the_number_of_cores(rig_hand, rig, pose_at, masks_of, monkeypatch):
    """Frames after the first hand are searched side by side where there are cores."""
    frames = [(place, _scene(masks_of(pose_at(turn=0.15 * place)))) for place in range(3)]
    found = []
    for cores in (1, 2):
        monkeypatch.setattr("torchhand.cluster.processes.usable_cores", lambda cores=cores: cores)
        fitter = FrameFitter(rig_hand, rig, SETTINGS)
        proposer = _proposer(fitter)
        with torch.inference_mode(), single_threaded():
            found.append(initialize_hand(fitter, iter(frames), proposer, shape=rig_hand.kinematics.default_shape))
    assert set(found[0].poses) == set(found[1].poses) == {0, 1, 2}
    for place in range(3):
        for name in ("dofs", "reference"):
            own, other = (getattr(one.poses[place], name) for one in found)
            assert torch.equal(own, other), (place, name)


def test_nothing_is_proposed_where_keypoints_tell_the_hand(rig_hand, rig, pose_at, masks_of):
    fitter, pose = FrameFitter(rig_hand, rig, SETTINGS), pose_at()
    known = HandPose(dofs=pose[0], reference=pose[1]).normalized().reshape(1)

    def propose(scene, shape):
        raise AssertionError("the network was asked")

    shape = rig_hand.kinematics.default_shape
    told = {"detect": lambda scene, shape: known, "shape": shape}
    found = initialize_hand(fitter, [(4, _scene(masks_of(pose)))], propose, **told)
    points = rig_hand.kinematics(found.poses[4].dofs, shape, root_reference=found.poses[4].reference).keypoints
    truth = rig_hand.kinematics(pose[0], root_reference=pose[1]).keypoints
    assert float((points - truth).norm(dim=-1).mean()) < 0.004


@pytest.mark.parametrize("is_told", [True, False])
def test_how_a_hand_faces_is_decided_over_two_views_alone_where_no_keypoints_tell(
    is_told, rig_hand, rig, pose_at, masks_of, monkeypatch
):
    asked = list[HandPose]()
    monkeypatch.setattr(FrameFitter, "fit_in_place", lambda self, hull, pose, *_: asked.append(pose) or [])
    fitter = FrameFitter(rig_hand, rig[:2], SETTINGS)
    pose = pose_at()
    known = HandPose(dofs=pose[0], reference=pose[1]).normalized().reshape(1)
    found = initialize_hand(
        fitter,
        [(4, _scene(masks_of(pose)[:2]))],
        lambda scene, shape: known,
        detect=lambda scene, shape: known if is_told else None,
        shape=rig_hand.kinematics.default_shape,
    )
    assert set(found.poses) == {4}
    assert len(asked) == (0 if is_told else 1)


def test_first_hand_is_told_before_proportions_are_fitted_to_it(rig_hand, rig, pose_at, masks_of, monkeypatch):
    fitter, pose, order = FrameFitter(rig_hand, rig, SETTINGS), pose_at(), list[str]()
    known, fit_shape = HandPose(dofs=pose[0], reference=pose[1]).normalized().reshape(1), FrameFitter.fit_shape

    def fitted(*arguments, **options):
        order.append("proportions")
        return fit_shape(*arguments, **options)

    monkeypatch.setattr(FrameFitter, "fit_shape", fitted)
    told = {"detect": lambda scene, shape: known, "done": lambda is_found: order.append(f"hand: {is_found}")}
    initialize_hand(fitter, [(0, _scene(masks_of(pose)))], _proposer(fitter), **told)
    assert order == ["hand: True", "proportions", "proportions"]


UNITS = (0.6, 0.72, 0.86, 1.0, 1.17, 1.35, 1.6)


@pytest.mark.parametrize("best", UNITS)
def test_unit_is_that_of_the_frame_that_shows_the_hand(best):
    """A frame without a hand is explained by any size as badly, by chance best by a wrong one."""
    asked = []

    def agreement(unit, frame):
        return 0.95 - 0.2 * abs(unit - best) if frame < 2 else 0.6 - abs(unit - 0.86)

    def agreements(pairs):
        asked.extend(pairs)
        return [agreement(unit, frame) for unit, frame in pairs]

    assert best_unit(UNITS, (2, 1, 0), agreements) == best
    assert asked[:3] == [(1.0, 2), (1.0, 1), (1.0, 0)]
    assert len(asked) == len(set(asked))
    assert {frame for _, frame in asked[3:]} == {0, 1}


def test_an_elbow_that_is_as_good_a_hand_in_one_frame_is_not_in_two():
    """Agreements as an arm that is bare to the elbow gave them."""
    first = dict(zip(UNITS, (0.65, 0.64, 0.778, 0.677, 0.679, 0.777, 0.76), strict=True))
    second = dict(zip(UNITS, (0.47, 0.47, 0.654, 0.627, 0.668, 0.744, 0.70), strict=True))

    def agreements(pairs):
        return [(first if frame == 5 else second)[unit] for unit, frame in pairs]

    assert best_unit(UNITS, (5,), agreements) == 0.86
    assert best_unit(UNITS, (7, 5), agreements) == 1.35


def test_no_hand_is_found_where_there_is_none(rig_hand, rig, pose_at, masks_of):
    fitter = FrameFitter(rig_hand, rig, SETTINGS)
    empty = [torch.zeros_like(mask) for mask in masks_of(pose_at())]
    found = initialize_hand(fitter, [(0, _scene(empty))], _proposer(fitter))
    assert not found.poses
    assert found.shape_std is None
    torch.testing.assert_close(found.shape, rig_hand.kinematics.default_shape)


def test_rough_units_hold_the_true_one(rig, pose_at, masks_of):
    unknown = Rig(rig).scaled(1 / 0.0254)  # as if in inches
    empty = [torch.zeros_like(mask) for mask in masks_of(pose_at())]
    for postures in (("open",), ("fist", "open"), ("fist",)):
        frames = [(i, masks_of(pose_at(name))) for i, name in enumerate(postures)]
        units, decisive = rough_units(unknown, [(9, empty), *frames])
        assert min(abs(unit / 0.0254 - 1) for unit in units) < 0.13
        assert [index for index, _ in decisive] == list(range(len(postures)))
    assert rough_units(unknown, [(9, empty)]) == ((), [])


def test_unit_is_told_by_points_of_two_views(rig_hand, rig, pose_at):
    kinematics, inches = rig_hand.kinematics, Rig(rig).scaled(1 / 0.0254)
    frames = []
    for name in ("open", "fist", "point"):
        pose, reference = pose_at(name)
        points = [camera.project(kinematics(pose, root_reference=reference).keypoints) for camera in rig]
        frames.append([View(keypoints=HandKeypoints(points_px=own, score=0.9)) for own in points])
    frames[1] = [View() for _ in rig]  # of which nothing is seen
    frames[2][1] = View(keypoints=HandKeypoints(points_px=frames[2][1].keypoints.points_px.flip(-1), score=0.9))
    known = (kinematics, kinematics.default_shape)
    assert unit_by_points(inches, frames, *known) == pytest.approx(0.0254, rel=1e-3)
    larger = resized_shape(kinematics.default_shape, 1.1, kinematics.shape_space)
    assert unit_by_points(inches, frames, kinematics, larger) == pytest.approx(1.1 * 0.0254, rel=1e-3)
    alone = [[own[0], *(View() for _ in own[1:])] for own in frames]
    assert unit_by_points(inches, alone, *known) is None


def test_everything_scales_together(rig_hand, pose_at):
    space = rig_hand.kinematics.shape_space
    shape = rig_hand.kinematics.default_shape
    larger = resized_shape(shape, 1.1, space)
    assert size_factor(shape, larger, space) == pytest.approx(1.1)
    pose, reference = pose_at()
    moved = resized_pose(HandPose(dofs=pose, reference=reference), 1.1)
    before = rig_hand.kinematics(pose, shape, root_reference=reference).keypoints
    after = rig_hand.kinematics(moved.dofs, larger, root_reference=moved.reference).keypoints
    torch.testing.assert_close(after, 1.1 * before)


def test_settings_refuse():
    for name, value in (("pose_space", "dof99"), ("shape_frames", -1)):
        with pytest.raises(ValueError, match=name):
            replace(SETTINGS, **{name: value})
