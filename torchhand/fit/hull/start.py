"""A hand found in a visual hull without any guess, from the hull's shape alone, or from hands that something proposes.

The palm is where the largest balls inside the hull are; the hand may point along any axis of the hull or between them,
turned about that direction in any way (so either facing), in a few postures and sizes. All of that is evaluated
coarsely, the best is fitted coarsely, and the best of that finely. Where the edges of the silhouettes are known, they
count in place of the hull's surface, most of which is no skin where few cameras look.
"""

import copy
import itertools
import math
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import kept
from torchhand.fit import Solutions, Stage
from torchhand.fit.hull.coverage import TURN_M
from torchhand.fit.hull.fitter import HullFitter
from torchhand.fit.hull.joint_priors import JointPriors
from torchhand.fit.hull.settings import HullSettings, HullStartSettings
from torchhand.fit.hull.target import HullTarget
from torchhand.fit.hull.vertices import spread_vertices
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, FINGERS, Hand, HandPose, posed_mesh, posture

_KNUCKLE, _PALM = 9, 0.6  # the middle finger's, and how far from the wrist to it the palm's middle is
_BLANKED = 1.0  # no two balls have centres nearer than so many radii of the larger
_MIN_BALL = 0.7  # smallest radius of a ball over that of the largest
_MIN_INNER = 8  # grid points inside a hull in which something can be looked for
_ALIKE = math.cos(math.radians(25.0) / 2)  # hypotheses turned by less count as the same
_FAR = 0.03  # metres: distances of skin and hull that are longer count as much in the first evaluation
_AT_ONCE = 64  # hypotheses that are evaluated together, which bounds the memory
_NEAR = 0.01  # metres: proposals whose palm is nearer to the largest ball are not tried there too
_COARSE = (Stage(gross_m=0.030, rounds=3, iterations=2), Stage(gross_m=0.012, rounds=1, iterations=2))
_FINGER_STAGES = (
    Stage(gross_m=0.012, rounds=2, iterations=2),
    Stage(gross_m=0.005, rounds=2, iterations=2),
    Stage(gross_m=0.003, rounds=1, iterations=2),
)
_FINEST = (*_FINGER_STAGES[1:], Stage(gross_m=0.002, rounds=1, iterations=2))  # ends as SEARCH: costs are compared
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

    found: Solutions
    """Solution of one hypothesis, without batch dimensions."""
    size: int
    """Index of the hand's shape among those given."""


def palm_of(keypoints: Float[Tensor, "*batch 21 3"]) -> Float[Tensor, "*batch 3"]:
    """The middle of the palm, which stays in place when the hand turns, and where its largest ball is."""
    wrist, knuckle = keypoints[..., 0, :], keypoints[..., _KNUCKLE, :]
    return wrist + _PALM * (knuckle - wrist)


def find_in_hull(
    target: HullTarget,
    fitter: HullFitter,
    shapes: Float[Tensor, "sizes shape"],
    settings: HullStartSettings | None = None,
) -> list[HullStart]:
    """The best fits of a hand to a hull, best first, those of all sizes together.

    target: with the edges of its silhouettes (`with_rays`) wherever these are known: several hands fill a hull equally
    well, and only the edges tell them apart. fitter: how the last hypotheses are fitted; its shape does not count.
    shapes: the sizes tried, such as one known shape.

    An empty list where there is no hull, or one too small to hold anything. Whether the best is a hand at all, rather
    than the least bad way to fill the hull of something else, `HullEvidence.is_good` tells.
    """
    settings = settings or HullStartSettings()
    if target.is_empty or len(target.inner) < _MIN_INNER:
        return []
    found = [one for size, shape in enumerate(shapes) for one in _of_size(target, fitter, shape, size, settings)]
    return sorted(found, key=lambda one: float(one.found.cost))


