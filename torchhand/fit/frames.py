"""One observation of each of several frames as an observation of all of them: row i is the hand of frame i."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from jaxtyping import Int
from torch import Tensor

from torchhand.fit.observation import Equations, Explained, Factor, Observation, PosedHands
from torchhand.fit.schedule import Stage


@dataclass(frozen=True, kw_only=True)
class FrameObservations:
    """Observations of one kind, one for each frame, none of them empty."""

    frames: tuple[Observation, ...]

    @property
    def is_empty(self) -> bool:
        return not self.frames

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "FrameObservations":
        """The rows of some of the frames."""
        if isinstance(rows, slice):
            return FrameObservations(frames=self.frames[rows])
        return FrameObservations(frames=tuple(self.frames[index] for index in rows.tolist()))

    def associate(self, hands: PosedHands, stage: Stage) -> "FrameFactor":
        """Frame by frame. Raises ValueError where there are not as many hands as frames."""
        if len(hands) != len(self.frames):
            raise ValueError(f"hands: expected one for each of {len(self.frames)} frames, got {len(hands)}")
        return FrameFactor(
            frames=tuple(one.associate(own, stage) for one, own in zip(self.frames, _each(hands), strict=True))
        )


@dataclass(frozen=True, kw_only=True)
class FrameFactor:
    """The factors of several frames, a row each."""

    frames: tuple[Factor, ...]

    def equations(self, hands: PosedHands) -> Equations:
        """A row for each frame."""
        return Equations.cat([factor.equations(own) for factor, own in zip(self.frames, _each(hands), strict=True)])

    def rows(self, rows: Int[Tensor, "n"]) -> "FrameFactor":
        """The rows of some of the frames."""
        return FrameFactor(frames=tuple(self.frames[index] for index in rows.tolist()))

    def explained(self) -> tuple[Explained, ...]:
        """View by view, a row for each frame; of what all frames tell."""
        parts = [factor.explained() for factor in self.frames]
        return tuple(Explained.cat(own) for own in zip(*parts, strict=True))


def _each(hands: PosedHands) -> Sequence[PosedHands]:
    """Every hand by itself; what is computed for one is kept for all factors."""
    return hands.once(
        "each", lambda: [replace(hands, pose=hands.pose[index : index + 1], kept={}) for index in range(len(hands))]
    )
