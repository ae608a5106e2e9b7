"""MPEG-4 BAP text files of one hand, written and read in both numberings (ISO/IEC 14496-2 and its draft).

Header `version name fps frames`; then per frame a line of flags, one per parameter, and a line with the frame's number
and the values of the flagged parameters; `#` begins a comment. Version 3.1 has 186 flags, 3.2 has 296 with the
extensions. A file's numbering is told by nothing but its numbers: ours say it in a comment, of others the parameters
that only one numbering has decide.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.files.disk import finite, read_lines_of, short, whole, write_text
from torchhand.hand import HandModel, Side
from torchhand.hand.conventions import LARGEST_ID, NUMBERINGS, Numbering, bap_ids, baps_of_pose, pose_of_baps

BapVersion = Literal["3.1", "3.2"]
FLAGS: dict[str, int] = {"3.1": 186, "3.2": 296}
_NUMBERING_COMMENT, _SIDE_COMMENT, _HELD_COMMENT = "# numbering", "# hand", "# held"
_MAX_FRAMES = 10_000_000
_LARGEST_VALUE = 1 << 31
_UNITS = {"1e-5 rad": 1.0, "1e-5 pi rad": torch.pi}
BapUnit = Literal["1e-5 rad", "1e-5 pi rad"]


def write_bap(
    clip: MotionClip, path: str | Path, *, numbering: Numbering = "final", version: BapVersion = "3.1"
) -> Float64[Tensor, "frames 30"]:
    """Write the file; returns what of each joint angle it could not hold, radians."""
    upright = clip.at_constant_rate().placed("y-up")
    baps = baps_of_pose(upright.poses, numbering, clip.side)
    ids = bap_ids(numbering, clip.side)
    order = sorted(range(len(baps.names)), key=lambda i: ids[baps.names[i]])
    flagged = {ids[name] for name in baps.names}
    mask = " ".join("1" if i in flagged else "0" for i in range(1, FLAGS[version] + 1))
    name = "_".join(clip.name.split()) or "hand"
    lines = [
        f"{_NUMBERING_COMMENT} {numbering}",
        f"{_SIDE_COMMENT} {clip.side}; 1e-5 rad and mm; HumanoidRoot is the hand frame, axes {clip.axes or 'y-up'}",
        *_held_comments(upright),
        f"{version} {name} {clip.fps:.9g} {len(upright)}",
    ]
    for frame, values in enumerate(baps.values[:, order].tolist()):
        lines += [mask, " ".join(map(str, (frame, *values)))]
    write_text(Path(path), "\n".join(lines) + "\n")
    return baps.residual


def _held_comments(clip: MotionClip) -> list[str]:
    """Places of the frames that repeat another's pose because their own was lost."""
    held = [str(place) for place, is_own in enumerate(clip.is_own) if not is_own]
    return [f"{_HELD_COMMENT} {' '.join(held)}"] if held else []


@dataclass(frozen=True, kw_only=True)
class BapMotion:
    """What a BAP file holds."""

    version: str
    """Version of the file, 3.1 or 3.2."""
    name: str
    fps: float
    held: tuple[int, ...]
    """Places of the frames that repeat another's pose, by the file's own comment."""
    declared: str | None
    """The numbering that the file's own comment names, if any."""
    flagged: tuple[int, ...]
    """Parameters that any frame has, increasing."""
    values: Float64[Tensor, "frames flagged"]
    """Values in the file's units. A parameter without a flag in a frame keeps its last value, 0 before the first."""


def read_bap(path: str | Path) -> BapMotion:
    """Any BAP text file, of either numbering. Raises InputError naming the line, what was expected and what was got."""
    path = Path(path)
    lines = [line.strip() for line in read_lines_of(path, "a BAP file")]
    comments = [line for line in lines if line.startswith("#")]
    declared = [
        line.removeprefix(_NUMBERING_COMMENT).strip() for line in comments if line.startswith(_NUMBERING_COMMENT)
    ]
    content = [(line.split(), i) for i, line in enumerate(lines, start=1) if line and not line.startswith("#")]
    if not content or len(content[0][0]) != 4 or content[0][0][0] not in FLAGS:
        got = short(" ".join(content[0][0][:4])) if content else "an empty file"
        raise InputError(f"{path}: expected a BAP file that begins with '3.1 NAME FPS FRAMES' or '3.2 …', got {got}")
    (version, name, rate, count), i = content[0]
    fps, frames = finite(f"{path}, line {i}", rate), whole(f"{path}, line {i}", count)
    if not 0 < fps <= 1e6 or not 1 <= frames <= _MAX_FRAMES:
        raise InputError(f"{path}, line {i}: expected a rate above 0 and one frame or more, got {rate} and {count}")
    words = [(word, i) for row, i in content[1:] for word in row][::-1]
    flags = FLAGS[version]
    current: dict[int, float] = {}
    rows: list[dict[int, float]] = []
    for frame in range(frames):
        mask = _taken(path, words, flags, f"the {flags} flags of version {version}", frame, frames)
        for word, i in mask:
            if word not in ("0", "1"):
                raise InputError(
                    f"{path}, line {i}: expected {flags} flags 0 or 1 (version {version}), got {short(word)}"
                )
        ids = [k for k, (word, _) in enumerate(mask, start=1) if word == "1"]
        (number, i), *data = _taken(path, words, 1 + len(ids), f"a frame number and {len(ids)} values", frame, frames)
        if data and data[-1][1] != i:
            raise InputError(
                f"{path}, line {i}: expected {flags} flags, then a frame number and {len(ids)} values on one line,"
                " got too few of either"
            )
        if whole(f"{path}, line {i}", number) < 0:
            raise InputError(f"{path}, line {i}: expected a frame number of 0 or more, got {number}")
        for k, (word, line) in zip(ids, data, strict=True):
            value = finite(f"{path}, line {line}", word)
            if abs(value) > _LARGEST_VALUE:
                raise InputError(f"{path}, line {line}: expected values within ±2^31, got {short(word)}")
            current[k] = value
        rows.append(dict(current))
    if words:
        raise InputError(
            f"{path}, line {words[-1][1]}: expected the end after {frames} frames, got {short(words[-1][0])}"
        )
    flagged = tuple(sorted(current))
    return BapMotion(
        version=version,
        name=name,
        fps=fps,
        held=_held(comments, frames),
        declared=declared[0] if declared else None,
        flagged=flagged,
        values=torch.tensor([[row.get(k, 0.0) for k in flagged] for row in rows], dtype=torch.float64).reshape(
            frames, -1
        ),
    )


