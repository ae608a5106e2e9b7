"""The manual alphabet: postures that touch without penetrating, the ways between them, and words spelled."""

from torchhand.signs.file import SIGNS_NAME, load_signs, save_signs
from torchhand.signs.fit import solve_signs
from torchhand.signs.paths import TRACERS
from torchhand.signs.spelling import (
    Spelling,
    SpellingSettings,
    check_text,
    sign_joints,
    spell,
    standing_pose,
    traced_poses,
)
from torchhand.signs.table import SIGNS

__all__ = [
    "SIGNS",
    "SIGNS_NAME",
    "TRACERS",
    "Spelling",
    "SpellingSettings",
    "check_text",
    "load_signs",
    "save_signs",
    "sign_joints",
    "solve_signs",
    "spell",
    "standing_pose",
    "traced_poses",
]
