"""The edge of a silhouette as a measurement of an open hand, with a noise that the residuals tell.

The measurement is the tracker's: edges along the normals of the model's contour. The noise is estimated: neighbouring
residuals that agree count as one, so a surface unlike the model's leaves the prior in charge, while sharp pictures of a
hand like the model's let faint changes of taper tell where the joints are.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit.contour import hand_length_px, is_outer
from torchhand.fit.open_hand.problem import OpenHandProblem
from torchhand.fit.open_hand.settings import OpenHandSettings
from torchhand.geometry import Camera
from torchhand.hand import CONE_NAMES, ELLIPSOID_NAMES, FINGERS, HandKinematics
from torchhand.image import (
    EdgeSettings,
    depth_map,
    distance_map,
    gaussian_blur,
    gradient,
    sample_bilinear,
    search_edges,
)
from torchhand.numerics import NormalEquations
from torchhand.view import HandProjector, OutlineTable, outline_table

_STEP = 1e-4  # of the numerical derivative, prior standard deviations
_FEWEST_POINTS = 30
_ROUGH_STD = 1.5  # px of an edge while the residuals do not tell yet
_MOST_CORRELATED = 0.95
_FEWEST_PAIRS = 8
_LEAST_SEARCH_PX = 4.0
_LEAST_COSINE = 0.7  # between the contour's normal and the edge's
_ASTRAY_WEIGHT = 0.3  # of a point outside the silhouette without an edge of its own
_EDGE_BLUR_PX = 1.5
_FROM_MASK = EdgeSettings(polarity="inside_bright", min_strength=0.15, choose="nearest")


@dataclass(frozen=True, kw_only=True)
class OutlineTerm:
    """Edges found from given values as normal equations: the cost falls by pull · d - ½ dᵀ information d."""

    values: Float[Tensor, "n"]
    """Where they were looked for."""
    information: Float[Tensor, "n n"]
    pull: Float[Tensor, "n"]
    residual_px: float
    found_share: float
    edge_std_px: float
    distance: Callable[[Tensor], Tensor]
    """Of the edges from the same points of the contour at other values (n) -> (points), px along the normals."""
    jacobian: Float[Tensor, "points n"]
    """Of those points along their normals, at `values`."""
    weight: Float[Tensor, "points"]

    def equations(self, values: Float[Tensor, "n"]) -> NormalEquations:
        """The cost at other values: there the contour's points are moved, but edges and derivative stay.

        What a linear model would miss is that a finger that bends gets shorter in the picture.
        """
        distance = self.distance(values)
        pull = self.weight * distance
        cost = 0.5 * (pull * distance).sum()
        return NormalEquations(matrix=self.information, gradient=-(self.jacobian.T @ pull), cost=cost)


class Outline:
    """The edge of a silhouette as a measurement of the scaled unknowns."""

    def __init__(
        self,
        plane: Float[Tensor, "height width"],
        problem: OpenHandProblem,
        kinematics: HandKinematics,
        camera: Camera,
        root_reference: Float[Tensor, "3 3"],
        settings: OpenHandSettings,
    ) -> None:
        """`plane` is the silhouette, smoothed, 1 inside.

        The picture's own edges would be sharper, but limbs are shaded: they lie up to half a pixel inside.
        """
        self._plane, self._problem, self._kinematics, self._camera = plane, problem, kinematics, camera
        self._root_reference, self._settings = root_reference, settings
        self._table = outline_table(settings.points_per_generator, settings.points_per_arc, without=("palm_wrist",))
        self._slopes = _slopes(plane)
        self._inside_by, self._slopes_of_depth = _depth(plane)

    def term(self, values: Float[Tensor, "n"], share: float, *, is_fine: bool) -> "OutlineTerm | None":
        """What the edges within `share` of the hand's length say at these values; None where hardly any is found.

        Fine ones are trusted as far as their residuals agree, others to a pixel or two.
        """
        settings, problem, table, plane = self._settings, self._problem, self._table, self._plane
        pose, shape = problem.split(values)
        projector = HandProjector(self._kinematics, self._camera, shape)
        contour = projector.contour(pose, self._root_reference, table)
        length_px = hand_length_px(self._camera, self._kinematics, pose, shape)
        keep = contour.visible & is_outer(
            projector.silhouette(pose, self._root_reference), contour.points_px, contour.normals, length_px
        )
        count = int(keep.sum())
        if count < _FEWEST_POINTS:
            return None
        reach = max(share * length_px, _LEAST_SEARCH_PX)
        points, normals = contour.points_px[keep], contour.normals[keep]
        search = torch.full((count,), reach, dtype=values.dtype)
        seen = search_edges(plane, points, normals, _FROM_MASK, half_length_px=search)
        offset = seen.offset_px
        found = seen.found & _faces(self._slopes, points + offset[:, None] * normals, normals)
        # What has no edge of its own goes back into the silhouette by the shortest way.
        depth = sample_bilinear(self._inside_by, points)[0].to(values)
        is_astray = ~found & (depth < -1.0)
        inwards = _unit(sample_bilinear(self._slopes_of_depth, points).T.to(values))
        normals = torch.where(is_astray[:, None], -inwards, normals)
        offset = torch.where(is_astray, depth, offset)
        chosen = table.select(keep)
        jacobian = _jacobian(problem, self._kinematics, self._camera, self._root_reference, chosen, values, normals)
        scale = 0.3 * reach
        weight = (found | is_astray) / (1 + (offset / scale) ** 2) ** 2 / seen.candidates.clamp_min(1)
        weight = torch.where(is_astray, _ASTRAY_WEIGHT / (1 + depth.abs() / scale), weight)
        if is_fine:
            most = max(settings.most_edge_std * length_px, settings.least_edge_std_px)
            std = _noise(offset, weight * found, chosen, settings.least_edge_std_px, most)
        else:
            std = torch.full_like(offset, _ROUGH_STD)
        weight = weight / std**2
        edges = points + offset[:, None] * normals

        def distance(values: Tensor) -> Tensor:
            pose, shape = problem.split(values)
            projector = HandProjector(self._kinematics, self._camera, shape)
            return ((edges - projector.outline_px(pose, self._root_reference, chosen)) * normals).sum(-1)

        return OutlineTerm(
            values=values,
            information=jacobian.T @ (weight[:, None] * jacobian),
            pull=jacobian.T @ (weight * offset),
            residual_px=float(offset[found].abs().median()) if bool(found.any()) else float("inf"),
            found_share=float(found.double().mean()),
            edge_std_px=float(std.median()),
            distance=distance,
            jacobian=jacobian,
            weight=weight,
        )


def _depth(plane: Float[Tensor, "height width"]) -> tuple[Tensor, Tensor]:
    """How deep every pixel lies in the silhouette, px, negative outside, and its gradient."""
    inside = plane >= 0.5
    depth = torch.where(inside, depth_map(inside) - 0.5, 0.5 - distance_map(inside))
    return depth[None], gradient(depth)


def _unit(vector: Float[Tensor, "points 2"]) -> Float[Tensor, "points 2"]:
    return vector / vector.norm(dim=-1, keepdim=True).clamp_min(1e-9)


def _slopes(plane: Float[Tensor, "height width"]) -> Float[Tensor, "2 height width"]:
    """Outward direction of the silhouette's edge, not of unit length, some pixels to both sides of it."""
    return -gradient(gaussian_blur(plane, _EDGE_BLUR_PX))


