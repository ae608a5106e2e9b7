"""Detected keypoints of a scene as observations of the hand."""

from collections.abc import Sequence

import torch

from torchhand.fit.keypoints import KeypointSettings, PictureKeypoints, SpaceKeypoints
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics
from torchhand.track.scene.views import Scene

KeypointObservation = PictureKeypoints | SpaceKeypoints


def keypoint_observations(
    scene: Scene, cameras: Sequence[Camera], kinematics: HandKinematics, settings: KeypointSettings
) -> tuple[KeypointObservation, ...]:
    """Observations of every view in which a detector found a hand: its points in the picture, and in space up to a
    similarity.

    Points that a detector does not believe itself (a score below `settings.min_score`) are left out.
    """
    found: list[KeypointObservation] = []
    for index, (view, camera) in enumerate(zip(scene.views, cameras, strict=True)):
        seen = view.keypoints
        if seen is None or seen.score < settings.min_score:
            continue
        points_px = seen.points_px.to(torch.float64)[None]
        in_picture = PictureKeypoints(
            points_px=points_px, kinematics=kinematics, camera=camera, settings=settings, view=index
        )
        found.append(in_picture)
        if seen.points is not None:
            points = seen.points.to(torch.float64)[None]
            found.append(SpaceKeypoints(points=points, kinematics=kinematics, settings=settings))
    return tuple(one for one in found if not one.is_empty)
