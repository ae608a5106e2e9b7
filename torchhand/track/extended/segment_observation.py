"""Observation of the extended Kalman filter of Ouhaddi and Horain (1998): registered limb segments, of each the middle,
length and direction.

The observation is loosely coupled (section 7.5 of the paper): registration fits the model to the picture
first, and the segments of the fitted pose are what the filter measures, never raw edges. Twenty segments of the last
two phalanges give 80 numbers.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.errors import require, require_positive
from torchhand.fit.contour import is_in_picture
from torchhand.hand import DOFS, HandFrames, PoseSpace, Primitives
from torchhand.hand.limits import clamp_to_limits
from torchhand.numerics import wrapped
from torchhand.track.extended.segment_jacobian import CONES, SEGMENT_NAMES, SegmentJacobian, Segments, segments_of
from torchhand.view import HandProjector, OutlineTable, outline, visible_points

SCALARS = ("u", "v", "length", "direction")
"""Of every segment: its middle in px, its length in px and its direction in rad, modulo π; segment by segment."""
OBSERVED = len(SEGMENT_NAMES) * len(SCALARS)
_SHORTEST_PX = 1e-6
_MIN_LENGTH_PX = 3.0  # shorter segments have no direction worth the name
_MIN_FORESHORTENING = 0.25  # sine of the angle between segment and line of sight that must be reached
_SAMPLES = 8  # points per segment at which visibility is tested


@dataclass(frozen=True, kw_only=True)
class SegmentSettings:
    """Which segments count, and how exactly they are known."""

    position_std_px: float = 1.0
    """Standard deviation of each coordinate of a segment's middle. That of its direction is this over its length."""
    length_std_px: float = 1.5
    """Standard deviation of the length of a segment that faces the camera; grows with 1 / foreshortening."""
    min_visible: float = 0.5
    """Share of a segment that must be seen, not hidden by the hand itself; 0 to 1."""

    def __post_init__(self) -> None:
        for name in ("position_std_px", "length_std_px"):
            require_positive(f"segments.{name}", getattr(self, name))
        require(0 <= self.min_visible <= 1, "segments.min_visible", "0 to 1", self.min_visible)


@dataclass(frozen=True, kw_only=True)
class SegmentMeasurement:
    """The segments of a registered pose as what `update_extended` and `update_iterated` measure."""

    value: Float[Tensor, "*batch m"]
    """Pixels; directions in radians."""
    noise: Float[Tensor, "..."]
    """Variances (*batch, 80), or covariances (*batch, 80, 80) where that of the registration was given."""
    valid: Bool[Tensor, "*batch m"]


