"""The hand as truncated quadrics: their sizes, places and penetration."""

from torchhand.hand.primitives.penetration import (
    Penetration,
    PenetrationSettings,
    digit_pairs,
    energy_of,
    penetration,
    penetration_penalty,
)
from torchhand.hand.primitives.primitives import (
    CONE_BONES,
    CONE_NAMES,
    ELLIPSOID_BONES,
    ELLIPSOID_NAMES,
    PRIMITIVE_NAMES,
    Implicit,
    Primitives,
    PrimitiveSizes,
    place_primitives,
)
from torchhand.hand.primitives.sizing import primitive_sizes

__all__ = [
    "CONE_BONES",
    "CONE_NAMES",
    "ELLIPSOID_BONES",
    "ELLIPSOID_NAMES",
    "PRIMITIVE_NAMES",
    "Implicit",
    "Penetration",
    "PenetrationSettings",
    "PrimitiveSizes",
    "Primitives",
    "digit_pairs",
    "energy_of",
    "penetration",
    "penetration_penalty",
    "place_primitives",
    "primitive_sizes",
]
