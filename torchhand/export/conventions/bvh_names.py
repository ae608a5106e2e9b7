"""What other programs call the bones of a hand in BVH files."""

from typing import Literal

from torchhand.hand import BONES, Side
from torchhand.hand.conventions import hanim_joints

BvhNames = Literal["torchhand", "mixamo", "hanim"]
BVH_NAMES: tuple[BvhNames, ...] = ("torchhand", "mixamo", "hanim")

_LEVELS = ("metacarpal", "proximal", "middle", "distal")


def bvh_names(side: Side, kind: BvhNames = "torchhand") -> tuple[str, ...]:
    """Joint names in the order of BONES.

    torchhand: right_index_proximal. mixamo: RightHandIndex1 to 3 for the phalanges, RightHandThumb1 to 3, and
    RightHandIndex0 for the metacarpals, which Mixamo's own skeletons lack. hanim: r_index1, H-Anim 1.
    """
    if kind == "torchhand":
        return tuple(f"{side}_{bone}" for bone in BONES)
    if kind == "hanim":
        return hanim_joints(side, "1")
    return tuple(_mixamo(bone, f"{side.capitalize()}Hand") for bone in BONES)


def _mixamo(bone: str, hand: str) -> str:
    if bone == "wrist":
        return hand
    finger, level = bone.split("_")
    if finger == "thumb":
        return f"{hand}Thumb{('metacarpal', 'proximal', 'distal').index(level) + 1}"
    return f"{hand}{'Pinky' if finger == 'little' else finger.capitalize()}{_LEVELS.index(level)}"


def known_names() -> dict[str, tuple[Side, BvhNames]]:
    """Name of every wrist that `bvh_names` knows, with what it tells."""
    sides: tuple[Side, ...] = ("right", "left")
    return {bvh_names(side, kind)[0]: (side, kind) for side in sides for kind in BVH_NAMES}