class SegmentObservation:
    """The 80 numbers as a function of the free parameters of a pose space, with their closed-form Jacobian.

    An angle that is tied to a free one stops at its limit while the free one goes on. Called with free parameters
    (*batch, free) it returns values (*batch, 80) and Jacobian (*batch, 80, free): the `observe` of `update_iterated`.
    Consecutive groups of four belong to one segment (`group=4` gates them together).
    """

    def __init__(
        self,
        projector: HandProjector,
        space: PoseSpace,
        root_reference: Float[Tensor, "*batch 3 3"],
        settings: SegmentSettings | None = None,
    ) -> None:
        """root_reference: world_from_hand that the pose's rotation vector is applied on, one or one per hypothesis."""
        self.projector = projector
        self.settings = settings or SegmentSettings()
        like = root_reference
        self.space = space.to(dtype=like.dtype, device=like.device)
        self.root_reference = root_reference
        is_free = torch.tensor([name in space.free_names for name in DOFS], device=like.device)
        self._is_tied = (self.space.basis != 0).any(-1) & ~is_free
        self._jacobian = SegmentJacobian(projector.kinematics, self.space.basis)
        self.period = like.new_tensor([math.inf, math.inf, math.inf, math.pi]).repeat(len(SEGMENT_NAMES))
        """Of every number: π for directions, infinite for all others."""

    def __call__(
        self, free: Float[Tensor, "*batch free"]
    ) -> tuple[Float[Tensor, "*batch 80"], Float[Tensor, "*batch 80 free"]]:
        """Values and Jacobian; derivatives of a segment without outline or length mean nothing."""
        posed = self._posed(free)
        return segment_values(posed.segments.ends_px), self._jacobian_of(posed)

    def value(self, free: Float[Tensor, "*batch free"]) -> Float[Tensor, "*batch 80"]:
        """The values alone, differentiable in the free parameters and in the projector's shape."""
        return segment_values(self._posed(free).segments.ends_px)

    def segments(self, free: Float[Tensor, "*batch free"]) -> Segments:
        """The segments themselves, for drawing and for judging."""
        return self._posed(free).segments

    def usable(self, free: Float[Tensor, "*batch free"]) -> Bool[Tensor, "*batch 20"]:
        """Segments that are real, in the picture, seen, long enough and not too foreshortened."""
        return self._usable(self._posed(free))

    def variances(self, free: Float[Tensor, "*batch free"]) -> Float[Tensor, "*batch 80"]:
        """Noise of the values: a fixed one of the middle, of the length more the more it is foreshortened, of the
        direction the middle's over the length."""
        return self._variances(self._posed(free).segments)

    def measure(
        self,
        free: Float[Tensor, "*batch free"],
        covariance: Float[Tensor, "*#batch free free"] | None = None,
    ) -> SegmentMeasurement:
        """The segments of a registered pose.

        covariance: of the registration's free parameters; H Σ Hᵀ is then added to the variances, which stand for what
        the registration cannot know (the model's shape). It must come from the picture alone: a registration that was
        pulled to the prediction would count the prediction twice.
        """
        posed = self._posed(free)
        noise, valid = self._variances(posed.segments), self._usable(posed).repeat_interleave(len(SCALARS), -1)
        if covariance is not None:
            jacobian = torch.where(valid[..., None], self._jacobian_of(posed), 0.0)
            spread = jacobian @ covariance @ jacobian.mT
            noise = 0.5 * (spread + spread.mT) + noise.diag_embed()
        return SegmentMeasurement(value=segment_values(posed.segments.ends_px), noise=noise, valid=valid)

    def _posed(self, free: Tensor) -> "_PosedSegments":
        wanted = self.space.dof(free)
        pose = torch.where(self._is_tied, clamp_to_limits(wanted, self.projector.kinematics.skeleton), wanted)
        frames = self.projector.kinematics(pose, self.projector.shape, root_reference=self.root_reference)
        primitives = self.projector.primitives_cam(frames)
        segments = segments_of(self.projector, primitives)
        return _PosedSegments(pose=pose, moving=pose == wanted, frames=frames, primitives=primitives, segments=segments)

    def _jacobian_of(self, posed: "_PosedSegments") -> Tensor:
        of_ends = self._jacobian(
            posed.pose, posed.frames, posed.primitives, posed.segments, self.projector, posed.moving
        )
        return _of_values(posed.segments.ends_px, of_ends)

    def _visible_fraction(self, posed: "_PosedSegments") -> Tensor:
        with torch.no_grad():
            table = _sample_table(posed.pose)
            is_orthographic = self.projector.is_orthographic
            seen = outline(posed.primitives, table, is_orthographic=is_orthographic)
            visible = visible_points(posed.primitives, seen, table, is_orthographic=is_orthographic)
        return visible.unflatten(-1, (len(SEGMENT_NAMES), -1)).to(posed.pose.dtype).mean(-1)

    def _usable(self, posed: "_PosedSegments") -> Tensor:
        segments, s = posed.segments, self.settings
        facing = foreshortening(segments.ends_cam, is_orthographic=self.projector.is_orthographic)
        return (
            segments.is_real
            & is_in_picture(segments.ends_px.mean(-2), self.projector.camera)
            & (_length(segments.ends_px) >= _MIN_LENGTH_PX)
            & (facing >= _MIN_FORESHORTENING)
            & (self._visible_fraction(posed) >= s.min_visible)
        )

    def _variances(self, segments: Segments) -> Tensor:
        s = self.settings
        facing = foreshortening(segments.ends_cam, is_orthographic=self.projector.is_orthographic)
        length = _length(segments.ends_px).clamp_min(_MIN_LENGTH_PX)
        of_length = s.length_std_px / facing.clamp_min(_MIN_FORESHORTENING)
        position = torch.full_like(length, s.position_std_px)
        return torch.stack((position, position, of_length, position / length), -1).flatten(-2).square()


