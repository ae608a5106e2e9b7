"""How often a hand is reported in pictures that show none."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import torch

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera
from torchhand.simulate import NO_HAND, NoHandKind, picture_without_hand
from torchhand.study import seed_of
from torchhand.track import Estimate, Tracker, TrackerSettings, View

WIDTH, HEIGHT = 320, 240

Finder = Callable[[View, Camera], Estimate]
"""What is made of a single picture."""


@dataclass(frozen=True, kw_only=True)
class EmptyPicture:
    """What was made of a picture without a hand."""

    kind: NoHandKind
    is_reported: bool
    """Whether a hand was."""


def first_frame(settings: TrackerSettings) -> Finder:
    """A tracker's first frame, right hands."""
    hand = load_hand_model().hand(side="right", dtype=torch.float64)

    def found(view: View, camera: Camera) -> Estimate:
        return Tracker(hand, camera, settings).step(None, [view], 0.0)[1]

    return found


def reported_hands(find: Finder, count: int, seed: int) -> Iterator[EmptyPicture]:
    """Pictures without a hand, all kinds in turn. The same seed gives the same pictures."""
    camera = replace(assumed_camera(WIDTH, HEIGHT), is_assumed=False)
    kinds = tuple(NO_HAND)
    for index in range(count):
        generator = torch.Generator().manual_seed(seed_of(seed, "empty", index))
        kind = kinds[index % len(kinds)]
        estimate = find(View(image=picture_without_hand(kind, WIDTH, HEIGHT, generator)), camera)
        yield EmptyPicture(kind=kind, is_reported=estimate.pose is not None)
