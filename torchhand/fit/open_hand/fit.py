"""Shape and first pose of a hand from one picture of it open (paper 000, sections 6.2 and 7.1).

The digits are measured, the unknowns placed by them, and the model's outline registered on the silhouette's, all under
what is known of people's hands. Then the digits of the model's own silhouette are measured in the same way, which tells
what the measuring adds by itself, and the outline is registered once more. Given the picture, its shading is used where
one light explains it (open_hand_shading_fit), which tells where the joints are. Hand length is that of the mean person;
`sized` of the module hand_size gives the hand a metric size.
"""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.fit import mask_plane
from torchhand.fit.detect import Fit, fit_overlap
from torchhand.fit.open_hand.contour import OutlineFit, fit_outline
from torchhand.fit.open_hand.edges import Outline
from torchhand.fit.open_hand.problem import OpenHandProblem
from torchhand.fit.open_hand.settings import OpenHandSettings
from torchhand.fit.open_hand.shading_fit import ShadingFit, fit_shading
from torchhand.fit.open_hand.soft import soft_silhouette
from torchhand.fit.open_hand.start import DigitResiduals, fit_digits, placed_open_hand
from torchhand.geometry import Camera
from torchhand.hand import DOFS, Anthropometry, HandKinematics, ShapeSpace, rebased
from torchhand.image import HandRegions, NoRegions, divide_hand, gaussian_blur
from torchhand.view import HandProjector

Facing = Literal["palm", "back"]

_SOFT_BLUR_PX = 0.7  # of a silhouette that is soft by itself


@dataclass(frozen=True, kw_only=True)
class OpenHand:
    """A hand fitted to one picture of it open."""

    fit: Fit
    regions: HandRegions
    facing: Facing
    """Side of the hand that the camera sees."""
    overlap: float
    """Intersection over union of the fitted hand and the silhouette, forearm cut at the wrist."""
    edge_std_px: float
    """What one edge of the outline was trusted to, px."""
    is_shaded: bool
    """Whether the shading was used."""
    corrected: tuple[str, ...]
    """Measures that the anthropometric constraints moved into their intervals."""


def facing_of(side: str, is_mirrored: bool) -> Facing:
    """Which side of a hand the camera sees, by the thumb's place: on the left of upright fingers, or mirrored."""
    return "palm" if is_mirrored == (side == "right") else "back"


def fit_open_hand(
    mask: Bool[Tensor, "height width"],
    kinematics: HandKinematics,
    camera: Camera,
    settings: OpenHandSettings | None = None,
    *,
    image: UInt8[Tensor, "height width 3"] | None = None,
) -> OpenHand | NoRegions:
    """Measures the digits of a silhouette and fits pose and shape; or says why it shows no open hand.

    The camera's frame is the world. With the picture itself, shading is used too where it is as simple as the model's.
    """
    settings = settings or OpenHandSettings()
    regions = divide_hand(mask)
    if isinstance(regions, NoRegions):
        return regions
    people = Anthropometry(kinematics.shape_space)
    facing = facing_of(kinematics.side, regions.is_mirrored)
    pose, root_reference = placed_open_hand(regions, kinematics, camera, facing)
    problem = OpenHandProblem.about(kinematics, people, pose)
    digits = DigitResiduals(regions, problem, kinematics, camera, root_reference, settings)

    def outline_of(plane: Float[Tensor, "height width"]) -> Outline:
        return Outline(plane, problem, kinematics, camera, root_reference, settings)

    outline = outline_of(mask_plane(regions.mask))
    found = fit_outline(outline, problem, fit_digits(digits, problem), settings, digits=digits)
    if found is not None:
        pose, shape = problem.split(found.values)
        drawn = divide_hand(HandProjector(kinematics, camera, shape).silhouette(pose, root_reference))
        if isinstance(drawn, HandRegions):
            digits = digits.corrected(found.values, drawn)
            sure = replace(
                settings,
                digit_share=settings.corrected_share,
                iterations=settings.more_iterations,
                search_share=settings.final_search_share,
            )
            found = fit_outline(outline, problem, found.values, sure, digits=digits)
    if found is None:
        return NoRegions(
            reason="the fitted hand has hardly any edge in the picture", found=tuple(d.name for d in regions.digits)
        )
    shaded: ShadingFit | None = None
    if image is not None:
        soft = soft_silhouette(image, regions.mask)
        shaded = fit_shading(
            image,
            regions.mask,
            camera,
            problem,
            kinematics,
            root_reference,
            found.values,
            outline if soft is None else outline_of(_smoothed(soft)),
            settings,
        )
    if shaded is not None:
        found = OutlineFit(
            values=shaded.values,
            covariance=shaded.covariance,
            residual_px=shaded.outline.residual_px,
            found_share=shaded.outline.found_share,
            edge_std_px=shaded.outline.edge_std_px,
        )
    pose, shape = problem.split(found.values)
    broken = people.violation(shape)
    std = found.covariance.diagonal().clamp_min(0).sqrt() * problem.std
    count = len(problem.free_pose)
    pose_std = torch.zeros(len(DOFS), dtype=pose.dtype).index_copy(0, problem.free_pose, std[:count])
    shape_std = torch.zeros_like(shape).index_copy(0, problem.free_shape, std[count:])
    shape, shape_std = _with_thickness(kinematics.shape_space, people.project(shape), shape_std)
    flat, reference = rebased(pose, root_reference)
    fit = Fit(
        pose=flat,
        root_reference=reference,
        shape=shape,
        pose_std=pose_std,
        shape_std=shape_std,
        residual_px=found.residual_px,
        found_share=found.found_share,
    )
    return OpenHand(
        fit=fit,
        regions=regions,
        facing=facing,
        overlap=fit_overlap(regions.mask, kinematics, camera, fit),
        edge_std_px=found.edge_std_px,
        is_shaded=shaded is not None,
        corrected=tuple(
            name for name, amount in zip(broken.names, broken.amount.tolist(), strict=True) if amount > 1e-6
        ),
    )


def _smoothed(plane: Float[Tensor, "height width"]) -> Float[Tensor, "height width"]:
    return gaussian_blur(plane, _SOFT_BLUR_PX)


def _with_thickness(space: ShapeSpace, shape: Tensor, std: Tensor) -> tuple[Tensor, Tensor]:
    """The palm as thick as the thumb, by the rule of paper 000, section 6.2: the picture shows no thickness."""
    palm, thumb = space.names.index("palm_thickness"), space.names.index("thumb_mcp_radius")
    shape, std = shape.clone(), std.clone()
    shape[palm] = (2 * shape[thumb]).clamp(space.lower[palm], space.upper[palm])
    std[palm] = torch.hypot(2 * std[thumb], space.std[palm])
    return shape, std
