"""BVH files read: any skeleton as a record, and a hand's motion as a clip of ours."""

from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.conventions.bvh import CENTIMETRES, held_path
from torchhand.export.conventions.bvh_names import bvh_names, known_names
from torchhand.files.disk import finite, read_json, read_lines_of, short, whole
from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandModel
from torchhand.hand.conventions import BoneFit, bone_rotations, fit_bones, rest_rotations

_POSITIONS = ("xposition", "yposition", "zposition")
_ROTATIONS = ("xrotation", "yrotation", "zrotation")
_DEEPEST = 200


@dataclass(frozen=True, kw_only=True)
class BvhMotion:
    """What a BVH file holds, in its own units (usually centimetres) and degrees."""

    names: tuple[str, ...]
    """Joints in the file's order; End Sites are left out."""
    parents: tuple[int, ...]
    offsets: Float64[Tensor, "joints 3"]
    channels: tuple[tuple[str, ...], ...]
    """Channels of each joint, in small letters."""
    values: Float64[Tensor, "frames channels"]
    frame_time: float
    """Time of a frame, seconds."""

    def rotations(self) -> Float64[Tensor, "frames joints 3 3"]:
        """parent_from_joint: the product of the rotations in the order in which the channels stand."""
        joints, column = [], 0
        for channels in self.channels:
            turn = torch.eye(3, dtype=torch.float64).expand(len(self.values), 3, 3)
            for channel in channels:
                if channel in _ROTATIONS:
                    axis = torch.eye(3, dtype=torch.float64)[_ROTATIONS.index(channel)]
                    turn = turn @ rotation_from_vector(torch.deg2rad(self.values[:, column, None]) * axis)
                column += 1
            joints.append(turn)
        return torch.stack(joints, 1)

    def positions(self, joint: int) -> Float64[Tensor, "frames 3"]:
        """What the position channels of a joint say, 0 where it has none."""
        start = sum(len(channels) for channels in self.channels[:joint])
        own = self.channels[joint]
        columns = [
            self.values[:, start + own.index(name)] if name in own else 0 * self.values[:, 0] for name in _POSITIONS
        ]
        return torch.stack(columns, -1)


def read_bvh(path: str | Path) -> BvhMotion:
    """Any BVH file. Raises InputError naming the file, the line, what was expected and what was got."""
    return _Reader(Path(path)).read()


def clip_of_bvh(
    path: str | Path, model: HandModel, shape: Float64[Tensor, "shape"] | None = None
) -> tuple[MotionClip, BoneFit]:
    """The motion of a file whose joints have the names of `bvh_names`, and how well our joints could follow it.

    The hand's proportions are those of `shape` (the default ones without), not the file's.

    Raises InputError for a file that is no BVH, or of another skeleton than a hand.
    """
    path = Path(path)
    motion = read_bvh(path)
    found = [known for name, known in known_names().items() if name in motion.names]
    if not found:
        allowed = ", ".join(known_names())
        raise InputError(
            f"{path}: expected the joints of a hand, its wrist named one of {allowed}; got {short(motion.names[0])}"
        )
    side, kind = found[0]
    names = bvh_names(side, kind)
    if missing := [name for name in names if name not in motion.names]:
        raise InputError(f"{path}: expected the {len(names)} joints of a hand, lacks {', '.join(missing[:5])}")
    wrist = motion.names.index(names[0])
    if motion.parents[wrist] >= 0:
        raise InputError(f"{path}: expected {names[0]} as the ROOT, got it below {motion.names[motion.parents[wrist]]}")
    index = [motion.names.index(name) for name in names]
    shape = model.shape_space.default.double() if shape is None else shape
    kinematics = model.kinematics(side, dtype=torch.float64)
    rotation = bone_rotations(motion.rotations()[:, index], rest_rotations(kinematics))
    fit = fit_bones(kinematics, rotation, (motion.positions(wrist) + motion.offsets[wrist]) / CENTIMETRES)
    clip = MotionClip(
        model=model,
        side=side,
        shape=shape,
        poses=fit.pose,
        fps=1 / motion.frame_time,
        held=_held(path, len(fit.pose)),
        name=path.stem,
        up="y",
    )
    return clip, fit


def _held(path: Path, frames: int) -> tuple[int, ...]:
    """Held frames as the file beside it lists them."""
    beside = held_path(path)
    content = read_json(beside) if beside.is_file() else {}
    listed = content.get("held") if isinstance(content, dict) else None
    places = listed if isinstance(listed, list) else []
    return tuple(place for place in places if isinstance(place, int) and 0 <= place < frames)


