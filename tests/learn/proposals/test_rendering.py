"""Rendered hands: exact pictures of the posed mesh, and the truth beside them."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.hand import HandPrior
from torchhand.learn.proposals.postures import drawn_hands, known_postures
from torchhand.learn.proposals.rendering import (
    HAND,
    HAND_SHARE,
    RENDERED_PX,
    RenderedHands,
    hand_pool,
    random_directions,
)

MODEL = load_hand_model()


def _plane(rendered: RenderedHands, pixels: Tensor, row: int) -> Tensor:
    return ((2 * pixels + 1) / RENDERED_PX - 1) * rendered.reach[row]


def test_hands_fill_the_square(rendered: RenderedHands) -> None:
    for row in range(len(rendered)):
        rows, columns = (rendered.label[row] == HAND).nonzero().float().unbind(-1)
        half = 0.5 * max(float(rows.max() - rows.min()), float(columns.max() - columns.min())) + 0.5
        assert half / (0.5 * RENDERED_PX) <= HAND_SHARE + 0.03
    sizes = (rendered.label == HAND).flatten(1).float().mean(1)
    assert bool((sizes > 0.03).all())


def test_the_palm_is_in_the_picture_of_the_hand(rendered: RenderedHands) -> None:
    """Behind the skin that is seen there, by less than a hand's thickness."""
    at = rendered.palm[:, :2] / rendered.palm[:, 2:] / rendered.reach[:, None]
    assert bool((at.abs() < HAND_SHARE + 0.05).all())
    pixels = (((at + 1) * RENDERED_PX - 1) / 2).round().long().clamp(0, RENDERED_PX - 1)
    rows = torch.arange(len(rendered))
    labels = rendered.label[rows, pixels[:, 1], pixels[:, 0]]
    assert float((labels > 0).float().mean()) > 0.9
    depth = (rendered.depth[rows, pixels[:, 1], pixels[:, 0]].float() / 127.5 - 1) * 0.15
    assert bool((depth[labels == HAND] < 0.03).all())


def test_keypoints_project_into_the_silhouette(rendered: RenderedHands) -> None:
    """Joint centres lie inside the skin, so whatever hides them is hand or forearm."""
    kinematics = MODEL.kinematics(dtype=torch.float32)
    pose = torch.cat((torch.zeros(len(rendered), 6), rendered.joints), -1)
    points = kinematics(pose, root_reference=rendered.rotation).keypoints
    scale = rendered.length / MODEL.shape_space.default[MODEL.shape_space.names.index("hand_length")].float()
    points = points - points[:, [0, 5, 9, 13, 17]].mean(1, keepdim=True)
    points = scale[:, None, None] * points + rendered.palm[:, None]
    plane = points[..., :2] / points[..., 2:] / rendered.reach[:, None, None]
    pixels = (((plane + 1) * RENDERED_PX - 1) / 2).round().long().clamp(0, RENDERED_PX - 1)
    rows = torch.arange(len(rendered))[:, None]
    inside = rendered.label[rows, pixels[..., 1], pixels[..., 0]] > 0
    assert float(inside.float().mean()) > 0.9  # people have other proportions than the usual hand


def test_normals_of_what_is_seen_point_to_the_camera(rendered: RenderedHands) -> None:
    normal = rendered.normal.float() / 127.5 - 1
    length = normal.square().sum(1)
    assert bool((length <= 1.02).all())
    assert float(length[rendered.label == 0].abs().max()) < 1e-3


def test_all_directions_occur_and_hands_along_the_line_of_sight_are_rarer() -> None:
    turn = random_directions(4000, torch.Generator().manual_seed(0))
    torch.testing.assert_close(turn @ turn.mT, torch.eye(3).expand(4000, 3, 3), atol=1e-5, rtol=0)
    dorsal, fingers = turn[:, 2, 0], turn[:, 2, 1]
    assert float((dorsal > 0).float().mean()) == pytest.approx(0.5, abs=0.03)
    steep = float((fingers.abs() > 0.75).float().mean())
    assert steep == pytest.approx(0.25 * 0.4 / (0.75 + 0.25 * 0.4), abs=0.02)  # of a quarter of all, two fifths
    angle = torch.atan2(turn[:, 0, 1], -turn[:, 1, 1])
    assert float(torch.histc(angle, 4, -math.pi, math.pi).min()) > 900


def test_the_same_seed_gives_the_same_hands(rendered: RenderedHands) -> None:
    again = hand_pool(MODEL, len(rendered), torch.Generator().manual_seed(5))
    assert torch.equal(again.label, rendered.label)
    assert torch.equal(again.rotation, rendered.rotation)


def test_drawn_joints_keep_their_limits_and_reach_fists_and_signs() -> None:
    prior = HandPrior(MODEL.skeleton, MODEL.shape_space, dtype=torch.float64)
    joints, shape = drawn_hands(prior, 600, torch.Generator().manual_seed(1))
    torch.testing.assert_close(prior.kinematics.skeleton.within_limits(joints), joints)
    MODEL.shape_space.check(shape)
    known = known_postures(MODEL.skeleton).to(joints)
    apart = (known[:, None] - joints).abs().mean(-1).amin(-1)
    assert float(apart.max()) < math.radians(16)  # every sign and posture has a neighbour
