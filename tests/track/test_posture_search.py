"""Where the first hand is looked for: the likeliest piece of a picture, and others every few searches."""

from dataclasses import replace
from typing import Any

import pytest
import torch

import torchhand.track.proposals.posture_search as room
from tests.steps import right_hand, run
from torchhand.fit.detect import NoStart
from torchhand.track import DEFAULTS, Tracker

SETTINGS = replace(DEFAULTS["contour"], pose_space="dof26", learned_proposals=False, learned_posture=False)


def test_other_pieces_are_looked_at_in_every_fifth_search(studio: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[bool] = []

    def nothing(*_: object, looks_elsewhere: bool, **__: object) -> NoStart:
        looked.append(looks_elsewhere)
        return NoStart(reason="nothing", has_foreground=False)

    monkeypatch.setattr(room, "find_hand", nothing)
    placed = studio.placed(size=0.8)
    tracker = Tracker(right_hand(), placed.camera, SETTINGS, shape=placed.shape)
    state, _ = run(tracker, [placed.picture(seed=1)] * 7)
    assert looked == [True, False, False, False, False, True, False]
    assert state.searches_in_vain == 7


def test_searches_are_in_vain_until_a_hand_is_found(studio: Any) -> None:
    placed = studio.placed(size=0.8, camera=studio.camera(320, 240))
    picture = placed.picture(seed=1)
    wall = torch.zeros_like(picture) + picture[0, 0]
    tracker = Tracker(right_hand(), placed.camera, SETTINGS, shape=placed.shape)
    state, _ = run(tracker, [wall] * 2)
    assert state.searches_in_vain == 2
    state, [estimate] = run(tracker, [picture], state)
    assert (estimate.status, state.searches_in_vain) == ("tracked", 0)
