"""Training of the presence network: views of things, and that it learns."""

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.learn.presence import (
    PresenceTraining,
    RenderedThings,
    new_presence_network,
    presence_figures,
    thing_pool,
    train_presence,
)
from torchhand.learn.presence.training import seen_things
from torchhand.learn.proposals import hand_pool
from torchhand.propose import CHANNELS, SIDE_PX

SMALL = PresenceTraining(steps=80, batch=16, hands=96, held_out=32, width=4)


def _square(left: int, right: int) -> RenderedThings:
    """A bright square in a corner of the picture."""
    label = torch.zeros(1, 96, 96, dtype=torch.uint8)
    label[:, left:right, left:right] = 1
    flat = torch.full((1, 2, 96, 96), 127, dtype=torch.uint8)
    return RenderedThings(label=label, depth=flat[:, 0], normal=flat, albedo=200 * label)


def test_views_are_about_the_thing_wherever_it_is() -> None:
    for seed in range(8):
        channels = seen_things(_square(4, 20), torch.Generator().manual_seed(seed))
        assert channels.shape == (1, CHANNELS, SIDE_PX, SIDE_PX)
        assert float((channels[0, 0] > 0).float().mean()) > 0.1 or float(channels[0, 2].mean()) > 0.3


@pytest.mark.slow
def test_it_learns_to_tell_hands_from_things_and_repeats_itself() -> None:
    count = SMALL.hands + SMALL.held_out
    hands = hand_pool(load_hand_model(), count, torch.Generator().manual_seed(2))
    things = thing_pool(count, torch.Generator().manual_seed(3))
    own, rest = slice(0, SMALL.hands), slice(SMALL.hands, None)
    told = []
    for _ in range(2):
        network = new_presence_network(SMALL)
        reports = list(train_presence(network, hands.rows(own), things.rows(own), SMALL, report_every=40))
        assert [step for step, _ in reports] == [40, 80]
        assert reports[1][1] < reports[0][1]
        told.append(presence_figures(network, hands.rows(rest), things.rows(rest), torch.Generator().manual_seed(0)))
    assert told[0] == told[1]
    missed, taken = told[0][0.0]
    assert missed + taken < 0.6  # 1 by chance
    assert told[0][6.0][0] >= missed
    assert told[0][6.0][1] <= taken
