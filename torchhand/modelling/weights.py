"""Skinning weights by diffusion over the surface: which bones carry a vertex, and by how much."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.hand import BONES, FINGERS, HandFrames, ShapeSpace
from torchhand.modelling.diffusion import Diffusion
from torchhand.modelling.field import HandField

INFLUENCES = 4
_MIN_WEIGHT = 0.01  # smaller weights are dropped

# Half widths of the zones in which the skin passes from one bone to the next, metres.
_JOINT_ZONE, _KNUCKLE_ZONE, _THUMB_ZONE = 3.0e-3, 4.5e-3, 8.0e-3
# Where the palm passes from the wrist to the metacarpals, shares of hand length; how far a metacarpal reaches aside,
# share of hand breadth.
_PALM_ZONE = (0.06, 0.20)
_PALM_FRACTION = 0.85  # of the metacarpals where they carry the palm most: soft tissue lags behind the bone
_METACARPAL_REACH = 0.12


def skin_weights(
    space: ShapeSpace,
    frames: HandFrames,
    shape: Float[Tensor, "shape"],
    vertices: Float[Tensor, "vertices 3"],
    faces: Int[Tensor, "faces 3"],
) -> tuple[Int[Tensor, "vertices 4"], Float[Tensor, "vertices 4"]]:
    """Bones and weights of every vertex. For every joint the part beyond it is diffused over the surface, by a width
    of its own; the palm is shared out between wrist and metacarpals.
    """
    metric = space.metric(shape)
    beyond = _parts(HandField(space, frames, shape), frames, vertices)
    diffuse = Diffusion(vertices, faces)
    weights = torch.zeros(len(vertices), len(BONES), dtype=torch.float64)
    left = torch.ones(len(vertices), dtype=torch.float64)
    for finger in FINGERS:
        thumb = finger == "thumb"
        chain = ("metacarpal", "proximal", "distal") if thumb else ("proximal", "middle", "distal")
        zones = (_THUMB_ZONE, _KNUCKLE_ZONE, _JOINT_ZONE) if thumb else (_KNUCKLE_ZONE, _JOINT_ZONE, _JOINT_ZONE)
        fractions = [
            diffuse(beyond[f"{finger}_{bone}"], zone).clamp(0, 1) for bone, zone in zip(chain, zones, strict=True)
        ]
        fractions = [*fractions, torch.zeros_like(left)]
        left = left - fractions[0]
        for i, bone in enumerate(chain):
            weights[:, BONES.index(f"{finger}_{bone}")] = (fractions[i] - fractions[i + 1]).clamp_min(0)
    weights += left.clamp_min(0)[:, None] * _palm(frames, metric, vertices)
    weights[weights < _MIN_WEIGHT] = 0
    top, bones = weights.topk(INFLUENCES, -1)
    return bones, top / top.sum(-1, keepdim=True)


def _parts(field: HandField, frames: HandFrames, vertices: Tensor) -> dict[str, Tensor]:
    """Whether, for every bone of the digits, a vertex lies on it or beyond."""
    digits = torch.stack([field.digit_distance(vertices, finger) for finger in FINGERS], -1)
    nearest = digits.argmin(-1)
    found = {}
    for i, finger in enumerate(FINGERS):
        on_digit = nearest == i
        for bone in ("proximal", "distal") if finger == "thumb" else ("proximal", "middle", "distal"):
            index = BONES.index(f"{finger}_{bone}")
            height = (vertices - frames.position[index]) @ frames.rotation[index][:, 1]
            on_digit = on_digit & (height > 0)
            found[f"{finger}_{bone}"] = on_digit
    found["thumb_metacarpal"] = found["thumb_proximal"] | field.thumb_base(vertices)
    return {name: part.double() for name, part in found.items()}


def _palm(frames: HandFrames, metric: dict[str, Tensor], vertices: Tensor) -> Tensor:
    """Shares of the wrist and the four metacarpals where nothing else carries the skin."""
    fractions = torch.zeros(len(vertices), len(BONES), dtype=torch.float64)
    low, high = (fraction * metric["hand_length"] for fraction in _PALM_ZONE)
    height = (vertices - frames.position[0]) @ frames.rotation[0][:, 1]
    up = ((height - low) / (high - low)).clamp(0, 1)
    up = _PALM_FRACTION * up * up * (3 - 2 * up)
    reach = _METACARPAL_REACH * metric["hand_breadth"]
    aside = []
    for finger in FINGERS[1:]:
        start = frames.position[BONES.index(f"{finger}_metacarpal")]
        end = frames.position[BONES.index(f"{finger}_proximal")]
        along = ((vertices - start) @ (end - start) / (end - start).square().sum()).clamp(0, 1)
        gap = (vertices - start - along[:, None] * (end - start))[:, 2]
        aside.append(-0.5 * (gap / reach).square())
    kernel = torch.stack(aside, -1).softmax(-1)
    for i, finger in enumerate(FINGERS[1:]):
        fractions[:, BONES.index(f"{finger}_metacarpal")] = up * kernel[:, i]
    fractions[:, 0] = 1 - up
    return fractions
