"""A hand found in a visual hull without any guess: from the hull's shape alone.

The palm is where the largest balls inside the hull are; the hand may point along any axis of the hull or between them,
turned about that direction in any way (so either facing), in a few postures and sizes. All of that is judged coarsely,
the best is fitted coarsely, and the best of that finely. Where the edges of the silhouettes are known, they count in
place of the hull's surface, most of which is no skin where few cameras look.
"""

import copy
import itertools
import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit import PostureResiduals
from torchhand.fit.hull.fit import HullFit, HullFitter
from torchhand.fit.hull.points import HullTarget, spread_vertices
from torchhand.fit.hull.settings import HullFitSettings, HullLevel, HullStartSettings
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, FINGERS, Hand, PoseConstraints, PoseSpace, posed_mesh, posture

_KNUCKLE, _PALM = 9, 0.6  # the middle finger's, and how far from the wrist to it the palm's middle is
_BLANKED = 1.0  # no two balls have centres nearer than so many radii of the larger
_LEAST_BALL = 0.7  # smallest radius of a ball over that of the largest
_FEWEST = 8  # grid points inside a hull in which something can be looked for
_ALIKE = math.cos(math.radians(25.0) / 2)  # hypotheses turned by less count as the same
_COARSE = (HullLevel(robust_m=0.030, rounds=3, iterations=2), HullLevel(robust_m=0.012, rounds=1, iterations=2))
_VARIED = (
    HullLevel(robust_m=0.012, rounds=2, iterations=2),
    HullLevel(robust_m=0.005, rounds=2, iterations=2),
    HullLevel(robust_m=0.003, rounds=1, iterations=2),
)
_WORTH_TRYING = 0.005  # share of the cost that another round of digits must have gained
_FINGERS = (
    {"mcp_aa": 0.0, "mcp_fe": 0.0, "pip_fe": 5.0, "dip_fe": 3.0},
    {"mcp_aa": 0.0, "mcp_fe": 5.0, "pip_fe": 80.0, "dip_fe": 55.0},
    {"mcp_aa": 0.0, "mcp_fe": 65.0, "pip_fe": 15.0, "dip_fe": 10.0},
    {"mcp_aa": 0.0, "mcp_fe": 80.0, "pip_fe": 95.0, "dip_fe": 60.0},
    {"mcp_aa": 0.0, "mcp_fe": 35.0, "pip_fe": 45.0, "dip_fe": 30.0},
)
_THUMBS = (
    {"cmc_fe": -10.0, "cmc_aa": 28.0, "mcp_fe": 0.0, "ip_fe": 0.0},
    {"cmc_fe": 15.0, "cmc_aa": 8.0, "mcp_fe": 37.0, "ip_fe": 65.0},
    {"cmc_fe": 30.0, "cmc_aa": 40.0, "mcp_fe": 20.0, "ip_fe": 30.0},
    {"cmc_fe": 10.0, "cmc_aa": 10.0, "mcp_fe": 5.0, "ip_fe": 5.0},
)


@dataclass(frozen=True, kw_only=True)
class HullStart:
    """A hand found in a hull."""

    fit: HullFit
    """Of one hypothesis."""
    size: int
    """Which of the given shapes it has."""


def palm_of(keypoints: Float[Tensor, "*batch 21 3"]) -> Float[Tensor, "*batch 3"]:
    """The middle of the palm, which stays in place when the hand turns, and where its largest ball is."""
    wrist, knuckle = keypoints[..., 0, :], keypoints[..., _KNUCKLE, :]
    return wrist + _PALM * (knuckle - wrist)


