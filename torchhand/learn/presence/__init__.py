"""Learning to tell hands from other things: things of the simulator, seen as hands are, and the training."""

from torchhand.learn.presence.things import RenderedThings, thing_pool
from torchhand.learn.presence.training import (
    PresenceTraining,
    new_presence_network,
    presence_figures,
    train_presence,
)

__all__ = [
    "PresenceTraining",
    "RenderedThings",
    "new_presence_network",
    "presence_figures",
    "thing_pool",
    "train_presence",
]
