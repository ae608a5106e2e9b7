"""The postures that the prior mixes: design values in degrees, not measurements.

Pinches were closed by inverse kinematics, so that the pads meet at the default shape.
"""

from torchhand.hand.prior.components import Degrees, DigitAngles, Finger, PostureComponent, Thumb, posture_component

_AWAY: Thumb = (-8.0, 24.0, 0.0, 4.0, 0.0, 6.0)  # stretched out to the side
_BESIDE: Thumb = (0.0, 6.0, 0.0, 6.0, 0.0, 8.0)  # along the palm's edge
_UP: Thumb = (-12.0, 26.0, 0.0, 0.0, 0.0, -4.0)
_ACROSS: Thumb = (14.0, 13.0, 0.0, 31.0, 0.0, 62.0)  # over the bent fingers
_OVER_RING: Thumb = (30.0, 13.0, 0.0, 39.0, 0.0, 52.0)


def _straight(spread_out: Degrees = 0, mcp: Degrees = 2) -> Finger:
    return (mcp, spread_out, 5.0)


def _fist_but(
    name: str,
    weight: float,
    *,
    thumb: Thumb = _ACROSS,
    index: Finger = (80.0, 3.0, 96.0),
    little: Finger = (77.0, 7.0, 90.0),
    spread: float = 0.5,
) -> PostureComponent:
    """A fist with some digits otherwise. The bent fingers turn a little about themselves, so that they find room."""
    return posture_component(
        name,
        weight,
        DigitAngles(
            thumb=thumb,
            index=index,
            middle=(78.0, 3.0, 94.0),
            ring=(82.0, 4.5, 97.0),
            little=little,
            twist=(0.0, 3.0, -3.0, -5.0),
        ),
        spread=spread,
    )


