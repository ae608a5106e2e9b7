"""Learned proposals in the tracker: hands start in other postures than that of the start, and skin does not."""

from dataclasses import replace
from typing import Any

import torch

from tests.steps import right_hand, run
from torchhand.track import DEFAULTS, Tracker

SETTINGS = replace(DEFAULTS["contour"], pose_space="dof26")
WITHOUT = replace(SETTINGS, learned_proposals=False)


def test_hands_in_other_postures_are_found(studio: Any) -> None:
    """Of pointing hands, victory signs and fists from both sides most are, and without the network hardly any."""
    found = []
    for settings in (SETTINGS, WITHOUT):
        count = 0
        for posed in ("point", "victory", "fist"):
            for view in ("palm", "back"):
                placed = studio.placed(size=0.8, posed=posed, view=view, camera=studio.camera(320, 240))
                tracker = Tracker(right_hand(), placed.camera, settings, shape=placed.shape)
                _, [estimate] = run(tracker, [placed.picture(seed=1)])
                if estimate.status == "tracked" and estimate.keypoints_px is not None:
                    error = (estimate.keypoints_px[0] - placed.keypoints_px).norm(dim=-1).mean()
                    count += int(float(error) < 20)  # a tenth of an open hand's length
        found.append(count)
    assert found[0] >= 4
    assert found[0] >= found[1] + 2


def test_an_open_hand_starts_as_it_did(studio: Any) -> None:
    """Where the posture of the start is found the network is not asked."""
    placed = studio.placed(size=0.8)
    image = placed.picture(seed=1)
    with_network, without = (
        run(Tracker(right_hand(), placed.camera, settings, shape=placed.shape), [image] * 2)[1]
        for settings in (SETTINGS, WITHOUT)
    )
    for own, other in zip(with_network, without, strict=True):
        assert torch.equal(own.pose, other.pose)


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
        _, estimates = run(Tracker(right_hand(), placed.camera, SETTINGS), [image] * 2)
        assert {one.status for one in estimates} <= {"lost", "no_hand"}, name
