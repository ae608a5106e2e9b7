"""Digits and the silhouette of one camera, which is the world: those of a hand that lie outside it, parts of it as
thick as a digit that no digit of the hand covers, and the hand with such digits bent or straightened."""

import itertools
from collections.abc import Sequence
from functools import cached_property

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit.contour import hand_length_px
from torchhand.geometry import Camera
from torchhand.hand import FINGER_CHAINS, FINGERS, JOINT_DOFS, KNUCKLES, HandKinematics, HandPose, posture
from torchhand.image import depth_map

_BENDS = (0.5, 1.0)  # of the way to a fist, or to an open hand
_BETWEEN = 4  # points that are looked at from one keypoint of a digit to the next
_DIGITS = tuple(pair for chain in FINGER_CHAINS for pair in itertools.pairwise(chain[1:]))
_PALM = (*((0, chain[1]) for chain in FINGER_CHAINS), (1, 2), (1, 5), (2, 5), *itertools.pairwise(KNUCKLES[1:]))
_DIGIT_REACH, _PALM_REACH = 0.075, 0.12  # hand lengths from the bones, beyond which nothing is a hand's
_THICK = 0.02  # hand lengths from its edge to the middle of what is as thick as a digit
_STEP = 0.01  # hand lengths between the points of a silhouette that are looked at
_REGION = 1.3  # hand lengths from the wrist, towards the fingers
_BEYOND_WRIST = 0.15  # hand lengths: an arm ends there
_STEEP = 0.125  # a palm seen shorter than this, hand lengths, has no direction in the picture
_NEAR = 0.5  # hand lengths from its first joint to what a digit may cover


def outside(points_px: Float[Tensor, "*batch 21 2"], mask: Bool[Tensor, "height width"]) -> Float[Tensor, "*batch 5"]:
    """Share of each digit beyond its first joint that lies outside a silhouette in its picture."""
    chains = points_px[..., 1:, :].unflatten(-2, (len(FINGERS), -1))[..., 1:, :]
    share = torch.arange(_BETWEEN, device=chains.device) / _BETWEEN
    way = torch.lerp(chains[..., :-1, None, :], chains[..., 1:, None, :], share[:, None].to(chains))
    places = torch.cat((way.flatten(-3, -2), chains[..., -1:, :]), -2).nan_to_num(nan=-1.0).round().long()
    x, y = places.unbind(-1)
    height, width = mask.shape
    is_in_picture = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    is_covered = mask[y.clamp(0, height - 1), x.clamp(0, width - 1)]
    return (is_in_picture & ~is_covered).to(points_px).mean(-1)


class PlacedDigits:
    """How the digits of hands in about one place lie in a silhouette."""

    def __init__(
        self,
        kinematics: HandKinematics,
        camera: Camera,
        poses: HandPose,
        shape: Float[Tensor, "shape"],
        mask: Bool[Tensor, "height width"],
    ) -> None:
        """poses: of the hands (k), one at least, with zero rotation vectors."""
        keypoints = kinematics(poses.dofs, shape, root_reference=poses.reference).keypoints
        self._points_px = camera.project(keypoints.to(camera.intrinsics))
        is_before = bool(poses.dofs[0, 2] > 0)
        self._length_px = hand_length_px(camera, kinematics, poses.dofs[0], shape) if is_before else 0.0
        self._mask = mask

    def outside(self) -> Float[Tensor, "k 5"]:
        """Share of each digit beyond its first joint that lies outside the silhouette."""
        return outside(self._points_px, self._mask)

    def leave_out(self) -> Bool[Tensor, "k"]:
        """Whether the hands leave out a part as thick as a digit, beyond the wrist."""
        return self._left_out.any(-1)

    def near_left_out(self) -> Bool[Tensor, "5"]:
        """Digits of the first hand that may cover what it leaves out."""
        left = self._inner[self._left_out[0]]
        if not len(left):
            return torch.zeros(len(FINGERS), dtype=torch.bool, device=left.device)
        knuckles = self._points_px[0, list(KNUCKLES)].float()
        return torch.cdist(knuckles, left).amin(-1) < _NEAR * self._length_px

    @cached_property
    def _inner(self) -> Float[Tensor, "points 2"]:
        return _inner_points(self._mask, self._points_px[0, 0].float(), self._length_px)

    @cached_property
    def _left_out(self) -> Bool[Tensor, "k points"]:
        points_px = self._points_px.float()
        wrist, away = points_px[:, 0], points_px[:, 9] - points_px[:, 0]
        seen_px = away.norm(dim=-1, keepdim=True)
        off = self._inner - wrist[:, None]
        along = (off * (away / seen_px)[:, None]).sum(-1)
        is_near = (along > _BEYOND_WRIST * self._length_px) & (off.square().sum(-1) < (_REGION * self._length_px) ** 2)
        is_near &= seen_px > _STEEP * self._length_px
        for bones, reach in ((_DIGITS, _DIGIT_REACH), (_PALM, _PALM_REACH)):
            is_near &= _squared_distances(self._inner, points_px, bones).amin(-1) > (reach * self._length_px) ** 2
        return is_near


