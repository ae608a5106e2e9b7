"""A hand placed by detected keypoints alone: no prediction, no silhouette, one camera or several."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import Problem, Solutions, Stage, solve
from torchhand.fit.keypoints.observation import PictureKeypoints
from torchhand.fit.keypoints.posture import PostureKeypoints
from torchhand.fit.keypoints.prior import NaturalPrior, natural_posture
from torchhand.fit.keypoints.views import starts_in_picture
from torchhand.hand import DOFS, JOINT_DOFS, HandKinematics, HandPose, named_pose_space

_SPACE = named_pose_space("dof26")  # what points tell of, whatever is followed
_SCHEDULE = (Stage(gross_m=0.03, rounds=1, iterations=8), Stage(gross_m=0.01, rounds=2, iterations=8))
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
    natural = natural_posture()
    told = [one for one in postures if not one.is_empty]
    missing = shape.new_ones(1, len(DOFS))
    if told:
        starts = HandPose.cat([_placed(one.pose, pictures, kinematics, shape) for one in told])
        is_open = torch.stack([one.precision for one in told]).amax((0, 1)) == 0
        missing[:, -len(JOINT_DOFS) :] = is_open.to(missing)
    else:
        found = [starts_in_picture(one, shape, natural.mean.to(shape), _STARTS).reshape(-1) for one in pictures]
        starts = HandPose.cat(found)
    problem = Problem(
        space=_SPACE,
        skeleton=kinematics.skeleton,
        shape=shape,
        observations=(*pictures, *told),
        priors=(NaturalPrior(posture=natural, fraction=missing.repeat(len(starts), 1)),),
    )
    solutions = solve(problem, starts, _SCHEDULE)
    return solutions.select(solutions.best)


def _placed(
    pose: HandPose, pictures: Sequence[PictureKeypoints], kinematics: HandKinematics, shape: Float[Tensor, "shape"]
) -> HandPose:
    """Hands of known rotation and posture where the points of all pictures want them in linear least squares."""
    arms = kinematics(pose.dofs, shape, root_reference=pose.reference).keypoints - pose.dofs[:, None, :3]
    matrices, values = [], []
    for one in pictures:
        camera, rotation = one.camera, one.camera.rotation.to(arms)
        plane = camera.plane_from_pixels(one.points_px.nan_to_num().to(arms))
        weight = one.is_known.to(arms)[..., None]
        seen = arms @ rotation.mT + camera.translation.to(arms)
        depth = seen[..., 2:] if camera.kind == "pinhole" else torch.ones_like(seen[..., 2:])
        slope = plane[..., None] if camera.kind == "pinhole" else torch.zeros_like(plane[..., None])
        rows = rotation[:2] - slope * rotation[2]
        matrices.append((weight[..., None] * rows).flatten(1, 2).expand(len(arms), -1, -1))
        values.append((weight * (plane * depth - seen[..., :2])).flatten(1))
    matrix, value = torch.cat(matrices, 1), torch.cat(values, 1)
    # A little of everything: cameras that show no depth leave one direction open.
    place = torch.linalg.solve(
        matrix.mT @ matrix + 1e-9 * torch.eye(3).to(arms), (matrix.mT @ value[..., None]).squeeze(-1)
    )
    dofs = pose.dofs.clone()
    dofs[:, :3] = _before(place, pictures[0])
    return HandPose(dofs=dofs, reference=pose.reference)


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
