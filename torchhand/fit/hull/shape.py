"""The proportions of one hand fitted to the hulls of several frames at once, together with its pose in each.

Nothing but the shape is common to the frames, and all are solved as one problem: a bone that is too short is only told
from a joint that is bent by the frames in which it is not. What is known of people's hands holds what the hulls do not
tell. To be done once per user, so correctness comes before speed.
"""

from collections.abc import Sequence
from dataclasses import replace

from torchhand.fit import FrameObservations, SharedSolution, SharedUnknowns, solve_shared
from torchhand.fit.hull.fitter import HullFitter
from torchhand.fit.hull.settings import HullShapeSettings
from torchhand.fit.hull.target import HullTarget
from torchhand.hand import Anthropometry, HandPose

_COST_TOLERANCE, _POSE_TOLERANCE = 1e-3, 1e-2
"""Shares of the cost below which a step is not worth taking before the next association, of all frames and of one."""


def fit_shape(
    fitter: HullFitter,
    targets: Sequence[HullTarget],
    starts: HandPose,
    population: Anthropometry,
    settings: HullShapeSettings | None = None,
) -> SharedSolution:
    """Shape and poses from fits of the poses with some shape; the shape is within the anthropometric constraints.

    fitter: for the poses alone, of a hand in float64 and of the shape to start from; its schedule does not count.
    targets: the hulls of the frames, none empty, with the edges of their silhouettes (`with_rays`): fitted to the
    surface alone, the palm grows into what of a hull no hand fills. starts: one for each; leave out frames whose start
    is not good. population: the anthropometric prior.

    Raises ValueError where the numbers of hulls and poses differ or a hull is empty.
    """
    settings = settings or HullShapeSettings()
    if not len(targets) == len(starts) or not len(targets):
        raise ValueError(f"targets: expected as many as poses, at least one, got {len(targets)} and {len(starts)}")
    if any(target.is_empty for target in targets):
        raise ValueError("targets: expected a hull in every frame")
    kinds = zip(*(fitter.observations(target) for target in targets), strict=True)
    problem = replace(
        fitter.problem(targets[0]),
        observations=tuple(FrameObservations(frames=frames) for frames in kinds),
        shared=SharedUnknowns.of_shape(population),
    )
    found = solve_shared(
        problem, starts, settings.schedule, cost_tolerance=_COST_TOLERANCE, pose_tolerance=_POSE_TOLERANCE
    )
    return replace(found, pose=found.pose.normalized(), shape=population.project(found.shape))
