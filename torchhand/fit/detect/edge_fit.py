"""Fits pose and proportions to one picture: maximum a posteriori Gauss-Newton on edges along the contour's normals.

The start of a track: Stenger et al. (2001) set the model's parameters by hand and name their estimation within the same
framework as future work (section 6.1); this is that. The measurement is the tracker's own.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.contour import hand_length_px, is_outer
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandKinematics, rebased
from torchhand.hand.limits import clamp_to_limits
from torchhand.image import EdgeSettings, search_edges
from torchhand.view import HandProjector, OutlineTable

# Prior standard deviations of the pose about the start posture, by ending of the DOF's name: metres and radians.
# Flexion of a straight finger is hardly seen in one picture and trades against its length, so it stays close.
_POSE_STD = {
    "root_tx": 0.03,
    "root_ty": 0.03,
    "root_tz": 0.10,
    "root_rx": 0.10,
    "root_ry": 0.10,
    "root_rz": 0.30,
    "thumb_cmc_fe": 0.30,
    "thumb_cmc_aa": 0.30,
    "thumb_mcp_fe": 0.25,
    "thumb_ip_fe": 0.25,
    "mcp_aa": 0.20,
    "mcp_fe": 0.08,
    "pip_fe": 0.08,
    "dip_fe": 0.05,
}
_BENT = 0.3  # radians: a finger joint flexed more than this by the posture counts as bent
_MIN_POINTS = 10
_MIN_SEARCH_PX = 4.0
_STEP = 1e-4  # of the numerical derivative, prior standard deviations


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    iterations: int = 14
    """Gauss-Newton steps; 1 or more."""
    search_fraction: float = 0.10
    """First half length of the edge search, as a share of the hand's length in the picture; above 0."""
    final_search_fraction: float = 0.035
    """Last half length, as such a share; above 0."""
    edge_std_px: float = 1.5
    """Standard deviation of one edge; above 0."""
    bent_std_rad: float = 0.25
    """Prior standard deviation of the flexions of a finger that the posture bends; above 0."""

    def __post_init__(self) -> None:
        for name in ("search_fraction", "final_search_fraction", "edge_std_px", "bent_std_rad"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"fit.{name}: expected above 0 and finite, got {getattr(self, name)!r}")
        if not self.iterations >= 1:
            raise ValueError(f"fit.iterations: expected 1 or more, got {self.iterations!r}")


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A hand fitted to one picture, in the camera's frame."""

    pose: Float[Tensor, "36"]
    """Metres and radians, with a zero rotation vector: the root's orientation is in root_reference."""
    root_reference: Float[Tensor, "3 3"]
    """Rotation cam_from_hand."""
    shape: Float[Tensor, "shape"]
    pose_std: Float[Tensor, "36"]
    """0 for DOFs that are held, and for those that lie at their limit."""
    shape_std: Float[Tensor, "shape"]
    """0 for parameters that are held, and for those that lie at their bound."""
    residual_px: float
    """Median absolute distance of the found edges from the contour before the last step; infinite without edges."""
    found_fraction: float
    """Share of the visible outer contour points at which an edge was found."""

    @classmethod
    def of_start(
        cls, pose: Float[Tensor, "36"], root_reference: Float[Tensor, "3 3"], shape: Float[Tensor, "shape"]
    ) -> "Fit":
        """A placement that no edge has been compared with."""
        zero, nothing = torch.zeros_like(pose), float("inf")
        return cls(
            pose=pose,
            root_reference=root_reference,
            shape=shape,
            pose_std=zero,
            shape_std=torch.zeros_like(shape),
            residual_px=nothing,
            found_fraction=0.0,
        )


def pose_prior_std(pose: Float[Tensor, "36"], bent_std_rad: float) -> Float[Tensor, "36"]:
    """Standard deviation of every DOF about a start posture, metres and radians; 0 for DOFs that are held."""
    std = torch.zeros(len(DOFS), dtype=pose.dtype)
    for i, dof in enumerate(DOFS):
        std[i] = next((value for ending, value in _POSE_STD.items() if dof.endswith(ending)), 0.0)
        if dof.endswith(("pip_fe", "mcp_fe")) and abs(float(pose[i])) > _BENT:
            std[i] = bent_std_rad
    return std