COMPONENTS: tuple[PostureComponent, ...] = (
    # the hand by itself
    posture_component(
        "open",
        1.0,
        DigitAngles(
            thumb=_AWAY, index=_straight(11, 0), middle=_straight(0, 0), ring=_straight(7, 0), little=_straight(16, 0)
        ),
    ),
    posture_component(
        "flat",
        0.8,
        DigitAngles(thumb=_BESIDE, index=_straight(), middle=_straight(), ring=_straight(1), little=_straight(3)),
        spread=0.8,
    ),
    posture_component(
        "relaxed",
        1.8,
        DigitAngles(
            thumb=(2, 22, 0, 12, 0, 18), index=(18, 3, 24), middle=(24, 0, 30), ring=(27, 2, 33), little=(26, 6, 32)
        ),
    ),
    posture_component(
        "half_closed",
        1.2,
        DigitAngles(
            thumb=(8, 26, 0, 16, 0, 24), index=(36, 2, 44), middle=(42, 0, 50), ring=(46, 2, 52), little=(46, 4, 48)
        ),
    ),
    _fist_but("fist", 1.6, spread=0.45),
    posture_component(
        "hook",
        0.8,
        DigitAngles(
            thumb=_BESIDE, index=(8, 2, 82, 52), middle=(10, 0, 86, 55), ring=(10, 2, 86, 55), little=(8, 4, 80, 52)
        ),
        spread=0.8,
    ),
    posture_component(
        "table_top",
        0.6,
        DigitAngles(
            thumb=(4, 16, 0, 8, 0, 10), index=(66, 0, 10), middle=(70, 0, 10), ring=(70, 1, 10), little=(66, 2, 12)
        ),
        spread=0.7,
    ),
    # gestures
    _fist_but("point", 0.9, index=_straight()),
    _fist_but("thumb_up", 0.6, thumb=_UP),
    _fist_but("gun", 0.5, thumb=_UP, index=_straight()),
    posture_component(
        *("victory", 0.7),
        DigitAngles(thumb=_OVER_RING, index=_straight(10, 4), middle=(24, -3, 7), ring=(64, 3, 91), little=(71, 4, 91)),
        spread=0.5,
    ),
    posture_component(
        "three",
        0.4,
        DigitAngles(
            thumb=(34, 24, 0, 44, 0, 46),
            index=_straight(9),
            middle=_straight(),
            ring=_straight(6, 6),
            little=(62, 0, 80),
        ),
        spread=0.6,
    ),
    posture_component(
        "four",
        0.4,
        DigitAngles(
            thumb=(28, 16, 0, 40, 0, 45),
            index=_straight(8),
            middle=_straight(),
            ring=_straight(6),
            little=_straight(14),
        ),
        spread=0.6,
    ),
    _fist_but("shaka", 0.4, thumb=_UP, little=_straight(16, 4)),
    # small things between the thumb and fingertips
    posture_component(
        "pinch_index",
        1.0,
        DigitAngles(
            thumb=(16, 20, -4, 28, -5, 28), index=(51, 0, 53), middle=(50, 0, 55), ring=(54, 2, 58), little=(54, 4, 55)
        ),
        spread=0.4,
    ),
    posture_component(
        "ring_shape",
        0.7,
        DigitAngles(
            thumb=(16, 20, -4, 28, -5, 28), index=(48, 2, 55), middle=(25, 0, 14), ring=(11, 4, 9), little=(5, 10, 7)
        ),
        spread=0.4,
    ),
    posture_component(
        "pinch_middle",
        0.6,
        DigitAngles(
            thumb=(25, 22, -4, 30, -5, 29), index=(30, 3, 30), middle=(54, 1, 53), ring=(56, 2, 53), little=(45, 5, 45)
        ),
        spread=0.4,
    ),
    posture_component(
        "pinch_ring",
        0.4,
        DigitAngles(
            thumb=(30, 28, -2, 35, -2, 32), index=(25, 3, 25), middle=(35, 0, 38), ring=(60, 0, 53), little=(50, 5, 50)
        ),
        spread=0.4,
    ),
    posture_component(
        "pinch_little",
        0.4,
        DigitAngles(
            thumb=(32, 28, -4, 42, -3, 42), index=(18, 3, 18), middle=(22, 0, 25), ring=(40, 0, 40), little=(62, 0, 51)
        ),
        spread=0.4,
    ),
    posture_component(
        "tripod",
        1.0,
        DigitAngles(
            thumb=(21, 23, -4, 29, -5, 29), index=(55, 0, 50), middle=(56, 0, 53), ring=(59, 2, 62), little=(58, 4, 60)
        ),
        spread=0.4,
    ),
    posture_component(
        "flat_pinch",
        0.6,
        DigitAngles(
            thumb=(28, 29, -6, 25, -7, 17), index=(68, 0, 27), middle=(67, 0, 29), ring=(70, 1, 27), little=(66, 2, 29)
        ),
        spread=0.4,
    ),
    posture_component(
        "key",
        0.8,
        DigitAngles(
            thumb=(7, 7, 0, 21, 0, 22), index=(54, 0, 70), middle=(56, 0, 71), ring=(63, 2, 76), little=(61, 4, 72)
        ),
        spread=0.45,
    ),
    # things in the whole hand
    posture_component(
        "small_cylinder",
        1.0,
        DigitAngles(
            thumb=(20, 30, 0, 26, 0, 36), index=(58, 1, 62), middle=(60, 0, 66), ring=(64, 2, 66), little=(62, 4, 62)
        ),
        spread=0.6,
    ),
    posture_component(
        "large_cylinder",
        1.0,
        DigitAngles(
            thumb=(15, 31, 0, 14, 0, 20), index=(30, 4, 38), middle=(34, 0, 40), ring=(36, 3, 40), little=(36, 6, 38)
        ),
        spread=0.7,
    ),
    posture_component(
        "ball",
        0.8,
        DigitAngles(
            thumb=(14, 33, 0, 14, 0, 22), index=(28, 11, 36), middle=(30, 0, 40), ring=(30, 7, 38), little=(30, 15, 36)
        ),
        spread=0.7,
    ),
    posture_component(
        "plate",
        0.6,
        DigitAngles(
            thumb=(18, 28, 0, 8, 0, 8), index=(46, 3, 12), middle=(50, 0, 14), ring=(52, 2, 14), little=(50, 5, 14)
        ),
        spread=0.7,
    ),
    posture_component(
        "opposed",
        0.6,
        DigitAngles(
            thumb=(42, 24, 0, 16, 0, 18), index=(48, 2, 46), middle=(52, 0, 52), ring=(56, 2, 54), little=(56, 4, 50)
        ),
        spread=0.8,
    ),
    # whatever lies between: wide, so that no human posture is far out
    posture_component(
        "other",
        1.2,
        DigitAngles(
            thumb=(12, 20, 0, 14, 0, 20), index=(32, 4, 34), middle=(36, 0, 38), ring=(38, 3, 40), little=(38, 7, 38)
        ),
        spread=1.9,
    ),
)