def fit_proposals(
    target: HullTarget,
    fitter: HullFitter,
    proposals: HandPose,
    shape: Float[Tensor, "shape"],
    settings: HullStartSettings | None = None,
) -> Solutions:
    """The best fit from some hands that may be centimetres and tens of degrees off, such as those that pictures were
    read to show, without batch dimensions. Each is tried where it is proposed and with its palm in the hull's largest
    ball. Much quicker than `find_in_hull`, and no better than the proposals.

    proposals: (n,), at least one that is finite, with zero rotation vectors. target: not empty.
    """
    settings = settings or HullStartSettings()
    work = _Work.of(target, fitter, shape, settings)
    starts = _also_in_ball(proposals, target, fitter.hand, shape)
    found = work.searching(work.some, work.likeliest(starts, settings.proposed))
    best = with_other_fingers(work.some, found.select(found.best), work.of_fingers, settings.proposed_finger_rounds)
    return work.finest(target, best)


def _also_in_ball(proposals: HandPose, target: HullTarget, hand: Hand, shape: Float[Tensor, "shape"]) -> HandPose:
    """Hands, and the same with their palms in the middle of the largest ball inside a hull."""
    proposals = proposals.to(hand.shape)
    proposals = proposals[proposals.dofs.isfinite().all(-1).nonzero()[:, 0]]
    points = hand.kinematics(proposals.dofs, shape.to(hand.shape), root_reference=proposals.reference).keypoints
    shift = _balls(target, 1).to(points) - palm_of(points)
    moved = torch.cat((proposals.dofs[:, :3] + shift, proposals.dofs[:, 3:]), -1)
    away = (shift.norm(dim=-1) > _NEAR).nonzero()[:, 0]
    return HandPose.cat([proposals, replace(proposals, dofs=moved)[away]])


@dataclass(frozen=True, kw_only=True)
class _Work:
    """What hypotheses of one size are compared and fitted with."""

    some: HullTarget
    """With some of the rays."""
    few: HullTarget
    """With some of the rays, or else of the points."""
    quick: HullFitter
    """In single precision."""
    exact: HullFitter
    """As the last hypotheses are fitted."""
    settings: HullStartSettings

    @classmethod
    def of(cls, target: HullTarget, fitter: HullFitter, shape: Tensor, settings: HullStartSettings) -> "_Work":
        some = target if target.rays is None else replace(target, rays=target.rays.thinned(settings.rays))
        return cls(
            some=some,
            few=_thinned(target, settings.points) if target.rays is None else some,
            quick=replace(fitter, hand=_in_single(fitter.hand), shape=shape.float()),
            exact=replace(fitter, shape=shape),
            settings=settings,
        )

    @property
    def searching(self) -> HullFitter:
        """From hands that may be far off."""
        return replace(self.of_fingers, schedule=self.exact.schedule)

    @property
    def coarse(self) -> HullFitter:
        return replace(
            self.quick,
            settings=HullSettings(vertices=self.settings.vertices),
            joints=JointPriors(constraints=self.quick.joints.constraints, postures=self.quick.joints.postures),
            schedule=_COARSE,
        )

    @cached_property
    def of_fingers(self) -> HullFitter:
        settings = replace(self.quick.settings, vertices=self.settings.vertices)
        return replace(self.quick, settings=settings, schedule=_FINGER_STAGES)

    def finest(self, target: HullTarget, best: Solutions) -> Solutions:
        """One hypothesis that was fitted in single precision fitted to all of the target."""
        return replace(self.exact, schedule=_FINEST)(target, HandPose.stack([best.pose])).select(0)

    def likeliest(self, starts: HandPose, count: int) -> HandPose:
        """The hands that explain most as they are, `count` at most, none turned like a better one."""
        with torch.inference_mode():
            cost = _evaluated(self.few, self.quick, starts, self.settings)
        return starts[_distinct(cost, starts, count)]


@kept(2)
def _in_single(hand: Hand) -> Hand:
    """The hand in single precision; made once."""
    return copy.deepcopy(hand).to(torch.float32)


