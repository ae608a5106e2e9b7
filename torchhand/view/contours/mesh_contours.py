"""Occluding contours of the skinned mesh: edges between faces turned to the camera and faces turned away, visible in a
z-buffer (Ouhaddi and Horain 1998, section 7.2)."""

import copy
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import constant_tensor, is_host
from torchhand.geometry import Camera
from torchhand.hand import KEYPOINTS, Hand, HandKinematics, HandPose, skin_jacobian
from torchhand.precision import own_precision
from torchhand.view.contours.contours import VisibleContour, varied_shapes, wrist_and_axis
from torchhand.view.contours.jacobian import cam_force
from torchhand.view.contours.terms import PointToLineTerms
from torchhand.view.raster import rasterize, rasterize_many

_INSIDE_PX = 1.5  # where the z-buffer is read for the surface that an edge belongs to
_WRIST, _KNUCKLE = KEYPOINTS.index("wrist"), KEYPOINTS.index("middle_mcp")
_PIXELS_AT_ONCE = 1 << 24  # of z-buffers that are made together
_SLACK = 0.006  # metres that surface may be nearer there


@dataclass(frozen=True, kw_only=True)
class EdgeMotion:
    """Middles of edges of a batch of skinned hands in the picture, and how they move."""

    columns_px: Float[Tensor, "hands 2 points"]
    """The points, a row for each coordinate."""
    columns_cam: Float[Tensor, "hands 3 points"]
    """Points in the camera frame, metres."""
    columns_plane: Float[Tensor, "hands 2 points"]
    """Points on the normalised image plane."""
    jacobian: Float[Tensor, "hands points 3 36"]
    """Jacobian of the points in the camera frame, in the pose."""
    camera: Camera

    def slopes(self, direction: Float[Tensor, "hands terms 2 points"]) -> Float[Tensor, "hands terms points 36"]:
        """Derivative of direction · point in the DOFs, px per metre or radian, the direction held."""
        force = cam_force(self.camera, self.columns_cam[:, None], self.columns_plane[:, None], direction)
        return (torch.stack(force, -1)[..., None, :] @ self.jacobian[:, None]).squeeze(-2)

    def equations(self, terms: PointToLineTerms) -> tuple[Float[Tensor, "hands 36 36"], Float[Tensor, "hands 36"]]:
        """Second derivative (of Gauss and Newton) and first of the terms' cost in the DOFs."""
        slopes = self.slopes(terms.direction).flatten(1, 2)
        curvature, gradient = terms.curvature.flatten(1), terms.gradient.flatten(1)
        return slopes.mT @ (curvature[..., None] * slopes), (gradient[:, None] @ slopes).squeeze(1)


