"""A hand in motion as a record: what every exporter writes, whatever it was tracked or composed from."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand import DOFS, Hand, HandFrames, HandKinematics, HandModel, Side, Skeleton
from torchhand.hand.kinematics import sided_skeleton

Up = Literal["y", "-y", "z", "-z"]
_FRAMES_AT_ONCE = 64

_Y_UP_FROM = {
    "y": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "-y": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "z": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
    "-z": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
}
"""Rotation from a frame in which that axis points up to one in which y does."""


@dataclass(frozen=True, kw_only=True)
class MotionClip:
    """One hand over time: whole poses at a constant rate, no gaps."""

    model: HandModel
    side: Side
    shape: Float64[Tensor, "shape"]
    """Parameters of the model's shape space."""
    poses: Float64[Tensor, "frames 36"]
    """Metres and radians in the order of DOFS; the rotation vector is the whole rotation."""
    fps: float
    """Frames per second."""
    frame: tuple[int, ...] = ()
    """Number of each frame in its source; 0, 1, 2 ... where it is not given."""
    held: tuple[int, ...] = ()
    """Numbers of the frames that repeat another's pose because their own was lost."""
    name: str = "hand"
    up: Up = "-y"
    """Axis of the poses' frame that points up: -y in the frame of a camera."""
    names: tuple[str, ...] = field(default=DOFS)
    """Names of the poses' columns: DOFS."""
    pose_std: Float64[Tensor, "frames 36"] | None = None
    """Standard deviations of the poses, where they are known; NaN in frames without an estimate."""
    finger_quality: Float64[Tensor, "frames 5"] | None = None
    """Probability that each fingertip is right, thumb to little, where it is known; NaN in frames without an
    estimate."""
    status: tuple[str, ...] = ()
    """What the tracker said of each frame; empty where nothing was tracked."""

    def __post_init__(self) -> None:
        if self.names != DOFS:
            raise ValueError(f"names: expected the {len(DOFS)} of DOFS in their order, got others")
        if not len(self.poses):
            raise ValueError("poses: expected one frame or more, got none")
        if not bool(self.poses.isfinite().all()):
            row = int((~self.poses.isfinite()).any(-1).nonzero()[0])
            raise ValueError(f"poses: expected finite numbers, got NaN or infinite ones in frame {row}")
        if not 0 < self.fps <= 1e6:
            raise ValueError(f"fps: expected more than 0, 1e6 at most, got {self.fps:g}")
        if self.up not in _Y_UP_FROM:
            raise ValueError(f"up: expected one of {', '.join(_Y_UP_FROM)}, got {self.up!r}")
        if not self.frame:
            object.__setattr__(self, "frame", tuple(range(len(self.poses))))
        if len(self.frame) != len(self.poses):
            raise ValueError(f"frame: expected {len(self.poses)} numbers, one per pose, got {len(self.frame)}")
        if self.status and len(self.status) != len(self.poses):
            raise ValueError(f"status: expected {len(self.poses)}, one per pose, got {len(self.status)}")
        self.model.shape_space.check(self.shape)

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def seconds(self) -> Float64[Tensor, "frames"]:
        """When each frame is shown; the first at 0."""
        return torch.arange(len(self), dtype=torch.float64) / self.fps

    @cached_property
    def hand(self) -> Hand:
        """The hand of this side and shape, float64."""
        return self.model.hand(self.shape, side=self.side, dtype=torch.float64)

    @property
    def kinematics(self) -> HandKinematics:
        return self.hand.kinematics

    @cached_property
    def frames(self) -> HandFrames:
        """Bones and keypoints of all frames, in the poses' own frame."""
        return self.kinematics(self.poses, self.shape)

    @cached_property
    def skeleton(self) -> Skeleton:
        """The skeleton of this side and shape, float64."""
        skeleton = self.model.skeleton.to(dtype=torch.float64)
        return sided_skeleton(skeleton, self.side, space=self.model.shape_space, shape=self.shape)

    def vertices(self) -> Float64[Tensor, "frames vertices 3"]:
        """The skin of all frames, in the poses' own frame."""
        parts = [self.hand(poses, self.shape).vertices for poses in self.poses.split(_FRAMES_AT_ONCE)]
        return torch.cat([part.contiguous() for part in parts])

    def with_up(self, up: Literal["y", "z"]) -> "MotionClip":
        """The same motion in a frame turned (about x) so that this axis points up."""
        turn = torch.tensor(_Y_UP_FROM[up], dtype=torch.float64).T @ torch.tensor(
            _Y_UP_FROM[self.up], dtype=torch.float64
        )
        poses = self.poses.clone()
        poses[:, :3] = self.poses[:, :3] @ turn.T
        poses[:, 3:6] = vector_from_rotation(turn @ rotation_from_vector(self.poses[:, 3:6]))
        return replace(self, poses=poses, up=up)

    def only(self, frame: int) -> "MotionClip":
        """The clip of the one frame with this number in its source. Raises ValueError where there is none."""
        if frame not in self.frame:
            allowed = f"{self.frame[0]} to {self.frame[-1]}"
            raise ValueError(f"frame: expected the number of a frame in the clip, {allowed}, got {frame}")
        place = self.frame.index(frame)
        rows = slice(place, place + 1)
        return replace(
            self,
            poses=self.poses[rows],
            frame=(frame,),
            held=tuple({frame} & set(self.held)),
            pose_std=None if self.pose_std is None else self.pose_std[rows],
            finger_quality=None if self.finger_quality is None else self.finger_quality[rows],
            status=self.status[rows],
        )


def rest_clip(
    model: HandModel, side: Side, shape: Float[Tensor, "shape"] | None = None, *, name: str = "hand", fps: float = 30.0
) -> MotionClip:
    """One frame of the hand as its mesh is made: open, the wrist at the origin, fingers up (y), the palm facing z."""
    if model.mesh is None:
        raise ValueError(f"model: expected one with a mesh, {model.name!r} has none")
    values = model.shape_space.default if shape is None else shape
    pose = model.mesh.bind_pose.double()[None].clone()
    pose[:, 4] = 0.5 * math.pi
    return MotionClip(model=model, side=side, shape=values.double(), poses=pose, fps=fps, name=name, up="y")
