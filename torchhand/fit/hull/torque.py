"""A skinned hand pulled into a visual hull by torques about its joints (Ueda et al. 2003, section 5.2, steps 3 to 7).

Every vertex outside the hull is drawn to it by a force, forces become torques about the joints, and every angle takes a
step in the direction of its torque, until hardly a vertex is outside. Nothing draws the hand to those parts of the hull
that it does not fill: any hand inside the hull is an end of it.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.fit import free_bounds
from torchhand.fit.hull.settings import HullTorqueSettings, TorqueSteps
from torchhand.fit.hull.skin import SkinPoints, WeightedVertices
from torchhand.fit.hull.target import HullField
from torchhand.hand import DOFS, HandPose, PoseSpace, Skeleton
from torchhand.hand.limits import clamp_to_limits

_NOTHING = 1e-30
_SHRINK, _GROW = 0.5, 1.2  # of Δα where a torque turns round, and where it does not


@dataclass(frozen=True, kw_only=True)
class HullTorqueFit:
    """Fitted hands, one per hypothesis, in the world, with the way there."""

    pose: HandPose
    """Poses (*hypotheses), with zero rotation vectors, within the limits."""
    converged: Bool[Tensor, "*hypotheses"]
    """Whether the share of vertices outside fell below its threshold."""
    iterations: Int[Tensor, "*hypotheses"]
    """Number of steps taken."""
    inside_fraction: Float[Tensor, "*hypotheses steps"]
    """Share of the vertices inside, at the start and after every step (the rate of convergence of figure 14)."""
    poses: HandPose
    """Poses (*hypotheses, steps), at the start and after every step, all about the start's reference (figure 13)."""


def fit_by_torques(
    field: HullField,
    skin: SkinPoints,
    space: PoseSpace,
    starts: HandPose,
    settings: HullTorqueSettings | None = None,
) -> HullTorqueFit:
    """Pull every hypothesis into a hull from its own start.

    space: what moves. With the root's DOFs among them the palm moves too (the paper's real pictures); a space without
        keeps it, as in its simulation: give `space.about(pose)`. Starts are put into the space and the limits.
    starts: any batch shape.

    How the paper is read where it leaves things open. A vertex outside is drawn along the field's gradient, by a force
    as large as its distance; a joint's torque is the sum over the skin that it carries. Give the field of the surface
    in the middle (`hull_field(octree, surface="middle")`): inside the outer surface, which contains the hand with half
    an octant to spare, nothing draws, and the hand comes to rest as soon as it touches (2° short of 10° at level 8, 3°
    at level 7); about the middle one it is pushed from all sides and the forces balance where it is.
    A finger that turns at its knuckle by 10° and one that shares the turn among its three joints differ by about 2 mm.
    Steps by the sign or the size of the torque end in between, 2° to 4° off at the knuckle, though hardly a vertex is
    outside. With the angle of the largest torque in each digit first, which is that of the longest lever, the knuckle
    turns back all that it can before another joint does, and is 0.1° to 0.4° off. It is also the best of the three
    where palm and fingers are off by 5 mm and 5° (`torchhand study ueda`); but where all joints of all fingers start
    straight and are bent, twenty such steps go less far than proportional ones.
    Starts should be nearer to the pose than half a finger's width: farther off a finger is drawn to its neighbour's
    hull. Where few views leave volume beside the finger, as three along the axes may, it stays there: up to 4° off.

    Never raises for what a hull or a start may be. One hypothesis never touches another.
    """
    settings, batch = settings or HullTorqueSettings(), starts.batch_shape
    with torch.inference_mode():
        found = _pulled(field, skin, space, starts.to(space.basis).reshape(-1).normalized(), settings)
    return HullTorqueFit(
        pose=found.pose.reshape(*batch),
        converged=found.converged.reshape(batch),
        iterations=found.iterations.reshape(batch),
        inside_fraction=found.inside_fraction.reshape(*batch, -1),
        poses=found.poses.reshape(*batch, settings.iterations + 1),
    )