def find_in_hull(
    target: HullTarget,
    hand: Hand,
    space: PoseSpace,
    shapes: Float[Tensor, "sizes shape"],
    settings: HullStartSettings | None = None,
    fit: HullFitSettings | None = None,
    *,
    constraints: PoseConstraints | None = None,
    prior: PostureResiduals | None = None,
) -> list[HullStart]:
    """The best fits of a hand to a hull, best first, those of all sizes together.

    target: with the edges of its silhouettes (`with_rims`) wherever these are known: several hands fill a hull equally
    well, and only the edges tell them apart. shapes: the sizes tried, such as one known shape. space, constraints,
    prior: as in `HullFitter`; fit: how the last hypotheses are fitted.

    An empty list where there is no hull, or one too small to hold anything. Whether the best is a hand at all, rather
    than the least bad way to fill the hull of something else, `HullFit.is_good` tells.
    """
    settings, fit = settings or HullStartSettings(), fit or HullFitSettings()
    if target.is_empty or len(target.inner) < _FEWEST:
        return []
    coarse_fit = HullFitSettings(levels=_COARSE, vertices=settings.vertices, hypotheses_at_once=32)
    varied_fit = replace(fit, levels=_VARIED, vertices=settings.vertices, hypotheses_at_once=32)
    some = target if target.rims is None else replace(target, rims=target.rims.thinned(settings.rays))
    few = _thinned(target, settings.points) if target.rims is None else some
    quick = copy.deepcopy(hand).to(torch.float32)
    found: list[HullStart] = []
    for size, shape in enumerate(shapes):
        pose, reference = hypotheses(target, hand, shape, settings)
        with torch.inference_mode():
            cost = _judged(few, quick, shape.float(), pose.float(), reference.float(), settings, fit.turn_m)
        chosen = _distinct(cost, reference, pose, settings.coarse)
        coarse = HullFitter(quick, space, coarse_fit, shape=shape.float(), constraints=constraints, prior=prior)
        varied = HullFitter(quick, space, varied_fit, shape=shape.float(), constraints=constraints, prior=prior)
        fine = HullFitter(hand, space, fit, shape=shape, constraints=constraints, prior=prior)
        rough = coarse(few, pose[chosen], reference[chosen])
        chosen = _distinct(rough.cost, rough.root_reference, rough.pose, settings.fine)
        ended = varied(some, rough.pose[chosen], rough.root_reference[chosen])
        own = [ended.select(index) for index in ended.cost.argsort().tolist()]
        own = [with_other_fingers(some, one, varied, settings.finger_rounds) for one in own[: settings.varied]]
        if own:
            last = fine(target, torch.stack([x.pose for x in own]), torch.stack([x.root_reference for x in own]))
            found += [HullStart(fit=last.select(index), size=size) for index in range(len(own))]
    found = [one for one in found if bool(one.fit.cost.isfinite())]
    return sorted(found, key=lambda one: float(one.fit.cost))


def with_other_fingers(target: HullTarget, best: HullFit, fitter: HullFitter, rounds: int) -> HullFit:
    """The best fit when one digit at a time is tried in other postures: a digit in the wrong part of the hull stays
    there by itself."""
    for _ in range(rounds):
        tried = varied_digits(best.pose)
        found = fitter(target, tried, best.root_reference.expand(len(tried), 3, 3))
        other = found.select(found.best)
        if not float(other.cost) < (1 - _WORTH_TRYING) * float(best.cost):
            break
        best = other
    return best


def varied_digits(pose: Float[Tensor, "36"]) -> Float[Tensor, "n 36"]:
    """The pose with each digit in each of its other postures."""
    tried = []
    for finger in FINGERS:
        presets = _THUMBS if finger == "thumb" else _FINGERS
        for preset in presets:
            other = pose.clone()
            for joint, angle_deg in preset.items():
                other[DOFS.index(f"{finger}_{joint}")] = math.radians(angle_deg)
            tried.append(other)
    return torch.stack(tried)


def hypotheses(
    target: HullTarget, hand: Hand, shape: Float[Tensor, "shape"], settings: HullStartSettings
) -> tuple[Float[Tensor, "n 36"], Float[Tensor, "n 3 3"]]:
    """Poses with a zero rotation vector and their references (world_from_hand): places × directions × rolls ×
    postures."""
    like = hand.shape
    centres = _balls(target, settings.places).to(like)
    turns = _turns(_axes(target.inner).to(like), settings.rolls)
    postures = torch.stack([posture(name, dtype=like.dtype) for name in settings.postures]).to(like.device)
    points = hand.kinematics(postures, shape.to(like)).keypoints
    palm = palm_of(points)
    count = (len(centres), len(turns), len(postures))
    place, turn, kind = (x.flatten() for x in torch.meshgrid(*map(torch.arange, count), indexing="ij"))
    pose, reference = postures[kind].clone(), turns[turn]
    pose[:, :3] = centres[place] - (reference @ palm[kind][..., None]).squeeze(-1)
    return pose, reference


def _axes(inner: Float[Tensor, "inner 3"]) -> Float[Tensor, "3 3"]:
    """Principal axes of the hull, columns; a right-handed frame."""
    apart = inner - inner.mean(0)
    _, axes = torch.linalg.eigh(apart.T @ apart)
    return axes * torch.linalg.det(axes)


