"""One camera: a hand in the posture of the start, looked for over the whole picture without a guess."""

from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor

from torchhand.fit import Appearance
from torchhand.fit.detect import ContourFitter, NoStart, Start, StartPoints, find_hand, start_at_points
from torchhand.hand import HandPose, posture
from torchhand.image import BackgroundPlate, SilhouetteSettings
from torchhand.track.knowledge import TrackerState
from torchhand.track.proposals.protocol import Occasion, Proposals, Proposed
from torchhand.track.scene import Candidate, Scene

_ELSEWHERE_EVERY = 5  # searches in vain from one in which other pieces are looked at to the next


@dataclass(frozen=True, kw_only=True)
class PostureSearch:
    """Segments the picture, lays the posture over the silhouette and fits it (`find_hand`).

    The first hand ever brings its proportions and its colours. Where no hand is followed, other pieces of the picture
    than the likeliest are looked at too, every few searches: that takes as long again.
    """

    occasion: ClassVar[Occasion] = "search"
    fitter: ContourFitter
    """How the first hand is fitted: proportions too, unless they are known."""
    posture: str
    """Name of the posture for which the first search looks."""
    silhouette: SilhouetteSettings
    min_overlap: float
    plate: BackgroundPlate | None = None
    start_points: StartPoints | None = None
    """Wrist and middle fingertip in the first picture, px, given by the user in place of the first search."""

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """Proposals of at most one hand."""
        image = scene.views[0].image
        if image is None:
            return Proposals(reason="the picture is missing")
        found = self._found(
            image, state, looks_elsewhere=best is None and state.searches_in_vain % _ELSEWHERE_EVERY == 0
        )
        if isinstance(found, NoStart):
            return Proposals(reason=found.reason, has_foreground=found.has_foreground)
        fit, is_first = found.fit, not state.has_started
        pose = HandPose.of(fit.pose, fit.root_reference)
        shape = fit.shape if is_first else None
        proposed = Proposed(pose=pose, shape=shape, appearance=found.appearance if is_first else None)
        return Proposals(hands=(proposed,), has_foreground=True)

    def _found(self, image: Tensor, state: TrackerState, *, looks_elsewhere: bool) -> Start | NoStart:
        first, is_first = self.fitter, not state.has_started
        if is_first and self.start_points is not None:
            return start_at_points(image, self.start_points, posture(self.posture, dtype=torch.float64), first)
        shape = first.shape if state.shape is None else state.shape
        known = state.appearance[0] if state.appearance else None
        return find_hand(
            image,
            posture(self.posture, dtype=torch.float64) if state.posture is None else state.posture,
            replace(first, shape=shape, fit_shape=is_first and first.fit_shape),
            appearance=known if isinstance(known, Appearance) else None,
            min_overlap=self.min_overlap,
            silhouette=self.silhouette,
            plate=self.plate,
            looks_elsewhere=looks_elsewhere,
        )
