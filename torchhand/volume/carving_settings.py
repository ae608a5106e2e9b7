"""How octants are told apart."""

from dataclasses import dataclass

DENSE_LEVELS = 4
"""Up to this level all octants are tested, because a few thousand take no longer than a few."""


@dataclass(frozen=True, kw_only=True)
class CarvingSettings:
    """Settings of `Carver`."""

    level: int = 7
    """The root cube is divided into 2**level along each side, 1 to 10."""
    margin_px: int = 1
    """Pixels by which the projection of an octant is widened on all sides, 0 or more.

    With 1 no point is carved away of an object whose silhouette is a union of discs of √2 px diameter and marked where
    a pixel's centre sees it; more allows for masks whose boundary is off by some pixels.
    """
    tolerated_views: int = 0
    """Views that may be wrong: an octant is carved away only where more than these see background."""
    min_views: int = 2
    """Views in which the object has to appear where an octant is, for the octant to be of the hull.

    At most the number of cameras less the tolerated ones counts. Octants where it appears in fewer, because the others
    do not look at them, are UNKNOWN unless they are carved away.
    """
    max_octants: int = 20_000_000
    """Carving ends at a coarser level where the next would have more octants, all frames together."""

    def __post_init__(self) -> None:
        for name, minimum, maximum in (
            ("level", 1, 10),
            ("margin_px", 0, 1000),
            ("tolerated_views", 0, 200),
            ("min_views", 1, 200),
            ("max_octants", 8**DENSE_LEVELS, 1 << 31),
        ):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not minimum <= value <= maximum:
                raise ValueError(f"{name}: expected a whole number from {minimum} to {maximum}, got {value!r}")
