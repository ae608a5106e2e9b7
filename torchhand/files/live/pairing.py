"""Pictures of several cameras paired by their time stamps as they come: no waiting for cameras that have stalled."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from jaxtyping import UInt8
from torch import Tensor

from torchhand.errors import require, require_positive

_KEPT = 4  # pictures of a camera that wait for those of the others


@dataclass(frozen=True, kw_only=True)
class LiveSettings:
    """When pictures of several cameras are of one time, and how long one waits for them."""

    tolerance_s: float = 0.016
    """Difference of time stamps from the common time up to which pictures belong together; above 0."""
    patience_s: float = 0.2
    """Silence after which a camera is not waited for until it delivers again; at least the tolerance."""

    def __post_init__(self) -> None:
        require_positive("live.tolerance_s", self.tolerance_s)
        is_patient = self.tolerance_s <= self.patience_s < float("inf")
        require(is_patient, "live.patience_s", f"{self.tolerance_s} (the tolerance) or more", self.patience_s)


@dataclass(frozen=True, kw_only=True)
class LivePictures:
    """What the cameras saw at one time."""

    time_s: float
    """Since the start, the earliest time stamp among them; later ones are later."""
    images: tuple[UInt8[Tensor, "height width 3"] | None, ...]
    """RGB, one per camera; None where a camera has none of that time."""
    numbers: tuple[int | None, ...]
    """Number of each picture in its source, counted from 0; None where a camera has none of that time."""


class _Taken(NamedTuple):
    """A picture that waits."""

    stamp_s: float
    number: int
    image: UInt8[Tensor, "height width 3"]


class Pairing:
    """Sets of pictures, newest first: the latest time of which every camera that is awake has a picture.

    Pictures that no set took are dropped, and counted camera by camera.
    """

    def __init__(self, cameras: int, settings: LiveSettings) -> None:
        self.settings = settings
        self.taken, self.dropped = [0] * cameras, [0] * cameras
        self._waiting: list[deque[_Taken]] = [deque() for _ in range(cameras)]
        self._heard_s = [0.0] * cameras  # when a camera last delivered
        self._has_ended = [False] * cameras
        self._last_s = -float("inf")  # latest time stamp that was handed out or passed over

    @property
    def is_over(self) -> bool:
        """Whether all cameras have ended and all of their pictures are handed out."""
        return all(self._has_ended) and not any(self._waiting)

    def add(
        self, camera: int, stamp_s: float, image: UInt8[Tensor, "height width 3"], now_s: float, *, number: int
    ) -> None:
        """A picture with its time stamp and its number in the source, in the order in which a camera takes them; times
        since the start."""
        self._heard_s[camera] = now_s
        if stamp_s <= self._last_s:
            self.dropped[camera] += 1
            return
        waiting = self._waiting[camera]
        waiting.append(_Taken(stamp_s, number, image))
        while len(waiting) > _KEPT:
            waiting.popleft()
            self.dropped[camera] += 1

    def end(self, camera: int) -> None:
        """A camera that will deliver nothing more."""
        self._has_ended[camera] = True

    def ready(self, now_s: float) -> LivePictures | None:
        """The newest set; None where pictures are to be waited for."""
        newest_s = [own[-1].stamp_s for own in self._waiting if own]
        is_missing = any(self._is_awake(camera, now_s) and not own for camera, own in enumerate(self._waiting))
        if not newest_s or is_missing:
            return None
        common_s = min(newest_s)
        chosen = [self._chosen(camera, common_s) for camera in range(len(self._waiting))]
        stamps = [one.stamp_s for one in chosen if one is not None]
        self._last_s = max(stamps)
        for camera, own in enumerate(self._waiting):
            while own and own[0].stamp_s <= self._last_s:
                own.popleft()
                self.dropped[camera] += 1
        return LivePictures(
            time_s=min(stamps),
            images=tuple(None if one is None else one.image for one in chosen),
            numbers=tuple(None if one is None else one.number for one in chosen),
        )

    def _is_awake(self, camera: int, now_s: float) -> bool:
        return not self._has_ended[camera] and now_s - self._heard_s[camera] <= self.settings.patience_s

    def _chosen(self, camera: int, common_s: float) -> _Taken | None:
        """A camera's picture nearest to a time, taken out; those before it are dropped."""
        own = self._waiting[camera]
        near = [one for one in own if abs(one.stamp_s - common_s) <= self.settings.tolerance_s]
        if not near:
            return None
        best = min(near, key=lambda one: abs(one.stamp_s - common_s))
        while own.popleft() is not best:
            self.dropped[camera] += 1
        self.taken[camera] += 1
        return best
