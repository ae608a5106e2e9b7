"""A text as a motion of one hand: sign after sign, held and eased from one to the next, frame by frame."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchhand.errors import InputError
from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand import Clearance, HandModel, Side
from torchhand.numerics import ease
from torchhand.signs.fit import solve_signs
from torchhand.signs.paths import TRACERS, hand_course
from torchhand.signs.table import SIGNS
from torchhand.signs.transitions import choose_recipe, curve, waypoints

_MIDDLE = (-0.02, 0.48, 0.0)
"""Middle of the hand in its own frame, what it turns about: metres, share of its length, metres."""
_SLIDE = (-0.03, 0.0, 0.0)  # metres from one letter to the same again, right hand
_VIA_FRACTION = 0.35  # of a transition's time more for every via-pose
_EPSILON = 1e-9


@dataclass(frozen=True, kw_only=True)
class SpellingSettings:
    """How fast a text is spelled."""

    fps: float = 25.0
    """Frames per second; above 0, 1000 at most."""
    seconds_per_sign: float = 1.0
    """Time from one sign to the next where the way is straight; 0.2 to 20."""
    hold_fraction: float = 0.55
    """Share of that for which the hand holds still; 0.1 to 0.9."""
    traced_seconds: float = 1.2
    """J and Z are traced in so many times seconds_per_sign; 0.2 to 20."""

    def __post_init__(self) -> None:
        ranges = {
            "fps": (0, 1000),
            "seconds_per_sign": (0.2, 20),
            "hold_fraction": (0.1, 0.9),
            "traced_seconds": (0.2, 20),
        }
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high or value == 0:
                above = f"more than {low}, {high} at most" if low == 0 else f"{low} to {high}"
                raise ValueError(f"{name}: expected {above}, got {value:g}")


@dataclass(frozen=True, kw_only=True)
class Spelling:
    """A spelled text."""

    text: str
    """Text as it is spelled: capitals, digits and spaces."""
    poses: Float64[Tensor, "frames 36"]
    """Metres and radians in the order of DOFS, whole rotation vectors; in the frame of a camera (x right, y down, z
    forward) about whose origin the hand moves."""
    fps: float
    place: tuple[int, ...]
    """Place, for every frame, in `text` of the sign that is held or that is being left."""
    overlap: Float64[Tensor, "frames"]
    """The deepest overlap of any two parts of the hand, metres: no slack for soft skin; below 0 the smallest gap."""


def check_text(text: str) -> str:
    """The text in capitals with single spaces.

    Raises InputError naming the first character that cannot be spelled, and for a text without any sign.
    """
    for place, letter in enumerate(text, start=1):
        if not letter.isspace() and letter.upper() not in SIGNS:
            raise InputError(
                f"text: expected letters A to Z, digits 0 to 9 and spaces, got {letter!r} (character {place} of"
                f" {text if len(text) <= 40 else text[:37] + '...'!r})"
            )
    found = " ".join(text.upper().split())
    if not found:
        raise InputError("text: expected at least one letter A to Z or digit 0 to 9, got none")
    return found


def sign_joints(
    model: HandModel, signs: str, stored: dict[str, Float64[Tensor, "30"]], shape: Float[Tensor, "shape"] | None = None
) -> dict[str, Float64[Tensor, "30"]]:
    """Joint angles of the signs of a hand of these proportions: the stored ones, or solved anew from them where the
    hand is not the model's own."""
    default = model.shape_space.default.double()
    if shape is None or torch.equal(shape.double(), default):
        return {sign: stored[sign] for sign in signs}
    start = torch.stack([stored[sign] for sign in signs])
    solved = solve_signs(model.kinematics(dtype=torch.float64), signs, shape, start=start)
    return dict(zip(signs, solved.joints, strict=True))


def spell(
    text: str,
    model: HandModel,
    joints: dict[str, Float64[Tensor, "30"]],
    *,
    side: Side = "right",
    shape: Float[Tensor, "shape"] | None = None,
    settings: SpellingSettings | None = None,
) -> Spelling:
    """The motion that spells a text; joints: of every sign in it (`sign_joints`). Deterministic.

    Between two signs the digits go straight or by way of opened postures so that they do not run through each other;
    a letter that comes twice slides to the side; spaces are pauses. Joint angles stay within the skeleton's limits.

    Raises InputError as `check_text` does.
    """
    settings = settings or SpellingSettings()
    text = check_text(text)
    clearance = Clearance(model.kinematics(dtype=torch.float64), shape)
    places = [i for i, letter in enumerate(text) if letter != " "]
    segments = _segments(text, places, joints, clearance, settings)
    ends = torch.tensor([segment.seconds for segment in segments], dtype=torch.float64).cumsum(0)
    frames = max(1, math.floor(float(ends[-1]) * settings.fps + _EPSILON) + 1)
    seconds = torch.arange(frames, dtype=torch.float64) / settings.fps
    which = torch.searchsorted(ends, seconds - _EPSILON).clamp_max(len(segments) - 1)
    values, centres, rotations = [], [], []
    for number, segment in enumerate(segments):
        fraction = ((seconds[which == number] - (ends[number] - segment.seconds)) / segment.seconds).clamp(0, 1)
        if len(fraction):
            values.append(segment.joints(fraction))
            centre, rotation = segment.course(fraction, side)
            centres.append(centre)
            rotations.append(rotation)
    found, rotation = clearance.separated(torch.cat(values)), torch.cat(rotations)
    root = torch.cat(centres) - rotation @ _middle(model, shape)
    return Spelling(
        text=text,
        poses=torch.cat((root, vector_from_rotation(rotation), found), -1),
        fps=settings.fps,
        place=tuple(segments[i].place for i in which.tolist()),
        overlap=clearance.worst(found),
    )


