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
    """Corners in pixels; on the normalised image plane where the camera's lens distorts, for only there edges are
    straight."""
    nearness: Float[Tensor, "triangles 3"]
    """Number that is affine over a triangle's picture and grows towards the camera: 1/z (orthographic: -z)."""
    face: Int[Tensor, "triangles"]
    """The face that each one is, or is a piece of."""
    mesh: Int[Tensor, "triangles"]
    """Index into the batch."""
    normals: Float[Tensor, "triangles 3 3"] | None = None
    """Normals at the corners, in the camera frame, of any length; where they were given."""


def seen_triangles(
    vertices_world: Float[Tensor, "meshes vertices 3"],
    faces: Int[Tensor, "faces 3"],
    camera: Camera,
    vertex_normals: Float[Tensor, "meshes vertices 3"] | None = None,
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
    is_ahead = (points[..., 2] >= NEAREST) & points.isfinite().all(-1)
    if vertex_normals is not None:
        points = torch.cat((points, vertex_normals @ camera.rotation.T), -1)
    is_whole = bool(is_ahead.all())
    if is_whole:  # placed before they are copied to the faces
        points = torch.cat((_on_grid(points[..., :3], camera), points[..., 2:]), -1)
    corners = points[:, faces].flatten(0, 1)
    source = torch.arange(len(corners), device=faces.device)
    if not is_whole:
        pieces, source = _cut(corners, is_ahead[:, faces].flatten(0, 1))
        corners = torch.cat((_on_grid(pieces[..., :3], camera), pieces[..., 2:]), -1)
    elif is_closed:
        source = (_turn(corners[..., :2], camera) < 0).nonzero()[:, 0]
        corners = corners.index_select(0, source)
    return SeenTriangles(
        corners=corners[..., :2],
        nearness=_nearness(corners[..., 2], camera),
        face=source % len(faces),
        mesh=source // len(faces),
        normals=None if vertex_normals is None else corners[..., 3:],
    )


def all_ahead(points_cam: Float[Tensor, "meshes vertices 3"]) -> Bool[Tensor, "meshes"]:
    """Whether nothing of a mesh is cut off."""
    least, most = points_cam.flatten(1).aminmax(dim=1)
    return (points_cam[..., 2].amin(1) >= NEAREST) & least.isfinite() & most.isfinite()


def placed(
    points_cam: Float[Tensor, "meshes vertices 3"], camera: Camera
) -> tuple[Float[Tensor, "meshes vertices 2"], Float[Tensor, "meshes vertices"]]:
    """Corners and nearness, as `SeenTriangles` has them, of points in front of the camera."""
    return _on_grid(points_cam, camera), _nearness(points_cam[..., 2], camera)


def depth_of(nearness: Tensor, camera: Camera) -> Tensor:
    """Inverse of what `SeenTriangles.nearness` says; metres."""
    return -nearness if camera.kind == "orthographic" else nearness.reciprocal()


def slopes(
    corners: Float[Tensor, "triangles 3 2"], values: Float[Tensor, "triangles 3 c"]
) -> Float[Tensor, "triangles 2 c"]:
    """Change along x and along y of what is affine over triangles and known at their corners; 0 of triangles without
    area."""
    a, b = (corners[:, 1:] - corners[:, :1])[..., None].unbind(1)
    rise_a, rise_b = (values[:, 1:] - values[:, :1]).unbind(1)
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    rises = torch.stack((rise_a * b[:, 1] - rise_b * a[:, 1], rise_b * a[:, 0] - rise_a * b[:, 0]), 1)
    return (rises / area[:, None]).nan_to_num(nan=0.0, posinf=0.0, neginf=0.0)


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
    corners: Float[Tensor, "triangles 3 c"], is_ahead: Bool[Tensor, "triangles 3"]
) -> tuple[Float[Tensor, "pieces 3 c"], Int[Tensor, "pieces"]]:
    """What lies before the plane z = NEAREST, and the triangle each piece comes from: none, one or two of each.

    The first three channels of a corner are its place in the camera frame; the others follow linearly.
    """
    is_ahead = is_ahead & corners[..., :3].isfinite().all(-1).all(-1, keepdim=True)
    ahead = is_ahead.sum(-1)
    pieces, sources = [corners[ahead == 3]], [(ahead == 3).nonzero()[:, 0]]
    for count in (1, 2):
        source = (ahead == count).nonzero()[:, 0]
        odd = (is_ahead[source] == (count == 1)).long().argmax(-1)  # the corner that is alone on its side
        turned = (odd[:, None] + torch.arange(3, device=odd.device)) % 3
        lone, after, before = torch.gather(corners[source], 1, turned[..., None].expand_as(corners[source])).unbind(1)
        if count == 1:
            pieces.append(torch.stack((lone, _crossing(lone, after), _crossing(lone, before)), 1))
        else:
            one, other = _crossing(after, lone), _crossing(before, lone)
            pieces += [torch.stack((one, after, before), 1), torch.stack((one, before, other), 1)]
        sources += [source] * count
    return torch.cat(pieces), torch.cat(sources)


def _crossing(ahead: Float[Tensor, "n c"], behind: Float[Tensor, "n c"]) -> Float[Tensor, "n c"]:
    """Where the edges meet the plane; the same for both faces of an edge, as it always runs away from the camera."""
    fraction = (ahead[:, 2:3] - NEAREST) / (ahead[:, 2:3] - behind[:, 2:3])
    crossing = ahead + fraction * (behind - ahead)
    crossing[:, 2] = NEAREST
    return crossing