def _inner_points(
    mask: Bool[Tensor, "height width"], wrist: Float[Tensor, "2"], length_px: float
) -> Float[Tensor, "points 2"]:
    """Points of a silhouette about a wrist, px, in whose place it is as thick as a digit."""
    nothing = wrist.new_zeros(0, 2)
    if not 0 < length_px < float("inf") or not bool(wrist.isfinite().all()):
        return nothing
    reach = round((_REGION + _THICK) * length_px) + 1
    x, y = (round(value) for value in wrist.tolist())
    left, top = max(0, x - reach), max(0, y - reach)
    part = mask[top : max(0, y + reach + 1), left : max(0, x + reach + 1)]
    if not part.numel():
        return nothing
    step = max(1, round(_STEP * length_px))
    thick = step * depth_map(part[::step, ::step]) > _THICK * length_px
    return step * thick.nonzero().flip(-1).to(wrist) + wrist.new_tensor((left, top))


def _squared_distances(
    places: Float[Tensor, "points 2"], points_px: Float[Tensor, "k 21 2"], bones: Sequence[tuple[int, int]]
) -> Float[Tensor, "k points bones"]:
    """From places to bones in the picture, px²."""
    first, last = (points_px[..., [bone[end] for bone in bones], :] for end in (0, 1))
    along = last - first
    squared = along.square().sum(-1)[..., None, :].clamp_min(1e-9)
    off = places @ along.mT - (first * along).sum(-1)[..., None, :]
    share = (off / squared).clamp_(0, 1)
    from_first = places.square().sum(-1)[:, None] - 2 * places @ first.mT + first.square().sum(-1)[..., None, :]
    return from_first + share * (share * squared - 2 * off)


def moved_digits(pose: HandPose, digits: Bool[Tensor, "5"], towards: str) -> HandPose | None:
    """A hand () with some of its digits moved half and wholly to those of a posture: each by itself, and all together.
    None where none is to be moved."""
    chosen = digits.nonzero().squeeze(-1).tolist()
    sets = [[one] for one in chosen] + ([chosen] if len(chosen) > 1 else [])
    if not sets:
        return None
    known, size = posture(towards, dtype=pose.dofs.dtype).to(pose.dofs.device), len(JOINT_DOFS) // len(FINGERS)
    dofs = []
    for some, share in itertools.product(sets, _BENDS):
        one = pose.dofs.clone()
        own, other = (x[-len(JOINT_DOFS) :].unflatten(0, (len(FINGERS), size)) for x in (one, known))
        own[some] = own[some].lerp(other[some], share)
        dofs.append(one)
    return HandPose(dofs=torch.stack(dofs), reference=pose.reference.expand(len(dofs), 3, 3))
