"""How the vertices move with the shape parameters: linear, as the joints themselves do."""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.hand import BONES, KEYPOINTS, HandFrames, HandKinematics
from torchhand.modelling.field import HandField
from torchhand.modelling.surface import projected

_BEYOND = 1.15  # a bone's lengthening is carried on so far past its end


def shape_basis(
    kinematics: HandKinematics,
    pose: Float[Tensor, "36"],
    vertices: Float[Tensor, "vertices 3"],
    bones: Int[Tensor, "vertices 4"],
    weights: Float[Tensor, "vertices 4"],
    *,
    names: Sequence[str] | None = None,
    on_step: Callable[[int], object] = lambda steps: None,
) -> Float[Tensor, "vertices 3 columns"]:
    """Change of the vertices with each parameter in metres, by central differences about the default shape.

    A vertex first goes with its bones, stretched along each as the bone is; then along the normal to the skin of the
    changed hand, where it keeps the distance that it had.

    names: the parameters that are wanted; all of them if not given. on_step: called after every parameter.
    """
    space = kinematics.shape_space
    default = kinematics.default_shape
    metres = space.metres(default)
    frames = kinematics(pose, default)
    level = HandField(space, frames, default)(vertices)
    steps = metres * space.std / default.abs().clamp_min(1e-9)
    steps = torch.where(default == 0, space.std * metres[space.names.index("hand_breadth")], steps).abs()
    columns = []
    for name in names or space.names:
        i = space.names.index(name)
        sides = []
        for sign in (1.0, -1.0):
            changed = metres.clone()
            changed[i] += sign * steps[i]
            shape = shape_of_metres(space.names, space.units, changed)
            moved_frames = kinematics(pose, shape)
            carried = _carried(vertices, bones, weights, frames, moved_frames)
            sides.append(projected(HandField(space, moved_frames, shape), carried, level))
        columns.append((sides[0] - sides[1]) / (2 * steps[i]))
        on_step(1)
    return torch.stack(columns, -1)


def shape_of_metres(names: tuple[str, ...], units: tuple[str, ...], metres: Float[Tensor, "shape"]) -> Tensor:
    """The shape vector whose parameters have the given sizes in metres."""
    length, breadth = metres[names.index("hand_length")], metres[names.index("hand_breadth")]
    scale = {"m": torch.ones_like(length), "/HL": length, "/HB": breadth}
    return metres / torch.stack([scale[unit] for unit in units])


def _carried(vertices: Tensor, bones: Tensor, weights: Tensor, before: HandFrames, after: HandFrames) -> Tensor:
    """Vertices moved with their bones; along a bone its end's displacement sets in linearly."""
    ends_before, ends_after = _ends(before), _ends(after)
    moved = torch.zeros_like(vertices)
    for slot in range(bones.shape[1]):
        bone = bones[:, slot]
        start, end = before.position[bone], ends_before[bone]
        axis = end - start
        fraction = ((vertices - start) * axis).sum(-1) / axis.square().sum(-1)
        at_start = after.position[bone] - start
        at_end = ends_after[bone] - end
        shift = at_start + fraction.clamp(0, _BEYOND)[:, None] * (at_end - at_start)
        moved += weights[:, slot, None] * (vertices + shift)
    return moved


_NEXT = {"metacarpal": "proximal", "proximal": "middle", "middle": "distal"}


def _ends(frames: HandFrames) -> Tensor:
    """Where each bone ends: the next joint or the fingertip; of the wrist, the middle finger's knuckle."""
    ends = []
    for name in BONES:
        if name == "wrist":
            ends.append(frames.position[BONES.index("middle_proximal")])
            continue
        finger, bone = name.split("_")
        following = "distal" if name == "thumb_proximal" else _NEXT.get(bone)
        if following is None:
            ends.append(frames.keypoints[KEYPOINTS.index(f"{finger}_tip")])
        else:
            ends.append(frames.position[BONES.index(f"{finger}_{following}")])
    return torch.stack(ends)
