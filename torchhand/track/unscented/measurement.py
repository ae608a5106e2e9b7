"""One measurement update of the contour tracker: project, search edges along the normals, correct (paper 003, 4.3)."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.contour import hand_length_px, is_in_picture, is_outer
from torchhand.geometry import Camera
from torchhand.hand import PoseSpace, Skeleton
from torchhand.image import search_edges
from torchhand.numerics import observed_points, update
from torchhand.track import ContourTrackerSettings, Measured, PosturePrior, Rebasing, SeenContour, TrackerState
from torchhand.view import HandProjector, OutlineTable

_FEWEST_POINTS = 10
_LEAST_SEARCH_PX = 4.0
_WIDENING = 0.5  # the search grows by this share with every failed frame
_INNER_REACH = 0.6  # half length of the search for inner edges over that for outer ones


@dataclass(frozen=True, kw_only=True)
class Planes:
    """The pictures in which edges are searched, 0..1."""

    outer: Float[Tensor, "height width"]
    """For the silhouette."""
    inner: Float[Tensor, "height width"] | None
    """For parts of the hand before others; None leaves those out."""


@dataclass(frozen=True, kw_only=True)
class ContourMeasurement:
    """What all measurement updates of one tracker share."""

    settings: ContourTrackerSettings
    camera: Camera
    """At the world's origin."""
    space: PoseSpace
    table: OutlineTable
    prior: PosturePrior
    skeleton: Skeleton

    def update(
        self, state: TrackerState, projector: HandProjector, planes: Planes, before: SeenContour | None = None
    ) -> Measured:
        """Corrects a predicted state; the pose stays within the joint limits.

        `before` is what an earlier pass over the same picture saw of the contour, which is then not judged again.

        Where fewer than ten visible contour points lie in the picture, the state comes back as it is with all shares 0.
        """
        s, camera = self.settings, self.camera
        count = self.space.size
        space = self.space.about(state.base)
        # The centre of the sigma points is the reference hand: all are placed at once.
        candidates = observed_points(state.belief, s.unscented, count)
        poses = space.dof(candidates)
        pose = poses[0]
        hands = projector.primitives_cam(projector.frames(poses, state.reference))
        cones, arcs = projector.generators_of(hands)
        primitives = replace(hands, rotation=hands.rotation[0], position=hands.position[0])
        own = (cones.of_hand(0), arcs.of_hand(0))
        contour = projector.contour_of(primitives, self.table, own, before.visible if before else None)
        points, normals = contour.points_px[contour.visible], contour.normals[contour.visible]
        in_picture = is_in_picture(points, camera)
        if int(in_picture.sum()) < _FEWEST_POINTS:
            return Measured(state=state)
        length_px = hand_length_px(camera, projector.kinematics, pose, projector.shape)
        if before is None:
            outer = is_outer(projector.silhouette_of(primitives, own), points, normals, length_px)
        else:
            outer = before.outer
        reach_px = max(_LEAST_SEARCH_PX, s.search_share * length_px) * (1 + _WIDENING * state.failures)
        offset, is_found = torch.zeros_like(points[:, 0]), torch.zeros_like(outer)
        rivals, weight = torch.ones_like(outer, dtype=torch.long), torch.ones_like(offset)
        searches = [(outer, planes.outer, s.outer_edges, reach_px, 1.0)]
        if planes.inner is not None:
            searches.append((~outer, planes.inner, s.inner_edges, _INNER_REACH * reach_px, s.inner_weight))
        for which, plane, how, half_length_px, share in searches:
            if bool(which.any()):
                edges = search_edges(plane, points[which], normals[which], replace(how, half_length_px=half_length_px))
                offset[which], is_found[which], rivals[which] = edges.offset_px, edges.found, edges.candidates
                weight[which] = share
        chosen = self.table.select(contour.visible)
        along = projector.along_normals_px((cones, arcs), chosen, normals)
        observed = torch.cat((along, candidates @ self.prior.matrix.T), -1)

        believed = self.prior.value(state.reference, state.start_reference)
        measurement = torch.cat(((points * normals).sum(-1) + offset, believed))
        # Every pass has its share of the weight; an edge among rivals deserves less trust.
        variance = torch.cat((s.edge_std_px**2 * rivals.clamp_min(1) / weight, self.prior.variance)) * s.passes
        valid = torch.cat((is_found, torch.ones_like(believed, dtype=torch.bool)))
        result = update(
            state.belief,
            lambda _: observed,
            measurement,
            variance,
            s.unscented,
            valid=valid,
            gate=s.gate,
            observed=count,
        )
        accepted = result.used[: len(points)] & outer
        return Measured(
            state=self._rebased(replace(state, belief=result.state)),
            found=int(accepted.sum()) / max(1, int((outer & in_picture).sum())),
            inside=float(in_picture.float().mean()),
            nis=float(result.nis) / max(1, int(result.count)),
            seen=SeenContour(visible=contour.visible, outer=outer),
        )

    @cached_property
    def _rebased(self) -> Rebasing:
        return Rebasing(space=self.space, skeleton=self.skeleton)
