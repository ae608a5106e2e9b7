"""Learned proposals in the tracker: hands start in other postures than that of the start, and skin does not."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from tests.steps import right_hand, run
from torchhand.geometry import assumed_camera
from torchhand.study.status import drawn_pictures
from torchhand.track import DEFAULTS, Tracker
from torchhand.track.proposals import LearnedHands, Proposals, SinglePictureHands
from torchhand.track.scene import Health, View

SETTINGS = replace(DEFAULTS["contour"], pose_space="dof26")
WITHOUT = replace(SETTINGS, learned_proposals=False)


def test_a_hand_in_another_posture_is_found(studio: Any) -> None:
    placed = studio.placed(size=0.8, posed="point", view="back", camera=studio.camera(320, 240))
    tracker = Tracker(right_hand(), placed.camera, SETTINGS, shape=placed.shape)
    _, [estimate] = run(tracker, [placed.picture(seed=1)])
    assert estimate.status == "tracked"
    assert estimate.keypoints_px is not None
    assert float((estimate.keypoints_px[0] - placed.keypoints_px).norm(dim=-1).mean()) < 8  # of 192 for an open hand


def test_without_the_network_it_is_not_found(studio: Any) -> None:
    placed = studio.placed(size=0.8, posed="point", view="back", camera=studio.camera(320, 240))
    tracker = Tracker(right_hand(), placed.camera, WITHOUT, shape=placed.shape)
    _, [estimate] = run(tracker, [placed.picture(seed=1)])
    assert estimate.status in ("no_hand", "lost")


def test_an_open_hand_starts_as_it_did(studio: Any) -> None:
    """Where the posture of the start is found the network is not asked."""
    placed = studio.placed(size=0.8)
    image = placed.picture(seed=1)
    with_network, without = (
        run(Tracker(right_hand(), placed.camera, settings, shape=placed.shape), [image] * 2)[1]
        for settings in (SETTINGS, WITHOUT)
    )
    for own, other in zip(with_network, without, strict=True):
        assert own.pose is not None
        assert other.pose is not None
        assert torch.equal(own.pose, other.pose)


@pytest.mark.slow
def test_a_rigid_hand_is_not_found_again_in_another_posture(studio: Any) -> None:
    """Trackers that hold the posture look for that of the first hand alone."""
    camera = studio.camera(320, 240)
    shown, other = (studio.placed(size=0.8, posed=posed, view="back", camera=camera) for posed in ("open", "point"))
    gone = torch.zeros_like(shown.picture(seed=1)) + shown.picture(seed=1)[0, 0]
    images = [shown.picture(seed=1), *[gone] * 5, *[other.picture(seed=seed) for seed in range(2, 8)]]
    statuses = {}
    for pose_space in ("planar_scale", "dof26"):
        settings = replace(SETTINGS, pose_space=pose_space)
        _, estimates = run(Tracker(right_hand(), camera, settings, shape=shown.shape), images)
        statuses[pose_space] = [one.status for one in estimates]
    assert statuses["planar_scale"][0] == statuses["dof26"][0] == "tracked"
    assert "recovered" in statuses["dof26"][6:]
    assert set(statuses["planar_scale"][6:]) <= {"lost", "no_hand"}


def test_skin_that_is_no_hand_is_none(studio: Any) -> None:
    """An ellipse like a face, and a bar like an arm, in the colours of a hand."""
    placed = studio.placed(size=0.8, camera=studio.camera(320, 240))
    picture = placed.picture(seed=1)
    skin, wall = picture[placed.mask].float().mean(0), picture[0, 0].float()
    y, x = torch.meshgrid(torch.arange(240.0), torch.arange(320.0), indexing="ij")
    shapes = {
        "face": ((x - 160) / 60).square() + ((y - 120) / 80).square() < 1,
        "arm": (x - 150).abs() < 28,
    }
    for name, shape in shapes.items():
        noise = 4 * torch.randn(240, 320, 3, generator=torch.Generator().manual_seed(0))
        image = (torch.where(shape[..., None], skin, wall) + noise).round().clamp(0, 255).to(torch.uint8)
        _, estimates = run(Tracker(right_hand(), placed.camera, SETTINGS), [image])
        assert {one.status for one in estimates} <= {"lost", "no_hand"}, name


def test_a_portrait_is_no_first_hand_though_one_fits_it() -> None:
    """A fist on a forearm is laid over a head on its neck; all that the picture says is against it."""
    [*_, (kind, picture)] = drawn_pictures(2, seed=1)
    assert kind == "portrait"
    height, width = picture.shape[:2]
    _, [estimate] = run(Tracker(right_hand(), assumed_camera(width, height), SETTINGS), [picture])
    assert estimate.status == "no_hand"
    assert "something else is likelier than a hand" in estimate.reason


def test_a_first_hand_has_its_wrist_in_the_picture_or_next_to_it(studio: Any) -> None:
    """A forearm that leaves the picture looks like the palm of a larger hand."""
    placed = studio.placed(size=0.8, posed="point", view="palm", camera=studio.camera(320, 240))
    wrist, middle = (float(placed.keypoints_px[index, 1]) for index in (0, 9))
    statuses = []
    for share in (0.03, 0.3):  # of the way from the wrist to the middle finger's knuckle lies below the picture
        height = round(wrist + share * (middle - wrist))
        tracker = Tracker(right_hand(), replace(placed.camera, height=height), SETTINGS, shape=placed.shape)
        _, [estimate] = run(tracker, [placed.picture(seed=1)[:height].contiguous()])
        statuses.append(estimate.status)
    assert statuses == ["tracked", "no_hand"]


def test_a_hand_beside_something_larger_is_found_as_in_a_single_picture(
    studio: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A larger oval in the colours of the hand is the likeliest piece, of which nobody makes a hand."""
    placed = studio.placed(size=0.5, posed="three", view="palm", camera=studio.camera(480, 320))
    hand = placed.picture(seed=1)
    y, x = torch.meshgrid(torch.arange(320.0), torch.arange(480.0), indexing="ij")
    oval = (((x - 80) / 70).square() + ((y - 140) / 98).square() < 1) & ~placed.mask
    skin = hand[placed.mask].float().mean(0) + 4 * torch.randn(320, 480, 3, generator=torch.Generator().manual_seed(0))
    picture = torch.where(oval[..., None], skin.round().clamp(0, 255).to(torch.uint8), hand)
    tracker = Tracker(right_hand(), placed.camera, SETTINGS)
    state, estimate = tracker.step(None, [View(image=picture)], 0.0)
    assert estimate.status == "no_hand"
    state = replace(state, searches_in_vain=4)
    _, estimate = tracker.step(state, [View(image=picture)], 1 / 30)
    assert estimate.status == "tracked"
    assert estimate.keypoints_px is not None
    assert float((estimate.keypoints_px[0] - placed.keypoints_px).norm(dim=-1).mean()) < 12  # of 150 for an open hand
    monkeypatch.setattr(SinglePictureHands, "__call__", lambda *_: Proposals())
    _, estimate = tracker.step(state, [View(image=picture)], 1 / 30)
    assert estimate.status == "no_hand"


def test_a_hand_that_is_refused_keeps_no_other_source_from_being_asked(
    studio: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def noted(source: Any, *_: Any) -> Proposals:
        asked.append(type(source).__name__)
        return Proposals()

    monkeypatch.setattr(Health, "is_found", lambda *_: False)
    for kind in (LearnedHands, SinglePictureHands):
        monkeypatch.setattr(kind, "__call__", noted)
    placed = studio.placed(size=0.8)
    run(Tracker(right_hand(), placed.camera, SETTINGS, shape=placed.shape), [placed.picture(seed=1)])
    assert asked == ["LearnedHands", "SinglePictureHands"]
