"""A z-buffer for triangle meshes in plain tensor operations: exact masks, depth, part labels and normals."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import is_host
from torchhand.geometry import Camera
from torchhand.precision import own_precision
from torchhand.view.raster.compiled import can_compile, nearest_compiled
from torchhand.view.raster.normals import face_normals, mixed_normals
from torchhand.view.raster.raycast import Raycast
from torchhand.view.raster.spans import numbered, row_spans, tested_pixels
from torchhand.view.raster.triangles import SeenTriangles, all_ahead, depth_of, placed, seen_triangles, slopes

_AT_ONCE = 1 << 24  # pixels of the pictures drawn together


@own_precision
def rasterize(
    vertices_world: Float[Tensor, "vertices 3"],
    faces: Int[Tensor, "faces 3"],
    camera: Camera,
    part_of_face: Int[Tensor, "faces"] | None = None,
    vertex_normals: Float[Tensor, "vertices 3"] | None = None,
    *,
    is_closed: bool = False,
) -> Raycast:
    """What the ray through the centre of every pixel meets first of one mesh. Exact up to rounding; no gradients.

    A pixel is covered where its ray meets a face, seen from either side, at least `triangles.NEAREST` in front of the
    camera; a face across that plane is cut there. `part` is the entry of `part_of_face`, or the face itself where that
    is not given; of faces equally near, the first one's. Normals are those of the faces (outward where these are
    counter-clockwise seen from outside), or with `vertex_normals` (world frame) interpolated between the corners.
    `is_closed`: the mesh has an inside and no holes, so that faces turned away can be left out, which halves the time.
    """
    size = (camera.height, camera.width)
    like = vertices_world
    depth = torch.full(size, torch.inf, dtype=like.dtype, device=like.device)
    part = torch.full(size, -1, dtype=torch.long, device=like.device)
    normal = torch.zeros(*size, 3, dtype=like.dtype, device=like.device)
    with torch.no_grad():
        normals = None if vertex_normals is None else vertex_normals[None]
        seen = seen_triangles(vertices_world[None], faces, camera, normals, is_closed=is_closed)
        if camera.has_distortion:
            triangle, row, column, nearness = _tested(seen, camera)
        else:
            triangle, row, column, nearness = _filled(seen, camera.width, camera.height)
        if len(triangle):
            (top, bottom), (left, right) = (tuple(map(int, x.aminmax())) for x in (row, column))
            window = (slice(top, bottom + 1), slice(left, right + 1))
            own = depth[window].shape
            pixel = (row - top) * own[1] + (column - left)
            nearest, winner = _nearest(triangle, pixel, nearness, own.numel(), len(seen.face))
            place = (winner < len(seen.face)).nonzero()[:, 0]
            winner = winner.index_select(0, place)
            face = seen.face.index_select(0, winner)
            found = depth_of(nearest.index_select(0, place), camera)
            if vertex_normals is None:
                facing = face_normals(camera.cam_from_world(vertices_world), faces).index_select(0, face)
            else:
                centre = torch.stack((place % own[1] + left, place // own[1] + top), -1).to(found)
                centre = camera.plane_from_pixels(centre) if camera.has_distortion else centre
                facing = mixed_normals(seen, winner, centre, camera)
            label = face if part_of_face is None else part_of_face.long().index_select(0, face)
            depth[window] = depth.new_full((own.numel(),), torch.inf).index_copy_(0, place, found).reshape(own)
            part[window] = part.new_full((own.numel(),), -1).index_copy_(0, place, label).reshape(own)
            normal[window] = normal.new_zeros(own.numel(), 3).index_copy_(0, place, facing).reshape(*own, 3)
    return Raycast(depth=depth, part=part, normal=normal)


@own_precision
def mesh_silhouette(
    vertices_world: Float[Tensor, "*batch vertices 3"],
    faces: Int[Tensor, "faces 3"],
    camera: Camera,
    *,
    is_closed: bool = False,
) -> Bool[Tensor, "*batch height width"]:
    """`rasterize(...).mask` of every mesh of a batch, without depths: in a half to a third of the time."""
    batch = vertices_world.shape[:-2]
    size = (camera.height, camera.width)
    flat = vertices_world.reshape(-1, *vertices_world.shape[-2:])
    together = max(1, _AT_ONCE // (size[0] * size[1]))
    with torch.no_grad():
        masks = [_masks(some, faces, camera, is_closed) for some in flat.split(together)] if len(flat) else []
    whole = torch.cat(masks) if masks else torch.zeros(0, *size, dtype=torch.bool, device=flat.device)
    return whole.reshape(*batch, *size)


def _masks(
    vertices_world: Tensor, faces: Tensor, camera: Camera, is_closed: bool
) -> Bool[Tensor, "meshes height width"]:
    count, width, height = len(vertices_world), camera.width, camera.height
    seen = seen_triangles(vertices_world, faces, camera, is_closed=is_closed)
    if camera.has_distortion:
        triangle, row, column, _ = _tested(seen, camera)
        mask = torch.zeros(count, height, width, dtype=torch.bool, device=row.device)
        mask[seen.mesh[triangle], row, column] = True
        return mask
    spans = row_spans(seen.corners, width, height)
    start = (seen.mesh[spans.triangle] * height + spans.row) * (width + 1)
    change = torch.zeros(count * height * (width + 1), dtype=torch.int32, device=start.device)
    one = torch.ones((), dtype=torch.int32, device=start.device).expand(len(start))
    change.index_add_(0, start + spans.first, one)
    change.index_add_(0, start + spans.last + 1, -one)
    covers = change.reshape(count, height, width + 1).cumsum(-1, dtype=torch.int32)
    return covers[..., :-1] > 0


@own_precision
def rasterize_many(
    vertices_world: Float[Tensor, "meshes vertices 3"],
    faces: Int[Tensor, "faces 3"],
    camera: Camera,
    *,
    is_closed: bool = False,
) -> tuple[Int[Tensor, "meshes height width"], Float[Tensor, "meshes height width"]]:
    """Face (-1 where there is none) and depth (metres; infinite there) that every pixel sees of every mesh of a batch.

    All meshes at once, before one camera without distortion; otherwise as `rasterize`.
    """
    if camera.has_distortion:
        raise ValueError("camera: expected one without distortion")
    with torch.no_grad():
        points = camera.cam_from_world(vertices_world)
        if not is_host(points.device):  # which meshes are cut off would have to be asked
            nearest, face = _drawn(vertices_world, faces, camera, is_closed)
            return face, depth_of(nearest, camera).masked_fill_(face < 0, torch.inf)
        is_whole = all_ahead(points)
        if can_compile(points):
            away = float(torch.linalg.det(camera.intrinsics[:2, :2]).sign()) if is_closed else 0.0
            pixels, nearness = placed(points, camera)
            nearest, face = nearest_compiled(pixels, nearness, faces, is_whole, (camera.height, camera.width), away)
            others = [~is_whole]
        else:
            nearest = points.new_empty(len(points), camera.height, camera.width)
            face = torch.empty_like(nearest, dtype=torch.long)
            others = [is_whole, ~is_whole]  # few are cut, and these take their time
        for rows in (which.nonzero()[:, 0] for which in others):
            if len(rows):
                nearest[rows], face[rows] = _drawn(vertices_world[rows], faces, camera, is_closed)
        return face, depth_of(nearest, camera).masked_fill_(face < 0, torch.inf)


def _drawn(vertices_world: Tensor, faces: Tensor, camera: Camera, is_closed: bool) -> tuple[Tensor, Tensor]:
    """Nearness and face of what every pixel sees."""
    size = (len(vertices_world), camera.height, camera.width)
    seen = seen_triangles(vertices_world, faces, camera, is_closed=is_closed)
    nearest, winner = _nearest_of(seen, size)
    face = torch.cat((seen.face, seen.face.new_full((1,), -1))).index_select(0, winner)
    return nearest.reshape(size), face.reshape(size)


def nearest_faces(seen: SeenTriangles, size: tuple[int, int, int]) -> Int[Tensor, "meshes height width"]:
    """The triangle of the list, -1 where there is none, that every pixel of the meshes' pictures sees.

    size: meshes, height, width. Corners are in px; no gradients.
    """
    _, winner = _nearest_of(seen, size)
    return torch.where(winner < len(seen.face), winner, -1).reshape(size)


def _nearest_of(seen: SeenTriangles, size: tuple[int, int, int]) -> tuple[Tensor, Tensor]:
    count, height, width = size
    triangle, row, column, nearness = _filled(seen, width, height)
    pixel = (seen.mesh.index_select(0, triangle) * height + row) * width + column
    return _nearest(triangle, pixel, nearness, count * height * width, len(seen.face))


def _filled(seen: SeenTriangles, width: int, height: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Triangle, row, column and nearness wherever a triangle covers a pixel, run by run."""
    spans = row_spans(seen.corners, width, height)
    steps = spans.last - spans.first
    row = spans.row.to(seen.nearness)
    ends = [torch.stack((column.to(row), row), -1) for column in (spans.first, spans.last)]
    start, end = _nearness_at(seen, spans.triangle, ends)
    slope = (end - start) / steps.clamp_min(1)
    span = torch.repeat_interleave(steps + 1)
    step = numbered(steps + 1, span)
    triangle, row, first = (x.index_select(0, span) for x in (spans.triangle, spans.row, spans.first))
    nearness = start.index_select(0, span) + slope.index_select(0, span) * step
    return triangle, row, first + step, nearness


