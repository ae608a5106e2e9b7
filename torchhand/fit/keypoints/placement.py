"""A hand placed by detected keypoints alone: no prediction, no silhouette, one camera or several."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import Problem, Solutions, Stage, solve
from torchhand.fit.keypoints.observation import PictureKeypoints
from torchhand.fit.keypoints.posture import PostureKeypoints
from torchhand.fit.keypoints.prior import NaturalPrior, natural_posture
from torchhand.fit.keypoints.views import placed_in_pictures, starts_in_picture
from torchhand.hand import DOFS, JOINT_DOFS, HandKinematics, HandPose, named_pose_space

_SPACE = named_pose_space("dof26")  # what points tell of, whatever is followed
_SCHEDULE = (Stage(gross_m=0.03, rounds=1, iterations=8), Stage(gross_m=0.01, rounds=2, iterations=8))
_NEAR = tuple(replace(stage, method="gauss_newton") for stage in _SCHEDULE)  # from points in space: starts are near
_STARTS = 4  # per view without points in space
_MIN_DEPTH = 0.05  # metres
_FAR = 0.5  # metres, for cameras that do not show depth


def place_hand(
    pictures: Sequence[PictureKeypoints],
    postures: Sequence[PostureKeypoints],
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
) -> Solutions | None:
    """The hand that explains the points of all views, without batch dimensions; None where no picture has any.

    pictures, postures: of one row each, in the frame of one world; postures may be of any of the views or of none,
    where directions all around are tried in a natural posture. Weak beliefs about posture fill in what points leave
    open.
    """
    pictures = [one for one in pictures if not one.is_empty]
    if not pictures:
        return None
    natural = natural_posture(device=shape.device)
    told = [one for one in postures if not one.is_empty]
    missing = shape.new_ones(1, len(DOFS))
    if told:
        starts = HandPose.cat([_placed(one.pose, pictures, shape) for one in told])
        is_open = torch.stack([one.precision for one in told]).amax((0, 1)) == 0
        missing[:, -len(JOINT_DOFS) :] = is_open.to(missing)
    else:
        found = [starts_in_picture(one, shape, natural.mean.to(shape), _STARTS).reshape(-1) for one in pictures]
        starts = HandPose.cat(found)
    problem = Problem(
        space=_SPACE.to(device=shape.device),
        skeleton=kinematics.skeleton,
        shape=shape,
        observations=(*pictures, *told),
        priors=(NaturalPrior(posture=natural, fraction=missing.repeat(len(starts), 1)),),
    )
    solutions = solve(problem, starts, _NEAR if told else _SCHEDULE)
    return solutions.select(solutions.best)


def _placed(pose: HandPose, pictures: Sequence[PictureKeypoints], shape: Float[Tensor, "shape"]) -> HandPose:
    """Hands of known rotation and posture where the points of all pictures want them, before the first camera."""
    placed = placed_in_pictures(pictures, pose, shape)
    return replace(placed, dofs=torch.cat((_before(placed.dofs[:, :3], pictures[0]), placed.dofs[:, 3:]), -1))


def _before(place: Float[Tensor, "k 3"], picture: PictureKeypoints) -> Float[Tensor, "k 3"]:
    """Places that lie before the first camera."""
    camera = picture.camera
    own = place @ camera.rotation.to(place).mT + camera.translation.to(place)
    if camera.kind == "pinhole":
        is_before = own[:, 2:] > _MIN_DEPTH
        own = torch.where(is_before, own, own.new_tensor((0.0, 0.0, _FAR)))
    else:
        own = torch.cat((own[:, :2], torch.full_like(own[:, 2:], _FAR)), -1)
    return (own - camera.translation.to(place)) @ camera.rotation.to(place)
