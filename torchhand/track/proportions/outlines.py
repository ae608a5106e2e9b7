"""Proportions of a hand while one camera follows it: fitted to a few frames that show it differently."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchhand.devices import read_back
from torchhand.hand import HandPose
from torchhand.track.knowledge import ShapeFrame, TrackerState
from torchhand.track.proportions.fitted import fitted_shape, reshaped_poses
from torchhand.track.proportions.frame_fit import FrameFit
from torchhand.track.scene import Candidate, Health, Scene, Segmentation, View

_APART = 0.4  # radians, over all joint angles and the turn, between frames that tell different things
_GOOD = 0.02  # score less than at best, up to which a frame is kept: wrong fingers would spoil the proportions
_MARGIN = 0.4  # of the longer side of the box of a hand's joints, which is kept about it
_PARTS = (4, 2, 1)  # of the frames: a fit when there are a quarter, a half and all of them


@dataclass(frozen=True, kw_only=True)
class OutlineShape:
    """Keeps frames that show a followed hand otherwise than those before, and fits proportions to all of them when
    there are a quarter of those that are wanted, half of them, and all: then the proportions stand, and no frame is
    kept. (Tkach et al. 2017 accumulate a Gaussian of the proportions in place of frames.)
    """

    fit: FrameFit
    """Of the tracker, with the proportions that a hand has before it is seen."""
    segmentation: Segmentation
    health: Health
    overconfidence: float
    """Of the tracker's update rule."""
    count: int
    """Frames at most; `TrackerSettings.shape_frames`."""

    def __call__(self, state: TrackerState, found: Candidate, scene: Scene, *, fits: bool = True) -> TrackerState:
        """The state after a frame in which a hand was followed or found.

        fits: whether it may take as long as a fit, some seconds; else the frames alone are kept (`is_due`)."""
        frames = state.shape_frames
        if frames is None or state.shape is None or len(frames) >= self.count or not self._is_good(found, state):
            return state
        pose = found.pose.normalized()
        if any(one.distance(pose) <= _APART for one in frames):
            return state
        view, corner = self._about(pose, state.shape, scene.views[0])
        kept = ShapeFrame(pose=pose, views=(view,), corner=corner, time_s=scene.time_s)
        state = replace(state, shape_frames=(*frames, kept))
        return self.fitted(state) if fits and self.is_due(state) else state

    def _is_good(self, found: Candidate, state: TrackerState) -> bool:
        """Whether the hand explains a frame about as well as any before."""
        is_sound = not self.health.is_degraded(found, state.usual_score)
        return is_sound and self.health.score(found) >= state.best_score - _GOOD

    def is_due(self, state: TrackerState) -> bool:
        """Whether there are so many frames that the proportions are to be fitted anew."""
        return state.is_shape_due(self.count // part for part in _PARTS)

    def fitted(self, state: TrackerState) -> TrackerState:
        """The state with proportions that are fitted to all of its frames, unless those that only judge contradict
        them."""
        frames, before = state.shape_frames, state.shape
        if not frames or before is None:
            return state
        fit = replace(self.fit, shape=before)
        scenes = [
            self.segmentation.scene((self._whole(one),), state.appearance, one.time_s, one.pose, before)
            for one in frames
        ]
        seen = [fit.seen(scene, one.pose) for scene, one in zip(scenes, frames, strict=True)]
        found = fitted_shape(fit, [one for one in seen if one is not None], self.overconfidence)
        is_last, shape, cov = len(frames) >= self.count, before, state.shape_keypoints_cov
        if found is not None and not found.is_contradicted:
            shape, cov = found.shape, found.keypoints_cov
            poses = torch.stack([one.pose.vector for one in frames])
            moved = HandPose.of(reshaped_poses(poses, fit.motion, fit.kinematics, before, shape)).normalized()
            frames = tuple(replace(one, pose=moved[row]) for row, one in enumerate(frames))
        return state.with_shape(shape, frames, is_last=is_last, keypoints_cov=cov)

    def _about(self, pose: HandPose, shape: Tensor, view: View) -> tuple[View, tuple[int, int]]:
        """The part of a view about a hand, and the row and column at which it begins: states are saved and sent, and
        the hand is a tenth of a picture."""
        keypoints = self.fit.kinematics(pose.dofs, shape, root_reference=pose.reference).keypoints
        points = read_back(self.fit.camera.project(keypoints))
        margin = _MARGIN * float((points.max(0) - points.min(0)).max())
        left, top = (max(0, int(value - margin)) for value in points.min(0))
        right, bottom = (max(1, int(value + margin)) for value in points.max(0))
        box = (slice(top, bottom), slice(left, right))
        image, mask = (None if one is None else one[box].clone() for one in (view.image, view.mask))
        return replace(view, image=image, mask=mask), (top, left)

    def _whole(self, frame: ShapeFrame) -> View:
        """The view of a frame in a picture of its size, which is black elsewhere."""
        [view], (top, left), camera = frame.views, frame.corner, self.fit.camera

        def placed(part: Tensor | None) -> Tensor | None:
            if part is None:
                return None
            whole = part.new_zeros((camera.height, camera.width, *part.shape[2:]))
            whole[top : top + part.shape[0], left : left + part.shape[1]] = part
            return whole

        return replace(view, image=placed(view.image), mask=placed(view.mask))
