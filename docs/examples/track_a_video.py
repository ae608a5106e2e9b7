"""Track a video and write the flexion of the index finger over time.

python track_a_video.py wave.mp4 right index.csv
"""

import argparse
import csv
import math
from pathlib import Path

from torchhand import track
from torchhand.hand import DOFS

JOINTS = ("index_mcp_fe", "index_pip_fe", "index_dip_fe")


def main(video: Path, side: str, out: Path) -> int:
    """The number of frames with a hand."""
    followed = 0
    with out.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time_s", "status", *(f"{name}_{what}" for name in JOINTS for what in ("deg", "std_deg"))])
        for estimate in track(video, side="left" if side == "left" else "right"):
            row = [f"{estimate.time_s:.4f}", estimate.status]
            if estimate.pose is not None and estimate.pose_std is not None:
                followed += 1
                for name in JOINTS:
                    number = DOFS.index(name)
                    row += [
                        f"{math.degrees(float(values[number])):.1f}" for values in (estimate.pose, estimate.pose_std)
                    ]
            table.writerow(row)
    print(f"{followed} frames with a hand; saved {out}")
    return followed


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write the flexion of the index finger of a video's hand over time.")
    parser.add_argument("video", type=Path)
    parser.add_argument("side", choices=("left", "right"))
    parser.add_argument("out", type=Path, help="table to write, .csv")
    main(**vars(parser.parse_args()))
