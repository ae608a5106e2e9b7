"""Our skin for programs that know only linear blend skinning and morph targets.

Our skin is blended linearly, and then pose correctives are added in the frames of single bones. Morph targets are added
before the blending instead. What they would have to be, frame by frame, is the missing offset turned back by the
blended matrices; its principal components over a clip serve as targets, as many as hold the error below a bound. Each
stands once for either sign: Blender clamps weights to the range from 0 to 1, and others do.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.export.clip import MotionClip
from torchhand.hand import HandFrames

MAX_TARGETS = 64
"""Principal components; one that is needed to both sides makes two targets."""
ERROR_BOUND = 1e-4
"""Metres, at every vertex of the frames that the targets are made of."""
_FRAMES_FOR_TARGETS = 512
_FRAMES_AT_ONCE = 32
_NEGLIGIBLE = 1e-6
"""Metres by which a target moves a vertex at most that is left out."""


@dataclass(frozen=True, kw_only=True)
class LinearSkin:
    """A mesh at its bind pose, its targets, and how well they do."""

    vertices: Float64[Tensor, "vertices 3"]
    """Vertices at the bind pose, hand frame, metres."""
    bind: HandFrames
    """The bones at the bind pose."""
    weights: Float64[Tensor, "vertices 20"]
    targets: Float64[Tensor, "targets vertices 3"]
    target_weights: Float64[Tensor, "frames targets"]
    """Between 0 and 1."""
    error: float
    """Largest distance of a vertex from our own skin over all frames of the clip, metres."""
    linear_error: float
    """Largest error without targets, by blending alone."""


def linear_skin(clip: MotionClip, *, max_targets: int = MAX_TARGETS, bound: float = ERROR_BOUND) -> LinearSkin:
    """The skin of a clip; without targets where blending alone is within the bound, or `max_targets` is 0."""
    mesh = clip.model.mesh
    if mesh is None:
        raise ValueError(f"model: expected one with a mesh, {clip.model.name!r} has none")
    at_bind = clip.hand(mesh.bind_pose.double(), clip.shape)
    weights = clip.hand.skinning.weights.T
    vertices = at_bind.vertices.contiguous()
    chosen = torch.linspace(0, len(clip) - 1, min(len(clip), _FRAMES_FOR_TARGETS)).round().long()
    residuals = [
        _residual(clip, chosen_part, vertices, weights, at_bind.frames) for chosen_part in chosen.split(_FRAMES_AT_ONCE)
    ]
    residual = torch.cat([part.flatten(1) for part in residuals])
    targets = _targets(residual, bound, max_targets)
    found, error, linear_error = [], 0.0, 0.0
    for part in torch.arange(len(clip)).split(_FRAMES_AT_ONCE):
        residual = _residual(clip, part, vertices, weights, at_bind.frames).flatten(1)
        fraction = residual @ targets.T
        rest = (residual - fraction @ targets).unflatten(1, (-1, 3))
        blended = _blend(clip, part, weights, at_bind.frames)
        error = max(error, _largest(blended @ rest[..., None]))
        linear_error = max(linear_error, _largest(blended @ residual.unflatten(1, (-1, 3))[..., None]))
        found.append(fraction)
    targets, target_weights = _one_sided(targets, torch.cat(found))
    return LinearSkin(
        vertices=vertices,
        bind=at_bind.frames,
        weights=weights,
        targets=targets.unflatten(1, (-1, 3)),
        target_weights=target_weights,
        error=error,
        linear_error=linear_error,
    )


def _blend(clip: MotionClip, index: Tensor, weights: Tensor, bind: HandFrames) -> Float64[Tensor, "n vertices 3 3"]:
    """Blended rotations of every vertex."""
    turns = clip.frames.rotation[index] @ bind.rotation.mT
    return torch.einsum("vb,nbij->nvij", weights, turns)


def _residual(
    clip: MotionClip, index: Tensor, vertices: Tensor, weights: Tensor, bind: HandFrames
) -> Float64[Tensor, "n vertices 3"]:
    """What has to be added to each vertex before blending for it to come where our skin has it."""
    turns = clip.frames.rotation[index] @ bind.rotation.mT
    shifts = clip.frames.position[index] - (turns @ bind.position[..., None]).squeeze(-1)
    blended = _blend(clip, index, weights, bind)
    linear = (blended @ vertices[..., None]).squeeze(-1) + weights @ shifts
    residual = clip.hand(clip.poses[index], clip.shape).vertices - linear
    return torch.linalg.solve(blended, residual[..., None]).squeeze(-1)


def _targets(residual: Float64[Tensor, "n m"], bound: float, max_targets: int) -> Float64[Tensor, "targets m"]:
    """Orthonormal rows; as few as leave no vertex of any frame off by more than the bound."""
    left = residual.clone()
    if not max_targets or float(_norms(left).max()) <= bound:
        return residual[:0]
    _, _, directions = torch.linalg.svd(residual, full_matrices=False)
    for count, direction in enumerate(directions[:max_targets], start=1):
        left -= (left @ direction)[:, None] * direction
        if float(_norms(left).max()) <= bound:
            return directions[:count]
    return directions[:max_targets]


def _one_sided(
    targets: Float64[Tensor, "n m"], weights: Float64[Tensor, "frames n"]
) -> tuple[Float64[Tensor, "targets m"], Float64[Tensor, "frames targets"]]:
    """The same sums with weights from 0 to 1, to which players clamp them: a target for either sign that is used."""
    both, sides = torch.cat((targets, -targets)), torch.cat((weights, -weights), 1).clamp(min=0)
    both = both * sides.amax(0)[:, None]
    used = (both.abs().amax(1) > _NEGLIGIBLE).nonzero().squeeze(-1) if len(both) else both.new_zeros(0).long()
    return both[used], (sides / sides.amax(0).clamp(min=1e-12))[:, used]


def _norms(flat: Tensor) -> Tensor:
    return flat.unflatten(1, (-1, 3)).norm(dim=-1)


def _largest(column: Float64[Tensor, "n vertices 3 1"]) -> float:
    return float(column.squeeze(-1).norm(dim=-1).max())
