"""What of the silhouettes the skin must explain, as an observation: their edges, or else the surface of their hull.

Every ray through a silhouette's edge touches the hand. Where the edges are not known, the hull's surface should be on
the skin, with less weight: a visual hull is larger than the hand where no camera looks in between two fingers or behind
the palm, so points far from all skin must count for little.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit import Equations, Explained, PosedHands, Stage
from torchhand.fit.hull.nearest import match_hull
from torchhand.fit.hull.shape_rows import shape_rows
from torchhand.fit.hull.skin import PosedBones, SkinPoints, WeightedVertices, bones_of, skin_at
from torchhand.fit.hull.target import HullTarget
from torchhand.fit.hull.vertices import SkinVertices
from torchhand.numerics import RobustLoss

NAME = "edges"
TURN_M = 0.012
"""Distance that a turn of the surface by one radian is worth in matching, metres."""
_BESIDE = 0.008  # metres along the surface to the nearest vertex, beyond which there is no skin


@dataclass(frozen=True, kw_only=True)
class CoverageObservation:
    """The edges of all silhouettes, or the surface of the hull where they are not known."""

    target: HullTarget
    vertices: SkinVertices

    @property
    def is_empty(self) -> bool:
        return self.target.is_empty

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "CoverageObservation":
        """This observation itself, which all hypotheses have in common."""
        return self

    def associate(self, hands: PosedHands, stage: Stage) -> "CoverageFactor":
        """The vertex of each hand that belongs to each ray or point of the surface."""
        s, skin = self.vertices.settings, self.vertices.skin.for_shape(hands)
        bones, vertices = bones_of(skin, hands), skin_at(skin, hands)
        matched = self._matched(vertices, skin.normals(vertices))
        across, beside = matched.distances()
        distance = torch.where(beside > _BESIDE, torch.inf, across)
        is_hand = _is_hand(matched.data_places, bones, s.beyond_wrist_m)
        count = is_hand.sum(-1, keepdim=True).clamp_min(1)
        worth = s.surface_weight if self.target.rays is None else s.edge_weight
        return CoverageFactor(
            skin=self.vertices.skin,
            match=matched.match,
            vertices=self.vertices.skin.weighted(matched.match),
            points=matched.points,
            normals=matched.normals,
            weight=worth * s.precision(stage) / count * is_hand * self.vertices.rigidity[matched.match],
            robust=RobustLoss(kind="geman_mcclure", scale=stage.gross_m),
            explanation=Explained(
                name=NAME,
                view=None,
                fraction=((distance <= s.near_m) * is_hand).sum(-1) / count[:, 0],
                distance=(distance.clamp_max(stage.gross_m) * is_hand).sum(-1) / count[:, 0],
            ),
        )

    def _matched(self, vertices: Tensor, skin_normals: Tensor) -> "_Matched":
        target = self.target
        if target.rays is None:
            points = target.points.to(vertices)
            match = match_hull(points, target.normals.to(vertices), vertices, skin_normals, turn=TURN_M)
            index = match[..., None].expand(-1, -1, 3)
            return _Matched(
                match=match,
                places=vertices.gather(1, index),
                points=points,
                data_places=points.expand(len(vertices), -1, -1),
                normals=skin_normals.gather(1, index),
            )
        match = target.rays.match(vertices, skin_normals, turn=TURN_M)
        places = vertices.gather(1, match[..., None].expand(-1, -1, 3))
        return _Matched(
            match=match,
            places=places,
            points=target.rays.points.to(vertices),
            data_places=target.rays.nearest_to(places),
            normals=target.rays.normals.to(vertices).expand_as(places),
        )


@dataclass(frozen=True, kw_only=True)
class _Matched:
    """Rays or points of the surface, and the vertices of some hands that belong to them."""

    match: Int[Tensor, "k data"]
    places: Float[Tensor, "k data 3"]
    """Places of the matched vertices."""
    points: Float[Tensor, "data 3"]
    """Any point of each ray, or the point of the surface."""
    data_places: Float[Tensor, "k data 3"]
    """The point of each ray beside its vertex, or the point of the surface."""
    normals: Float[Tensor, "k data 3"]
    """Across the rays, or of the skin at the vertices."""

    def distances(self) -> tuple[Float[Tensor, "k data"], Float[Tensor, "k data"]]:
        """Distances of the data from the vertices: across the surface and along it, metres."""
        away = self.places - self.data_places
        across = (self.normals * away).sum(-1).abs()
        return across, (away.square().sum(-1) - across.square()).clamp_min(0).sqrt()


def _is_hand(points: Float[Tensor, "k data 3"], bones: PosedBones, beyond_wrist_m: float) -> Float[Tensor, "k data"]:
    """1 for points on the fingers' side of the wrist, 0 beyond it: there may be a forearm, which the model has not."""
    height = ((points - bones.position[:, :1]) * bones.rotation[:, :1, :, 1]).sum(-1)
    return (height > -beyond_wrist_m).to(points)


@dataclass(frozen=True, kw_only=True)
class CoverageFactor:
    """½ Σ weight ρ(normal · (skin - data)), ρ of Geman and McClure; a row per hand. The skin is free to slide."""

    skin: SkinPoints
    """Skin of the shape that is held fixed or, where the shape is unknown, was the start."""
    match: Int[Tensor, "k data"]
    """The vertex of each datum."""
    vertices: WeightedVertices
    """Vertices of the skin."""
    points: Float[Tensor, "data 3"]
    normals: Float[Tensor, "k data 3"]
    weight: Float[Tensor, "k data"]
    """Inverse variances, m⁻²."""
    robust: RobustLoss
    explanation: Explained

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in the DOFs, and in the shape where it is unknown."""
        skin = self.skin.for_shape(hands)
        vertices = self.vertices if skin is self.skin else skin.weighted(self.match)
        motion = skin.motion(bones_of(skin, hands), vertices)
        residual = (self.normals * (motion.points - self.points)).sum(-1)
        cost, weight = self.robust.each(residual)
        shared = None
        if hands.unknowns is not None:
            shared = shape_rows(skin, hands, self.match, self.normals)
        return Equations.of_rows(
            residual,
            self.weight * weight,
            motion.along(self.normals),
            (self.weight * cost).sum(-1),
            shared=shared,
        )

    def rows(self, rows: Int[Tensor, "n"]) -> "CoverageFactor":
        """The rows of some of the hands."""
        return replace(
            self,
            match=self.match[rows],
            vertices=self.vertices.rows(rows),
            normals=self.normals[rows],
            weight=self.weight[rows],
            explanation=self.explanation.rows(rows),
        )

    def explained(self) -> tuple[Explained, ...]:
        """Share of the edges (or of the surface) with skin nearby, and their mean distance from it."""
        return (self.explanation,)
