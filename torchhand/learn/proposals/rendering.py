"""Pictures of single hands and forearms as a z-buffer gives them: what is where, how far away and how it is turned."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from torchhand.geometry import assumed_camera, rotation_of_quaternion
from torchhand.hand import HandModel
from torchhand.learn.proposals.postures import drawn_hands
from torchhand.propose import palm_middle, views_towards
from torchhand.simulate import forearm_meshes
from torchhand.view import rasterize

RENDERED_PX = 96
HAND_SHARE = 0.58
"""Half the side of the smallest square around the hand, over half that of the picture."""
HAND = 1
"""Label."""
_DEPTH_RANGE = 0.15  # metres before and behind the palm
_DISTANCES = (0.22, 1.6)  # metres, from the camera to the palm
_STEEP, _KEPT_STEEP = 0.75, 0.4  # hands that point along the line of sight more than that are rarer by that factor
_AT_ONCE = 256


@dataclass(frozen=True, kw_only=True)
class RenderedHands:
    """Right hands before cameras that look at the middle of the hand, and the truth in the cameras' frames."""

    label: UInt8[Tensor, "hands side side"]
    """0 beside, 1 the hand, 2 to 255 the forearm from the wrist to its end."""
    depth: UInt8[Tensor, "hands side side"]
    """Depth relative to the palm's, 0 to 255 for `_DEPTH_RANGE` before to as much behind; 255 where nothing is."""
    normal: UInt8[Tensor, "hands 2 side side"]
    """x and y of the unit normal in the camera frame, 0 to 255 for -1 to 1."""
    rotation: Float[Tensor, "hands 3 3"]
    """cam_from_hand"""
    joints: Float[Tensor, "hands 30"]
    palm: Float[Tensor, "hands 3"]
    """Middle of the palm in the camera frame, metres."""
    length: Float[Tensor, "hands"]
    """The hands' lengths, metres."""
    reach: Float[Tensor, "hands"]
    """Half the side of the picture on the normalised image plane."""

    def __len__(self) -> int:
        return len(self.reach)

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "RenderedHands":
        return RenderedHands(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    @classmethod
    def cat(cls, parts: "list[RenderedHands]") -> "RenderedHands":
        return cls(**{f.name: torch.cat([getattr(part, f.name) for part in parts]) for f in fields(cls)})


def hand_pool(
    model: HandModel, count: int, generator: torch.Generator, tick: Callable[[int], object] = lambda count: None
) -> RenderedHands:
    """Random hands, rendered. tick: is told of the hands that are ready, some hundreds at a time."""
    joints, shape = drawn_hands(model.prior(dtype=torch.float64), count, generator)
    parts = []
    for rows in torch.arange(count).split(_AT_ONCE):
        parts.append(rendered_hands(model, joints[rows], shape[rows], generator))
        tick(len(rows))
    return RenderedHands.cat(parts)


def rendered_hands(
    model: HandModel,
    joints: Float[Tensor, "hands 30"],
    shape: Float[Tensor, "hands shape"],
    generator: torch.Generator,
) -> RenderedHands:
    """Every hand from a random direction and distance, with a forearm that is bent at the wrist and 24 cm long."""
    parts = zip(joints.split(_AT_ONCE), shape.split(_AT_ONCE), strict=True)
    return RenderedHands.cat([_rendered(model, some.float(), own.float(), generator) for some, own in parts])


def _rendered(model: HandModel, joints: Tensor, shape: Tensor, generator: torch.Generator) -> RenderedHands:
    count = len(joints)
    hand = model.hand(dtype=torch.float32)
    turn = random_directions(count, generator)
    with torch.no_grad():
        state = hand(torch.cat((torch.zeros(count, 6), joints), -1), shape)
    metric = model.shape_space.to(dtype=torch.float32).metric(shape)
    forearm, forearm_faces, forearm_labels = forearm_meshes(metric["wrist_breadth"], generator)
    low, high = (math.log(end) for end in _DISTANCES)
    distance = (low + (high - low) * torch.rand(count, generator=generator)).exp()
    palm = (turn @ palm_middle(state.keypoints)[..., None]).squeeze(-1)
    place = torch.stack((0 * distance, 0 * distance, distance), -1) - palm
    skin, arm = (points @ turn.mT + place[:, None] for points in (state.vertices, forearm))
    looking = _looking_at(skin)
    plane = skin @ looking
    plane = plane[..., :2] / plane[..., 2:]
    reach = plane.abs().amax((1, 2)) / HAND_SHARE
    everything = torch.cat((skin, arm), 1) @ looking
    faces = torch.cat((state.faces, forearm_faces + skin.shape[1]))
    labels = torch.cat((torch.full((len(state.faces),), HAND), forearm_labels))
    palm = (palm + place)[:, None] @ looking
    pictures = [
        _picture(points, faces, labels, float(own_reach), float(depth))
        for points, own_reach, depth in zip(everything, reach, palm[:, 0, 2], strict=True)
    ]
    label, depth, normal = (torch.stack(part) for part in zip(*pictures, strict=True))
    return RenderedHands(
        label=label,
        depth=depth,
        normal=normal,
        rotation=looking.mT @ turn,
        joints=joints,
        palm=palm[:, 0],
        length=metric["hand_length"].expand(count).clone(),
        reach=reach,
    )


def _picture(
    points: Float[Tensor, "points 3"], faces: Tensor, labels: Tensor, reach: float, palm: float
) -> tuple[Tensor, Tensor, Tensor]:
    focal, middle = 0.5 * RENDERED_PX / reach, 0.5 * (RENDERED_PX - 1)
    intrinsics = torch.tensor([[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]])
    camera = replace(assumed_camera(RENDERED_PX, RENDERED_PX, dtype=torch.float32), intrinsics=intrinsics)
    seen = rasterize(points.contiguous(), faces, camera, labels, is_closed=True)
    depth = ((seen.depth - palm) / _DEPTH_RANGE).clamp(-1, 1)
    normal = seen.normal[..., :2].movedim(-1, 0)
    return seen.part.clamp_min(0).to(torch.uint8), stored_bytes(depth), stored_bytes(normal)


def stored_bytes(values: Tensor) -> UInt8[Tensor, "*shape"]:
    """-1 to 1 as 0 to 255, as pictures of depth and normals are kept."""
    return (127.5 * (values + 1)).round().to(torch.uint8)


def random_directions(count: int, generator: torch.Generator) -> Float[Tensor, "count 3 3"]:
    """cam_from_hand: uniform, but for hands that point along the line of sight, which are rarer."""
    tries = rotation_of_quaternion(
        torch.nn.functional.normalize(torch.randn(4 * count + 64, 4, generator=generator), dim=-1)
    )
    chance = torch.rand(len(tries), generator=generator)
    kept = (tries[:, 2, 1].abs() < _STEEP) | (chance < _KEPT_STEEP)
    return tries[kept][:count]


def _looking_at(points: Float[Tensor, "hands points 3"]) -> Float[Tensor, "hands 3 3"]:
    """cam_from_view of views towards the middle of the points' picture."""
    plane = points[..., :2] / points[..., 2:]
    middle = 0.5 * (plane.amin(1) + plane.amax(1))
    ahead = torch.cat((middle, torch.ones_like(middle[:, :1])), -1)
    up = torch.tensor((0.0, -1.0, 0.0)).expand_as(ahead)
    return views_towards(ahead, up, torch.ones(len(ahead))).cam_from_view
