"""What tracking found: one `FrameRecord` per frame while it runs, one `Track` of arrays afterwards."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Float64, Int, Shaped

from torchhand.files.disk import short

FrameStatus = Literal["tracked", "lost", "recovered", "no_hand"]
STATUSES: tuple[FrameStatus, ...] = get_args(FrameStatus)
EMPTY_STATUSES = ("lost", "no_hand")
"""Frames of these hold NaN."""
ARRAY_FIELDS = ("pose", "pose_std", "keypoints3d", "keypoints2d", "keypoints3d_cov", "finger_quality")
MISSING_FIELDS = ("keypoints2d", "finger_quality")
"""Those that a track may lack."""
DETERMINED = 0.5
"""Quality from which on a finger is called determined: it is more likely right than wrong."""
OF_PICTURES = ("image", "side", "shape", "shape_names", "K")
"""What poses.npz has besides: of every picture its name, the hand's side and proportions, the camera's intrinsics."""
WANTED_END = "wanted_end"
"""In the arrays of a run that has ended well: number of the frame after the last one that was wanted; -1 for all."""
RESERVED_NAMES = (
    *("frame", "time_s", "status", "seconds", "reason", *ARRAY_FIELDS, "dof_names", "units", "convention", "header"),
    *(WANTED_END, *OF_PICTURES),
)
"""In a line of track.jsonl and in track.npz, every other name is that of a measure."""

TRACK_FORMAT = "torchhand track 2"
UNITS = "metres, radians, seconds; keypoints2d px"
CONVENTION = (
    "camera frame of OpenCV: x right, y down, z forward; the centre of the first pixel is (0, 0); root rotation is a"
    " rotation vector of length pi at most, whose sign may change from frame to frame where it is pi; flexion is"
    " positive; keypoints: wrist, then thumb, index, middle, ring, little from base to tip"
)
_KEYPOINTS, _FINGERS = 21, 5
_KIND_OF = {"frame": "iu", "status": "U", "reason": "U", "image": "U"}
_KINDS = {"f": "floating-point numbers", "iu": "whole numbers", "U": "texts"}


@dataclass(frozen=True, kw_only=True)
class TrackHeader:
    """What holds for all frames of a track; a run is resumed only with an equal header."""

    dof_names: tuple[str, ...]
    source: str
    """The input as the user named it."""
    side: str
    """Side of the hand: left or right."""
    camera: Mapping[str, Any]
    """Identity of the camera: name, size, numbers, whether it was assumed. Values that JSON knows."""
    units: str = UNITS
    convention: str = CONVENTION
    made_with: Mapping[str, Any] = field(default_factory=dict)
    """Version, seed, settings, start: whatever changes the result. Values that JSON knows."""

    def as_json(self) -> dict[str, Any]:
        """What header.json holds, as it reads back."""
        return json.loads(json.dumps({"format": TRACK_FORMAT, **vars(self)}, default=str))


@dataclass(frozen=True, kw_only=True)
class FrameRecord:
    """The estimate of one frame."""

    frame: int
    """Index in the source, from 0."""
    status: FrameStatus
    pose: Float[np.ndarray, "dofs"]
    """DOFs in the order of the header's dof_names, metres and radians."""
    pose_std: Float[np.ndarray, "dofs"]
    """Standard deviation of each DOF."""
    keypoints3d: Float[np.ndarray, "21 3"]
    """Keypoints in space, metres, camera frame (world frame for several cameras)."""
    keypoints2d: Float[np.ndarray, "21 2"] | None
    """Keypoints in the picture, px; None for several cameras."""
    keypoints3d_cov: Float[np.ndarray, "21 3 3"]
    """Covariances of the keypoints in space, m²."""
    seconds: float
    """Compute time of the frame."""
    finger_quality: Float[np.ndarray, "5"] | None = None
    """Probability that each fingertip, thumb to little, is where it is said to be (`Track.finger_quality`); None where
    nobody tells."""
    time_s: float | None = None
    """When the frame is shown or was taken, seconds since the source's first one; None where nobody tells."""
    measures: Mapping[str, float] = field(default_factory=dict)
    """Further numbers by name, such as how well the model fits; NaN where unknown. The same names in every frame."""
    reason: str | None = None
    """Why a frame is lost or without a hand, empty otherwise; None in all frames where nobody gives reasons."""

    def __post_init__(self) -> None:
        if taken := [name for name in self.measures if name in RESERVED_NAMES]:
            raise ValueError(f"measures: expected names that are not those of the record, got {taken[0]!r}")
        if self.status not in STATUSES:
            raise ValueError(f"status: expected one of {', '.join(STATUSES)}, got {self.status!r}")
        if self.status in EMPTY_STATUSES:
            arrays = {name: getattr(self, name) for name in ARRAY_FIELDS}
            stale = [name for name, array in arrays.items() if array is not None and np.isfinite(array).any()]
            if stale:
                raise ValueError(f"{', '.join(stale)}: expected NaN in a frame that is {self.status}, got numbers")

    @classmethod
    def empty(
        cls,
        frame: int,
        status: FrameStatus,
        *,
        dofs: int,
        seconds: float,
        has_keypoints2d: bool = True,
        time_s: float | None = None,
        measures: Mapping[str, float] | None = None,
        reason: str | None = None,
    ) -> "FrameRecord":
        """The record of a frame without an estimate: all NaN."""
        nan = math.nan
        return cls(
            frame=frame,
            status=status,
            pose=np.full(dofs, nan),
            pose_std=np.full(dofs, nan),
            keypoints3d=np.full((_KEYPOINTS, 3), nan),
            keypoints2d=np.full((_KEYPOINTS, 2), nan) if has_keypoints2d else None,
            keypoints3d_cov=np.full((_KEYPOINTS, 3, 3), nan),
            seconds=seconds,
            finger_quality=np.full(_FINGERS, nan),
            time_s=time_s,
            measures=measures or {},
            reason=reason,
        )

    def with_measures(self, more: Mapping[str, float | None]) -> "FrameRecord":
        """The record with further measures; None is unknown."""
        known = {name: math.nan if value is None else float(value) for name, value in more.items()}
        return replace(self, measures={**self.measures, **known})

    def as_json(self) -> str:
        """One line of strict JSON without its end: numbers exact to the last bit, whatever is not finite as null."""
        time = {} if self.time_s is None else {"time_s": self.time_s}
        content: dict[str, Any] = {"frame": self.frame, **time, "status": self.status, "seconds": self.seconds}
        content |= {name: float(value) if math.isfinite(value) else None for name, value in self.measures.items()}
        if self.reason is not None:
            content["reason"] = self.reason
        for name in ARRAY_FIELDS:
            content[name] = _nested(getattr(self, name))
        return json.dumps(content, allow_nan=False, separators=(",", ":"))


