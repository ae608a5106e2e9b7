"""From the views of one time to a scene: the hand's silhouettes by what is known of its appearance, view by view."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from torchhand.fit import Appearance, relearned
from torchhand.fit.contour import hand_length_px
from torchhand.fit.detect import CutAtKeypoints
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, HandPose
from torchhand.track.scene.silhouettes import LearnedSkin, ViewSilhouettes
from torchhand.track.scene.views import Scene, View
from torchhand.view import HandProjector

Appearances = tuple[Appearance | CutAtKeypoints | LearnedSkin | None, ...]
"""Appearance of the hand, view by view; None where nothing is known."""

_KEEP = 0.7  # share of what is known of a colour that outlasts an update with that colour in it
_MARGIN = 0.015  # along the outline, colours are nobody's, hand lengths


@runtime_checkable
class Segmentation(Protocol):
    """Makes scenes, and learns the hand's appearance where the pictures bear the hand out."""

    def initial_appearances(self, views: Sequence[View]) -> Appearances:
        """Appearances that pictures tell without any hand being known; empty where they tell nothing."""
        ...

    def scene(
        self,
        views: Sequence[View],
        appearances: Appearances,
        time_s: float,
        pose: HandPose | None = None,
        shape: Float[Tensor, "shape"] | None = None,
    ) -> Scene:
        """The views of one time with their silhouettes. pose (), shape: of the hand that is expected then, if any."""
        ...

    def learned(
        self, appearances: Appearances, pose: HandPose, shape: Float[Tensor, "shape"], scene: Scene
    ) -> Appearances:
        """The appearances after a scene that bears a hand out."""
        ...


@dataclass(frozen=True, kw_only=True)
class ColourSegmentation:
    """One camera: colours of the hand against its surroundings, learned where it is found and updated since then."""

    kinematics: HandKinematics
    camera: Camera

    def initial_appearances(self, views: Sequence[View]) -> Appearances:
        """No appearances: colours are learned with the first hand."""
        return ()

    def scene(
        self,
        views: Sequence[View],
        appearances: Appearances,
        time_s: float,
        pose: HandPose | None = None,
        shape: Float[Tensor, "shape"] | None = None,
    ) -> Scene:
        """The views as a scene. Without appearances nothing is told of the silhouette: the search for a hand makes its
        own. What is cut out about keypoints is cut out about those of the expected hand where none are detected."""
        [view] = views
        probability, known = None, appearances[0] if appearances else None
        if isinstance(known, Appearance) and view.image is not None:
            probability = known.probability(view.image)
        elif isinstance(known, CutAtKeypoints) and view.image is not None:
            points = None if view.keypoints is None else view.keypoints.points_px
            if points is None and pose is not None and shape is not None:
                hand = self.kinematics(pose.dofs, shape, root_reference=pose.reference)
                points = self.camera.project(hand.keypoints)
            probability = None if points is None else known.probability(view.image, points)
        return Scene(views=(view,), masks=(view.mask,), probabilities=(probability,), time_s=time_s)

    def learned(
        self, appearances: Appearances, pose: HandPose, shape: Float[Tensor, "shape"], scene: Scene
    ) -> Appearances:
        """The colours of a picture that bears a hand out."""
        [appearance], image, probability = appearances, scene.views[0].image, scene.probabilities[0]
        if not isinstance(appearance, Appearance) or image is None or probability is None:
            return appearances
        model = HandProjector(self.kinematics, self.camera, shape).silhouette(pose.dofs, pose.reference)
        margin = max(1, round(_MARGIN * hand_length_px(self.camera, self.kinematics, pose.dofs, shape)))
        return (relearned(appearance, image, probability, model, margin, keep=_KEEP),)


@dataclass(frozen=True, kw_only=True)
class RigSegmentation:
    """Several cameras: silhouettes by the skin of each view, by plates or a screen, or as given; undistorted."""

    silhouettes: ViewSilhouettes

    def initial_appearances(self, views: Sequence[View]) -> Appearances:
        """The skin that stands out of every view's picture."""
        if self.silhouettes.settings.method != "skin":
            return ()
        learned = self.silhouettes.learn([view.image for view in views], [None] * len(views), points_of(views))
        return tuple(learned) if any(learned) else ()

    def scene(
        self,
        views: Sequence[View],
        appearances: Appearances,
        time_s: float,
        pose: HandPose | None = None,
        shape: Float[Tensor, "shape"] | None = None,
    ) -> Scene:
        """A view's given silhouette is preferred to one by its picture; the hand that is expected does not count."""
        skins = [one if isinstance(one, LearnedSkin) else None for one in appearances] or [None] * len(views)
        given = self.silhouettes.undistorted([view.mask for view in views])
        images = [view.image if mask is None else None for view, mask in zip(views, given, strict=True)]
        seen = self.silhouettes(images, skins, points_of(views))
        masks = tuple(own if mask is None else mask for own, mask in zip(seen, given, strict=True))
        return Scene(views=tuple(views), masks=masks, probabilities=(None,) * len(views), time_s=time_s)

    def learned(
        self, appearances: Appearances, pose: HandPose, shape: Float[Tensor, "shape"], scene: Scene
    ) -> Appearances:
        """Skin is learned before tracking begins and kept."""
        return appearances


def points_of(views: Sequence[View]) -> list[Tensor | None]:
    """Detected keypoints of every view; None where there are none."""
    return [None if view.keypoints is None else view.keypoints.points_px for view in views]
