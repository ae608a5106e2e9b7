"""A hand in motion as a record: what every exporter writes, whatever it was tracked or composed from."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand import DOFS, Hand, HandFrames, HandKinematics, HandModel, Side, Skeleton
from torchhand.hand.conventions import mano_from_hand
from torchhand.hand.kinematics import sided_skeleton

Up = Literal["y", "-y", "z", "-z"]
Axes = Literal["camera", "y-up", "z-up", "wrist", "mano"]
"""Frame of an export: that of the track (a camera's: OpenCV), one with y or z up, the hand's own (wrist at the origin,
x out of the back of the hand, y towards the fingers), or the wrist's with MANO's axes (fingers along -x of the right
hand, back of the hand to y)."""
_FRAMES_AT_ONCE = 64
_STEADY = 0.05
"""Share of an interval by which times may be off those of the rate."""
MAX_GAP_S = 10.0
"""A still hand for so long tells that it is lost; more of it is as long a file for nothing."""
_LARGEST_GAP_S = 86_400.0
MISSING = "missing"
"""Status of a frame whose number the track leaves out: it repeats the pose before it."""

_Y_UP_FROM = {
    "y": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "-y": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "z": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
    "-z": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
}
"""Rotation from a frame in which that axis points up to one in which y does."""


@dataclass(frozen=True, kw_only=True)
class MotionClip:
    """One hand over time: whole poses, no gaps."""

    model: HandModel
    side: Side
    shape: Float64[Tensor, "shape"]
    """Parameters of the model's shape space."""
    poses: Float64[Tensor, "frames 36"]
    """Metres and radians in the order of DOFS; the rotation vector is the whole rotation."""
    fps: float
    """Frames per second; the usual rate where `time_s` tells another."""
    time_s: tuple[float, ...] = ()
    """When each frame was taken, seconds, increasing; by the rate and the frames' numbers where it is not given."""
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
    keypoints_cov: Float64[Tensor, "frames 21 3 3"] | None = None
    """Covariances of the keypoints in the poses' frame, m², where they are known; NaN in frames without an estimate."""
    finger_quality: Float64[Tensor, "frames 5"] | None = None
    """Probability that each fingertip is right, thumb to little, where it is known; NaN in frames without an
    estimate."""
    status: tuple[str, ...] = ()
    """What the tracker said of each frame; empty where nothing was tracked."""
    notes: tuple[str, ...] = ()
    """What a user should know of how the clip came about, such as what was lost when another format was read."""
    axes: Axes | None = None
    """Frame that is asked of exports; each format's usual one where it is None."""
    max_gap_s: float = MAX_GAP_S
    """Longest time between two frames that formats of one rate keep, seconds, above 0, a day at most: longer gaps, in
    which nothing was tracked, become so long."""

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
        if self.time_s and len(self.time_s) != len(self.poses):
            raise ValueError(f"time_s: expected {len(self.poses)} times, one per pose, got {len(self.time_s)}")
        if any(after <= before for before, after in pairwise(self.time_s)):
            raise ValueError("time_s: expected increasing times, got others")
        if self.status and len(self.status) != len(self.poses):
            raise ValueError(f"status: expected {len(self.poses)}, one per pose, got {len(self.status)}")
        check_max_gap(self.max_gap_s)
        self.model.shape_space.check(self.shape)

    def __len__(self) -> int:
        return len(self.poses)

    @cached_property
    def seconds(self) -> Float64[Tensor, "frames"]:
        """When each frame is shown; the first at 0."""
        if self.time_s:
            return torch.tensor([time - self.time_s[0] for time in self.time_s], dtype=torch.float64)
        return torch.tensor([number - self.frame[0] for number in self.frame], dtype=torch.float64) / self.fps

    @cached_property
    def is_own(self) -> tuple[bool, ...]:
        """Whether each frame's pose is its own, not one held because its own was lost."""
        held = set(self.held)
        return tuple(number not in held for number in self.frame)

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
        return replace(self, poses=poses, up=up, keypoints_cov=self._turned_cov(turn))

    def placed(self, usual: Axes) -> "MotionClip":
        """The same motion in the frame that is asked for (`axes`), or in a format's usual one."""
        axes = self.axes or usual
        if axes == "camera":
            return self
        if axes in ("y-up", "z-up"):
            return self.with_up("y" if axes == "y-up" else "z")
        turn = torch.eye(3, dtype=torch.float64) if axes == "wrist" else mano_from_hand(self.side)
        own_from_poses = turn @ rotation_from_vector(self.poses[:, 3:6]).mT
        poses = self.poses.clone()
        poses[:, :3], poses[:, 3:6] = 0.0, vector_from_rotation(turn)
        return replace(self, poses=poses, up="y", keypoints_cov=self._turned_cov(own_from_poses))

    def at_constant_rate(self) -> "MotionClip":
        """The same motion at its rate throughout, for formats that know no times: in between poses are interpolated.

        Itself where its times are those of the rate; else frames are numbered by the rate, and a frame is held where
        the nearest one that was taken is. Gaps longer than `max_gap_s` become so long (`gap_notes`).
        """
        if self._gaps().numel():
            return self._without_long_gaps().at_constant_rate()
        seconds = self.seconds
        grid = torch.arange(round(float(seconds[-1]) * self.fps) + 1, dtype=torch.float64) / self.fps
        if len(grid) == len(seconds) and float((grid - seconds).abs().max()) * self.fps < _STEADY:
            return self
        after = torch.searchsorted(seconds, grid).clamp(1, len(seconds) - 1)
        start, end = self.poses[after - 1], self.poses[after]
        share = ((grid - seconds[after - 1]) / (seconds[after] - seconds[after - 1])).clamp(0, 1)[:, None]
        poses = start + share * (end - start)
        first = rotation_from_vector(start[:, 3:6])
        rest = vector_from_rotation(first.mT @ rotation_from_vector(end[:, 3:6]))
        poses[:, 3:6] = vector_from_rotation(first @ rotation_from_vector(share * rest))
        nearest = torch.where(share[:, 0] < 0.5, after - 1, after).tolist()
        number = range(self.frame[0], self.frame[0] + len(grid))
        return MotionClip(
            model=self.model,
            side=self.side,
            shape=self.shape,
            poses=poses,
            fps=self.fps,
            frame=tuple(number),
            held=tuple(n for n, place in zip(number, nearest, strict=True) if not self.is_own[place]),
            name=self.name,
            up=self.up,
            axes=self.axes,
            max_gap_s=self.max_gap_s,
        )

    def gap_notes(self) -> list[str]:
        """One line where `at_constant_rate` shortens gaps, else none."""
        gaps = self._gaps()
        if not gaps.numel():
            return []
        early = float((gaps - self._longest_gap_s).sum())
        return [
            f"{len(gaps)} gap(s) without frames, {float(gaps.max()):.1f} s the longest, last {self.max_gap_s:g} s here"
            f" (--max-gap-s): what follows comes up to {early:.1f} s early"
        ]

    def _taken(self) -> Tensor:
        """Places of the frames that the track has, with a hand or without."""
        places = [place for place in range(len(self)) if self.status[place : place + 1] != (MISSING,)]
        return torch.tensor(places, dtype=torch.int64)

    @property
    def _longest_gap_s(self) -> float:
        """One frame of the rate at least."""
        return max(self.max_gap_s, 1 / self.fps)

    def _gaps(self) -> Float64[Tensor, "gaps"]:
        """Times between frames of the track that are too long."""
        lengths = self.seconds[self._taken()].diff()
        return lengths[lengths > self._longest_gap_s + _STEADY / self.fps]

    def _without_long_gaps(self) -> "MotionClip":
        """The clip with its long gaps shortened; of what is held in them, their beginning stays."""
        taken, seconds = self._taken(), self.seconds
        excess = (seconds[taken].diff() - self._longest_gap_s).clamp(min=0.0)
        early = torch.cat((excess.new_zeros(1), excess.cumsum(0)))
        before = torch.searchsorted(taken, torch.arange(len(self)), right=True) - 1
        kept = (seconds - seconds[taken[before]] < self._longest_gap_s - 0.5 / self.fps).nonzero().squeeze(-1)
        return replace(self._at(kept.tolist()), time_s=tuple((seconds - early[before])[kept].tolist()))

    def _turned_cov(self, turn: Tensor) -> Tensor | None:
        if self.keypoints_cov is None:
            return None
        turns = turn[..., None, :, :]
        return turns @ self.keypoints_cov @ turns.mT

    def only(self, frame: int) -> "MotionClip":
        """The clip of the one frame with this number in its source. Raises ValueError where there is none."""
        if frame not in self.frame:
            allowed = f"{self.frame[0]} to {self.frame[-1]}"
            raise ValueError(f"frame: expected the number of a frame in the clip, {allowed}, got {frame}")
        return self._at([self.frame.index(frame)])

    def _at(self, places: list[int]) -> "MotionClip":
        """The clip of the frames at these places."""
        frames = tuple(self.frame[place] for place in places)
        held = set(self.held)
        return replace(
            self,
            poses=self.poses[places],
            frame=frames,
            time_s=tuple(self.time_s[place] for place in places) if self.time_s else (),
            keypoints_cov=None if self.keypoints_cov is None else self.keypoints_cov[places],
            held=tuple(number for number in frames if number in held),
            pose_std=None if self.pose_std is None else self.pose_std[places],
            finger_quality=None if self.finger_quality is None else self.finger_quality[places],
            status=tuple(self.status[place] for place in places) if self.status else (),
        )


def check_max_gap(seconds: float, name: str = "max_gap_s") -> None:
    """Raise ValueError where this cannot be a clip's `max_gap_s`. name: what the error calls it."""
    if not 0 < seconds <= _LARGEST_GAP_S:
        raise ValueError(f"{name}: expected more than 0, {_LARGEST_GAP_S:g} (a day) at most, got {seconds:g}")


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