def _faces(
    slopes: Float[Tensor, "2 height width"], points: Float[Tensor, "points 2"], normals: Float[Tensor, "points 2"]
) -> Bool[Tensor, "points"]:
    """Whether the silhouette's edge at a point runs as the contour does: else it is another part's."""
    outward = sample_bilinear(slopes, points).T.to(normals)
    return (outward * normals).sum(-1) > _LEAST_COSINE * outward.norm(dim=-1)


def _jacobian(
    problem: OpenHandProblem,
    kinematics: HandKinematics,
    camera: Camera,
    root_reference: Tensor,
    table: OutlineTable,
    values: Tensor,
    normals: Float[Tensor, "points 2"],
) -> Float[Tensor, "points n"]:
    """Change of the contour points along their normals with the unknowns, px, by forward differences."""
    steps = _STEP * torch.eye(problem.size, dtype=values.dtype)
    poses, shapes = problem.split(torch.cat((values[None], values + steps)))
    points = HandProjector(kinematics, camera, shapes).outline_px(poses, root_reference, table)
    return torch.einsum("npi,pi->pn", points[1:] - points[0], normals) / _STEP


def _noise(
    offset: Float[Tensor, "points"], weight: Float[Tensor, "points"], table: OutlineTable, least: float, most: float
) -> Float[Tensor, "points"]:
    """Standard deviation of every edge, one for each digit and one for the palm.

    Residuals on one side of a bone that err alike tell less: with correlation ρ between neighbours, n of them as much
    as n (1 - ρ) / (1 + ρ) independent ones.
    """
    run = 2 * table.primitive
    run[: len(table.cone)] += table.cone_side
    part = _PARTS[table.primitive]
    std = torch.full_like(offset, most)
    for number in part.unique():
        mine = part == number
        own, trust, side = offset[mine], weight[mine], run[mine]
        power = float((trust * own.square()).sum() / trust.sum().clamp_min(1e-12))
        is_pair = (side[1:] == side[:-1]) & (trust[1:] > 0) & (trust[:-1] > 0)
        if int(is_pair.sum()) < _FEWEST_PAIRS or power <= 0:
            continue
        together = (trust[1:] * trust[:-1])[is_pair].sqrt()
        shared = float((together * own[1:][is_pair] * own[:-1][is_pair]).sum() / together.sum())
        correlation = min(max(shared / power, 0.0), _MOST_CORRELATED)
        std[mine] = min(max((power * (1 + correlation) / (1 - correlation)) ** 0.5, least), most)
    return std


_PARTS = torch.tensor(
    [
        next((i for i, finger in enumerate(FINGERS, 1) if name.startswith(finger) and not name.endswith("_mcp")), 0)
        for name in (*CONE_NAMES, *ELLIPSOID_NAMES)
    ]
)
"""Of every primitive: 1 to 5 thumb to little, 0 the palm with the knuckles and their webs."""
