"""A first pose for 21 points in space, in closed form: the palm placed as a rigid body, then angles from directions."""

from functools import lru_cache, reduce

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.devices import constant_tensor
from torchhand.geometry import rotation_from_vector
from torchhand.hand import BONES, DOFS, FINGERS, JOINT_DOFS, KEYPOINTS, PALM, HandKinematics, HandPose

_IS_PALM = tuple(point in PALM for point in range(len(KEYPOINTS)))
_ELSEWHERE = 1e-3  # weight of all other points, which tell the palm's orientation only where the palm does not
_ROOT = len(DOFS) - len(JOINT_DOFS)


def rigid_placement(
    source: Float[Tensor, "*#batch n 3"], target: Float[Tensor, "*#batch n 3"], weight: Float[Tensor, "*#batch n"]
) -> tuple[Float[Tensor, "*batch 3 3"], Float[Tensor, "*batch 3"], Float[Tensor, "*batch"]]:
    """Rotation, translation and scale that put `source` onto `target` in weighted least squares (Kabsch, Umeyama).

    target = rotation · source + translation; the scale is the factor that the turned source would still need.
    """
    total = weight.sum(-1).clamp_min(torch.finfo(weight.dtype).tiny)[..., None]
    centre_source = (weight[..., None] * source).sum(-2) / total
    centre_target = (weight[..., None] * target).sum(-2) / total
    arms_source, arms_target = source - centre_source[..., None, :], target - centre_target[..., None, :]
    product = (weight[..., None] * arms_target).mT @ arms_source
    is_sound = product.isfinite().all((-2, -1), keepdim=True)  # sums of large numbers overflow; svd would raise
    left, singular, right = torch.linalg.svd(torch.where(is_sound, product, 0.0))
    sign = torch.ones_like(singular)
    sign[..., 2] = torch.where(torch.linalg.det(left) * torch.linalg.det(right) < 0, -1.0, 1.0)
    rotation = (left * sign[..., None, :]) @ right
    spread = (weight * arms_source.square().sum(-1)).sum(-1)
    scale = (singular * sign).sum(-1) / spread.clamp_min(torch.finfo(weight.dtype).tiny)
    return rotation, centre_target - (rotation @ centre_source[..., None]).squeeze(-1), scale


def palm_weight(is_known: Bool[Tensor, "*frames 21"]) -> Float[Tensor, "*frames 21"]:
    """Weights for placing the hand: by its palm where three points of it are known, else by all points."""
    is_palm = constant_tensor(_IS_PALM, torch.bool, is_known.device)
    has_palm = (is_known & is_palm).sum(-1, keepdim=True) >= 3
    weight = torch.where(is_palm | ~has_palm, 1.0, _ELSEWHERE)
    return (weight * is_known).to(torch.float64)


def start_in_space(
    kinematics: HandKinematics,
    points: Float[Tensor, "frames 21 3"],
    is_known: Bool[Tensor, "frames 21"],
    shape: Float[Tensor, "shape"],
    posture: Float[Tensor, "36"],
    *,
    rest: Float[Tensor, "21 3"] | None = None,
) -> tuple[HandPose, Float[Tensor, "frames"]]:
    """Poses with zero rotation vectors, and the sizes of the points' palms over that of the shape.

    rest: keypoints of that shape and posture, where they are known.

    Exact for points without noise in so far as only wrist-side twists and bends of the palm are those of `posture`,
    from which also come the angles whose points are missing. Angles lie within the limits.
    """
    own: Tensor = kinematics(posture, shape).keypoints if rest is None else rest
    known = torch.where(is_known[..., None], points, 0.0)
    rotation, translation, scale = rigid_placement(own, known, palm_weight(is_known).to(points))
    local = (known - translation[:, None]) @ rotation
    if kinematics.side == "left":
        local = local * local.new_tensor((1.0, 1.0, -1.0))
    local = torch.where(is_known[..., None], local, torch.nan)
    pose = posture.expand(len(points), -1).clone()
    pose[:, :3] = translation
    pose[:, 3:6] = 0
    pose[:, _ROOT:] = _DigitAngles(kinematics, local, pose[:, _ROOT:]).found()
    return HandPose(dofs=pose, reference=rotation), scale


