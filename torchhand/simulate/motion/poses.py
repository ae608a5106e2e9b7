"""Motions made of single poses: as the user writes them, or drawn from the prior."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files.disk import suggestion
from torchhand.geometry import Camera
from torchhand.hand import DOFS, POSTURES, HandKinematics, HandPrior, Skeleton, posture
from torchhand.simulate.motion.motion import Motion, Staging, hand_length, perform, stage_before
from torchhand.simulate.motion.scripts import Course

_ROOT = 6
_LIMIT_SLACK = 1e-9


def parse_pose(text: str, skeleton: Skeleton) -> Float[Tensor, "36"]:
    """A posture and what differs from it: NAME,DOF=VALUE,... such as flat,index_mcp_fe=10.

    Joint angles and root_rx, root_ry, root_rz in degrees, root_tx, root_ty, root_tz in mm: turn and displacement of the
    middle of the hand in the axes of the camera. Raises InputError naming what is unknown or outside the limits.
    """
    name, *changes = [part.strip() for part in text.split(",")]
    if name not in POSTURES:
        allowed = ", ".join(POSTURES)
        raise InputError(f"--pose: {name!r} is no posture{suggestion(name, POSTURES)}; allowed: {allowed}")
    pose = posture(name, dtype=torch.float64)
    for change in changes:
        dof, sign, number = (part.strip() for part in change.partition("="))
        if dof not in DOFS:
            raise InputError(
                f"--pose: {dof!r} is no degree of freedom{suggestion(dof, DOFS)}; allowed: {', '.join(DOFS)}"
            )
        try:
            value = float(number) if sign else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(f"--pose: expected {dof}=NUMBER, got {change!r}")
        row = DOFS.index(dof)
        pose[row] = 1e-3 * value if dof.startswith("root_t") else math.radians(value)
        if row >= _ROOT:
            low, high = (float(ends[row - _ROOT]) for ends in (skeleton.lower, skeleton.upper))
            if not low - _LIMIT_SLACK <= float(pose[row]) <= high + _LIMIT_SLACK:
                allowed = f"{math.degrees(low):.4g} to {math.degrees(high):.4g} degrees"
                raise InputError(f"--pose: {dof}: expected {allowed}, got {value:g}")
    return pose


def posed_motion(
    poses: Sequence[Float[Tensor, "36"]],
    frames: int,
    kinematics: HandKinematics,
    camera: Camera,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    staging: Staging | None = None,
) -> Motion:
    """Through the poses of `parse_pose` one after the other, evenly; as many frames as poses: each once.

    Raises InputError for fewer frames than poses.
    """
    if frames < len(poses):
        raise InputError(f"--frames: expected {len(poses)} or more, one for each --pose, got {frames}")
    place = torch.linspace(0, len(poses) - 1, frames, dtype=torch.float64)
    before = place.floor().clamp_max(max(0, len(poses) - 2)).long()
    after = (before + 1).clamp_max(len(poses) - 1)
    known = torch.stack([pose.double() for pose in poses])
    course = torch.lerp(known[before], known[after], (place - before)[:, None])
    return _performed("poses", course, kinematics, camera, shape, staging)


def sampled_motion(
    prior: HandPrior,
    frames: int,
    kinematics: HandKinematics,
    camera: Camera,
    generator: torch.Generator,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    staging: Staging | None = None,
    turn_deg: float = 40.0,
) -> Motion:
    """Unrelated postures of the prior, one per frame, turned about any axis by up to `turn_deg`."""
    drawn, _ = prior.sample(frames, generator)
    axis = torch.nn.functional.normalize(torch.randn(frames, 3, generator=generator, dtype=torch.float64), dim=-1)
    amount = torch.rand(frames, 1, generator=generator, dtype=torch.float64)
    root = torch.cat((torch.zeros(frames, 3, dtype=torch.float64), math.radians(turn_deg) * amount * axis), -1)
    course = torch.cat((root, drawn[:, _ROOT:].double()), -1)
    return _performed("sampled", course, kinematics, camera, shape, staging)


def _performed(
    name: str,
    course: Float[Tensor, "frames 36"],
    kinematics: HandKinematics,
    camera: Camera,
    shape: Tensor | None,
    staging: Staging | None,
) -> Motion:
    length, staging = hand_length(kinematics, shape), staging or Staging()
    stage = stage_before(camera, len(course), torch.Generator(), hand_length=length, staging=staging)
    path = Course(posture="flat", centre=course[:, :3], turn=course[:, 3:_ROOT])
    joints = kinematics.skeleton.within_limits(course[:, _ROOT:])
    return perform(name, path, joints, camera, hand_length=length, stage=stage, staging=staging)
