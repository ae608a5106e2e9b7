"""Silhouettes of the hand in a single picture: by the colours that it has where it is believed to be, or by skin."""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.devices import on_host
from torchhand.fit import learn_appearance
from torchhand.fit.contour import hand_length_px
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, HandPose
from torchhand.image import (
    clean,
    dilate,
    disc_kernel,
    enlarged_mask,
    erode,
    fill_holes,
    graph_cut,
    hand_region,
    reduced_mask,
    skin_candidates,
    touching,
)
from torchhand.view import HandProjector

_MARGIN = 0.02  # hand lengths on either side of a placed hand's outline that teach no colours
_AROUND = 1.6  # surroundings that teach colours, hand lengths from the wrist
_CORE, _REACH = 0.03, 0.25  # hand lengths inside a placed hand that are believed, and about it that may be hand
_CUT_SIDE_PX = 320  # of the reduced pictures that are cut
_HOLE = 3e-4  # largest hole that is filled, squares of the hand's length


def silhouette_at(
    image: UInt8[Tensor, "height width 3"],
    pose: HandPose,
    kinematics: HandKinematics,
    camera: Camera,
    shape: Float[Tensor, "shape"],
) -> Bool[Tensor, "height width"] | None:
    """What touches a placed hand and has its colours, as against those around it on the fingers' side of the wrist.

    None where too little of the hand is in the picture to teach colours. pose: (), in the camera's frame.
    """
    projector = HandProjector(kinematics, camera, shape)
    model = projector.silhouette(pose.dofs, pose.reference)
    keypoints = camera.project(projector.frames(pose.dofs, pose.reference).keypoints)
    length_px = hand_length_px(camera, kinematics, pose.dofs, shape)
    around = hand_region((camera.height, camera.width), keypoints[0], keypoints[9], _AROUND * length_px)
    appearance = learn_appearance(image, model, around & ~model, max(1, round(_MARGIN * length_px)))
    if appearance is None:
        return None
    mask = fill_holes(clean(appearance.probability(image) > 0.5), max(1, round(_HOLE * length_px**2)))
    return touching(mask, model)


@on_host
def cut_at(
    image: UInt8[Tensor, "height width 3"],
    mask: Bool[Tensor, "height width"],
    pose: HandPose,
    kinematics: HandKinematics,
    camera: Camera,
    shape: Float[Tensor, "shape"],
) -> Bool[Tensor, "height width"] | None:
    """What a graph cut takes for the hand and its forearm that starts from a placed hand (`graph_cut`).

    Inside is what lies deep in the hand and in the silhouette that it was placed on, outside what is far from both; the
    forearm starts as the silhouette has it. None where nothing is inside. pose: (), in the camera's frame.
    """
    small = camera.resized(min(1.0, _CUT_SIDE_PX / max(camera.width, camera.height)))
    size = (small.width, small.height)
    pixels = torch.from_numpy(cv2.resize(image.cpu().contiguous().numpy(), size, interpolation=cv2.INTER_AREA))
    projector, seen = HandProjector(kinematics, small, shape), reduced_mask(mask.cpu(), small.height, small.width)
    model = projector.silhouette(pose.dofs, pose.reference)
    keypoints = small.project(projector.frames(pose.dofs, pose.reference).keypoints)
    length_px = hand_length_px(small, kinematics, pose.dofs, shape)
    hand_side = hand_region((small.height, small.width), keypoints[0], keypoints[9], _AROUND * length_px)
    inside = erode(model, disc_kernel(max(1, round(_CORE * length_px)))) & seen
    if not bool(inside.any()):
        return None
    reach = disc_kernel(max(2, round(min(_REACH * length_px, _CUT_SIDE_PX))))
    cut = graph_cut(pixels, model | (seen & ~hand_side), inside=inside, outside=~dilate(model | seen, reach))
    cut = touching(clean(cut), model)
    if not bool(cut.any()):
        return None
    return enlarged_mask(cut, camera.height, camera.width)


@on_host
def silhouettes_by_skin(image: UInt8[Tensor, "height width 3"]) -> list[Bool[Tensor, "height width"]]:
    """What may be hand and bare forearm where nothing is known of it: `skin_candidates` in the picture's size."""
    height, width = image.shape[:2]
    return [enlarged_mask(piece, height, width) for piece in skin_candidates(image)]


def oval_overlap(mask: Bool[Tensor, "height width"]) -> float:
    """Intersection over union of a mask and the ellipse of its first and second moments; 0 for an empty mask."""
    pixels = mask.cpu().numpy().astype(np.uint8)
    moments = cv2.moments(pixels, binaryImage=True)
    area = moments["m00"]
    if not area:
        return 0.0
    spread = np.array(((moments["mu20"], moments["mu11"]), (moments["mu11"], moments["mu02"]))) / area
    y, x = np.mgrid[: pixels.shape[0], : pixels.shape[1]]
    away = np.stack((x - moments["m10"] / area, y - moments["m01"] / area), -1)
    inverse = np.linalg.inv(spread + 1e-6 * np.eye(2))
    is_oval = np.einsum("...i,ij,...j->...", away, inverse, away) <= 4  # of a filled ellipse: half axes of 2 deviations
    return float((is_oval & (pixels > 0)).sum() / (is_oval | (pixels > 0)).sum())
