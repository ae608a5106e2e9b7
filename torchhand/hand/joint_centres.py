"""How far joints are from where they are taken to be, for reasons that no pose tells: makers of hands differ about
where joints are under the same skin, and one camera sees no size."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import constant_tensor
from torchhand.hand.kinematics import KEYPOINTS, TIPS

_ALONG_M = {"wrist": 0.011, "thumb_cmc": 0.021, "thumb_mcp": 0.005, "thumb_ip": 0.005, "tip": 0.0075}
_OTHER_M = 0.004
"""Two hand models place their joint centres some millimetres apart under the same skin, most of it along the bones; the
base of the thumb's metacarpal, two centimetres. Root mean square distances between ours and another maker's along the
bone, and along an axis across it, where the surface is known to a millimetre: `torchhand track_multiview` on
`mv_static`, `mv_motion` and `mv_index10`, then `torchhand evaluate`, whose file has them joint by joint. Joints that
happen to agree better there are not believed to do so in every model."""

_OF_KEYPOINTS_M = tuple(_ALONG_M.get(name, _ALONG_M.get(name.split("_")[-1], _OTHER_M)) for name in KEYPOINTS)
_WRIST, _TOWARDS = KEYPOINTS.index("wrist"), KEYPOINTS.index("middle_mcp")
_BEGINS = tuple(index - 1 if index in TIPS else index for index in range(len(KEYPOINTS)))
_ENDS = tuple(_TOWARDS if begin == _WRIST else begin + 1 for begin in _BEGINS)


def bone_directions(keypoints: Float[Tensor, "*batch 21 3"]) -> Float[Tensor, "*batch 21 3"]:
    """Unit vectors along the bone that begins in each keypoint; along the last one of a finger at its tip, towards the
    middle finger's knuckle at the wrist. Zero where both ends are one place."""
    ends, begins = (constant_tensor(which, torch.long, keypoints.device) for which in (_ENDS, _BEGINS))
    return torch.nn.functional.normalize(keypoints.index_select(-2, ends) - keypoints.index_select(-2, begins), dim=-1)


def centre_spread(keypoints: Float[Tensor, "*batch 21 3"]) -> Float[Tensor, "*batch 21 3 3"]:
    """Symmetric root of `centre_covariance`, metres: times numbers of unit variance, what another maker's keypoints of
    a hand may differ from ours by."""
    along = constant_tensor(_OF_KEYPOINTS_M, keypoints.dtype, keypoints.device)[:, None, None]
    across = _OTHER_M * torch.eye(3, dtype=keypoints.dtype, device=keypoints.device)
    axis = bone_directions(keypoints)[..., None]
    return (along - _OTHER_M) * (axis @ axis.mT) + across


def centre_covariance(keypoints: Float[Tensor, "*batch 21 3"]) -> Float[Tensor, "*batch 21 3 3"]:
    """Covariance of what another maker's keypoints of a hand differ from ours by, m²: more along a bone than across."""
    spread = centre_spread(keypoints)
    return spread @ spread


def scale_covariance(from_camera: Float[Tensor, "*batch 21 3"], scale_std: float) -> Float[Tensor, "*batch 21 3 3"]:
    """What an unknown hand length adds before one camera, m²: size and distance in common.

    from_camera: keypoints less the camera's centre, metres. scale_std: relative standard deviation of the length.
    """
    return scale_std**2 * (from_camera[..., :, None] * from_camera[..., None, :])
