"""How often a hand is reported in pictures that show none."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import UInt8
from torch import Tensor

from torchhand.devices import HOST
from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera
from torchhand.simulate import NO_HAND, NoHandKind, picture_without_hand
from torchhand.study import seed_of
from torchhand.track import Estimate, Tracker, TrackerSettings, View

WIDTH, HEIGHT = 320, 240

Picture = UInt8[Tensor, "height width 3"]

Finder = Callable[[View, Camera], Estimate]
"""What is made of a single picture."""


@dataclass(frozen=True, kw_only=True)
class EmptyPicture:
    """What was made of a picture without a hand."""

    kind: str
    """What it shows."""
    is_reported: bool
    """Whether a hand was."""


def first_frame(settings: TrackerSettings, device: torch.device = HOST) -> Finder:
    """A tracker's first frame, right hands."""
    hand = load_hand_model().to(device=device).hand(side="right", dtype=torch.float64)

    def found(view: View, camera: Camera) -> Estimate:
        return Tracker(hand, camera, settings).step(None, [view], 0.0)[1]

    return found


def drawn_pictures(count: int, seed: int) -> Iterator[tuple[str, Picture]]:
    """Drawn pictures without a hand, all kinds in turn. The same seed gives the same pictures."""
    kinds = tuple(NO_HAND)
    for index in range(count):
        generator = torch.Generator().manual_seed(seed_of(seed, "empty", index))
        kind: NoHandKind = kinds[index % len(kinds)]
        yield kind, picture_without_hand(kind, WIDTH, HEIGHT, generator)


def reported_hands(find: Finder, pictures: Iterable[tuple[str, Picture]]) -> Iterator[EmptyPicture]:
    """What is made of pictures without a hand, each with its kind."""
    for kind, picture in pictures:
        camera = replace(assumed_camera(picture.shape[1], picture.shape[0]), is_assumed=False)
        yield EmptyPicture(kind=kind, is_reported=find(View(image=picture), camera).pose is not None)