def _tested(seen: SeenTriangles, camera: Camera) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Triangles, rows, columns and nearness, tested pixel by pixel, for lenses that distort."""
    triangle, pixel, plane = tested_pixels(seen.corners, camera)
    [nearness] = _nearness_at(seen, triangle, [plane])
    return triangle, pixel // camera.width, pixel % camera.width, nearness


def _nearest(
    triangle: Int[Tensor, "n"], pixel: Int[Tensor, "n"], nearness: Float[Tensor, "n"], pixels: int, none: int
) -> tuple[Float[Tensor, "pixels"], Int[Tensor, "pixels"]]:
    """Nearness and triangle (`none` where there is none) of what every pixel sees; of equally near ones the first."""
    nearest = nearness.new_full((pixels,), -torch.inf).scatter_reduce_(0, pixel, nearness, "amax")
    wins = torch.where(nearness == nearest.index_select(0, pixel), triangle, none)
    return nearest, triangle.new_full((pixels,), none).scatter_reduce_(0, pixel, wins, "amin")


def _nearness_at(
    seen: SeenTriangles, triangle: Int[Tensor, "n"], points: Sequence[Float[Tensor, "n 2"]]
) -> list[Float[Tensor, "n"]]:
    """Nearness at points of triangles, never beyond that of its corners: a sliver's own slope is all rounding."""
    low, high = seen.nearness.aminmax(dim=-1, keepdim=True)
    along = slopes(seen.corners, seen.nearness[..., None]).squeeze(-1)
    table = torch.cat((seen.corners[:, 0], seen.nearness[:, :1], along, low, high), -1)
    x, y, base, along_x, along_y, low, high = table.index_select(0, triangle).unbind(-1)
    values = (base + along_x * (point[:, 0] - x) + along_y * (point[:, 1] - y) for point in points)
    return [torch.minimum(torch.maximum(value, low), high) for value in values]
