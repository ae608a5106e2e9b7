"""Proportions of a hand while it is followed: fitted ever more finely to a few frames that show it differently."""

from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from torchhand.hand import HandPose
from torchhand.track.knowledge import ShapeFrame, TrackerState
from torchhand.track.multiview.fitting import FrameFitter
from torchhand.track.multiview.hand_initialization import FOUND_OVERLAP, SHAPE_AT
from torchhand.track.scene import Candidate, PackedMask, Scene

_APART = 0.6  # radians, over all joint angles and the turn, between frames that tell different things


@dataclass(frozen=True, kw_only=True)
class AccumulatedShape:
    """Keeps frames that show a followed hand otherwise than those before, and fits proportions and poses to all of
    them, until there are as many as `RigSettings.shape_frames`: then the proportions stand, and no frame is kept."""

    fitter: FrameFitter

    def __call__(self, state: TrackerState, found: Candidate, scene: Scene, *, fits: bool = True) -> TrackerState:
        """The state after a frame in which a hand was followed or found.

        fits: whether it may take as long as a fit, some seconds; else the frames alone are kept (`is_due`)."""
        frames = state.shape_frames
        if frames is None or state.shape is None or not self._is_news(frames, found):
            return state
        state = replace(state, shape_frames=(*frames, self._frame(found, scene)))
        return self.fitted(state) if fits and self.is_due(state) else state

    def is_due(self, state: TrackerState) -> bool:
        """Whether there are so many frames that the proportions are to be fitted anew."""
        return state.is_shape_due((*SHAPE_AT, self.fitter.settings.shape_frames))

    def fitted(self, state: TrackerState) -> TrackerState:
        """The state with proportions that are fitted to all of its frames."""
        frames = state.shape_frames
        if not frames or state.shape is None:
            return state
        is_last = len(frames) >= self.fitter.settings.shape_frames
        shape, frames = self._fitted(frames, state.shape, is_rough=not is_last)
        return state.with_shape(shape, frames, is_last=is_last)

    def _is_news(self, frames: tuple[ShapeFrame, ...], found: Candidate) -> bool:
        if len(frames) >= self.fitter.settings.shape_frames:
            return False
        if not found.is_sound or found.overlap < FOUND_OVERLAP:
            return False
        return all(frame.distance(found.pose.normalized()) > _APART for frame in frames)

    def _frame(self, found: Candidate, scene: Scene) -> ShapeFrame:
        masks = tuple(None if mask is None else PackedMask.of(mask) for mask in scene.masks)
        return ShapeFrame(pose=found.pose.normalized(), masks=masks)

    def _fitted(
        self, frames: tuple[ShapeFrame, ...], shape: Float[Tensor, "shape"], *, is_rough: bool
    ) -> tuple[Float[Tensor, "shape"], tuple[ShapeFrame, ...]]:
        """Proportions and the frames with the poses that go with them; frames without a hull drop out."""
        seen = []
        for frame in frames:
            masks = [None if mask is None else mask.mask().to(shape.device) for mask in frame.masks]
            hull = self.fitter.hull_about(frame.pose, shape, masks)
            if hull.target is not None and not hull.target.is_empty:
                seen.append((frame, hull))
        if not seen:
            return shape, frames
        starts = HandPose.stack([frame.pose for frame, _ in seen])
        solution = self.fitter.fit_shape([hull for _, hull in seen], starts, shape, is_rough=is_rough)
        posed = tuple(replace(frame, pose=solution.pose[row]) for row, (frame, _) in enumerate(seen))
        return solution.shape, posed
