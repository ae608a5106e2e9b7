"""Views that deliver pictures and yet show nothing: black ones, and ones that stand still while others go on."""

from collections.abc import Sequence

import torch
from jaxtyping import UInt8
from torch import Tensor

FROZEN_AFTER = 10
"""A view is frozen when its picture was the same so many times in a row although another view's changed."""
BLACK_LEVEL = 16
"""A picture is black when no sampled value is brighter (0 to 255)."""
_BLACK_STRIDE = 4  # px between the samples


def blackness(name: str, image: UInt8[Tensor, "height width 3"]) -> str | None:
    """What is wrong with a picture that is black."""
    samples = image[::_BLACK_STRIDE, ::_BLACK_STRIDE]
    return f"{name}: the picture is black" if int(samples.max()) <= BLACK_LEVEL else None


class FrozenViews:
    """Counts how often each view's picture stayed the same while another's changed."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._last: list[Tensor | None] = [None] * len(names)
        self._same = [0] * len(names)

    def check(self, images: Sequence[Tensor | None], problems: Sequence[str | None]) -> list[str | None]:
        """The problems, with those of frozen views."""
        is_same = [
            image is not None and last is not None and image.shape == last.shape and bool(torch.equal(image, last))
            for image, last in zip(images, self._last, strict=True)
        ]
        has_changed = [
            image is not None and last is not None and not same
            for image, last, same in zip(images, self._last, is_same, strict=True)
        ]
        self._last = [last if image is None else image for image, last in zip(images, self._last, strict=True)]
        checked = list(problems)
        for i, same in enumerate(is_same):
            if has_changed[i]:
                self._same[i] = 0
            elif same and any(has_changed):
                self._same[i] += 1
            if same and self._same[i] >= FROZEN_AFTER and checked[i] is None:
                checked[i] = f"{self._names[i]}: frozen, the same picture for {self._same[i] + 1} frames"
        return checked
