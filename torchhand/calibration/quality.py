"""Whether a calibration can be trusted: what speaks against it, line by line."""

from dataclasses import dataclass

from torchhand.calibration.rig import RigCalibration


@dataclass(frozen=True, kw_only=True)
class QualityLimits:
    """What a good calibration reaches."""

    rms_px: float = 1.0
    """Largest root mean square reprojection error of a camera; above 0."""
    boards: int = 6
    """Fewest pictures of the board per camera; 3 or more."""
    coverage: float = 0.3
    """Least share of the cells of a 4 x 4 grid in which corners were seen; 0 to 1."""
    tilt_deg: float = 15.0
    """Least angle between the two most different orientations of the board; 0 to 90."""
    focal_std: float = 0.02
    """Largest standard deviation of the focal length, relative; above 0."""

    def __post_init__(self) -> None:
        if not self.rms_px > 0:
            raise ValueError(f"rms_px: expected above 0, got {self.rms_px}")
        if self.boards < 3:
            raise ValueError(f"boards: expected 3 or more, got {self.boards}")
        if not 0 <= self.coverage <= 1:
            raise ValueError(f"coverage: expected 0 to 1, got {self.coverage}")
        if not 0 <= self.tilt_deg <= 90:
            raise ValueError(f"tilt_deg: expected 0 to 90, got {self.tilt_deg}")
        if not self.focal_std > 0:
            raise ValueError(f"focal_std: expected above 0, got {self.focal_std}")


def shortcomings(found: RigCalibration, limits: QualityLimits) -> list[str]:
    """One line for everything that a good calibration has and this one lacks, with the figure; empty of a good one."""
    lines = []
    for i, (camera, view, alone) in enumerate(zip(found.cameras, found.views, found.alone, strict=True)):
        name, rms = camera.name, found.rms_px(camera.name)
        if len(view.corners) < limits.boards:
            lines.append(
                f"{name}: the board was found in {len(view.corners)} pictures, expected {limits.boards} or more"
            )
        if alone.tilt_deg < limits.tilt_deg:
            lines.append(
                f"{name}: the board has one orientation only (within {alone.tilt_deg:.0f}°); tilt it by"
                f" {limits.tilt_deg:g}° or more, to different sides"
            )
        if view.coverage < limits.coverage:
            lines.append(
                f"{name}: the board covers {view.coverage:.0%} of the picture, expected {limits.coverage:.0%} or more"
            )
        if alone.rms_px > limits.rms_px:
            lines.append(
                f"{name}: reprojection error {alone.rms_px:.2f} px, expected {limits.rms_px:g} or less (blurred"
                " pictures, a bent board, or a wrong number of squares)"
            )
        elif rms > limits.rms_px:
            lines.append(
                f"{name}: {alone.rms_px:.2f} px alone, but {rms:.2f} px together with the other cameras, expected"
                f" {limits.rms_px:g} or less: pictures of the same number are not of the same time (give an offset),"
                " or a camera has moved"
            )
        if rms <= limits.rms_px and found.focal_std[i] > limits.focal_std:
            lines.append(
                f"{name}: the focal length is known to {found.focal_std[i]:.1%} only, expected {limits.focal_std:.0%};"
                " more pictures of the tilted board, nearer, would tell"
            )
    return lines
