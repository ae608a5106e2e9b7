"""The short way: the hand of one picture in one call."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from torch import Tensor

from torchhand.files import camera_for
from torchhand.files.pictures import named_picture
from torchhand.geometry import Camera
from torchhand.hand import Side
from torchhand.runs.pictures.bounded import BoundedView
from torchhand.runs.pictures.run import single_pose_fitter
from torchhand.track import HandKeypoints, View
from torchhand.track.single import SinglePose, SinglePoseSettings


def fit_pose(
    picture: str | Path | Tensor | np.ndarray,
    *,
    side: Side = "right",
    camera: Camera | str | Path | None = None,
    shape: Float[Tensor, "shape"] | None = None,
    keypoints: HandKeypoints | None = None,
    settings: SinglePoseSettings | None = None,
) -> SinglePose:
    """The hand in one picture (a file, or RGB as uint8), in any posture; `estimate.status` is `no_hand` where there is
    none.

    camera: in whose frame the pose is, or a file of its calibration; a field of view is assumed where none is given.
    shape: proportions where they are known; else those that the outline shows, in the size of the average hand.
    keypoints: those of a detector.

    Raises InputError where the picture cannot be read, for what is none, and for a camera of others; ValueError for a
    shape outside its bounds, TypeError for what is no camera, file or HandKeypoints.
    """
    _, image = named_picture(picture)
    camera = camera_for(camera, image.shape[1], image.shape[0])
    fitter = single_pose_fitter(side, settings or SinglePoseSettings())
    return BoundedView.of(View(image=image, keypoints=keypoints), camera).fitted(fitter, shape)
