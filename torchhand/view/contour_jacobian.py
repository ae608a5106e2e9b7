"""How the outline of the primitives moves in the picture with the pose, in closed form.

A point of a contour generator is carried by its bone, and slides on the surface as the direction of view changes. The
slide is tangent to the surface, whose tangent plane holds the line of sight: in the picture it runs along the outline.
Across the outline the derivative is therefore that of the rigid motion alone, exactly; along it the slide is left out,
as distances from a contour hardly change that way.

A change of the residual per pixel is a force at the point; its wrench about the camera's centre, times the screws of
the joints before the point's bone, is the derivative: six numbers per point and per joint instead of a lever for each
pair.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera, left_jacobian
from torchhand.hand import BONES, PARENTS, ROOT_DOFS, HandFrames, HandKinematics
from torchhand.hand.joint_rotations import world_axes
from torchhand.hand.primitives import CONE_BONES, ELLIPSOID_BONES
from torchhand.view.outline import OutlineTable, outline_points
from torchhand.view.projector import HandProjector

_ROOT = len(ROOT_DOFS)
_NEAREST = 1e-3  # metres before the camera


@dataclass(frozen=True, kw_only=True)
class OutlineMotion:
    """Points of the outlines of a batch of hands in the picture, and how they move."""

    points_px: Float[Tensor, "hands points 2"]
    points_cam: Float[Tensor, "hands points 3"]
    """Metres; of points that are not before the camera, any that are."""
    camera: Camera
    per_part: tuple[int, int]
    """Points on every cone and on every ellipsoid."""
    cone_screws: Float[Tensor, "hands cones 6 free"]
    """Of each part: turn, then shift of the camera's centre."""
    ellipsoid_screws: Float[Tensor, "hands ellipsoids 6 free"]

    def along(self, direction: Float[Tensor, "hands points 2"]) -> Float[Tensor, "hands points free"]:
        """Derivative of direction · point in the free parameters, px per unit, the direction held."""
        force = cam_force(self.camera, self.points_cam, direction)
        wrench = torch.cat((torch.linalg.cross(self.points_cam, force), force), -1)
        parts, start = [], 0
        for per_part, screws in zip(self.per_part, (self.cone_screws, self.ellipsoid_screws), strict=True):
            count = screws.shape[1]
            own = wrench[:, start : start + count * per_part].unflatten(1, (count, per_part))
            parts.append((own @ screws).flatten(1, 2))
            start += count * per_part
        return torch.cat(parts, 1)


def cam_force(
    camera: Camera, points_cam: Float[Tensor, "*batch 3"], direction: Float[Tensor, "*batch 2"]
) -> Float[Tensor, "*batch 3"]:
    """Derivative of direction · pixel in the point, camera frame: px per metre."""
    if camera.has_distortion or camera.has_skew:
        plane = camera.plane_from_cam(points_cam)
        on_plane = (direction[..., None, :] @ camera.pixel_jacobian(plane)).squeeze(-2)
    else:
        on_plane = direction * camera.intrinsics.diagonal()[:2]
    if camera.kind == "orthographic":
        return torch.cat((on_plane, torch.zeros_like(on_plane[..., :1])), -1)
    x, y, z = points_cam.unbind(-1)
    nearness = z.reciprocal()
    scaled = on_plane * nearness[..., None]
    depth = -(scaled[..., 0] * x + scaled[..., 1] * y) * nearness
    return torch.cat((scaled, depth[..., None]), -1)