class _Reader:
    """Goes through the words of the hierarchy, then through the lines of the motion."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines = read_lines_of(path, "a BVH file")
        self.words: list[tuple[str, int]] = []
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[list[float]] = []
        self.channels: list[tuple[str, ...]] = []

    def read(self) -> BvhMotion:
        start = next((i for i, line in enumerate(self.lines) if line.split()), 0)
        first = self.lines[start].split() if self.lines else []
        if not first or first[0] != "HIERARCHY":
            raise InputError(
                f"{self.path}: expected a BVH file that begins with HIERARCHY, got {short(' '.join(first[:3]))}"
            )
        motion = next((i for i, line in enumerate(self.lines) if line.split()[:1] == ["MOTION"]), None)
        if motion is None:
            raise InputError(f"{self.path}: expected MOTION after the hierarchy, got the end of the file")
        self.words = [(word, i + 1) for i in range(start, motion) for word in self.lines[i].split()][:0:-1]
        self._take("ROOT")
        self._joint(-1, depth=0)
        if self.words:
            raise InputError(f"{self._where()}: expected MOTION after the one ROOT, got {short(self.words[-1][0])}")
        values, frame_time = self._motion(motion + 1)
        return BvhMotion(
            names=tuple(self.names),
            parents=tuple(self.parents),
            offsets=torch.tensor(self.offsets, dtype=torch.float64),
            channels=tuple(self.channels),
            values=values,
            frame_time=frame_time,
        )

    def _joint(self, parent: int, *, depth: int) -> None:
        if depth > _DEEPEST:
            raise InputError(f"{self._where()}: expected joints nested {_DEEPEST} deep at most, got more")
        own = len(self.names)
        name = self._take()
        if name in self.names:
            raise InputError(f"{self._where()}: expected each joint once, got {short(name)} again")
        self.names.append(name)
        self.parents.append(parent)
        self._take("{")
        self._take("OFFSET")
        self.offsets.append([finite(self._where(), self._take()) for _ in range(3)])
        self._take("CHANNELS")
        count = whole(self._where(), self._take())
        if not 0 <= count <= 6:
            raise InputError(f"{self._where()}: expected 0 to 6 channels, got {count}")
        channels = tuple(self._take().lower() for _ in range(count))
        for channel in channels:
            if channel not in _POSITIONS + _ROTATIONS:
                raise InputError(f"{self._where()}: expected channels Xposition … Zrotation, got {short(channel)}")
        self.channels.append(channels)
        while (word := self._take()) != "}":
            if word == "JOINT":
                self._joint(own, depth=depth + 1)
            elif word == "End":
                for expected in ("Site", "{", "OFFSET"):
                    self._take(expected)
                for _ in range(3):
                    finite(self._where(), self._take())
                self._take("}")
            else:
                raise InputError(f"{self._where()}: expected JOINT, End Site or }}, got {short(word)}")

    def _take(self, expected: str | None = None) -> str:
        if not self.words:
            raise InputError(
                f"{self.path}: expected {expected or 'more'} in the hierarchy, got MOTION: it is cut short"
            )
        word, self._line = self.words.pop()
        if expected is not None and word != expected:
            raise InputError(f"{self._where()}: expected {expected}, got {short(word)}")
        return word

    def _where(self) -> str:
        return f"{self.path}, line {self._line if hasattr(self, '_line') else self.words[-1][1]}"

    def _motion(self, start: int) -> tuple[Tensor, float]:
        lines = [(line.split(), i + 1) for i, line in enumerate(self.lines[start:], start=start) if line.split()]
        if len(lines) < 2 or lines[0][0][:1] != ["Frames:"] or lines[1][0][:2] != ["Frame", "Time:"]:
            raise InputError(f"{self.path}: expected 'Frames: N' and 'Frame Time: SECONDS' after MOTION, got others")
        (frames_line, i), (time_line, j) = lines[:2]
        count = whole(f"{self.path}, line {i}", frames_line[1] if len(frames_line) == 2 else "")
        frame_time = finite(f"{self.path}, line {j}", time_line[2] if len(time_line) == 3 else "")
        if count < 1 or not 1e-6 <= frame_time <= 1e6:
            raise InputError(
                f"{self.path}: expected one frame or more and a time above 0, got {count} and {frame_time:g} s"
            )
        width = sum(len(channels) for channels in self.channels)
        rows = []
        for words, number in lines[2:]:
            if len(words) != width:
                raise InputError(
                    f"{self.path}, line {number}: expected {width} numbers, one per channel, got {len(words)}"
                )
            rows.append([finite(f"{self.path}, line {number}", word) for word in words])
        if len(rows) != count:
            raise InputError(f"{self.path}: expected {count} frames as 'Frames:' says, got {len(rows)}")
        return torch.tensor(rows, dtype=torch.float64).reshape(count, width), frame_time