@dataclass(frozen=True, kw_only=True)
class Track:
    """A tracked sequence, frame by frame along the first axis; also what track.npz holds under the same names."""

    frame: Int[np.ndarray, " t"]
    status: Shaped[np.ndarray, " t"]
    """tracked, lost, recovered or no_hand"""
    pose: Float64[np.ndarray, "t dofs"]
    pose_std: Float64[np.ndarray, "t dofs"]
    keypoints3d: Float64[np.ndarray, "t 21 3"]
    keypoints2d: Float64[np.ndarray, "t 21 2"] | None
    keypoints3d_cov: Float64[np.ndarray, "t 21 3 3"]
    seconds: Float64[np.ndarray, " t"]
    dof_names: tuple[str, ...]
    units: str
    convention: str
    header: Mapping[str, Any]
    """What header.json beside track.jsonl holds."""
    finger_quality: Float64[np.ndarray, "t 5"] | None = None
    """Probability that each fingertip, thumb to little, lies within 20 mm of where it is, once the two hands are laid
    over one another; None in tracks that tell none."""
    time_s: Float64[np.ndarray, " t"] | None = None
    """When each frame is shown or was taken, seconds since the source's first one; None in tracks that tell none."""
    measures: Mapping[str, Float64[np.ndarray, " t"]] = field(default_factory=dict)
    """The records' measures by name; NaN where a record has none of that name."""
    reason: Shaped[np.ndarray, " t"] | None = None
    """The records' reasons; None in tracks that hold none."""
    image: Shaped[np.ndarray, " t"] | None = None
    """Names of the pictures, where the frames are single ones."""

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def has_hand(self) -> Bool[np.ndarray, " t"]:
        """Frames with an estimate."""
        return np.asarray(np.isfinite(self.pose).all(1))

    @property
    def cameras(self) -> list[Mapping[str, Any]]:
        """Entries of the cameras, as the header tells them; none for points in space."""
        camera = self.header.get("camera")
        entries = camera if isinstance(camera, list) else [camera]
        entries = entries[0].get("rig", entries) if len(entries) == 1 and isinstance(entries[0], Mapping) else entries
        return [entry for entry in entries if isinstance(entry, Mapping) and "K" in entry]

    def arrays(self) -> dict[str, np.ndarray]:
        """What track.npz holds."""
        arrays = {
            name: getattr(self, name)
            for name in ("frame", "time_s", "status", *ARRAY_FIELDS, "seconds", "reason", "image")
        }
        arrays |= self.measures
        arrays |= {"dof_names": np.array(self.dof_names), "units": np.array(self.units)}
        arrays |= {"convention": np.array(self.convention), "header": np.array(json.dumps(self.header))}
        return {name: array for name, array in arrays.items() if array is not None}


