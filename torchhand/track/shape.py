"""The proportions of a hand that one camera has followed through a recording, over frames that show it differently.

The picture in which a hand is found gives first proportions. Over well-spread frames, poses free and one shape for all,
the same observations tell more of them: contours, detected keypoints, and the posture that a network sees.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit import (
    GaussianPrior,
    Problem,
    SharedUnknowns,
    Stage,
    solve,
    solve_shared,
)
from torchhand.fit.keypoints import KeypointSettings, WorldKeypoints, limit_information
from torchhand.hand import (
    FINGERS,
    Anthropometry,
    HandKinematics,
    HandPose,
    named_pose_space,
)
from torchhand.numerics import RobustLoss, single_threaded
from torchhand.track.belief import HandMotion
from torchhand.track.frame_fit import FollowedFrame, FrameFit, SeenFrame, contour_settings
from torchhand.track.knowledge import TrackerState
from torchhand.track.tracker import Tracker

_SCHEDULE = (Stage(gross_m=0.0075, rounds=2, iterations=4),)
"""The finest stage of the distance-map tracker, from poses that were followed there."""
_HELD_OUT = 4  # every fourth frame judges the shape that the others gave
_TURN = 0.7  # radians of joint angles that a radian of the hand's own turn is worth, when frames are told apart
_TIME = 1.0  # radians that the recording's length is worth
_KEYPOINTS, _SQUARES = KeypointSettings(space_std_m=0.003, correlation=0.0), RobustLoss(kind="squares")
"""How far the keypoints of a hand of another shape may lie from those before."""
_NEAR = (Stage(gross_m=0.03, rounds=2, iterations=6),)
_KEPT_RAD, _HELD_RAD = 0.1, 1e-3  # standard deviations of its angles about those before: that move, and that do not


@dataclass(frozen=True, kw_only=True)
class RecordedShape:
    """Proportions fitted over several frames."""

    shape: Float[Tensor, "shape"]
    shape_std: Float[Tensor, "shape"]
    """Standard deviations; 0 for the hand's length, which one camera cannot tell from its distance."""
    cost: float
    """Nats for each frame that was held out, its pose free."""
    cost_before: float
    """The same with the proportions before."""


def spread_frames(poses: Float[Tensor, "frames 36"], is_good: Bool[Tensor, "frames"], count: int) -> list[int]:
    """Rows of at most `count` good frames that differ most in posture, direction and time, in their order.

    poses: with the root's whole rotation vector; rows that are not good may hold NaN. Chosen one by one, from the first
    good one on, each the farthest from all that are chosen (Gonzalez 1985).
    """
    rows = is_good.nonzero()[:, 0]
    if not len(rows) or count < 1:
        return []
    hands = HandPose.of(poses[rows]).normalized()
    time = _TIME * rows.to(poses) / max(1, len(poses) - 1)
    turn = _TURN * hands.rotation.flatten(1) / 2**0.5  # Frobenius distance of rotations: √2 of a small angle
    features = torch.cat((poses[rows][:, 6:], turn, time[:, None]), 1)
    chosen, apart = [0], (features - features[0]).norm(dim=-1)
    while len(chosen) < min(count, len(rows)) and float(apart.max()) > 0:
        chosen.append(int(apart.argmax()))
        apart = torch.minimum(apart, (features - features[chosen[-1]]).norm(dim=-1))
    return rows[sorted(chosen)].tolist()


def can_tell_shape(tracker: Tracker) -> bool:
    """Whether a tracker's frames tell the proportions: they are not given, and the fingers flex before one camera."""
    names = tracker.parts.motion.space.free_names
    flexes = all(f"{finger}_{joint}_fe" in names for finger in FINGERS[1:] for joint in ("mcp", "pip"))
    return tracker.known_shape is None and len(tracker.parts.cameras) == 1 and flexes


@torch.inference_mode()
@single_threaded()
def recorded_shape(tracker: Tracker, state: TrackerState, frames: Iterable[FollowedFrame]) -> RecordedShape | None:
    """Proportions that explain well-spread frames, their poses free; None where too few of these show a hand.

    Every fourth frame is held out, and tells by its cost which proportions are better. state: of the tracker, with the
    proportions before and the hand's colours. The prior is that of the population: the picture in which the hand was
    found may be among the frames. The frames count less than as many independent ones, by what is known of the update
    rule's overconfidence: the surface of the model, the network and a detector err alike in all of them.
    """
    assert state.shape is not None
    contours = contour_settings(tracker, tracker.parts.rule.overconfidence)
    fit = FrameFit(tracker=tracker, state=state, schedule=_SCHEDULE, contours=contours)
    seen = [one for one in map(fit.seen, frames) if one is not None]
    kinds = max((one.kinds for one in seen), key=len, default=())  # frames of which as much is known as of any
    seen = [one for one in seen if one.kinds == kinds]
    used = [one for place, one in enumerate(seen) if place % _HELD_OUT != _HELD_OUT - 1]
    held_out = seen[_HELD_OUT - 1 :: _HELD_OUT]
    if not held_out:
        return None
    columns = tuple(i for i, name in enumerate(tracker.kinematics.shape_space.names) if name != "hand_length")
    population = Anthropometry(tracker.kinematics.shape_space)
    unknown = SharedUnknowns.of_shape(population, columns, weight=tracker.parts.rule.overconfidence)
    known = limit_information(tracker.kinematics.skeleton)
    found = solve_shared(replace(fit.problem(used), shared=unknown), _starts(used), _SCHEDULE, information=known)
    costs = []
    for shape in (state.shape, found.shape):
        alone = replace(fit.problem(held_out), shape=shape)
        costs.append(solve_shared(alone, _starts(held_out), _SCHEDULE).cost / len(held_out))
    return RecordedShape(shape=found.shape, shape_std=found.shape_std, cost=costs[1], cost_before=costs[0])


def reshaped_poses(
    poses: Float[Tensor, "frames 36"],
    motion: HandMotion,
    kinematics: HandKinematics,
    before: Float[Tensor, "shape"],
    shape: Float[Tensor, "shape"],
) -> Float[Tensor, "frames 36"]:
    """Poses of a hand of another shape that lie where those of the hand before did, as far as its angles stay as they
    were: maximum a posteriori by its keypoints, of which another outline follows more than the angles. Angles that do
    not move while a hand is followed stay. Poses have the root's whole rotation vector."""
    hands, space = HandPose.of(poses).normalized(), named_pose_space("dof36").to(device=poses.device)
    points = kinematics(hands.dofs, before, root_reference=hands.reference).keypoints
    std = poses.new_tensor([_angle_std(name, motion.space.free_names) for name in space.free_names])
    problem = Problem(
        space=space,
        skeleton=kinematics.skeleton,
        shape=shape,
        observations=(WorldKeypoints(points=points, kinematics=kinematics, settings=_KEYPOINTS, loss=_SQUARES),),
        priors=(GaussianPrior.of_std(hands, std, space),),
    )
    return solve(problem, hands, _NEAR).pose.vector


def _angle_std(name: str, free_names: Sequence[str]) -> float:
    if name.startswith("root_"):
        return math.inf
    return _KEPT_RAD if name in free_names else _HELD_RAD


def _starts(frames: Sequence[SeenFrame]) -> HandPose:
    return HandPose.stack([one.pose for one in frames])
