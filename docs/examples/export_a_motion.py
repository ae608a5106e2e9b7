"""Make a motion of one's own and write it for other programs: a glTF with skin, BVH, MANO's rotations, a URDF.

A tracked result is read by `torchhand.export.load_clip("result")` in place of the clip that is made here.
"""

import sys
from pathlib import Path

import torch

from torchhand import load_hand_model
from torchhand.export import MotionClip, write
from torchhand.hand import posture

NAMES = ("hand.glb", "hand.bvh", "hand.mano.npz", "hand.urdf")


def main(folder: Path) -> list[Path]:
    """The files that were written."""
    model = load_hand_model()
    opening = torch.linspace(0, 1, 30, dtype=torch.float64)[:, None]
    poses = torch.lerp(posture("fist", dtype=torch.float64), posture("open", dtype=torch.float64), opening)
    clip = MotionClip(model=model, side="right", shape=model.shape_space.default, poses=poses, fps=30.0)
    for name in NAMES:
        for note in write(clip, folder / name):
            print(f"{name}: {note}")
    return [folder / name for name in NAMES]


if __name__ == "__main__":
    print(*main(Path(sys.argv[1] if len(sys.argv) > 1 else ".")), sep="\n")
