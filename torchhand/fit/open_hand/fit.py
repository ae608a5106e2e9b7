"""Shape and first pose of a hand from one picture of it open (Ouhaddi and Horain 1998, sections 6.2 and 7.1).

The digits are measured, the unknowns placed by them, and the model's outline registered on the silhouette's, all under
what is known of people's hands. Then the digits of the model's own silhouette are measured in the same way, which tells
the bias of the measurement, and the outline is registered once more. Hand length is that of the mean person; `sized` of
the module hand_size gives the hand a metric size.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Bool
from torch import Tensor

from torchhand.devices import HOST, sent_to
from torchhand.fit import Observation, Problem, Schedule, SharedSolution, Stage, mask_plane, solve_shared
from torchhand.fit.contour import EdgeObservation
from torchhand.fit.detect import Fit, fit_overlap
from torchhand.fit.open_hand.digits import DigitObservation
from torchhand.fit.open_hand.problem import open_hand_problem
from torchhand.fit.open_hand.start import placed_open_hand
from torchhand.geometry import Camera
from torchhand.hand import Anthropometry, HandKinematics, HandPose, ShapeSpace
from torchhand.image import HandRegions, NoRegions, PicturePart, divide_hand
from torchhand.view import HandProjector, PrimitiveContours, outline_table

Facing = Literal["palm", "back"]

_POINTS_PER_GENERATOR, _POINTS_PER_ARC = 10, 8  # on each straight side of a primitive and on each round end
_EDGE_STD_M = 0.00094  # standard deviation of the surface: surfaces differ, and neighbours alike
_BIASED_TRUST = 0.15  # factor on the digits' residuals before they are corrected
_ON_DIGITS = (Stage(rounds=1, iterations=15),)
_ON_BIASED, _ON_EDGES = (
    (Stage(gross_m=0.00168, rounds=rounds, iterations=2, method="gauss_newton"),) for rounds in (2, 3)
)


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
    population, start = Anthropometry(kinematics.shape_space), placed_open_hand(regions, kinematics, camera, facing)
    problem = open_hand_problem(kinematics, population, start)
    found = _registered(regions, problem, start, HandProjector(kinematics, camera))
    if not math.isfinite(found.residual_px):
        return NoRegions(
            reason="the fitted hand has hardly any edge in the picture", found=tuple(d.name for d in regions.digits)
        )
    found = sent_to(found, HOST)
    broken, fit = population.violation(found.shape), _feasible(found, population)
    return OpenHand(
        fit=fit,
        regions=regions,
        facing=facing,
        overlap=fit_overlap(regions.mask, kinematics.on(HOST), camera.to(device=HOST), fit),
        corrected=tuple(
            name for name, amount in zip(broken.names, broken.amount.tolist(), strict=True) if amount > 1e-6
        ),
    )


def _registered(regions: HandRegions, problem: Problem, start: HandPose, projector: HandProjector) -> Fit:
    """Digits, outline, digits freed of the measurement's bias together with the outline."""
    kinematics, camera, device = projector.kinematics, projector.camera, start.dofs.device
    digits = DigitObservation.of(regions, kinematics, camera)
    table = sent_to(outline_table(_POINTS_PER_GENERATOR, _POINTS_PER_ARC, without=("palm_wrist",)), device)
    edges = EdgeObservation(
        plane=mask_plane(regions.mask).to(device),
        contours=PrimitiveContours(projector, table),
        std_m=_EDGE_STD_M,
    )

    def solved(before: SharedSolution | None, schedule: Schedule, *observations: Observation) -> SharedSolution:
        shape, pose = (problem.shape, start.reshape(1)) if before is None else (before.shape, before.pose)
        return solve_shared(replace(problem, shape=shape, observations=observations), pose, schedule)

    placed = solved(None, _ON_DIGITS, digits)
    first = solved(placed, _ON_BIASED, edges, replace(digits, trust=_BIASED_TRUST))
    fit = Fit.of_solution(first, problem)
    own = HandProjector(kinematics, camera, fit.shape)
    drawn = divide_hand(own.silhouette(fit.pose, fit.root_reference).to(HOST))
    if isinstance(drawn, NoRegions) or not math.isfinite(fit.residual_px):
        return fit
    digits = digits.corrected(first.pose[0], first.shape, drawn)
    return Fit.of_solution(solved(first, _ON_EDGES, edges, digits), problem)


def _feasible(fit: Fit, population: Anthropometry) -> Fit:
    """The fit with its shape put into the anthropometric constraints, the palm as thick as the thumb."""
    shape, std = _with_thickness(population.space, population.project(fit.shape), fit.shape_std)
    return replace(fit, shape=shape, shape_std=std)


def _with_thickness(space: ShapeSpace, shape: Tensor, std: Tensor) -> tuple[Tensor, Tensor]:
    """The palm as thick as the thumb (Ouhaddi and Horain 1998, section 6.2): the picture shows no thickness."""
    palm, thumb = space.names.index("palm_thickness"), space.names.index("thumb_mcp_radius")
    shape, std = shape.clone(), std.clone()
    shape[palm] = (2 * shape[thumb]).clamp(space.lower[palm], space.upper[palm])
    std[palm] = torch.hypot(2 * std[thumb], space.std[palm])
    return shape, std