class _DigitAngles:
    """Angles of the five digits from points in the frame of a right hand, joint after joint; fingers of like joints
    together."""

    def __init__(self, kinematics: HandKinematics, points: Tensor, joints: Tensor) -> None:
        self.skeleton = kinematics.skeleton.to(dtype=points.dtype, device=points.device)
        self.points = points
        self.joints = joints.clone()

    def found(self) -> Tensor:
        chains = self.points[:, 1:].unflatten(1, (len(FINGERS), 4))
        bones = chains[:, :, 1:] - chains[:, :, :-1]
        thumb, along = FINGERS[:1], bones[:, :1].unbind(2)
        frame = self._ball(thumb, "cmc", "metacarpal", None, along[0], along[1:])
        frame = self._ball(thumb, "mcp", "proximal", frame, along[1], along[2:])
        self._hinge(thumb, "ip", "distal", frame, along[2])
        fingers, along = FINGERS[1:], bones[:, 1:].unbind(2)
        frame = self._turned(fingers, "metacarpal", None)
        frame = self._ball(fingers, "mcp", "proximal", frame, along[0], along[1:])
        self._hinge(fingers, "pip", "middle", frame, along[1])
        frame = self._turned(fingers, "middle", frame)
        self._hinge(fingers, "dip", "distal", frame, along[2])
        return self.joints

    def _ball(
        self,
        digits: tuple[str, ...],
        joint: str,
        bone: str,
        parent: Tensor | None,
        along: Tensor,
        beyond: tuple[Tensor, ...],
    ) -> Tensor:
        """Abduction outside flexion: the bone's direction (-sin fe, cos fe cos aa, ± cos fe sin aa).

        The further the joint is bent, the less the direction tells of the abduction; then the plane in which the next
        bones bend does, whose normal is the flexion axis (0, ∓sin aa, cos aa).
        """
        abduction, flexion = (self._index(_angles(digits, joint, kind)) for kind in ("aa", "fe"))
        axis = self.skeleton.axis.index_select(0, abduction)
        side = torch.sign(axis[:, 0])
        rest = self._rest(digits, bone, parent)
        x, y, z = self._unit(rest, along).unbind(-1)
        far = torch.stack([torch.where(b.isfinite(), b, 0.0) for b in beyond]).sum(0)
        normal = torch.linalg.cross(self._unit(rest, along), self._unit(rest, far))
        normal = torch.where(normal.isfinite(), normal, 0.0)
        forwards, upwards = torch.where(y < 0, -1.0, 1.0), torch.where(normal[..., 2] < 0, -1.0, 1.0)
        cosine = forwards * y + upwards * normal[..., 2]
        sine = side * (forwards * z - upwards * normal[..., 1])
        self._set(abduction, torch.atan2(sine, cosine))
        turned = rotation_from_vector(-self.joints.index_select(1, abduction)[..., None] * axis)
        x, y, _ = (turned @ torch.stack((x, y, z), -1)[..., None]).squeeze(-1).unbind(-1)
        self._set(flexion, torch.atan2(-x, y))
        return self._turned(digits, bone, parent)

    def _hinge(self, digits: tuple[str, ...], joint: str, bone: str, parent: Tensor, along: Tensor) -> None:
        x, y, _ = self._unit(self._rest(digits, bone, parent), along).unbind(-1)
        self._set(self._index(_angles(digits, joint, "fe")), torch.atan2(-x, y))

    def _index(self, places: tuple[int, ...]) -> Tensor:
        return constant_tensor(places, torch.long, self.joints.device)

    def _set(self, angles: Tensor, value: Tensor) -> None:
        lower, upper = (bound.index_select(0, angles) for bound in (self.skeleton.lower, self.skeleton.upper))
        found = torch.where(value.isfinite(), value.clamp(lower, upper), self.joints.index_select(1, angles))
        self.joints.index_copy_(1, angles, found)

    def _rest(self, digits: tuple[str, ...], bone: str, parent: Tensor | None) -> Tensor:
        rest = self.skeleton.rest_rotation.index_select(0, self._index(_bones(digits, bone)))
        return rest if parent is None else parent @ rest

    def _unit(self, frame: Tensor, vector: Tensor) -> Tensor:
        local = (frame.mT @ vector[..., None]).squeeze(-1)
        return local / local.norm(dim=-1, keepdim=True)

    def _turned(self, digits: tuple[str, ...], bone: str, parent: Tensor | None) -> Tensor:
        """hand_from_bone with the angles found so far."""
        turning = _turning(self.skeleton.bone, self.skeleton.order, _bones(digits, bone))
        axes = self.skeleton.axis.index_select(0, self._index(turning)).unflatten(0, (-1, len(digits)))
        angles = self.joints.index_select(1, self._index(turning)).unflatten(1, (-1, len(digits)))
        turns = rotation_from_vector(angles[..., None] * axes)
        return reduce(torch.matmul, turns.unbind(1), self._rest(digits, bone, parent))


@lru_cache(maxsize=64)
def _angles(digits: tuple[str, ...], joint: str, kind: str) -> tuple[int, ...]:
    return tuple(JOINT_DOFS.index(f"{one}_{joint}_{kind}") for one in digits)


@lru_cache(maxsize=64)
def _bones(digits: tuple[str, ...], bone: str) -> tuple[int, ...]:
    return tuple(BONES.index(f"{one}_{bone}") for one in digits)


@lru_cache(maxsize=64)
def _turning(bones: tuple[int, ...], order: tuple[int, ...], turned: tuple[int, ...]) -> tuple[int, ...]:
    """Angles that turn some bones of like joints: first the first one of each bone, then the next ones."""
    each = [_angles_of(bones, order, bone) for bone in turned]
    return tuple(angle for turn in zip(*each, strict=True) for angle in turn)


@lru_cache(maxsize=64)
def _angles_of(bones: tuple[int, ...], order: tuple[int, ...], bone: int) -> tuple[int, ...]:
    """Angles that turn a bone, in the order in which they do."""
    own = [i for i in range(len(JOINT_DOFS)) if bones[i] == bone]
    return tuple(sorted(own, key=lambda i: order[i]))
