"""The manual alphabet and digits of American Sign Language as a table: which finger does what, what touches what.

Codes of the joints are those of Johnson and Liddell: E straight, i half bent, F bent; one letter
each for MCP, PIP and DIP. Degrees are design values, a starting point: `sign_fit` solves the contacts.
Signs of one shape share a row: H is U pointing sideways, P is K pointing down, J is I and Z is 1 in motion. Q is
G with the index pointing down from its knuckle.
"""

from dataclasses import dataclass, field
from typing import Literal

Spread = Literal["wide", "half", "together"]
ThumbPlace = Literal["beside", "across", "opposed", "out", "under"]
Facing = Literal["palm", "back", "quarter", "side", "across", "down"]

MCP_DEG = {"E": 0.0, "h": 20.0, "i": 40.0, "m": 62.0, "F": 85.0}
PIP_DEG = {"E": 0.0, "h": 25.0, "i": 50.0, "m": 80.0, "F": 100.0}
DIP_DEG = {"E": 0.0, "h": 17.0, "i": 33.0, "m": 50.0, "F": 67.0}
"""Flexions of the codes, degrees; h and m lie on either side of i, for shapes that the three codes leave too coarse."""
SPREAD_DEG: dict[str, float] = {"wide": 1.0, "half": 0.45, "together": 0.0}
"""Share of SPREAD_WIDE_DEG."""
SPREAD_WIDE_DEG = {"index": 13.0, "middle": 0.0, "ring": 9.0, "little": 19.0}
THUMB_DEG: dict[str, tuple[float, float, float, float]] = {
    # flexion and abduction of the CMC joint, flexion of MCP and IP joints, degrees
    "beside": (0.0, 2.0, 0.0, 0.0),
    "across": (35.0, 25.0, 45.0, 40.0),
    "opposed": (30.0, 45.0, 25.0, 35.0),
    "out": (-18.0, 38.0, -5.0, -8.0),
    "under": (25.0, 20.0, 40.0, 20.0),
}


@dataclass(frozen=True, kw_only=True)
class Handshape:
    """One row of the table."""

    index: str
    """Codes of MCP, PIP and DIP."""
    middle: str
    ring: str
    little: str
    spread: tuple[Spread, Spread, Spread] = ("together", "together", "together")
    """Gaps from index to middle, middle to ring, ring to little."""
    thumb: ThumbPlace
    thumb_deg: tuple[float, float, float, float] | None = None
    """Angles of the thumb in place of those that THUMB_DEG has for `thumb`."""
    meet: tuple[tuple[str, str], ...] = ()
    """Points of the skin (`skin_points.POINTS`) that touch."""
    touch: tuple[tuple[str, str], ...] = ()
    """Segments that touch, wherever."""
    gap: tuple[tuple[str, str, float], ...] = ()
    """Points that keep a distance, metres."""
    rest: tuple[str, ...] = ()
    """Fingers whose very tips lie on the thumb."""
    between: tuple[str, str] | None = None
    """Neighbouring fingers that have the thumb's tip between them: it passes below the first, which is bent over it."""
    crossed: bool = False
    """Index and middle finger are crossed: the middle one behind the index, its tip on the thumb's side."""
    straight_thumb: bool = False
    """The thumb's MCP and IP joints keep to the table."""
    free: tuple[str, ...] = field(default=())
    """Fingers whose joints may leave their codes further, because the contact asks for it."""


_F = "FFF"
_WIDE: tuple[Spread, Spread, Spread] = ("wide", "wide", "wide")
_U = Handshape(
    index="EEE",
    middle="EEE",
    ring="mmm",
    little="mmm",
    thumb="across",
    meet=(("thumb_pad", "ring_back"),),
    touch=(("index_middle", "middle_middle"),),
)
_V = Handshape(
    index="EEE",
    middle="EEE",
    ring="mmm",
    little="mmm",
    spread=("wide", "half", "together"),
    thumb="across",
    meet=(("thumb_pad", "ring_back"),),
)
_O = Handshape(
    index="iii",
    middle="iii",
    ring="iii",
    little="iii",
    thumb="opposed",
    meet=(("thumb_pad", "index_tip"),),
    touch=(("thumb_distal", "middle_distal"),),
    rest=("ring", "little"),
    free=("index", "middle", "ring", "little"),
)

_G = Handshape(
    index="EEE",
    middle=_F,
    ring=_F,
    little=_F,
    thumb="beside",
    thumb_deg=(0.0, 10.0, 0.0, 0.0),
    gap=(("thumb_pad", "index_side", 0.015),),
    straight_thumb=True,
)
_Q = Handshape(index="FEE", middle=_F, ring=_F, little=_F, thumb="beside", thumb_deg=(20.0, 25.0, 5.0, 0.0))
_K = Handshape(
    index="EEE",
    middle="FEE",
    ring="FFi",
    little="FFi",
    spread=("half", "together", "together"),
    thumb="across",
    thumb_deg=(20.0, 25.0, 10.0, 5.0),
    meet=(("thumb_pad", "middle_side"),),
)
_ONE = Handshape(index="EEE", middle=_F, ring=_F, little=_F, thumb="across", meet=(("thumb_pad", "middle_back"),))
_I = Handshape(index="FFi", middle="FFi", ring="FFi", little="EEE", thumb="across", meet=(("thumb_pad", "index_back"),))
_NINE = Handshape(
    index="iii",
    middle="hEE",
    ring="EEE",
    little="EEE",
    spread=_WIDE,
    thumb="opposed",
    meet=(("thumb_pad", "index_pad"),),
    free=("index",),
)