def fit_contour(
    plane: Float[Tensor, "height width"],
    kinematics: HandKinematics,
    camera: Camera,
    table: OutlineTable,
    pose: Float[Tensor, "36"],
    root_reference: Float[Tensor, "3 3"],
    shape: Float[Tensor, "shape"],
    settings: FitSettings | None = None,
    *,
    fit_shape: bool = True,
    edges: EdgeSettings | None = None,
) -> Fit:
    """Moves pose and shape from a rough start until the outer contour lies on the edges of `plane` (hand bright, 0..1).

    Minimises Σ ρ(n·(e - x)) / σ² plus the squared distance to the start in units of its prior spread: the shape space's
    over people, a fixed one of the posture. Hand length stays: one picture cannot tell it from depth. Joint limits and
    the shape's bounds hold. The camera's frame is the world. Where fewer than ten contour points can be compared, the
    start comes back with `found_fraction` 0.
    """
    settings = settings or FitSettings()
    edges = edges or EdgeSettings(polarity="inside_bright", min_strength=0.15, choose="nearest")
    space = kinematics.shape_space
    pose_std = pose_prior_std(pose, settings.bent_std_rad)
    shape_std = space.std.to(pose).clone()
    shape_std[space.names.index("hand_length")] = 0.0
    if not fit_shape:
        shape_std = torch.zeros_like(shape_std)
    free_pose, free_shape = pose_std.nonzero()[:, 0], shape_std.nonzero()[:, 0]
    prior_std = torch.cat((pose_std[free_pose], shape_std[free_shape]))
    start = torch.cat((pose[free_pose], shape[free_shape]))
    values = start.clone()
    is_bounded = torch.zeros_like(values, dtype=torch.bool)

    def split(candidates: Tensor) -> tuple[Tensor, Tensor]:
        poses = pose.expand(*candidates.shape[:-1], -1).index_copy(-1, free_pose, candidates[..., : len(free_pose)])
        shapes = shape.expand(*candidates.shape[:-1], -1).index_copy(-1, free_shape, candidates[..., len(free_pose) :])
        return poses, shapes

    precision = torch.diag(prior_std**-2)
    steps = _STEP * prior_std
    information, residual, found_fraction = precision, torch.zeros(0, dtype=pose.dtype), 0.0
    for iteration in range(settings.iterations):
        here_pose, here_shape = split(values)
        projector = HandProjector(kinematics, camera, here_shape)
        contour = projector.contour(here_pose, root_reference, table)
        length_px = hand_length_px(camera, kinematics, here_pose, here_shape)
        silhouette = projector.silhouette(here_pose, root_reference)
        keep = contour.visible & is_outer(silhouette, contour.points_px, contour.normals, length_px)
        if int(keep.sum()) < _MIN_POINTS:
            break
        progress = iteration / max(1, settings.iterations - 1)
        fraction = settings.search_fraction * (settings.final_search_fraction / settings.search_fraction) ** progress
        search = torch.full((int(keep.sum()),), max(_MIN_SEARCH_PX, fraction * length_px), dtype=pose.dtype)
        normals = contour.normals[keep]
        seen = search_edges(plane, contour.points_px[keep], normals, edges, half_length_px=search)
        chosen = table.select(keep)
        shifted = torch.cat((values + torch.diag(steps), values - torch.diag(steps)))
        poses, shapes = split(shifted)
        points = HandProjector(kinematics, camera, shapes).outline_px(poses, root_reference, chosen)
        plus, minus = points.chunk(2)
        jacobian = ((plus - minus) * normals).sum(-1).T / (2 * steps)
        residual, found_fraction = seen.offset_px, float(seen.found.float().mean())
        # Geman-McClure weights: half the search length is far; wrong edges of neighbouring fingers fade out.
        scale = max(2.0, 0.3 * fraction * length_px)
        weight = seen.found / settings.edge_std_px**2 / (1 + (residual / scale) ** 2) ** 2
        weight = weight / seen.candidates.clamp_min(1)
        information = jacobian.T @ (weight[:, None] * jacobian) + precision
        gradient = jacobian.T @ (weight * residual) - precision @ (values - start)
        values = values + torch.linalg.solve(information, gradient)
        bounded_pose = clamp_to_limits(split(values)[0], kinematics.skeleton)[free_pose]
        lower, upper = space.lower.to(pose)[free_shape], space.upper.to(pose)[free_shape]
        bounded = torch.cat((bounded_pose, values[len(free_pose) :].clamp(lower, upper)))
        is_bounded = bounded != values
        values = bounded
        residual = residual[seen.found]
    std = torch.linalg.inv(information).diagonal().clamp_min(0).sqrt()
    std = torch.where(is_bounded, torch.zeros_like(std), std)
    final_pose, final_shape = split(values)
    rebased_pose, reference = rebased(final_pose, root_reference)
    return Fit(
        pose=rebased_pose,
        root_reference=reference,
        shape=final_shape,
        pose_std=torch.zeros_like(pose).index_copy(0, free_pose, std[: len(free_pose)]),
        shape_std=torch.zeros_like(shape).index_copy(0, free_shape, std[len(free_pose) :]),
        residual_px=float(residual.abs().median()) if residual.numel() else float("inf"),
        found_fraction=found_fraction,
    )