def _turns(axes: Float[Tensor, "3 3"], rolls: int) -> Float[Tensor, "n 3 3"]:
    """world_from_hand with the fingers (y) along the axes and the diagonals between them, turned about them."""
    signs = torch.tensor(list(itertools.product((-1.0, 0.0, 1.0), repeat=3))).to(axes)
    signs = signs[(signs.abs().sum(-1) == 1) | (signs.abs().sum(-1) == 3)]
    along = torch.nn.functional.normalize(signs @ axes.T, dim=-1)
    least = torch.nn.functional.one_hot(along.abs().argmin(-1), 3).to(axes)
    across = torch.nn.functional.normalize(torch.linalg.cross(along, least), dim=-1)
    base = torch.stack((across, along, torch.linalg.cross(across, along)), -1)
    angle = torch.arange(rolls, dtype=axes.dtype, device=axes.device) * (2 * math.pi / rolls)
    roll = rotation_from_vector(angle[:, None] * axes.new_tensor((0.0, 1.0, 0.0)))
    return (base[:, None] @ roll).flatten(0, 1)


def _balls(target: HullTarget, most: int) -> Float[Tensor, "balls 3"]:
    """Centres of the largest balls inside the hull, none within another."""
    depth, centres = target.depth.clone(), []
    largest = float(depth.max())
    while len(centres) < most:
        index = int(depth.argmax())
        radius = float(depth[index])
        if radius < _LEAST_BALL * largest or radius <= 0:
            break
        centres.append(target.inner[index])
        near = (target.inner - target.inner[index]).norm(dim=-1) < _BLANKED * largest
        depth[near] = -torch.inf
    return torch.stack(centres)


def _thinned(target: HullTarget, count: int) -> HullTarget:
    return replace(target, points=target.points[:count], normals=target.normals[:count], rims=None)


def _judged(
    target: HullTarget,
    hand: Hand,
    shape: Tensor,
    pose: Tensor,
    reference: Tensor,
    settings: HullStartSettings,
    turn_m: float,
) -> Float[Tensor, "n"]:
    """Mean distance of the skin outside the hull plus that of the silhouettes' edges, or else of the hull's surface,
    from the skin, cut off, metres."""
    vertices, share = spread_vertices(hand, 2 * settings.vertices)
    kinds, which = pose[:, 6:].unique(dim=0, return_inverse=True)
    still = torch.cat((torch.zeros_like(kinds[:, :6]), kinds), -1)
    state = hand(still, shape.to(pose))
    skins, normals = state.vertices[:, vertices], posed_mesh(hand, state).vertex_normals()[:, vertices]
    surface = target.points.to(pose)
    costs = []
    for some in torch.arange(len(pose)).split(settings.judged_at_once):
        turned = reference[some].mT
        placed, facing = skins[which[some]] @ turned + pose[some, None, :3], normals[which[some]] @ turned
        value, _ = target.field.sample(placed)
        outside = (value.clamp(0, settings.far_m) * share).sum(-1)
        if target.rims is None:
            apart = torch.cdist(surface.float().expand(len(some), -1, 3), placed.float()).amin(-1)
        else:
            match = target.rims.match(placed, facing, turn=turn_m)
            touched = placed.gather(1, match[..., None].expand(-1, -1, 3))
            apart = (touched - target.rims.near(touched)).norm(dim=-1)
        costs.append(outside + apart.clamp_max(settings.far_m).mean(-1).to(pose))
    return torch.cat(costs)


def _distinct(
    cost: Float[Tensor, "n"], reference: Float[Tensor, "n 3 3"], pose: Float[Tensor, "n 36"], most: int
) -> Int[Tensor, "k"]:
    """The best hypotheses, none turned like a better one with the same posture."""
    chosen: list[int] = []
    for index in cost.argsort().tolist():
        if len(chosen) == most or not math.isfinite(float(cost[index])):
            break
        if chosen:
            others = torch.tensor(chosen)
            trace = (reference[others] * reference[index]).sum((-2, -1))
            is_turned_alike = trace > 4 * _ALIKE**2 - 1
            bent = (pose[others, 6:] - pose[index, 6:]).abs().mean(-1)
            if bool((is_turned_alike & (bent < math.radians(4.0))).any()):
                continue
        chosen.append(index)
    return torch.tensor(chosen, dtype=torch.long)