class StackedSegments:
    """The segments of several views of one hand, one view's numbers after the other's."""

    def __init__(self, views: Sequence[SegmentObservation]) -> None:
        self.views = tuple(views)
        self.period = torch.cat([view.period for view in self.views])
        """Of every number: π for directions, infinite for all others."""

    def __call__(
        self, free: Float[Tensor, "*batch free"]
    ) -> tuple[Float[Tensor, "*batch m"], Float[Tensor, "*batch m free"]]:
        """Values and Jacobian, as of one view."""
        found = [view(free) for view in self.views]
        return torch.cat([value for value, _ in found], -1), torch.cat([jacobian for _, jacobian in found], -2)

    def measure(self, free: Float[Tensor, "*batch free"]) -> SegmentMeasurement:
        """The segments of a registered pose, errors independent."""
        found = [view.measure(free) for view in self.views]
        return SegmentMeasurement(
            value=torch.cat([one.value for one in found], -1),
            noise=torch.cat([one.noise for one in found], -1),
            valid=torch.cat([one.valid for one in found], -1),
        )


@dataclass(frozen=True, kw_only=True)
class _PosedSegments:
    """A batch of hands before the camera."""

    pose: Tensor
    moving: Tensor
    frames: HandFrames
    primitives: Primitives
    segments: Segments


def segment_values(ends_px: Float[Tensor, "*batch 20 2 2"]) -> Float[Tensor, "*batch 80"]:
    """Middle, length and direction in (-π/2, π/2] of every segment."""
    rise = ends_px[..., 1, :] - ends_px[..., 0, :]
    direction = torch.atan2(rise[..., 1], rise[..., 0])
    direction = wrapped(direction, direction.new_full((direction.shape[-1],), math.pi))
    middle = ends_px.mean(-2)
    return torch.stack((*middle.unbind(-1), _length(ends_px), direction), -1).flatten(-2)


def foreshortening(ends_cam: Float[Tensor, "*batch 2 3"], *, is_orthographic: bool = False) -> Float[Tensor, "*batch"]:
    """Sine of the angle between a segment and the line of sight to its middle: 1 facing the camera, 0 end on."""
    along = ends_cam[..., 1, :] - ends_cam[..., 0, :]
    sight = ends_cam.mean(-2)
    if is_orthographic:
        sight = torch.zeros_like(sight) + sight.new_tensor((0.0, 0.0, 1.0))
    product = torch.linalg.cross(along, sight, dim=-1).norm(dim=-1)
    return product / (along.norm(dim=-1) * sight.norm(dim=-1)).clamp_min(1e-30)


def _length(ends_px: Tensor) -> Tensor:
    rise = ends_px[..., 1, :] - ends_px[..., 0, :]
    return rise.square().sum(-1).clamp_min(_SHORTEST_PX**2).sqrt()


def _of_values(ends_px: Tensor, of_ends: Tensor) -> Float[Tensor, "*batch 80 free"]:
    """Chain rule from the ends (*batch, 20, 2, 2, free) to the values."""
    rise = ends_px[..., 1, :] - ends_px[..., 0, :]
    length = _length(ends_px)
    along = (rise / length[..., None]).unsqueeze(-2)
    across = torch.stack((-along[..., 1], along[..., 0]), -1)
    of_rise = of_ends[..., 1, :, :] - of_ends[..., 0, :, :]
    of_direction = (across @ of_rise) / length[..., None, None]
    return torch.cat((of_ends.mean(-3), along @ of_rise, of_direction), -2).flatten(-3, -2)


def _sample_table(like: Tensor) -> OutlineTable:
    """Points spread evenly on the segments, in their order."""
    device, each = like.device, len(CONES) * 2
    fraction = (torch.arange(_SAMPLES, dtype=like.dtype, device=device) + 0.5) / _SAMPLES
    return OutlineTable(
        cone=torch.tensor(CONES, device=device).repeat_interleave(2 * _SAMPLES),
        cone_side=torch.tensor((0, 1), device=device).repeat_interleave(_SAMPLES).repeat(len(CONES)),
        cone_fraction=fraction.repeat(each),
        ellipsoid=torch.zeros(0, dtype=torch.int64, device=device),
        ellipsoid_fraction=fraction[:0],
    )
