"""A calibration as a table of text."""

from torchhand.calibration.rig import RigCalibration, shared_frames

_HEAD = ("camera", "pictures", "covered", "tilt", "fx", "fy", "cx", "cy", "± focal", "± place", "alone", "together")


def calibration_table(found: RigCalibration) -> str:
    """One line per camera, then pairs, pictures left out, and the error over all."""
    rows = [_HEAD, ("", "", "%", "°", "px", "px", "px", "px", "%", "mm", "RMS px", "RMS px")]
    for i, (camera, view, alone) in enumerate(zip(found.cameras, found.views, found.alone, strict=True)):
        (fx, _, cx), (_, fy, cy), _ = camera.intrinsics.tolist()
        figures = (f"{fx:.1f}", f"{fy:.1f}", f"{cx:.1f}", f"{cy:.1f}", f"{100 * found.focal_std[i]:.2f}")
        rows.append(
            (
                camera.name,
                str(len(view.corners)),
                f"{100 * view.coverage:.0f}",
                f"{alone.tilt_deg:.0f}",
                *figures,
                f"{1000 * found.centre_std[i]:.2f}",
                f"{alone.rms_px:.3f}",
                f"{found.rms_px(camera.name):.3f}",
            )
        )
    widths = [max(len(row[i]) for row in rows) for i in range(len(_HEAD))]
    lines = ["  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    if len(found.cameras) > 1:
        shared = shared_frames(found.views)
        pairs = [f"{found.cameras[a].name} and {found.cameras[b].name} {len(m)}" for (a, b), m in shared.items()]
        lines.append(f"frames in which two cameras saw the board: {', '.join(pairs)}")
    for name, frame, rms in found.dropped:
        lines.append(f"left out: {name} in frame {frame} ({rms:.1f} px)")
    lines.append(f"reprojection error of all corners: {found.rms_px():.3f} px RMS")
    return "\n".join(lines)
