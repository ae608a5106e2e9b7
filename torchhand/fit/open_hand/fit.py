"""Shape and first pose of a hand from one picture of it open (Ouhaddi and Horain 1998, sections 6.2 and 7.1).

The digits are measured, the unknowns placed by them, and the model's outline registered on the silhouette's, all under
what is known of people's hands. Then the digits of the model's own silhouette are measured in the same way, which tells
the bias of the measurement, and the outline is registered once more. Hand length is that of the mean person; `sized` of
the module hand_size gives the hand a metric size.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool
from torch import Tensor

from torchhand.devices import HOST, sent_to
from torchhand.fit import mask_plane
from torchhand.fit.detect import Fit, fit_overlap
from torchhand.fit.open_hand.contour import OutlineFit, fit_outline
from torchhand.fit.open_hand.problem import OpenHandProblem
from torchhand.fit.open_hand.start import DigitResiduals, fit_digits, placed_open_hand
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, ShapeSpace, rebased
from torchhand.image import HandRegions, NoRegions, PicturePart, divide_hand

Facing = Literal["palm", "back"]

_ROUNDS, _CORRECTED_ROUNDS = 2, 3  # of matching and fitting the outline, before and after digits are corrected
_BIASED_WEIGHT = 0.15  # of the digits' residuals before


@dataclass(frozen=True, kw_only=True)
class OpenHand:
    """A hand fitted to one picture of it open."""

    fit: Fit
    regions: HandRegions
    facing: Facing
    """Side of the hand that the camera sees."""
    overlap: float
    """Intersection over union of the fitted hand and the silhouette, forearm cut at the wrist."""
    corrected: tuple[str, ...]
    """Measures that the anthropometric constraints moved into their intervals."""
    part: PicturePart | None = None
    """Part of a large picture in whose pixels `regions` are; None: the whole picture."""


def facing_of(side: str, is_mirrored: bool) -> Facing:
    """Which side of a hand the camera sees, by the thumb's place: on the left of upright fingers, or mirrored."""
    return "palm" if is_mirrored == (side == "right") else "back"


def fit_open_hand(
    mask: Bool[Tensor, "height width"], kinematics: HandKinematics, camera: Camera
) -> OpenHand | NoRegions:
    """Measures the digits of a silhouette and fits pose and shape; or says why it shows no open hand.

    The camera's frame is the world. The fit is made on the device of the kinematics; digits are measured on the
    processor, and all that comes back is there.
    """
    device = kinematics.default_shape.device
    camera = camera.to(device=device)
    regions = divide_hand(mask.to(HOST))
    if isinstance(regions, NoRegions):
        return regions
    facing = facing_of(kinematics.side, regions.is_mirrored)
    problem = OpenHandProblem.about(kinematics, camera, *placed_open_hand(regions, kinematics, camera, facing))
    found = _registered(regions, problem)
    if found is None:
        return NoRegions(
            reason="the fitted hand has hardly any edge in the picture", found=tuple(d.name for d in regions.digits)
        )
    broken = problem.population.violation(problem.split(found.values)[1].to(HOST))
    fit = sent_to(_as_fit(found, problem), HOST)
    return OpenHand(
        fit=fit,
        regions=regions,
        facing=facing,
        overlap=fit_overlap(regions.mask, kinematics.on(HOST), camera.to(device=HOST), fit),
        corrected=tuple(
            name for name, amount in zip(broken.names, broken.amount.tolist(), strict=True) if amount > 1e-6
        ),
    )


def _registered(regions: HandRegions, problem: OpenHandProblem) -> OutlineFit | None:
    """Digits, outline, digits freed of the measurement's bias together with the outline."""
    plane, digits = mask_plane(regions.mask).to(problem.std.device), DigitResiduals(regions, problem)
    start = fit_digits(digits, problem)
    first = fit_outline(plane, digits, problem, start, rounds=_ROUNDS, digit_weight=_BIASED_WEIGHT)
    if first is None:
        return None
    projector, pose = problem.projected(first.values)
    drawn = divide_hand(projector.silhouette(pose, problem.root_reference).to(HOST))
    if isinstance(drawn, NoRegions):
        return first
    digits = digits.corrected(first.values, drawn)
    return fit_outline(plane, digits, problem, first.values, rounds=_CORRECTED_ROUNDS, digit_weight=1.0)


def _as_fit(found: OutlineFit, problem: OpenHandProblem) -> Fit:
    """Pose and feasible shape with their standard deviations."""
    pose, shape = problem.split(found.values)
    std = found.covariance.diagonal().clamp_min(0).sqrt() * problem.std
    count = len(problem.free_pose)
    pose_std = torch.zeros_like(pose).index_copy(0, problem.free_pose, std[:count])
    shape_std = torch.zeros_like(shape).index_copy(0, problem.free_shape, std[count:])
    shape, shape_std = _with_thickness(
        problem.population.space, problem.population.project(shape.to(HOST)), shape_std.to(HOST)
    )
    flat, reference = rebased(pose, problem.root_reference)
    return Fit(
        pose=flat,
        root_reference=reference,
        shape=shape,
        pose_std=pose_std,
        shape_std=shape_std,
        residual_px=found.edges.residual_px,
        found_fraction=found.edges.found_fraction,
    )


def _with_thickness(space: ShapeSpace, shape: Tensor, std: Tensor) -> tuple[Tensor, Tensor]:
    """The palm as thick as the thumb (Ouhaddi and Horain 1998, section 6.2): the picture shows no thickness."""
    palm, thumb = space.names.index("palm_thickness"), space.names.index("thumb_mcp_radius")
    shape, std = shape.clone(), std.clone()
    shape[palm] = (2 * shape[thumb]).clamp(space.lower[palm], space.upper[palm])
    std[palm] = torch.hypot(2 * std[thumb], space.std[palm])
    return shape, std
