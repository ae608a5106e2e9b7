"""How labelled crops of hands look."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CropSettings:
    """Ranges that crops are drawn from; each crop draws for itself."""

    side_px: int = 128
    """Width and height of a crop, px; 32 to 512."""
    views: int = 4
    """Cameras that see each hand at the same time, from directions of their own; 1 to 64."""
    left: float = 0.5
    """Share of left hands."""
    forearm: float = 0.8
    """Share of crops in which a forearm goes on from the wrist."""
    sleeve: float = 0.5
    """Share of the forearms that a sleeve covers from some place on."""
    occluder: float = 0.3
    """Share of crops in which something stands before the hand."""
    blur_px: tuple[float, float] = (0.4, 1.2)
    """Standard deviation of the blur along x and along y, each drawn from this range, px; 0.3 to 2."""
    noise: tuple[float, float] = (0.5, 8.0)
    """Standard deviation of the sensor's noise, drawn from this range, grey levels of 255."""
    distance: tuple[float, float] = (0.25, 1.2)
    """Distance of the camera from the middle of the hand, metres."""
    roll_deg: float | None = None
    """Standard deviation of the hands' turn about the line of sight from fingers upwards, degrees, 0 to 180; any turn
    if not given."""
    fill: tuple[float, float] = (0.6, 1.0)
    """Larger side of the hand's box over that of the crop."""

    def __post_init__(self) -> None:
        for name, low, high in (("side_px", 32, 512), ("views", 1, 64)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: expected {low} to {high}, got {getattr(self, name)}")
        for name in ("left", "forearm", "sleeve", "occluder"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name}: expected a share, 0 to 1, got {getattr(self, name)}")
        if self.roll_deg is not None and not 0 <= self.roll_deg <= 180:
            raise ValueError(f"roll_deg: expected 0 to 180, got {self.roll_deg}")
        ranges = (("blur_px", 0.3, 2.0), ("noise", 0.0, 100.0), ("distance", 0.15, 10.0), ("fill", 0.1, 1.5))
        for name, lowest, highest in ranges:
            low, high = getattr(self, name)
            if not lowest <= low <= high <= highest:
                raise ValueError(f"{name}: expected two numbers from {lowest} to {highest}, got {low}, {high}")