def _of_size(
    target: HullTarget, fitter: HullFitter, shape: Float[Tensor, "shape"], size: int, settings: HullStartSettings
) -> list[HullStart]:
    work = _Work.of(target, fitter, shape, settings)
    some, of_fingers = work.some, work.of_fingers
    rough = work.coarse(work.few, work.likeliest(hypotheses(target, fitter.hand, shape, settings), settings.coarse))
    better = of_fingers(some, rough.pose[_distinct(rough.cost, rough.pose, settings.fine)])
    best = [better.select(index) for index in better.cost.argsort().tolist()[: settings.finger_hypotheses]]
    if not best:
        return []
    best = [with_other_fingers(some, one, of_fingers, settings.finger_rounds) for one in best]
    last = replace(fitter, shape=shape)(target, HandPose.stack([one.pose for one in best]))
    own = [HullStart(found=last.select(index), size=size) for index in range(len(best))]
    return [one for one in own if bool(one.found.is_sound)]


def with_other_fingers(target: HullTarget, best: Solutions, fitter: HullFitter, rounds: int) -> Solutions:
    """The best fit when one digit at a time is tried in other postures: a digit in the wrong part of the hull stays
    there by itself. best: of one hypothesis."""
    for _ in range(rounds):
        found = fitter(target, finger_proposals(best.pose))
        other = found.select(found.best)
        if not float(other.cost) < (1 - _WORTH_TRYING) * float(best.cost):
            break
        best = other
    return best


def finger_proposals(pose: HandPose) -> HandPose:
    """One hand with each digit in each of its other postures, (n,)."""
    tried = []
    for finger in FINGERS:
        presets = _THUMBS if finger == "thumb" else _FINGERS
        for preset in presets:
            other = pose.dofs.clone()
            for joint, angle_deg in preset.items():
                other[DOFS.index(f"{finger}_{joint}")] = math.radians(angle_deg)
            tried.append(other)
    return HandPose.of(torch.stack(tried), pose.reference)


def hypotheses(target: HullTarget, hand: Hand, shape: Float[Tensor, "shape"], settings: HullStartSettings) -> HandPose:
    """Hands with zero rotation vectors, (n,): places × directions × rolls × postures."""
    like = hand.shape
    centres = _balls(target, settings.places).to(like)
    turns = _turns(_axes(target.inner).to(like), settings.rolls)
    postures = torch.stack([posture(name, dtype=like.dtype) for name in settings.postures]).to(like.device)
    points = hand.kinematics(postures, shape.to(like)).keypoints
    palm = palm_of(points)
    count = (len(centres), len(turns), len(postures))
    place, turn, kind = (x.flatten() for x in torch.meshgrid(*map(torch.arange, count), indexing="ij"))
    dofs, reference = postures[kind].clone(), turns[turn]
    dofs[:, :3] = centres[place] - (reference @ palm[kind][..., None]).squeeze(-1)
    return HandPose(dofs=dofs, reference=reference)


def _axes(inner: Float[Tensor, "inner 3"]) -> Float[Tensor, "3 3"]:
    """Principal axes of the hull, columns; a right-handed frame."""
    offsets = inner - inner.mean(0)
    _, axes = torch.linalg.eigh(offsets.T @ offsets)
    return axes * torch.linalg.det(axes)