class OutlineTracer:
    """Outlines of many hands with their motion in a pose space, with all that does not change multiplied out once.

    table: with the same number of points on every cone that it has, and on every ellipsoid. basis: (36, free).
    """

    def __init__(self, projector: HandProjector, table: OutlineTable, basis: Float[Tensor, "36 free"]) -> None:
        self.projector, self.table = projector, table
        cones, per_cone = _runs(table.cone)
        balls, per_ball = _runs(table.ellipsoid)
        self._per_part = (per_cone, per_ball)
        bones = [CONE_BONES[i] for i in cones], [ELLIPSOID_BONES[i] for i in balls]
        carried = _carried(projector.kinematics).to(basis)
        # (36, parts · free) for both kinds of parts.
        self._counts = tuple(len(own) for own in bones)
        self._spread = tuple((carried[own].T[:, :, None] * basis[:, None]).flatten(1) for own in bones)
        self._free = basis.shape[1]

    def __call__(
        self,
        pose: Float[Tensor, "hands 36"],
        root_reference: Float[Tensor, "hands 3 3"],
        moving: Bool[Tensor, "hands 36"] | None = None,
    ) -> OutlineMotion:
        """Of poses with rotation vectors about their references; no visibility.

        moving: DOFs that follow the free parameters; others are held, such as tied angles at their limits.
        """
        projector = self.projector
        camera, kinematics = projector.camera, projector.kinematics
        frames = kinematics(pose, projector.shape, root_reference=root_reference)
        primitives = projector.primitives_cam(frames)
        points = outline_points(primitives, self.table, is_orthographic=projector.is_orthographic).contiguous()
        is_behind = points[..., 2:] < _NEAREST  # must not become infinite
        points = torch.where(is_behind, points.new_tensor((0.0, 0.0, 1.0)), points)
        screws = joint_screws(kinematics, camera, pose, frames)
        if moving is not None:
            screws = screws * moving[..., None]
        of_cones, of_ellipsoids = (
            (screws.mT @ spread).unflatten(-1, (count, self._free)).transpose(1, 2)
            for count, spread in zip(self._counts, self._spread, strict=True)
        )
        return OutlineMotion(
            points_px=camera.pixels_from_plane(camera.plane_from_cam(points)),
            points_cam=points,
            camera=camera,
            per_part=self._per_part,
            cone_screws=of_cones,
            ellipsoid_screws=of_ellipsoids,
        )


def joint_screws(
    kinematics: HandKinematics, camera: Camera, pose: Float[Tensor, "hands 36"], frames: HandFrames
) -> Float[Tensor, "hands 36 6"]:
    """What each DOF does to a body that it carries: its turn, and the shift of the camera's centre, camera frame."""
    axes = world_axes(pose.T, frames.rotation.permute(1, 2, 3, 0), kinematics.chain.constants).permute(2, 0, 1)
    bones = torch.tensor(kinematics.skeleton.bone, device=pose.device)
    centres = frames.position.index_select(1, bones)
    spin = left_jacobian(pose[:, 3:6]).mT
    turns = torch.cat((spin, axes), 1) @ camera.rotation.T
    places = torch.cat((frames.position[:, :1].expand(-1, 3, -1), centres), 1) @ camera.rotation.T + camera.translation
    shifts = torch.linalg.cross(places, turns)
    still = torch.zeros_like(turns[:, :3])
    moves = camera.rotation.T.expand(len(pose), 3, 3)  # rows: images of the world's axes
    return torch.cat((torch.cat((still, moves), -1), torch.cat((turns, shifts), -1)), 1)


def _carried(kinematics: HandKinematics) -> Bool[Tensor, "20 36"]:
    """Whether a DOF moves a bone."""
    above = torch.eye(len(BONES), dtype=torch.bool)
    for bone in range(1, len(BONES)):
        above[bone] |= above[PARENTS[bone]]
    root = torch.ones(len(BONES), _ROOT, dtype=torch.bool)
    return torch.cat((root, above[:, list(kinematics.skeleton.bone)]), 1)


def _runs(index: Tensor) -> tuple[list[int], int]:
    """Parts in the order of their points, and how many points each has."""
    parts, counts = index.unique_consecutive(return_counts=True)
    if len(parts) != len(index.unique()) or len(counts.unique()) > 1:
        raise ValueError("table: expected equally many points on every cone, and on every ellipsoid, one after another")
    return parts.tolist(), int(counts[0]) if len(counts) else 0
