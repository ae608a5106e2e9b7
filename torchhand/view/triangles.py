"""The triangles of meshes as one camera sees them: cut at the plane before it, and placed in its picture."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.geometry import Camera

NEAREST = 1e-3
"""Metres before the camera: what is nearer, or behind, is cut off."""


@dataclass(frozen=True, kw_only=True)
class SeenTriangles:
    """Triangles with every corner in front of the camera; those of all meshes of a batch one after the other."""

    corners: Float[Tensor, "triangles 3 2"]
    """In pixels; on the normalised image plane where the camera's lens distorts, for only there edges are straight."""
    nearness: Float[Tensor, "triangles 3"]
    """What is affine over a triangle's picture and grows towards the camera: 1/z (orthographic: -z)."""
    face: Int[Tensor, "triangles"]
    """The face that each one is, or is a piece of."""
    mesh: Int[Tensor, "triangles"]
    """Index into the batch."""


def seen_triangles(
    vertices_world: Float[Tensor, "meshes vertices 3"],
    faces: Int[Tensor, "faces 3"],
    camera: Camera,
    *,
    is_closed: bool = False,
) -> SeenTriangles:
    """Every triangle of every mesh before the camera. A face across the plane z = NEAREST loses what lies behind it.

    Faces with a corner that is not finite are left out. Corners that neighbours share stay equal to the last bit, cut
    or not. Of closed meshes the faces that turn away are left out, unless that plane opens one of them.
    """
    if camera.rotation.ndim != 2:
        raise ValueError(f"camera: expected one camera, got a batch of shape {tuple(camera.rotation.shape[:-2])}")
    points = camera.cam_from_world(vertices_world)
    count = len(points)
    is_ahead = points[..., 2] >= NEAREST
    if bool((is_ahead & points.isfinite().all(-1)).all()):
        corners = _on_grid(points, camera)[:, faces].flatten(0, 1)
        nearness = _nearness(points[..., 2], camera)[:, faces].flatten(0, 1)
        index = torch.arange(count * len(faces), device=faces.device)
        if is_closed:
            index = (_turn(corners, camera) < 0).nonzero()[:, 0]
            corners, nearness = corners.index_select(0, index), nearness.index_select(0, index)
        return SeenTriangles(corners=corners, nearness=nearness, face=index % len(faces), mesh=index // len(faces))
    pieces, source = _cut(points[:, faces].flatten(0, 1), is_ahead[:, faces].flatten(0, 1))
    return SeenTriangles(
        corners=_on_grid(pieces, camera),
        nearness=_nearness(pieces[..., 2], camera),
        face=source % len(faces),
        mesh=source // len(faces),
    )


def depth_of(nearness: Tensor, camera: Camera) -> Tensor:
    """Inverse of what `SeenTriangles.nearness` says; metres."""
    return -nearness if camera.kind == "orthographic" else nearness.reciprocal()


def _nearness(depth: Tensor, camera: Camera) -> Tensor:
    return -depth if camera.kind == "orthographic" else depth.reciprocal()


def _on_grid(points_cam: Float[Tensor, "*points 3"], camera: Camera) -> Float[Tensor, "*points 2"]:
    plane = camera.plane_from_cam(points_cam)
    return plane if camera.has_distortion else camera.pixels_from_plane(plane)


def _turn(corners: Float[Tensor, "triangles 3 2"], camera: Camera) -> Float[Tensor, "triangles"]:
    """Twice the area on the image plane, negative where the corners go round counter-clockwise for the camera."""
    (ax, ay), (bx, by) = (edge.unbind(-1) for edge in (corners[:, 1:] - corners[:, :1]).unbind(1))
    area = ax * by - ay * bx
    return area if camera.has_distortion else area * torch.linalg.det(camera.intrinsics[:2, :2]).sign()


def _cut(
    corners: Float[Tensor, "triangles 3 3"], is_ahead: Bool[Tensor, "triangles 3"]
) -> tuple[Float[Tensor, "pieces 3 3"], Int[Tensor, "pieces"]]:
    """What lies before the plane z = NEAREST, and the triangle each piece comes from: none, one or two of each."""
    is_ahead = is_ahead & corners.isfinite().all(-1).all(-1, keepdim=True)
    ahead = is_ahead.sum(-1)
    pieces, sources = [corners[ahead == 3]], [(ahead == 3).nonzero()[:, 0]]
    for count in (1, 2):
        source = (ahead == count).nonzero()[:, 0]
        odd = (is_ahead[source] == (count == 1)).long().argmax(-1)  # the corner that is alone on its side
        turned = (odd[:, None] + torch.arange(3, device=odd.device)) % 3
        lone, after, before = torch.gather(corners[source], 1, turned[..., None].expand(-1, -1, 3)).unbind(1)
        if count == 1:
            pieces.append(torch.stack((lone, _crossing(lone, after), _crossing(lone, before)), 1))
        else:
            one, other = _crossing(after, lone), _crossing(before, lone)
            pieces += [torch.stack((one, after, before), 1), torch.stack((one, before, other), 1)]
        sources += [source] * count
    return torch.cat(pieces), torch.cat(sources)


def _crossing(ahead: Float[Tensor, "n 3"], behind: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """Where the edges meet the plane; the same for both faces of an edge, as it always runs away from the camera."""
    share = (ahead[:, 2:] - NEAREST) / (ahead[:, 2:] - behind[:, 2:])
    flat = ahead[:, :2] + share * (behind[:, :2] - ahead[:, :2])
    return torch.cat((flat, torch.full_like(share, NEAREST)), -1)
