"""The skeleton as a frozen record: bones, parents, joint axes, limits. No file format is known here."""

from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.precision import own_precision

FINGERS = ("thumb", "index", "middle", "ring", "little")

BONES = (
    "wrist",
    *(f"{finger}_metacarpal" for finger in FINGERS),
    *(f"{finger}_proximal" for finger in FINGERS),
    "thumb_distal",
    *(f"{finger}_middle" for finger in FINGERS[1:]),
    *(f"{finger}_distal" for finger in FINGERS[1:]),
)
"""Twenty bones by level, thumb to little in each; the wrist is the root. The thumb's third bone is its distal one."""

PARENTS = (-1, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 13, 14, 15)

ROOT_DOFS = ("root_tx", "root_ty", "root_tz", "root_rx", "root_ry", "root_rz")
JOINT_DOFS = (
    *("thumb_cmc_fe", "thumb_cmc_aa", "thumb_cmc_tw", "thumb_mcp_fe", "thumb_mcp_aa", "thumb_ip_fe"),
    *(
        f"{finger}_{joint}"
        for finger in FINGERS[1:]
        for joint in ("cmc_fe", "mcp_fe", "mcp_aa", "mcp_tw", "pip_fe", "dip_fe")
    ),
)
"""Names of the thirty joint angles: fe flexion, aa abduction, tw twist along the bone."""
DOFS = ROOT_DOFS + JOINT_DOFS
"""The superset pose: three translations (m), a rotation vector (rad), thirty angles (rad)."""

KEYPOINTS = (
    "wrist",
    *("thumb_cmc", "thumb_mcp", "thumb_ip", "thumb_tip"),
    *(f"{finger}_{point}" for finger in FINGERS[1:] for point in ("mcp", "pip", "dip", "tip")),
)
"""Twenty-one keypoints: wrist, then thumb, index, middle, ring, little from base to tip."""

TIPS = tuple(i for i, name in enumerate(KEYPOINTS) if name.endswith("_tip"))
"""Places of the fingertips among them."""

FINGER_CHAINS = tuple((0, *range(first, first + 4)) for first in range(1, len(KEYPOINTS), 4))
"""Places of the wrist and the points of thumb, index, middle, ring and little finger, from base to tip."""

KNUCKLES = tuple(i for i, name in enumerate(KEYPOINTS) if name.endswith("_mcp"))
"""Places of the metacarpophalangeal joints, the thumb's first."""

PALM = (0, *KNUCKLES[1:])
"""Places of the wrist and the fingers' knuckles: they move as one body but for the slight bend of the palm."""


@dataclass(frozen=True, kw_only=True)
class Skeleton:
    """Joints of a right hand; the left hand is its mirror image in the plane z = 0 of the hand frame.

    Hand frame: origin on the wrist crease below the middle finger's metacarpal, x out of the back of the hand, y
    towards the fingers, z towards the thumb's side. Bone frames: y along the bone at rest, flexion positive about +z
    for fingers.
    """

    rest_rotation: Float[Tensor, "20 3 3"]
    """parent_from_bone at zero angles."""
    rest_offset: Float[Tensor, "20 3"]
    """Origin of each bone in its parent's frame at the default shape, metres."""
    tip_offset: Float[Tensor, "5 3"]
    """Fingertip keypoint in the frame of each digit's last bone at the default shape, metres."""
    axis: Float[Tensor, "30 3"]
    """Axis of each joint angle in the frame of the bone that it moves, before the angles after it are applied."""
    bone: tuple[int, ...]
    """Bone that each joint angle moves, index into BONES."""
    order: tuple[int, ...]
    """Place of the angle among those of its bone: 0 is applied outermost (abduction), 2 innermost (twist)."""
    lower: Float[Tensor, "30"]
    """Lower limit of each joint angle, radians."""
    upper: Float[Tensor, "30"]
    """Upper limit of each joint angle, radians."""

    @own_precision
    def within_limits(self, joints: Float[Tensor, "*batch 30"]) -> Float[Tensor, "*batch 30"]:
        """The nearest joint angles within the limits, radians."""
        return joints.clamp(self.lower.to(joints), self.upper.to(joints))

    def to(self, *, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> "Skeleton":
        """The same skeleton with its tensors moved; itself where they need not be."""
        tensors = {f.name: getattr(self, f.name) for f in fields(self) if isinstance(getattr(self, f.name), Tensor)}
        moved = {name: value.to(dtype=dtype, device=device) for name, value in tensors.items()}
        return self if all(moved[name] is value for name, value in tensors.items()) else replace(self, **moved)
