"""A picture of a hull: its octants' faces, shaded by where they look, the far ones painted first."""

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.volume.octree import Octree
from torchhand.volume.surface import hull_quads

COLOUR = (120, 180, 225)  # RGB of a face that looks at the camera
BACKGROUND = (24, 26, 30)

_DARKEST = 0.35  # brightness of a face seen from its edge
_EDGE_ON = 1e-9  # cosine
_SHIFT = 4  # bits behind the point of a corner's place in the picture
_FARTHEST_PX = 1 << 14  # OpenCV draws no farther


def draw_hull(
    octree: Octree,
    camera: Camera,
    *,
    frame: int = 0,
    unknown: bool = False,
    picture: UInt8[Tensor, "height width 3"] | None = None,
) -> UInt8[Tensor, "height width 3"]:
    """One frame's hull as a camera sees it, RGB, over a picture of the camera's size or a dark ground.

    unknown: the octants that too few views look at as well. Faces across the camera's plane are left out.
    Raises ValueError for a picture of another size.
    """
    size = (camera.height, camera.width, 3)
    if picture is not None and picture.shape != size:
        raise ValueError(f"picture: expected {size}, got {tuple(picture.shape)}")
    ground = torch.tensor(BACKGROUND, dtype=torch.uint8).expand(size) if picture is None else picture
    canvas = np.ascontiguousarray(ground.cpu().numpy()).copy()
    camera = camera.to(dtype=torch.float64, device="cpu")
    vertices, quads, normals = (x.cpu() for x in hull_quads(octree, frame=frame, unknown=unknown))
    vertices_cam = camera.cam_from_world(vertices)
    places = camera.pixels_from_plane(camera.plane_from_cam(vertices_cam)).nan_to_num(_FARTHEST_PX)
    places = (places.clamp(-_FARTHEST_PX, _FARTHEST_PX) * 2**_SHIFT).round().to(torch.int32).numpy()
    centres = vertices_cam[quads].mean(1)
    if camera.kind == "orthographic":
        towards, distance = torch.tensor((0.0, 0.0, -1.0), dtype=torch.float64).expand_as(centres), centres[:, 2]
        in_front = torch.ones(len(quads), dtype=torch.bool)
    else:
        distance = centres.norm(dim=-1)
        towards = -centres / distance[:, None]
        in_front = (vertices_cam[quads][..., 2] > 1e-6).all(-1)
    slant = (towards * (normals.double() @ camera.rotation.T)).sum(-1)
    drawn = ((slant > _EDGE_ON) & in_front).nonzero()[:, 0]
    drawn = drawn[distance[drawn].argsort(descending=True, stable=True)]
    bright = _DARKEST + (1 - _DARKEST) * slant[drawn, None]
    colours = (bright * torch.tensor(COLOUR, dtype=torch.float64)).tolist()
    for corners, colour in zip(quads[drawn].numpy(), colours, strict=True):
        cv2.fillConvexPoly(canvas, places[corners], colour, lineType=cv2.LINE_8, shift=_SHIFT)
    return torch.from_numpy(canvas)