def clip_of_bap(
    path: str | Path,
    model: HandModel,
    shape: Float64[Tensor, "shape"] | None = None,
    *,
    numbering: Numbering = "final",
    side: Side | None = None,
    unit: BapUnit = "1e-5 rad",
) -> MotionClip:
    """The motion of one hand in a BAP file of this numbering.

    side: which hand; the one that the file has where it is None. unit: of the angles; some programs take those of
    version 3.2 for 1e-5 · π radians.

    Raises InputError for a file of the other numbering and for one without that hand.
    """
    path = Path(path)
    motion = read_bap(path)
    _check_numbering(path, motion, numbering)
    sides: tuple[Side, ...] = ("right", "left")
    has: list[Side] = [s for s in sides if set(_joint_ids(numbering, s)) & set(motion.flagged)]
    if side is None and len(has) == 2:
        raise InputError(f"{path}: expected one hand, got both; say which one")
    if not has or (side is not None and side not in has):
        got = " and ".join(has) or "none"
        raise InputError(f"{path}: expected angles of a {side or 'left or right'} hand, got {got}")
    own: Side = side or has[0]
    ids = bap_ids(numbering, own)
    column = {k: motion.values[:, i] for i, k in enumerate(motion.flagged)}
    zero = torch.zeros(len(motion.values), dtype=torch.float64)
    values = torch.stack([column.get(k, zero) for k in ids.values()], -1)
    is_angle = torch.tensor([not name.startswith("tr_") for name in ids])
    values = torch.where(is_angle, values * _UNITS[unit], values)
    return MotionClip(
        model=model,
        side=own,
        shape=model.shape_space.default.double() if shape is None else shape,
        poses=pose_of_baps(values.round().long(), numbering, own),
        fps=motion.fps,
        held=motion.held,
        name=motion.name,
        up="y",
    )


def _held(comments: list[str], frames: int) -> tuple[int, ...]:
    """Places that the comment of held frames names, those beyond the end left out."""
    words = [word for line in comments if line.startswith(_HELD_COMMENT) for word in line.split()[2:]]
    return tuple(place for place in (int(word) for word in words if word.isdecimal()) if place < frames)


def _taken(
    path: Path, words: list[tuple[str, int]], count: int, what: str, frame: int, frames: int
) -> list[tuple[str, int]]:
    if len(words) < count:
        raise InputError(
            f"{path}: expected {what} in frame {frame} of {frames}, got the end of the file: it is cut short"
        )
    taken = words[: -count - 1 : -1]
    del words[-count:]
    return taken


def _joint_ids(numbering: Numbering, side: Side) -> list[int]:
    return [k for name, k in bap_ids(numbering, side).items() if not name.startswith(("tr_", "rt_"))]


def _check_numbering(path: Path, motion: BapMotion, numbering: Numbering) -> None:
    """Raise InputError where the file says, or its parameters show, that its numbering is the other one."""
    found, why = motion.declared, "it says so"
    if found is None:
        flagged = set(motion.flagged)
        fits = {n: sum(len(_only_whole(n, s, flagged)) for s in ("left", "right")) for n in NUMBERINGS}
        beyond = [k for k in flagged if LARGEST_ID["draft"] < k <= LARGEST_ID["final"]]
        found = (
            "final"
            if beyond or fits["final"] > fits["draft"]
            else "draft"
            if fits["draft"] > fits["final"]
            else numbering
        )
        why = f"parameter {beyond[0]} is" if beyond else "its parameters are a whole hand's there"
    if found != numbering:
        raise InputError(
            f"{path}: expected a BAP file of the {numbering} numbering, got one of the {short(found)} numbering"
            f" ({why}); read it as that one (allowed: {', '.join(NUMBERINGS)})"
        )


def _only_whole(numbering: Numbering, side: Side, flagged: set[int]) -> set[int]:
    """A hand's parameters where a file has all of them."""
    ids = set(_joint_ids(numbering, side))
    return ids if ids <= flagged else set()