def _pulled(
    field: HullField, skin: SkinPoints, space: PoseSpace, start: HandPose, settings: HullTorqueSettings
) -> HullTorqueFit:
    skeleton: Skeleton = skin.hand.kinematics.skeleton
    bounds = free_bounds(space, skeleton)
    device = start.dofs.device
    everything = skin.weighted(torch.arange(skin.hand.skinning.weights.shape[1], device=device))
    values = space.free(start.dofs).clamp(*bounds)
    step = _first_steps(space, settings).expand(len(start), -1).clone()
    max_step, min_step = step, step * (settings.min_step_deg / settings.step_deg)
    before = torch.zeros_like(values)
    digits = _digits(space)
    is_open = torch.ones(len(start), dtype=torch.bool, device=device)
    taken = torch.zeros(len(start), dtype=torch.long, device=device)
    fractions, poses = [], []
    for turn in range(settings.iterations + 1):
        here = HandPose(dofs=clamp_to_limits(space.dof(values), skeleton), reference=start.reference)
        fraction, torque, reach = _torques(field, skin, everything, here, space, settings.slack_m)
        fractions.append(fraction.to(values))
        poses.append(here)
        is_open = is_open & (fraction < 1 - settings.outside_fraction)
        if turn == settings.iterations or not bool(is_open.any()):
            break
        torque, reach = torque.to(values), reach.to(values)
        at_end = ((values <= bounds[0]) & (torque < 0)) | ((values >= bounds[1]) & (torque > 0))
        torque = torque.where((torque.abs() > settings.min_torque * reach) & ~at_end, 0.0)
        fraction_of_step = _fractions(torque, settings.steps, digits)
        pulled = torque.sign() * (fraction_of_step > 0)
        agrees = pulled * before
        step = torch.where(agrees < 0, torch.maximum(_SHRINK * step, min_step), step)
        step = torch.where(agrees > 0, torch.minimum(_GROW * step, max_step), step)
        before = torch.where(pulled == 0, before, pulled)
        moved = (values + step * pulled * fraction_of_step).clamp(*bounds)
        values = torch.where(is_open[:, None], moved, values)
        taken = taken + is_open
    missing = settings.iterations + 1 - len(poses)  # all had arrived: they stay
    way = HandPose.stack([*poses, *[poses[-1]] * missing])
    return HullTorqueFit(
        pose=poses[-1].normalized(),
        converged=fractions[-1] >= 1 - settings.outside_fraction,
        iterations=taken,
        inside_fraction=torch.stack([*fractions, *[fractions[-1]] * missing], 1),
        poses=HandPose(dofs=way.dofs.transpose(0, 1), reference=way.reference.transpose(0, 1)),
    )


def _first_steps(space: PoseSpace, settings: HullTorqueSettings) -> Float[Tensor, "free"]:
    """Δα of each free parameter: metres of translations, radians of the others."""
    is_shift = torch.tensor([name.startswith("root_t") for name in space.free_names], device=space.basis.device)
    turn = torch.full((space.size,), settings.step_deg, dtype=space.basis.dtype, device=space.basis.device).deg2rad()
    return torch.where(is_shift, 1e-3 * settings.root_step_mm, turn)


def _digits(space: PoseSpace) -> Float[Tensor, "digits free"]:
    """The free angles of each digit; those that move several, and the root's coordinates, each as one by themselves."""
    moved = space.basis != 0
    groups: dict[str, list[int]] = {}
    for column, name in enumerate(space.free_names):
        owners = {DOFS[row].partition("_")[0] for row in moved[:, column].nonzero()[:, 0].tolist()}
        owner = owners.pop() if len(owners) == 1 and owners != {"root"} else name
        groups.setdefault(owner, []).append(column)
    digits = space.basis.new_zeros(len(groups), space.size)
    for row, columns in enumerate(groups.values()):
        digits[row, columns] = 1
    return digits


def _fractions(
    torque: Float[Tensor, "k free"], steps: TorqueSteps, digits: Float[Tensor, "digits free"]
) -> Float[Tensor, "k free"]:
    """Share of Δα that every angle takes."""
    size = torque.abs()
    if steps == "equal":
        return (size > 0).to(size)
    if steps == "proportional":
        return size / size.amax(-1, keepdim=True).clamp_min(_NOTHING)
    of_digit = size[:, None] * digits
    largest = of_digit.amax(-1, keepdim=True)
    return ((of_digit == largest) & (largest > 0)).any(1).to(size)


def _torques(
    field: HullField,
    skin: SkinPoints,
    everything: WeightedVertices,
    pose: HandPose,
    space: PoseSpace,
    slack_m: float,
) -> tuple[Float[Tensor, "k"], Float[Tensor, "k free"], Float[Tensor, "k free"]]:
    """Share of the vertices inside; torque about every free angle; and the torque if all its parts went one way.

    The force on a vertex outside draws it to the hull, the more the farther it is. Along its bone it has no torque
    about the bone's joint, so what is left of it is perpendicular to the bone (figure 7).
    """
    motion = skin.motion(skin.posed(pose), everything)
    value, gradient = field.sample(motion.points)
    beyond = (value - slack_m).clamp_min(0)
    parts = motion.along(-beyond[..., None] * gradient) @ space.basis.to(beyond)
    return (beyond == 0).to(beyond).mean(-1), parts.sum(-2), parts.abs().sum(-2)
