"""The proportions of a hand that one camera follows, over frames that show it differently.

The picture in which a hand is found gives first proportions. Over well-spread frames, poses free and one shape for all,
the same observations tell more of them: contours, detected keypoints, and the posture that a network sees.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from torchhand.devices import read_back
from torchhand.fit import (
    GaussianPrior,
    Problem,
    SharedSolution,
    SharedUnknowns,
    SolveStatus,
    Stage,
    solve,
    solve_shared,
)
from torchhand.fit.keypoints import KeypointSettings, WorldKeypoints, limit_information
from torchhand.hand import (
    Anthropometry,
    HandKinematics,
    HandPose,
    ShapeJacobian,
    keypoint_jacobian,
    named_pose_space,
)
from torchhand.numerics import RobustLoss
from torchhand.track.belief import HandMotion
from torchhand.track.proportions.frame_fit import FrameFit, SeenFrame

SCHEDULE = (Stage(gross_m=0.0075, rounds=2, iterations=4),)
"""The finest stage of the distance-map tracker, from poses that were followed there."""
_HELD_OUT = 4  # every fourth frame judges the shape that the others gave
_BY_CHANCE = (6.31, 2.92, 2.35, 2.13, 2.02, 1.94)
"""Student's t of one in twenty, one-sided, for 1, 2 … degrees of freedom, and at most for more."""
_KEYPOINTS, _SQUARES = KeypointSettings(space_std_m=0.003, correlation=0.0), RobustLoss(kind="squares")
"""How far the keypoints of a hand of another shape may lie from those before."""
_NEAR = (Stage(gross_m=0.03, rounds=2, iterations=6),)
_KEPT_RAD, _HELD_RAD = 0.1, 1e-3  # standard deviations of its angles about those before: that move, and that do not


@dataclass(frozen=True, kw_only=True)
class FittedShape:
    """Proportions fitted over several frames."""

    shape: Float[Tensor, "shape"]
    shape_std: Float[Tensor, "shape"]
    """Standard deviations; 0 for the hand's length, which one camera cannot tell from its distance."""
    keypoints_cov: Float[Tensor, "21 3 3"]
    """What that uncertainty adds to the covariances of keypoints, camera's frame, m²: hands of other proportions, each
    where it explains the frames best, mean over these."""
    costs: Float[Tensor, "held_out"]
    """Nats of each frame that was held out, its pose free."""
    costs_before: Float[Tensor, "held_out"]
    """The same with the proportions before."""

    @property
    def is_contradicted(self) -> bool:
        """Whether the frames that were held out cost so much more with these proportions that one in twenty fits which
        are no worse would look it by chance (paired t test; of a single frame, whether it costs more).

        Several frames are believed before one unless they are contradicted. Of six synthetic recordings, with keypoints
        and without, and `palm_gestures` with them, three had a higher mean; in these, too, the hand was followed better
        with the fitted proportions (docs/tried.md).
        """
        more = read_back(self.costs - self.costs_before)
        if len(more) < 2:
            return bool((more > 0).all())
        quantile = _BY_CHANCE[min(len(more) - 1, len(_BY_CHANCE)) - 1]
        return bool(more.mean() > quantile * more.std(ddof=1) / math.sqrt(len(more)))


def fitted_shape(fit: FrameFit, frames: Sequence[SeenFrame], overconfidence: float) -> FittedShape | None:
    """Proportions that explain frames, their poses free; None where too few of these show a hand.

    Every fourth frame is held out, and tells by its cost whether the proportions are worse than those of `fit`. The
    prior is that of the population: the picture in which the hand was found may be among the frames. These count less
    than as many independent ones, by what is known of an update rule's overconfidence: the surface of the model, the
    network and a detector err alike in all of them.
    """
    kinds = max((one.kinds for one in frames), key=len, default=())  # frames of which as much is known as of any
    seen = [one for one in frames if one.kinds == kinds]
    used = [one for place, one in enumerate(seen) if place % _HELD_OUT != _HELD_OUT - 1]
    held_out = seen[_HELD_OUT - 1 :: _HELD_OUT]
    if not held_out:
        return None
    skeleton, space = fit.kinematics.skeleton, fit.kinematics.shape_space
    columns = tuple(i for i, name in enumerate(space.names) if name != "hand_length")
    unknown = SharedUnknowns.of_shape(Anthropometry(space), columns, weight=overconfidence)
    known = limit_information(skeleton)
    found = solve_shared(replace(fit.problem(used), shared=unknown), _starts(used), fit.schedule, information=known)
    costs = []
    for shape in (fit.shape, found.shape):
        alone = replace(fit.problem(held_out), shape=shape)
        costs.append(solve(alone, _starts(held_out), fit.schedule).cost)
    return FittedShape(
        shape=found.shape,
        shape_std=math.sqrt(overconfidence) * found.shape_std,
        keypoints_cov=overconfidence * _keypoints_cov(fit, found, columns),
        costs=costs[1],
        costs_before=costs[0],
    )


def _keypoints_cov(fit: FrameFit, found: SharedSolution, columns: tuple[int, ...]) -> Float[Tensor, "21 3 3"]:
    """Covariance of keypoints by that of the proportions, the poses following these, mean over the frames."""
    hands = fit.kinematics(found.pose.dofs, found.shape, root_reference=found.pose.reference)
    of_pose = keypoint_jacobian(fit.kinematics, found.pose.dofs, hands, basis=fit.motion.space.basis)
    moved = ShapeJacobian(fit.kinematics, columns)(hands, found.shape) + of_pose @ found.follow[:, None]
    is_sound = (found.frame_status != SolveStatus.FAILED.value).to(moved)[:, None, None, None]
    return (is_sound * (moved @ found.shared_covariance @ moved.mT)).sum(0) / is_sound.sum().clamp_min(1)


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
