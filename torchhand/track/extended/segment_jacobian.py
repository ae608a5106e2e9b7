"""Limb segments of the last two phalanges, and how their ends move with the pose, in closed form.

A limb is a straight contour generator of a phalanx's cone, between the cone's two ends (Ouhaddi and Horain 1998, 7.2).
When the pose changes, its ends move with the bone, and they slide around the cone, because the contour is where the
camera grazes it: at the angle θ of the section with cos(θ ∓ α) = c, (cos α, sin α) the direction of the camera in units
of the section and c as in `torchhand.view.outlines.generators`. Both parts are needed: seen at a slant, sliding moves
an end along the segment.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import batch_first, batch_last, left_jacobian
from torchhand.hand import CONE_NAMES, FINGERS, PARENTS, ROOT_DOFS, HandFrames, HandKinematics, Primitives
from torchhand.hand.kinematics import world_axes
from torchhand.hand.primitives import CONE_BONES
from torchhand.view import HandProjector
from torchhand.view.outlines import generators

SEGMENT_CONES = (
    *("thumb_proximal", "thumb_distal"),
    *(f"{finger}_{bone}" for finger in FINGERS[1:] for bone in ("middle", "distal")),
)
"""The phalanges that are observed: two of each finger, from the palm outwards."""
SEGMENT_NAMES = tuple(f"{cone}_{side}" for cone in SEGMENT_CONES for side in (0, 1))
"""Twenty segments; 0 and 1 are the two sides of `OutlineTable.cone_side`."""

CONES = tuple(CONE_NAMES.index(name) for name in SEGMENT_CONES)
_ROOT = len(ROOT_DOFS)
_ANGLES = 6  # joint angles of one finger


@dataclass(frozen=True, kw_only=True)
class Segments:
    """The twenty limb segments of a hand before a camera, in SEGMENT_NAMES order."""

    ends_px: Float[Tensor, "*batch 20 2 2"]
    """Beginning (towards the palm) and end; x, y."""
    ends_cam: Float[Tensor, "*batch 20 2 3"]
    """Ends of the segments, camera frame, metres."""
    is_real: Bool[Tensor, "*batch 20"]
    """False where the cone has no outline (seen along its axis, or from inside) or lies behind the camera."""


def segments_of(projector: HandProjector, primitives_cam: Primitives) -> Segments:
    """Segments of hands whose primitives in the camera frame are known; differentiable in them."""
    cones, _ = generators(primitives_cam, is_orthographic=projector.is_orthographic, with_normals=False)
    index = torch.tensor(CONES, device=cones.low.device)
    low, rise = cones.low.index_select(0, index), cones.rise.index_select(0, index)
    batch = primitives_cam.position.shape[:-2]
    ends = batch_first(torch.stack((low, low + rise), 2).flatten(0, 1), batch)
    is_real = batch_first(cones.is_real.index_select(0, index).repeat_interleave(2, 0), batch)
    camera = projector.camera
    return Segments(
        ends_px=camera.pixels_from_plane(camera.plane_from_cam(ends)),
        ends_cam=ends,
        is_real=is_real & (ends[..., 2] > 0).all(-1),
    )


class SegmentJacobian:
    """d ends_px / d free for pose = basis · free + constant; what does not change is laid out once."""

    def __init__(self, kinematics: HandKinematics, basis: Float[Tensor, "36 free"]) -> None:
        like = kinematics.default_levers
        bones, angles, used = [], [], []
        for cone in CONES:
            chain, bone = set(), CONE_BONES[cone]
            while bone > 0:
                chain.add(bone)
                bone = PARENTS[bone]
            own = [i for i, moved in enumerate(kinematics.skeleton.bone) if moved in chain]
            angles.append(own + [own[0]] * (_ANGLES - len(own)))
            bones.append([kinematics.skeleton.bone[i] for i in angles[-1]])
            used.append([1.0] * (_ROOT + len(own)) + [0.0] * (_ANGLES - len(own)))
        device = like.device
        self._angles, self._bones = torch.tensor(angles, device=device), torch.tensor(bones, device=device)
        dofs = torch.tensor([[*range(_ROOT), *(_ROOT + i for i in own)] for own in angles], device=device)
        self._dofs = dofs
        # (10, 12, free): the free parameters' effect on the DOFs that move each phalanx.
        self._basis = basis.to(like)[dofs] * torch.tensor(used, device=device).to(like)[..., None]
        self._cones = torch.tensor(CONES, device=device)
        self._constants = kinematics.chain.constants

    def __call__(
        self,
        pose: Float[Tensor, "*batch 36"],
        frames: HandFrames,
        primitives_cam: Primitives,
        segments: Segments,
        projector: HandProjector,
        moving: Bool[Tensor, "*batch 36"] | None = None,
    ) -> Float[Tensor, "*batch 20 2 2 free"]:
        """Pixels per metre or radian, for the hands that frames, primitives and segments belong to.

        moving: DOFs that follow the free parameters; others are held, such as tied angles at their limits.
        Where a segment is not real the numbers are finite, or not, and mean nothing.
        """
        spin, about, shift = self._twists(pose, frames, projector)
        ends = segments.ends_cam.unflatten(-3, (len(CONES), 2))[..., None, :]  # 10, sides, ends, 1, 3
        turning = torch.linalg.cross(spin[..., None, None, :, :], ends - about[..., None, None, :, :], dim=-1)
        sliding, slide = self._sliding(spin, about, shift, primitives_cam, projector.is_orthographic)
        turning = torch.cat((shift.expand(*turning.shape[:-2], 3, 3), turning), -2)  # 10, sides, ends, 12, 3
        moved = turning + sliding[..., None, :, None] * slide[..., None, :]
        camera = projector.camera
        plane = camera.plane_from_cam(segments.ends_cam)
        pixels = camera.pixel_jacobian(plane).unflatten(-4, (len(CONES), 2))
        if projector.is_orthographic:
            on_plane = moved[..., :2]
        else:
            seen = plane.unflatten(-3, (len(CONES), 2))[..., None, :]
            on_plane = (moved[..., :2] - seen * moved[..., 2:]) / ends[..., 2:]
        of_dofs = pixels @ on_plane.mT  # 10, sides, ends, 2, 12
        of_dofs = of_dofs.flatten(-4, -2)
        if moving is not None:
            of_dofs = of_dofs * moving[..., self._dofs].unsqueeze(-2)
        of_free = of_dofs @ self._basis
        return of_free.unflatten(-2, (2, 2, 2)).flatten(-5, -4)

    def _twists(self, pose: Tensor, frames: HandFrames, projector: HandProjector) -> tuple[Tensor, Tensor, Tensor]:
        """Twists in the camera frame: axes (10, 9, 3) of root and joints, points on them, and the root's shifts (3,
        3)."""
        batch = pose.shape[:-1]
        axes = world_axes(batch_last(pose, 1, batch), batch_last(frames.rotation, 3, batch), self._constants)
        axes = batch_first(axes, batch)[..., self._angles, :]
        columns = left_jacobian(pose[..., 3:6]).mT[..., None, :, :].expand(*batch, len(CONES), 3, 3)
        origins = frames.position[..., self._bones, :]
        root = frames.position[..., None, :1, :].expand(*batch, len(CONES), 3, 3)
        camera = projector.camera
        spin = torch.cat((columns, axes), -2) @ camera.rotation.mT
        about = camera.cam_from_world(torch.cat((root, origins), -2))
        return spin, about, camera.rotation.mT

    def _sliding(
        self, spin: Tensor, about: Tensor, shift: Tensor, primitives_cam: Primitives, is_orthographic: bool
    ) -> tuple[Tensor, Tensor]:
        """dθ / d DOF (10, sides, 12) and the movement of the ends per dθ (10, sides, ends, 3)."""
        rotation = primitives_cam.rotation[..., self._cones, :, :]
        position = primitives_cam.position[..., self._cones, :]
        sizes = primitives_cam.sizes
        start = sizes.cone_start[..., self._cones, :]
        end_scale, length = sizes.cone_end_scale[..., self._cones], sizes.cone_length[..., self._cones]
        # The camera in the cone's frame, and how it moves there: a turn by ω about o moves it by ω × o.
        if is_orthographic:
            eye = -rotation[..., 2, :]
            forward = torch.zeros_like(spin)
            forward[..., 2] = 1.0
            rate = torch.linalg.cross(spin, forward, dim=-1)
            shifted = torch.zeros_like(shift)
        else:
            eye = -(rotation.mT @ position[..., None]).squeeze(-1)
            rate, shifted = torch.linalg.cross(spin, about, dim=-1), -shift
        rate = torch.cat((shifted.expand(*rate.shape[:-2], 3, 3), rate), -2) @ rotation  # 10, 12, 3
        slope = (1 - end_scale) / length
        across = eye[..., ::2] / start
        distance = across.norm(dim=-1)
        towards = across / distance[..., None]
        weight = 0.0 if is_orthographic else 1.0
        cosine = ((weight - slope * eye[..., 1]) / distance).clamp(-1 + 1e-12, 1 - 1e-12)
        sine = (1 - cosine * cosine).sqrt()
        ux, uz = towards.unbind(-1)
        turned = rate[..., 2] * (ux / start[..., 1])[..., None] - rate[..., 0] * (uz / start[..., 0])[..., None]
        nearer = rate[..., 0] * (ux / start[..., 0])[..., None] + rate[..., 2] * (uz / start[..., 1])[..., None]
        of_cosine = -slope[..., None] * rate[..., 1] - cosine[..., None] * nearer
        opening = -of_cosine / sine[..., None]  # of α - θ and θ - α
        angle_rate = torch.stack((turned - opening, turned + opening), -2) / distance[..., None, None]
        side = torch.stack((sine, -sine), -1)
        x = ux[..., None] * cosine[..., None] + uz[..., None] * side
        z = uz[..., None] * cosine[..., None] - ux[..., None] * side
        tangent = torch.stack((-z * start[..., None, 0], torch.zeros_like(x), x * start[..., None, 1]), -1)
        tangent = tangent @ rotation.mT  # 10, sides, 3
        scales = torch.stack((torch.ones_like(end_scale), end_scale), -1)
        return angle_rate, tangent[..., None, :] * scales[..., None, :, None]