class MeshContours:
    """Contours of a hand's skin.

    An edge is carried by the skin while the hand moves. Across the contour that is its exact motion: what the contour
    itself slides on the surface is along the line of sight and the contour.

    hand: of the dtype to compute in; shape: in place of its own. max_points: most edges that are followed.
    """

    def __init__(
        self,
        hand: Hand,
        camera: Camera,
        shape: Float[Tensor, "shape"] | None = None,
        *,
        max_points: int = 500,
    ) -> None:
        if max_points < 1:
            raise ValueError(f"max_points: expected 1 or more, got {max_points}")
        self.hand, self._camera, self._max_points = hand, camera, max_points
        self._shape = hand.shape if shape is None else shape
        self._edges, self._faces_of_edge = _edges(hand.faces)
        self._thinned: dict[int, MeshContours] = {}

    @property
    def kinematics(self) -> HandKinematics:
        return self.hand.kinematics

    @property
    def camera(self) -> Camera:
        return self._camera

    @property
    def shape(self) -> Float[Tensor, "shape"]:
        return self._shape

    def with_shape(self, shape: Float[Tensor, "shape"]) -> "MeshContours":
        """The contours of a hand of another shape."""
        other = copy.copy(self)
        other._shape, other._thinned = shape, {}
        return other

    def thinned(self, factor: int) -> "MeshContours":
        """The contours with one point in place of so many; itself for 1. Made once."""
        if factor == 1:
            return self
        if factor not in self._thinned:
            other = copy.copy(self)
            other._max_points, other._thinned = max(1, self._max_points // factor), {}
            self._thinned[factor] = other
        return self._thinned[factor]

    @own_precision
    def visible(self, pose: HandPose, *, probe_distance_px: float | Float[Tensor, "hands"] = 1.0) -> VisibleContour:
        """Contours at the poses (hands). probe_distance_px: how far outside a point the picture is asked for the
        hand."""
        state = self.hand(pose.dofs, self._shape, root_reference=pose.reference)
        like = state.vertices[:, 0, 0]
        probes = torch.as_tensor(probe_distance_px, dtype=like.dtype, device=like.device).expand_as(like)
        # On a processor hand by hand, which keeps to what is visible of each; elsewhere all in a few operations.
        some = 1 if is_host(like.device) else max(1, len(like))
        parts = zip(state.vertices.split(some), probes.split(some), strict=True)
        found = zip(*(self._visible(*own) for own in parts), strict=True)
        points, normals, outer, inner, length, edges = (torch.cat(part) for part in found)
        ends = state.frames.keypoints.index_select(1, constant_tensor((_WRIST, _KNUCKLE), torch.long, like.device))
        ends = self._camera.cam_from_world(ends)
        wrist, distal = wrist_and_axis(ends, self._camera)
        return VisibleContour(
            points_px=points,
            normals=normals,
            outer=outer,
            inner=inner,
            length_px=length,
            wrist_px=wrist,
            distal_px=distal,
            edges=edges,
        )

    @own_precision
    def points(self, pose: HandPose, visible: VisibleContour) -> Float[Tensor, "hands 2 points"]:
        """The points that `visible` decides about, px, wherever the hands have moved since."""
        vertices = self.hand(pose.dofs, self._shape, root_reference=pose.reference).vertices
        each = torch.arange(len(vertices), device=vertices.device)[:, None, None]
        middles = vertices[each, _edges_of(visible)].mean(2)
        return self._camera.project(middles).mT

    @own_precision
    def motion(self, pose: HandPose, visible: VisibleContour) -> EdgeMotion:
        """The same points with their motion."""
        edges = _edges_of(visible)
        points, jacobian = skin_jacobian(self.hand, pose.dofs, edges, shape=self._shape, root_reference=pose.reference)
        points_cam = self._camera.cam_from_world(points)
        plane = self._camera.plane_from_cam(points_cam)
        return EdgeMotion(
            columns_px=self._camera.pixels_from_plane(plane).mT,
            columns_cam=points_cam.mT,
            columns_plane=plane.mT,
            jacobian=self._camera.rotation @ jacobian,
            camera=self._camera,
        )

    def shape_slopes(
        self, pose: HandPose, visible: VisibleContour, columns: tuple[int, ...]
    ) -> Float[Tensor, "hands 2 points columns"]:
        """Derivative of the same points in some parameters of the shape, px; by finite differences, one parameter after
        the other. Only across the outline, along which points may slide, is it that of the outline."""
        shapes, steps = varied_shapes(self.kinematics.shape_space, self._shape, columns)
        here, *others = (self.with_shape(shape).points(pose, visible) for shape in shapes)
        return torch.stack([(other - here) / step for other, step in zip(others, steps, strict=True)], -1)

    def _visible(
        self, vertices: Float[Tensor, "hands vertices 3"], probe_distance_px: Float[Tensor, "hands"]
    ) -> tuple[Tensor, ...]:
        """Contours: points, normals, which are outer, which inner, lengths, edges; padded with what is neither."""
        camera, faces = self._camera, self.hand.faces
        seen = camera.cam_from_world(vertices)
        a, b, c = seen[:, faces].unbind(2)
        towards = torch.linalg.cross(b - a, c - a)
        sight = a
        if camera.kind == "orthographic":
            sight = torch.zeros_like(a) + constant_tensor((0.0, 0.0, 1.0), a.dtype, a.device)
        is_front = (towards * sight).sum(-1) < 0
        edges, owners, of_edge = self._edges, self._faces_of_edge, is_front[:, self._faces_of_edge]
        if len(vertices) == 1 and is_host(vertices.device):  # few of all edges are followed up where they are known
            chosen = (of_edge[0, :, 0] != of_edge[0, :, 1]).nonzero()[:, 0]
            chosen = chosen if len(chosen) else chosen.new_zeros(1)
            edges, owners, of_edge = edges[chosen], owners[chosen], of_edge[:, chosen]
        ends = seen[:, edges]
        is_contour = (of_edge[..., 0] != of_edge[..., 1]) & (ends[..., 2] > 0).all(-1)
        corners = camera.pixels_from_plane(camera.plane_from_cam(ends))
        along = corners[:, :, 1] - corners[:, :, 0]
        normals = torch.nn.functional.normalize(torch.stack((along[..., 1], -along[..., 0]), -1), dim=-1)
        points_cam = ends.mean(2)
        points = camera.pixels_from_plane(camera.plane_from_cam(points_cam))
        # Outward is away from the third corner of the face that is turned to the camera.
        which = of_edge.long().argmax(-1, keepdim=True)
        front = owners.expand(len(seen), -1, -1).gather(2, which).squeeze(2)
        each = torch.arange(len(seen), device=seen.device)[:, None, None]
        centre = camera.pixels_from_plane(camera.plane_from_cam(seen[each, faces[front]].mean(2)))
        normals = torch.where((((centre - points) * normals).sum(-1) > 0)[..., None], -normals, normals)
        depth = self._depths(vertices)
        surface = _read(depth, points - _INSIDE_PX * normals)
        visible = is_contour & (points_cam[..., 2] <= surface + _SLACK)
        outer = visible & ~_read(depth, points + probe_distance_px[:, None, None] * normals).isfinite()
        kept, is_kept = _spread(visible, self._max_points)

        def padded(values: Tensor) -> Tensor:
            own = values.flatten(2) if values.ndim > 2 else values[..., None]
            found = own.gather(1, kept[..., None].expand(-1, -1, own.shape[2]))
            return torch.where(is_kept[..., None], found, 0).reshape(*kept.shape, *values.shape[2:])

        filled = torch.where(is_kept[..., None], edges[kept], self._edges[0])
        decided = padded(outer).bool(), padded(visible & ~outer).bool()
        return padded(points), padded(normals), *decided, padded(along.norm(dim=-1)), filled

    def _depths(self, vertices: Float[Tensor, "hands vertices 3"]) -> Float[Tensor, "hands height width"]:
        """Z-buffers of the hands. The one place where contours wait for an accelerator, once for each association of
        data: how many pixels the triangles cover must be known before they are drawn."""
        camera, faces = self._camera, self.hand.faces
        if is_host(vertices.device) or camera.has_distortion:
            return torch.stack([rasterize(own, faces, camera, is_closed=True).depth for own in vertices])
        together = vertices.split(max(1, _PIXELS_AT_ONCE // (camera.width * camera.height)))
        return torch.cat([rasterize_many(some, faces, camera, is_closed=True)[1] for some in together])


def _spread(
    flags: Bool[Tensor, "hands edges"], count: int
) -> tuple[Int[Tensor, "hands count"], Bool[Tensor, "hands count"]]:
    """Places of the flags that are set, at most so many, spread evenly over all of each hand; and which of the places
    are such, for there may be fewer."""
    rank = flags.cumsum(1)
    total, slot = rank[:, -1:], torch.arange(count, device=flags.device)
    step = (total - 1).to(torch.float32) / max(1, count - 1)  # from both ends, as torch.linspace does
    spread = torch.where(slot < max(1, count // 2), step * slot, (total - 1) - step * (count - 1 - slot)).round().long()
    wanted = torch.where(total > count, spread, slot)
    place = torch.searchsorted(rank, wanted + 1).clamp_max(flags.shape[1] - 1)
    return place, wanted < total


def _edges_of(visible: VisibleContour) -> Int[Tensor, "hands points 2"]:
    if visible.edges is None:
        raise ValueError("visible: expected the contour of a mesh, got that of another surface")
    return visible.edges


def _edges(faces: Int[Tensor, "faces 3"]) -> tuple[Int[Tensor, "edges 2"], Int[Tensor, "edges 2"]]:
    """Edges of a closed mesh, and the two faces of each."""
    pairs = torch.cat((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]])).sort(-1).values
    owner = torch.arange(len(faces), device=faces.device).repeat(3)
    edges, which = pairs.unique(dim=0, return_inverse=True)
    if 2 * len(edges) != len(pairs) or not bool((which.bincount() == 2).all()):
        raise ValueError("faces: expected a closed mesh, two faces at every edge")
    return edges, owner[which.argsort(stable=True)].reshape(-1, 2)


def _read(
    depth: Float[Tensor, "hands height width"], points_px: Float[Tensor, "hands points 2"]
) -> Float[Tensor, "hands points"]:
    """Depth at the nearest pixels; infinite where nothing is seen, and beyond the picture."""
    _, height, width = depth.shape
    x, y = points_px.nan_to_num(nan=-1e6).round().clamp(-2, max(height, width) + 1).long().unbind(-1)
    inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    pixel = y.clamp(0, height - 1) * width + x.clamp(0, width - 1)
    return torch.where(inside, depth.flatten(1).gather(1, pixel), torch.inf)
