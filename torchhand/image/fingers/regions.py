"""From the silhouette of an open hand to its parts: five digits with axes, ends and widths, webs, wrist.

Ouhaddi and Horain 1998, section 6.1, at any angle in the picture and for either hand. Nothing here knows lengths in
metres.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from torchhand.image.fingers.fingers import FingerPiece, FingerSearch, FingerSettings, find_fingers
from torchhand.image.fingers.moments import mask_moments
from torchhand.image.fingers.order import DIGITS
from torchhand.image.fingers.profile import FingerProfile, finger_profile
from torchhand.image.operations import gaussian_blur
from torchhand.image.segmentation import fill_holes, largest_component

_MIN_AREA_PX = 400  # fewer pixels show no fingers
_MIN_ANGLE = 0.1  # radians between a finger's axis and the hand's for their crossing to tell anything
_PLAN_WEIGHT = 2.0  # of the plan's wrist, in crossings
_FARTHEST_CROSSING = 0.3  # of the plan's wrist, hand lengths; a crossing farther off is none
_REACH = 3.4  # no part of a hand is farther from its palm's centre, palm radii
_SECOND_HAND = 0.2  # least area of a second hand, over that of the largest piece
_CLEAR_MISFIT = 0.1  # of a second hand
_CUT_FRACTION = 0.6  # a digit that ends at the picture's border over so much of its width is cut


@dataclass(frozen=True, kw_only=True)
class Digit:
    """One digit; px, (x, y)."""

    name: str
    tip: np.ndarray
    """End of the digit on its axis."""
    base: np.ndarray
    """The point of its axis level with the webs beside it; of the thumb, with the end of its top-hat piece."""
    direction: np.ndarray
    """Unit vector from base to tip."""
    length: float
    radius: float
    """Half of the median width of its shaft."""
    profile: FingerProfile


@dataclass(frozen=True, kw_only=True)
class HandRegions:
    """The parts of an open hand in one picture; px, (x, y)."""

    mask: Bool[Tensor, "height width"]
    """The silhouette that was looked at: the largest piece, holes filled."""
    digits: tuple[Digit, ...]
    """Thumb to little."""
    webs: np.ndarray
    """Webs (4, 2): deepest points between neighbouring digits, thumb and index first."""
    wrist: np.ndarray
    axis: np.ndarray
    """Unit vector from the wrist to the fingers."""
    hand_length: float
    """Wrist to middle fingertip, as an open hand of common proportions lies over the digits."""
    is_mirrored: bool
    """False where the thumb lies on the left of upright fingers: a right hand's back or a left hand's palm."""


@dataclass(frozen=True, kw_only=True)
class NoRegions:
    """Why a silhouette is not divided."""

    reason: str
    found: tuple[str, ...] = ()
    """Digits that stand out."""


def divide_hand(mask: Bool[Tensor, "height width"], settings: FingerSettings | None = None) -> HandRegions | NoRegions:
    """The parts of the open hand whose silhouette is the mask's largest piece, or why there are none.

    Refused are: an almost empty mask, two hands, fewer than five digits, digits that the picture's border cuts.
    """
    silhouette = fill_holes(largest_component(mask)).cpu()
    area = int(silhouette.sum())
    if area < _MIN_AREA_PX:
        return NoRegions(reason=f"the silhouette is almost empty ({area} px, expected {_MIN_AREA_PX} or more)")
    search = find_fingers(silhouette, settings)
    if search.order is not None and _has_second_hand(mask.cpu(), area, search, settings):
        return NoRegions(reason="there are two hands; cover one, or give its mask alone")
    names = () if search.order is None else tuple(search.order.fingers)
    if search.order is None:
        count = len(search.pieces)
        return NoRegions(reason=f"no open hand: of five fingers {count or 'none'} stand out, and not as a hand's do")
    if len(names) < 5:
        missing = [name for name in DIGITS if name not in names]
        return NoRegions(
            reason=f"only {_listed(names)} stand out, not {_listed(missing)}; spread all five, apart from each other",
            found=names,
        )
    return _divided(silhouette, search)


def _divided(mask: Tensor, search: FingerSearch) -> HandRegions | NoRegions:
    order = search.order
    assert order is not None
    pixels = mask.numpy().astype(np.uint8)
    plane = gaussian_blur(mask.float(), 1.0).numpy()
    pieces = [search.pieces[order.fingers[name]] for name in DIGITS]
    cut = [name for name, piece in zip(DIGITS, pieces, strict=True) if _is_cut(pixels, piece)]
    if cut:
        return NoRegions(reason=f"the picture's edge cuts {_listed(cut)}; show the whole hand", found=DIGITS)
    profiles = [finger_profile(plane, piece.tip, piece.base, piece.width) for piece in pieces]
    unclear = [name for name, profile in zip(DIGITS, profiles, strict=True) if profile is None]
    if unclear:
        return NoRegions(reason=f"the outline of {_listed(unclear)} is unclear", found=DIGITS)
    known = [profile for profile in profiles if profile is not None]
    webs = _webs(pixels, known, np.array(order.wrist))
    digits = tuple(
        _digit(i, profile, piece, webs) for i, (profile, piece) in enumerate(zip(known, pieces, strict=True))
    )
    axis = np.array(order.axis)
    return HandRegions(
        mask=mask,
        digits=digits,
        webs=webs,
        wrist=_wrist(mask, digits, np.array(order.wrist), axis, order.hand_length),
        axis=axis,
        hand_length=order.hand_length,
        is_mirrored=order.is_mirrored,
    )


def _has_second_hand(mask: Tensor, area: int, search: FingerSearch, settings: FingerSettings | None) -> bool:
    """Whether the mask beyond the reach of the first hand, joined to it or apart, shows most of another one."""
    rest = mask.numpy().astype(np.uint8)
    centre = (round(search.palm_centre[0]), round(search.palm_centre[1]))
    cv2.circle(rest, centre, round(_REACH * search.palm_radius), 0, -1)
    piece = largest_component(torch.from_numpy(rest > 0))
    if int(piece.sum()) < _SECOND_HAND * area:
        return False
    order = find_fingers(piece, settings).order
    return order is not None and len(order.fingers) >= 4 and order.misfit < _CLEAR_MISFIT


def _is_cut(pixels: np.ndarray, piece: FingerPiece) -> bool:
    """Whether the silhouette reaches the picture's border at the tip over most of the digit's width."""
    height, width = pixels.shape
    x, y = piece.tip
    reach = 0.75 * piece.width
    contact = 0
    for line, near, along in (
        (pixels[0], y, x),
        (pixels[-1], height - 1 - y, x),
        (pixels[:, 0], x, y),
        (pixels[:, -1], width - 1 - x, y),
    ):
        if near < reach:
            first = max(0, round(along - piece.width))
            contact = max(contact, int(line[first : round(along + piece.width) + 1].sum()))
    return contact > _CUT_FRACTION * piece.width


def _webs(pixels: np.ndarray, profiles: list[FingerProfile], wrist: np.ndarray) -> np.ndarray:
    """Between neighbouring tips, along the outline, the point nearest the wrist."""
    outlines, _ = cv2.findContours(pixels, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(outlines, key=len)[:, 0].astype(float)
    at = [int(np.hypot(*(outline - profile.tip).T).argmin()) for profile in profiles]
    webs = []
    for i in range(4):
        a, b = sorted((at[i], at[i + 1]))
        inner, outer = outline[a : b + 1], np.concatenate((outline[b:], outline[: a + 1]))
        others = [at[k] for k in range(5) if k not in (i, i + 1)]
        arc = outer if any(a < other < b for other in others) else inner
        towards = profiles[i].direction + profiles[i + 1].direction
        towards = towards / max(float(np.hypot(*towards)), 1e-9) if i else arc.mean(0) - wrist
        depth = (arc - wrist) @ towards
        if i == 0:  # thumb and index open wide: the point nearest the wrist is the web
            depth = np.hypot(*(arc - wrist).T)
        webs.append(arc[depth <= depth.min() + 0.5].mean(0))
    return np.array(webs)


def _digit(i: int, profile: FingerProfile, piece: FingerPiece, webs: np.ndarray) -> Digit:
    beside = {0: (), 1: (1,), 2: (1, 2), 3: (2, 3), 4: (3,)}[i]
    levels = [float((profile.tip - webs[k]) @ profile.direction) for k in beside]
    if not levels:
        levels = [float((profile.tip - np.array(piece.base)) @ profile.direction)]
    length = max(float(np.mean(levels)), 1.0)
    shaft = (profile.along > 0.2 * length) & (profile.along < 0.9 * length) & np.isfinite(profile.width)
    width = float(np.median(profile.width[shaft])) if shaft.any() else piece.width
    return Digit(
        name=DIGITS[i],
        tip=profile.tip,
        base=profile.tip - length * profile.direction,
        direction=profile.direction,
        length=length,
        radius=0.5 * width,
        profile=profile,
    )


def _wrist(
    mask: Tensor, digits: tuple[Digit, ...], plan_wrist: np.ndarray, plan_axis: np.ndarray, length: float
) -> np.ndarray:
    """Crossings (Ouhaddi and Horain 1998) of the four finger axes with the hand's inertia axis, held near the wrist of
    the plan, which alone decides where axes are too parallel to cross."""
    height, width = mask.shape
    y, x = np.mgrid[:height, :width]
    above = (x - plan_wrist[0]) * plan_axis[0] + (y - plan_wrist[1]) * plan_axis[1] > 0
    near = (x - plan_wrist[0]) ** 2 + (y - plan_wrist[1]) ** 2 < (1.2 * length) ** 2
    moments = mask_moments(mask & torch.from_numpy(above & near))
    centre, inertia = moments.centroid_px.double().numpy(), moments.axis.double().numpy()
    inertia = inertia * (1.0 if inertia @ plan_axis > 0 else -1.0)
    places = [plan_wrist] * round(_PLAN_WEIGHT)
    for digit in digits[1:]:
        cross = inertia[0] * digit.direction[1] - inertia[1] * digit.direction[0]
        if abs(cross) < _MIN_ANGLE:
            continue
        gap = digit.tip - centre
        along = (gap[0] * digit.direction[1] - gap[1] * digit.direction[0]) / cross
        place = centre + along * inertia
        if np.hypot(*(place - plan_wrist)) < _FARTHEST_CROSSING * length:
            places.append(place)
    return np.mean(places, 0)


def _listed(names: tuple[str, ...] | list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