def _turns(axes: Float[Tensor, "3 3"], rolls: int) -> Float[Tensor, "n 3 3"]:
    """world_from_hand with the fingers (y) along the axes and the diagonals between them, turned about them."""
    signs = torch.tensor(list(itertools.product((-1.0, 0.0, 1.0), repeat=3))).to(axes)
    signs = signs[(signs.abs().sum(-1) == 1) | (signs.abs().sum(-1) == 3)]
    along = torch.nn.functional.normalize(signs @ axes.T, dim=-1)
    aside = torch.nn.functional.one_hot(along.abs().argmin(-1), 3).to(axes)
    across = torch.nn.functional.normalize(torch.linalg.cross(along, aside), dim=-1)
    base = torch.stack((across, along, torch.linalg.cross(across, along)), -1)
    angle = torch.arange(rolls, dtype=axes.dtype, device=axes.device) * (2 * math.pi / rolls)
    roll = rotation_from_vector(angle[:, None] * axes.new_tensor((0.0, 1.0, 0.0)))
    return (base[:, None] @ roll).flatten(0, 1)


def _balls(target: HullTarget, count: int) -> Float[Tensor, "balls 3"]:
    """Centres of the largest balls inside the hull, none within another; `count` at most."""
    depth, centres = target.depth.clone(), []
    largest = float(depth.max())
    while len(centres) < count:
        index = int(depth.argmax())
        radius = float(depth[index])
        if radius < _MIN_BALL * largest or radius <= 0:
            break
        centres.append(target.inner[index])
        near = (target.inner - target.inner[index]).norm(dim=-1) < _BLANKED * largest
        depth[near] = -torch.inf
    return torch.stack(centres)


def _thinned(target: HullTarget, count: int) -> HullTarget:
    return replace(target, points=target.points[:count], normals=target.normals[:count], rays=None)


def _evaluated(
    target: HullTarget, fitter: HullFitter, starts: HandPose, settings: HullStartSettings
) -> Float[Tensor, "n"]:
    """Mean distance of the skin outside the hull plus that of the silhouettes' edges, or else of the hull's surface,
    from the skin, cut off, metres. fitter: tells hand and shape."""
    hand, shape, starts = fitter.hand, fitter.vertices.skin.shape, starts.to(fitter.vertices.skin.shape)
    vertices, fraction = spread_vertices(hand, 2 * settings.vertices)
    kinds, which = starts.dofs[:, 6:].unique(dim=0, return_inverse=True)
    state = hand(torch.cat((torch.zeros_like(kinds[:, :6]), kinds), -1), shape)
    skins, normals = state.vertices[:, vertices], posed_mesh(hand, state).vertex_normals()[:, vertices]
    surface = target.points.to(shape)
    costs = []
    for some in torch.arange(len(starts)).split(_AT_ONCE):
        turned = starts.reference[some].mT
        placed = skins[which[some]] @ turned + starts.dofs[some, None, :3]
        value, _ = target.field.sample(placed)
        outside = (value.clamp(0, _FAR) * fraction).sum(-1)
        if target.rays is None:
            distance = torch.cdist(surface.expand(len(some), -1, 3), placed).amin(-1)
        else:
            match = target.rays.match(placed, normals[which[some]] @ turned, turn=TURN_M)
            touched = placed.gather(1, match[..., None].expand(-1, -1, 3))
            distance = (touched - target.rays.nearest_to(touched)).norm(dim=-1)
        costs.append(outside + distance.clamp_max(_FAR).mean(-1))
    return torch.cat(costs)


def _distinct(cost: Float[Tensor, "n"], hands: HandPose, count: int) -> Int[Tensor, "k"]:
    """The best hypotheses, `count` at most, none turned like a better one with the same posture. Rotation vectors are
    zero."""
    chosen: list[int] = []
    for index in cost.argsort().tolist():
        if len(chosen) == count or not math.isfinite(float(cost[index])):
            break
        if chosen:
            others = hands[torch.tensor(chosen)]
            trace = (others.reference * hands.reference[index]).sum((-2, -1))
            is_turned_alike = trace > 4 * _ALIKE**2 - 1
            bent = (others.dofs[:, 6:] - hands.dofs[index, 6:]).abs().mean(-1)
            if bool((is_turned_alike & (bent < math.radians(4.0))).any()):
                continue
        chosen.append(index)
    return torch.tensor(chosen, dtype=torch.long)