def standing_pose(
    sign: str,
    joints: Float64[Tensor, "30"],
    model: HandModel,
    *,
    side: Side = "right",
    shape: Float[Tensor, "shape"] | None = None,
) -> Float64[Tensor, "36"]:
    """One sign as a pose in the frame of `Spelling.poses`; a traced one as it begins, but in the middle."""
    pose = traced_poses(sign, joints, model, torch.zeros(1, dtype=torch.float64), side=side, shape=shape)[0]
    if sign in TRACERS:
        pose[:3] -= hand_course(sign, torch.zeros(1), side)[0][0]
    return pose


def traced_poses(
    sign: str,
    joints: Float64[Tensor, "30"],
    model: HandModel,
    fraction: Float64[Tensor, "frames"],
    *,
    side: Side = "right",
    shape: Float[Tensor, "shape"] | None = None,
) -> Float64[Tensor, "frames 36"]:
    """One sign over its time, share 0 to 1."""
    offset, rotation = hand_course(sign, fraction, side)
    root = offset - rotation @ _middle(model, shape)
    return torch.cat((root, vector_from_rotation(rotation), joints.expand(len(fraction), -1)), -1)


def _middle(model: HandModel, shape: Float[Tensor, "shape"] | None) -> Float64[Tensor, "3"]:
    """Middle of the hand, in its own frame, metres."""
    values = model.shape_space.default if shape is None else shape
    back, along, aside = _MIDDLE
    length = float(model.shape_space.metric(values)["hand_length"])
    return torch.tensor((back, along * length, aside), dtype=torch.float64)


@dataclass(frozen=True, kw_only=True)
class _Segment:
    """A sign that is held or traced, or the way to the next one."""

    place: int
    seconds: float
    points: Float64[Tensor, "points 30"]
    """One, or the way's."""
    first: str
    second: str | None
    offsets: tuple[Float64[Tensor, "3"], Float64[Tensor, "3"]]
    """Offsets to which the hand slid, at the beginning and at the end, right hand."""

    def joints(self, fraction: Float64[Tensor, "frames"]) -> Float64[Tensor, "frames 30"]:
        return self.points.expand(len(fraction), -1) if len(self.points) == 1 else curve(self.points, fraction)

    def course(
        self, fraction: Float64[Tensor, "frames"], side: Side
    ) -> tuple[Float64[Tensor, "frames 3"], Float64[Tensor, "frames 3 3"]]:
        flip = fraction.new_tensor((-1.0 if side == "left" else 1.0, 1.0, 1.0))
        eased = ease(fraction)[:, None]
        slid = (self.offsets[0] + eased * (self.offsets[1] - self.offsets[0])) * flip
        if self.second is None:
            offset, rotation = hand_course(self.first, fraction, side)
            return offset + slid, rotation
        (start, begin), (stop, end) = (
            hand_course(sign, fraction.new_tensor([at]), side) for sign, at in ((self.first, 1.0), (self.second, 0.0))
        )
        turn = vector_from_rotation(end[0] @ begin[0].T)
        return start + eased * (stop - start) + slid, rotation_from_vector(eased * turn) @ begin[0]


def _segments(
    text: str,
    places: list[int],
    joints: dict[str, Float64[Tensor, "30"]],
    clearance: Clearance,
    settings: SpellingSettings,
) -> list[_Segment]:
    hold = settings.hold_fraction * settings.seconds_per_sign
    way = settings.seconds_per_sign - hold
    slid = torch.zeros(3, dtype=torch.float64)
    segments = []
    recipes: dict[tuple[str, str], int] = {}
    for number, place in enumerate(places):
        sign = text[place]
        pause = hold if place + 1 < len(text) and text[place + 1] == " " else 0.0
        lasts = settings.traced_seconds * settings.seconds_per_sign if sign in TRACERS else hold
        own = joints[sign][None]
        segments.append(_Segment(place=place, seconds=lasts, points=own, first=sign, second=None, offsets=(slid, slid)))
        if number + 1 == len(places):
            break
        following = text[places[number + 1]]
        if following == sign and sign not in TRACERS:
            to = slid + torch.tensor(_SLIDE, dtype=torch.float64)
            points, seconds = own, way
        else:
            to = torch.zeros(3, dtype=torch.float64)
            if (sign, following) not in recipes:
                recipes[sign, following] = choose_recipe(clearance, sign, following, joints[sign], joints[following])[0]
            points = waypoints(sign, following, joints[sign], joints[following], recipes[sign, following])
            seconds = way * (1 + _VIA_FRACTION * (len(points) - 2))
        segments.append(
            _Segment(
                place=place, seconds=seconds + pause, points=points, first=sign, second=following, offsets=(slid, to)
            )
        )
        slid = to
    return segments
