"""What the network sees in training is what it would see of a picture of the same hand."""

import torch

from torchhand.files import load_hand_model
from torchhand.learn.proposals.observing import SeenHands, seen_hands
from torchhand.learn.proposals.rendering import RenderedHands
from torchhand.propose import CHANNELS, SIDE_PX

KINEMATICS = load_hand_model().kinematics(dtype=torch.float32)
USUAL = float(load_hand_model().shape_space.metric(load_hand_model().shape_space.default)["hand_length"])


def _keypoints_in_square(seen: SeenHands) -> torch.Tensor:
    """By the targets alone, as `propose_hands` reads them: the distance of the palm follows from the size."""
    pose = torch.cat((torch.zeros(len(seen.joints), 6), seen.joints), -1)
    points = KINEMATICS(pose, root_reference=seen.rotation).keypoints
    points = (points - points[:, [0, 5, 9, 13, 17]].mean(1, keepdim=True)) / USUAL
    return seen.place[:, None] + seen.log_size.exp()[:, None, None] * points[..., :2]


def test_targets_put_the_hand_onto_its_silhouette(rendered: RenderedHands) -> None:
    """Whatever the view: turned, shifted, larger. Perspective and other proportions are left out here."""
    shares = []
    for seed in range(8):
        seen = seen_hands(rendered, torch.Generator().manual_seed(seed))
        at = _keypoints_in_square(seen)
        pixels = (((at + 1) * SIDE_PX - 1) / 2).round().long()
        is_inside = ((pixels >= 0) & (pixels < SIDE_PX)).all(-1)
        pixels = pixels.clamp(0, SIDE_PX - 1)
        rows = torch.arange(len(pixels))[:, None]
        seen_there = seen.channels[rows, 0, pixels[..., 1], pixels[..., 0]] > 0
        known = seen.channels[rows, 2, pixels[..., 1], pixels[..., 0]] < 0.5
        counts = is_inside & known
        shares.append(float(seen_there[counts].float().mean()))
    assert sum(shares) / len(shares) > 0.75


def test_channels_are_finite_and_in_range(rendered: RenderedHands) -> None:
    seen = seen_hands(rendered, torch.Generator().manual_seed(1))
    assert seen.channels.shape == (len(rendered), CHANNELS, SIDE_PX, SIDE_PX)
    mask, grey, unknown = seen.channels.unbind(1)
    assert float(mask.min()) >= -1
    assert float(mask.max()) <= 1
    assert float(grey.abs().max()) <= 3
    assert bool(((unknown == 0) | (unknown == 1)).all())
    assert bool((mask[unknown == 1] == -1).all())


def test_some_hands_have_no_grey_levels_and_some_reach_the_edge(rendered: RenderedHands) -> None:
    many = rendered.rows(torch.arange(len(rendered)).repeat(6))
    seen = seen_hands(many, torch.Generator().manual_seed(2))
    without = (seen.channels[:, 1].abs().amax((1, 2)) < 0.1).float().mean()
    at_edge = seen.channels[:, 2].amax((1, 2)).mean()
    assert 0.15 < float(without) < 0.45
    assert 0.08 < float(at_edge) < 0.35


def test_views_differ_and_follow_from_the_generator(rendered: RenderedHands) -> None:
    one, again, other = (seen_hands(rendered, torch.Generator().manual_seed(seed)) for seed in (3, 3, 4))
    assert torch.equal(one.channels, again.channels)
    assert torch.equal(one.joints, rendered.joints)
    assert float((one.rotation - other.rotation).abs().mean()) > 0.1
    assert float((one.channels - other.channels).abs().mean()) > 0.1