HANDSHAPES: dict[str, Handshape] = {
    "A": Handshape(
        index=_F,
        middle=_F,
        ring=_F,
        little=_F,
        thumb="beside",
        touch=(("thumb_distal", "index_proximal"),),
        straight_thumb=True,
    ),
    "B": Handshape(
        index="EEE", middle="EEE", ring="EEE", little="EEE", thumb="across", gap=(("thumb_pad", "palm_middle", 0.024),)
    ),
    "C": Handshape(
        index="hii", middle="hii", ring="hii", little="hii", thumb="opposed", gap=(("thumb_tip", "index_tip", 0.05),)
    ),
    "D": Handshape(
        index="EEE",
        middle="iii",
        ring="mmm",
        little="mmm",
        spread=("half", "together", "together"),
        thumb="opposed",
        meet=(("thumb_pad", "middle_pad"),),
        free=("middle",),
    ),
    "E": Handshape(
        index="iFF",
        middle="iFF",
        ring="iFF",
        little="iFF",
        thumb="across",
        rest=("index", "middle", "ring", "little"),
        free=("index", "middle", "ring", "little"),
    ),
    "F": _NINE,
    "G": _G,
    "H": _U,
    "I": _I,
    "J": _I,
    "K": _K,
    "L": Handshape(index="EEE", middle=_F, ring=_F, little=_F, spread=("half", "together", "together"), thumb="out"),
    "M": Handshape(
        index="Fmi",
        middle="Fmi",
        ring="Fmi",
        little="FFi",
        thumb="under",
        touch=(("thumb_distal", "little_proximal"), ("thumb_distal", "ring_proximal")),
        between=("ring", "little"),
        free=("index", "middle", "ring"),
    ),
    "N": Handshape(
        index="Fmi",
        middle="Fmi",
        ring="FFi",
        little="FFi",
        thumb="under",
        touch=(("thumb_distal", "ring_proximal"),),
        between=("middle", "ring"),
        free=("index", "middle"),
    ),
    "O": _O,
    "P": _K,
    "Q": _Q,
    "R": Handshape(
        index="EEE",
        middle="EEE",
        ring="FFi",
        little="FFi",
        thumb="across",
        meet=(("thumb_pad", "ring_back"),),
        crossed=True,
        free=("index", "middle"),
    ),
    "S": Handshape(index=_F, middle=_F, ring=_F, little=_F, thumb="across", meet=(("thumb_pad", "middle_back"),)),
    "T": Handshape(
        index="mFi",
        middle=_F,
        ring=_F,
        little=_F,
        spread=("half", "together", "together"),
        thumb="under",
        thumb_deg=(10.0, 5.0, 50.0, 10.0),
        straight_thumb=True,
        touch=(("thumb_distal", "middle_proximal"), ("thumb_distal", "index_middle")),
        between=("index", "middle"),
        free=("index",),
    ),
    "U": _U,
    "V": _V,
    "W": Handshape(
        index="EEE",
        middle="EEE",
        ring="EEE",
        little="mmm",
        spread=_WIDE,
        thumb="opposed",
        meet=(("thumb_pad", "little_back"),),
        free=("little",),
    ),
    "X": Handshape(index="EFi", middle=_F, ring=_F, little=_F, thumb="across", meet=(("thumb_pad", "middle_back"),)),
    "Y": Handshape(index="FFi", middle="FFi", ring="FFi", little="EEE", spread=_WIDE, thumb="out"),
    "Z": _ONE,
    "0": _O,
    "1": _ONE,
    "2": _V,
    "3": Handshape(
        index="EEE", middle="EEE", ring="FFi", little="FFi", spread=("wide", "half", "together"), thumb="out"
    ),
    "4": Handshape(
        index="EEE",
        middle="EEE",
        ring="EEE",
        little="EEE",
        spread=_WIDE,
        thumb="across",
        gap=(("thumb_pad", "palm_middle", 0.024),),
    ),
    "5": Handshape(index="EEE", middle="EEE", ring="EEE", little="EEE", spread=_WIDE, thumb="out"),
    "6": Handshape(
        index="EEE",
        middle="EEE",
        ring="EEE",
        little="iii",
        spread=_WIDE,
        thumb="opposed",
        meet=(("thumb_pad", "little_pad"),),
        free=("little",),
    ),
    "7": Handshape(
        index="EEE",
        middle="EEE",
        ring="iii",
        little="EEE",
        spread=_WIDE,
        thumb="opposed",
        meet=(("thumb_pad", "ring_pad"),),
        free=("ring",),
    ),
    "8": Handshape(
        index="EEE",
        middle="iii",
        ring="EEE",
        little="EEE",
        spread=_WIDE,
        thumb="opposed",
        meet=(("thumb_pad", "middle_pad"),),
        free=("middle",),
    ),
    "9": _NINE,
}
"""The 36 signs by letter and digit."""

SIGNS = "".join(HANDSHAPES)
"""All letters and digits that can be spelled."""

FACINGS: dict[str, Facing] = {
    "C": "side",
    "G": "across",
    "H": "across",
    "K": "quarter",
    "O": "side",
    "P": "down",
    "Q": "down",
    "X": "quarter",
    "0": "side",
    **dict.fromkeys("12345", "back"),
}
"""Where the hand turns; those not named show the palm."""