def check_fields(fields: Mapping[str, Any]) -> None:
    """Raise ValueError naming the first field that has not the form of a track's."""
    if not isinstance(fields["header"], Mapping):
        raise ValueError(f"header: expected keys with values, got {short(fields['header'])}")
    if not all(isinstance(name, str) for name in fields["dof_names"]):
        raise ValueError("dof_names: expected names, got others")
    measures = fields["measures"]
    names = ("frame", "time_s", "status", "seconds", "reason", "image")
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(names, ())
    shapes |= _shapes(len(fields["dof_names"])) | dict.fromkeys(measures, ())
    frames = fields["frame"].shape[:1] or (0,)
    for name, shape in shapes.items():
        array = measures[name] if name in measures else fields.get(name)
        if array is None:
            continue
        if array.shape != (*frames, *shape):
            raise ValueError(f"{name}: expected the shape {(*frames, *shape)}, got {array.shape}")
        kind = _KIND_OF.get(name, "f")
        if array.dtype.kind not in kind:
            raise ValueError(f"{name}: expected {_KINDS[kind]}, got {array.dtype}")


def track_of(header: Mapping[str, Any], rows: Iterable[Mapping[str, Any]]) -> Track:
    """The track of a header and of frames as they stand in track.jsonl; a frame's last row counts.

    Raises ValueError, KeyError, TypeError or OverflowError where they do not have that form.
    """
    dof_names = tuple(header["dof_names"])
    shapes = _shapes(len(dof_names))
    columns: dict[str, list[Any]] = {name: [] for name in ("frame", "time_s", "status", "seconds", *ARRAY_FIELDS)}
    reasons: list[str | None] = []
    measures: dict[str, list[float]] = {}
    for row in rows:
        for name in row:
            if name not in RESERVED_NAMES and name not in measures:
                measures[name] = [math.nan] * len(reasons)
        for name, values in measures.items():
            value = row.get(name)
            values.append(math.nan if value is None else float(value))
        reasons.append(row.get("reason"))
        for name, column in columns.items():
            # np.float64 of None is NaN; arrays are made row by row because they are far smaller than lists of numbers.
            value = row.get(name) if name in (*MISSING_FIELDS, "time_s") else row[name]
            is_array = name in ARRAY_FIELDS and value is not None
            column.append(np.asarray(value, dtype=np.float64).reshape(shapes[name]) if is_array else value)
    if wrong := [frame for frame in columns["frame"] if not isinstance(frame, int)]:
        raise ValueError(f"frame: expected whole numbers, got {short(wrong[0])}")
    last = {int(frame): place for place, frame in enumerate(columns["frame"])}
    if list(last) != sorted(last) or len(last) < len(reasons):
        places = [last[frame] for frame in sorted(last)]
        columns = {name: [column[place] for place in places] for name, column in columns.items()}
        measures = {name: [values[place] for place in places] for name, values in measures.items()}
        reasons = [reasons[place] for place in places]
    times = None if None in columns["time_s"] else np.array(columns["time_s"], dtype=np.float64)
    missing = [name for name in MISSING_FIELDS if any(array is None for array in columns[name])]
    arrays: dict[str, Any] = {
        name: np.stack(columns[name]) if columns[name] else np.empty((0, *shape))
        for name, shape in shapes.items()
        if name not in missing
    }
    return Track(
        frame=np.array(columns["frame"], dtype=np.int64),
        status=np.array(columns["status"], dtype="<U16"),
        seconds=np.array(columns["seconds"], dtype=np.float64),
        dof_names=dof_names,
        units=header["units"],
        convention=header["convention"],
        header=header,
        time_s=times,
        measures={name: np.array(values, dtype=np.float64) for name, values in measures.items()},
        reason=np.array([reason or "" for reason in reasons], np.str_) if any(r is not None for r in reasons) else None,
        **{**dict.fromkeys(missing), **arrays},
    )


def _shapes(dofs: int) -> dict[str, tuple[int, ...]]:
    """Of the arrays of one frame."""
    return {
        "pose": (dofs,),
        "pose_std": (dofs,),
        "keypoints3d": (_KEYPOINTS, 3),
        "keypoints2d": (_KEYPOINTS, 2),
        "keypoints3d_cov": (_KEYPOINTS, 3, 3),
        "finger_quality": (_FINGERS,),
    }


def _nested(array: np.ndarray | None) -> Any:
    """Nested lists with None for what is not finite."""
    if array is None:
        return None
    boxed = array.astype(object)
    boxed[~np.isfinite(array)] = None
    return boxed.tolist()
