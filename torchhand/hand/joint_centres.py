"""How far joints are from where they are taken to be, for reasons that no pose tells: makers of hands differ about
where joints are under the same skin, and one camera sees no size."""

from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand.kinematics import KEYPOINTS

_STD_M = {"wrist": 0.008, "thumb_cmc": 0.0105, "tip": 0.0045}
_OTHER_STD_M = 0.004
"""Two hand models place their joint centres some millimetres apart under the same skin. Root mean square distances
along an axis between ours and another maker's, the surface being known to a millimetre: `torchhand track_multiview` on
`mv_static`, then `torchhand evaluate`, which prints them joint by joint. Joints that happen to agree better there are
not believed to do so in every model."""


@lru_cache(maxsize=1)
def centre_covariance() -> Float[Tensor, "21 3 3"]:
    """Covariance of what another maker's keypoints differ from ours by, m²; float64."""
    std = [_STD_M.get(name, _STD_M.get(name.split("_")[-1], _OTHER_STD_M)) for name in KEYPOINTS]
    return torch.tensor(std, dtype=torch.float64).square()[:, None, None] * torch.eye(3, dtype=torch.float64)


def scale_covariance(from_camera: Float[Tensor, "*batch 21 3"], scale_std: float) -> Float[Tensor, "*batch 21 3 3"]:
    """What an unknown hand length adds before one camera, m²: size and distance in common.

    from_camera: keypoints less the camera's centre, metres. scale_std: relative standard deviation of the length.
    """
    return scale_std**2 * (from_camera[..., :, None] * from_camera[..., None, :])
