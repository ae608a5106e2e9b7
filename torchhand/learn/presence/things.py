"""Things that are no hands, rendered as the hands are: heads, limbs, furniture, lumps, boxes, and spots of noise."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import torch
import trimesh
from jaxtyping import Float, Int, UInt8
from torch import Tensor
from torch.nn import functional

from torchhand.geometry import assumed_camera, rotation_from_vector, rotation_of_quaternion
from torchhand.learn.proposals import RENDERED_PX, stored_bytes
from torchhand.view import rasterize

_SHARE = 0.8  # half a thing's extent, over half the side of the picture
_EXTENTS = (0.08, 0.3)  # metres, as those of hands and of what they hold: shading looks at distances in depth
_DISTANCES = (2.0, 8.0)  # extents
_DEPTH_RANGE = 0.15  # metres before and behind the middle, as in the pictures of hands
_TILT = 0.25  # radians
_COVERED, _STRIPED = 0.4, 0.2  # shares of the things that others cover in part, and that have stripes
_BRIGHTEST = 1.3  # albedo
_NOISE = 0.12  # share of the things that are spots of noise
_CELLS = (4, 24)


@dataclass(frozen=True)
class Part:
    """A closed mesh."""

    points: Float[Tensor, "points 3"]
    faces: Int[Tensor, "faces 3"]
    albedo: float = 1.0
    """Brightness under equal light; 0 of a part that has other colours, which a segmentation leaves out."""

    def turned(self, turn: Float[Tensor, "3 3"]) -> "Part":
        return replace(self, points=self.points @ turn.mT)


@dataclass(frozen=True, kw_only=True)
class RenderedThings:
    """Things (*things) before cameras that look at their middle."""

    label: UInt8[Tensor, "*things side side"]
    """1 where the thing is."""
    depth: UInt8[Tensor, "*things side side"]
    """As in `RenderedHands`, relative to the thing's middle."""
    normal: UInt8[Tensor, "*things 2 side side"]
    """As in `RenderedHands`."""
    albedo: UInt8[Tensor, "*things side side"]
    """Brightness under equal light, of 255."""

    def __len__(self) -> int:
        return len(self.label)

    @property
    def brightness(self) -> Float[Tensor, "*things side side"]:
        return self.albedo.float() * (_BRIGHTEST / 255)

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "RenderedThings":
        return RenderedThings(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def thing_pool(
    count: int, generator: torch.Generator, tick: Callable[[int], object] = lambda count: None
) -> RenderedThings:
    """Random things, all kinds in turn. tick: is told of those that are ready."""
    pictures = []
    for index in range(count):
        if float(torch.rand((), generator=generator)) < _NOISE:
            pictures.append(_spots(generator))
        else:
            make, is_upright = _KINDS[index % len(_KINDS)]
            pictures.append(_rendered(make(_Chance(generator)), generator, is_upright=is_upright))
        tick(1)
    return RenderedThings(
        **{f.name: torch.stack([getattr(one, f.name) for one in pictures]) for f in fields(RenderedThings)}
    )


@dataclass(frozen=True)
class _Chance:
    """Random numbers."""

    generator: torch.Generator

    def between(self, low: float, high: float) -> float:
        return low + (high - low) * float(torch.rand((), generator=self.generator))

    def vector(self, std: float = 1.0) -> Tensor:
        return std * torch.randn(3, generator=self.generator)

    def number(self, low: int, high: int) -> int:
        return int(torch.randint(low, high + 1, (), generator=self.generator))

    def happens(self, share: float) -> bool:
        return self.between(0.0, 1.0) < share

    def sizes(self, low: float, high: float) -> tuple[float, float, float]:
        return self.between(low, high), self.between(low, high), self.between(low, high)

    def turn(self) -> Float[Tensor, "3 3"]:
        return rotation_of_quaternion(functional.normalize(torch.randn(4, generator=self.generator), dim=-1))


@lru_cache
def _unit(kind: str) -> tuple[Tensor, Tensor]:
    """Points and faces of a ball of radius 1, a box of half sides 1, or a bar of radius 1 from z = -1 to 1."""
    made = {
        "ball": lambda: trimesh.creation.icosphere(subdivisions=3),
        "box": lambda: trimesh.creation.box(extents=(2, 2, 2)),
        "bar": lambda: trimesh.creation.cylinder(radius=1, height=2, sections=32),
    }[kind]()
    return torch.tensor(made.vertices, dtype=torch.float32), torch.tensor(made.faces, dtype=torch.long)


def _part(
    kind: str, centre: Tensor, sizes: tuple[float, float, float], turn: Tensor | None = None, albedo: float = 1.0
) -> Part:
    points, faces = _unit(kind)
    points = points * torch.tensor(sizes)
    return Part((points if turn is None else points @ turn.mT) + centre, faces, albedo)


def _cone(start: Tensor, end: Tensor, first: float, last: float, flatness: float = 1.0) -> Part:
    """A bar from one point to another whose radius changes from one to the other."""
    points, faces = _unit("bar")
    share = 0.5 * (points[:, 2:] + 1)
    along = functional.normalize(end - start, dim=0)
    other = torch.tensor((0.3, 0.2, 0.9)) if abs(float(along[2])) < 0.9 else torch.tensor((0.9, 0.2, 0.1))
    across = functional.normalize(torch.linalg.cross(along, other), dim=0)
    third = torch.linalg.cross(along, across)
    ring = points[:, :1] * across + flatness * points[:, 1:2] * third
    return Part(start + share * (end - start) + (first + share * (last - first)) * ring, faces)


def _head(chance: _Chance) -> list[Part]:
    """Upright, turned to the side by up to 60 degrees; with hair, ears, neck, shoulders and arms or without. y down."""
    zero = torch.zeros(3)
    broad, deep = chance.between(0.65, 0.85), chance.between(0.8, 1.0)
    mouth, dark = chance.between(0.5, 1.0), chance.between(0.2, 1.0)
    parts = [
        _part("ball", zero, (broad, 1.0, deep)),
        _cone(torch.tensor((0.0, -0.1, -deep)), torch.tensor((0.0, 0.25, -deep - 0.12)), 0.06, 0.16),
        _part("ball", torch.tensor((0.0, 0.5, -0.87 * deep)), (0.25, chance.between(0.05, 0.12), 0.08), None, mouth),
    ]
    for side in (-1.0, 1.0):
        eye = torch.tensor((side * 0.4 * broad, -0.12, -0.84 * deep))
        parts.append(_part("ball", eye, (0.14, 0.08, 0.1), None, chance.between(0.9, 1.3)))
        parts.append(_part("ball", eye - torch.tensor((0.0, 0.0, 0.08)), (0.06, 0.06, 0.05), None, dark))
        brow = torch.tensor((side * 0.4 * broad, -0.3, -0.86 * deep))
        parts.append(_part("ball", brow, (0.2, 0.05, 0.08), None, dark))
        if chance.happens(0.7):
            parts.append(_part("ball", torch.tensor((side * 1.02 * broad, 0.05, 0.0)), (0.1, 0.25, 0.16)))
    if chance.happens(0.7):
        back, colour = chance.between(1.02, 1.3), chance.between(0.3, 1.1) if chance.happens(0.3) else 0.0
        sizes = (broad * back, back, deep * back)
        parts.append(_part("ball", torch.tensor((0.0, -0.2, 0.25)), sizes, None, colour))
    turn = rotation_from_vector(torch.tensor((chance.between(-0.35, 0.35), chance.between(-1.0, 1.0), 0.0)))
    parts = [part.turned(turn) for part in parts]
    if chance.happens(0.75):
        parts.append(_cone(zero, torch.tensor((0.0, 1.7, 0.15)), 0.45, chance.between(0.5, 0.65)))
    if chance.happens(0.5):
        half = chance.between(1.4, 2.1)
        sizes, colour = (half, chance.between(0.7, 1.1), 0.7), float(chance.happens(0.5))
        parts.append(_part("ball", torch.tensor((0.0, 2.4, 0.2)), sizes, None, colour))
        for side in (-1.0, 1.0):
            if chance.happens(0.4):
                elbow = torch.tensor((side * (half + chance.between(-0.2, 0.8)), chance.between(3.5, 4.5), 0.0))
                parts.append(_cone(torch.tensor((side * 0.85 * half, 2.3, 0.2)), elbow, 0.38, 0.28))
    return parts


def _limb(chance: _Chance) -> list[Part]:
    """An arm or a leg of one to three pieces, which may end in a foot."""
    place, radius, parts = torch.zeros(3), chance.between(0.15, 0.5), []
    along = functional.normalize(chance.vector(), dim=0)
    for _ in range(chance.number(1, 3)):
        end, narrower = place + chance.between(1.0, 3.0) * along, radius * chance.between(0.6, 1.15)
        parts += [_cone(place, end, radius, narrower, chance.between(0.75, 1.0))]
        parts += [_part("ball", end, (1.03 * narrower, 1.03 * narrower, 1.03 * narrower))]
        place, radius = end, narrower
        along = functional.normalize(along + chance.vector(0.5), dim=0)
    if chance.happens(0.3):
        foot = functional.normalize(along + chance.vector(0.7), dim=0)
        parts += [_cone(place, place + chance.between(0.5, 1.2) * foot, radius, 0.7 * radius, 0.6)]
    return parts


def _furniture(chance: _Chance) -> list[Part]:
    """A board with legs, or posts, of about one length and thickness."""
    half = (chance.between(0.5, 1.2), chance.between(0.08, 0.6), chance.between(0.15, 1.0))
    parts = [_part("box", torch.zeros(3), half)]
    count, thick, length = chance.number(2, 8), chance.between(0.03, 0.14), chance.between(0.5, 2.2)
    slant, is_row = chance.between(-0.3, 0.3), chance.happens(0.5)
    for number in range(count):
        share = 2 * number / (count - 1) - 1
        z = 0.0 if is_row else (-1.0 if number % 2 else 1.0) * 0.85 * half[2]
        top = torch.tensor((0.92 * share * half[0], 0.5 * half[1], z))
        end = top + torch.tensor((slant * share, length * chance.between(0.93, 1.07), 0.0))
        parts.append(_cone(top, end, thick, thick * chance.between(0.6, 1.0)))
    if chance.happens(0.3):
        back = torch.tensor((0.0, -chance.between(0.4, 1.2), half[2]))
        parts.append(_part("box", back, (half[0], float(-back[1]), 0.07)))
    return parts


def _lumps(chance: _Chance) -> list[Part]:
    return [
        _part("ball", chance.vector(0.6), chance.sizes(0.15, 0.8), chance.turn(), chance.between(0.7, 1.1))
        for _ in range(chance.number(1, 8))
    ]


def _boxes(chance: _Chance) -> list[Part]:
    parts = []
    for _ in range(chance.number(1, 5)):
        kind = "box" if chance.happens(0.6) else "bar"
        parts.append(_part(kind, chance.vector(0.5), chance.sizes(0.08, 0.8), chance.turn(), chance.between(0.7, 1.1)))
    return parts


def _bars(chance: _Chance) -> list[Part]:
    """Bars of all directions across each other, such as twigs, pens and cables."""
    parts = []
    for _ in range(chance.number(2, 7)):
        middle, along, thick = chance.vector(0.3), chance.vector(0.8), chance.between(0.04, 0.2)
        parts.append(_cone(middle - along, middle + along, thick, thick * chance.between(0.5, 1.0)))
    return parts


_KINDS = (
    (_head, True),
    (_limb, False),
    (_furniture, False),
    (_lumps, False),
    (_head, True),
    (_boxes, False),
    (_limb, False),
    (_bars, False),
)
"""What is made, and whether it is held as it is made but for some degrees; the roll of all is the view's."""


def _covers(chance: _Chance, points: Float[Tensor, "points 3"]) -> list[Part]:
    """Things of other colours before a thing, of which they leave pieces with round or straight edges."""
    size = 0.5 * float((points.amax(0) - points.amin(0))[:2].max())
    parts = []
    for _ in range(chance.number(1, 3)):
        place = chance.vector(0.7 * size)
        place[2] = float(points[:, 2].min()) - 0.3 * size
        sizes = (size * chance.between(0.1, 0.7), size * chance.between(0.1, 0.7), 0.1 * size)
        kind = "ball" if chance.happens(0.5) else "box"
        roll = rotation_from_vector(torch.tensor((0.0, 0.0, chance.between(-math.pi, math.pi))))
        parts.append(_part(kind, place, sizes, roll, 0.0))
    return parts


def _rendered(parts: list[Part], generator: torch.Generator, *, is_upright: bool) -> RenderedThings:
    """One thing, turned and seen from some distance, with or without things before it."""
    chance = _Chance(generator)
    turn = rotation_from_vector(chance.vector(_TILT)) if is_upright else chance.turn()
    parts = [part.turned(turn) for part in parts]
    whole = torch.cat([part.points for part in parts])
    middle, spread = 0.5 * (whole.amin(0) + whole.amax(0)), (whole.amax(0) - whole.amin(0))[:2].max()
    parts = [replace(part, points=part.points - middle) for part in parts]
    if chance.happens(_COVERED):
        parts += _covers(chance, whole - middle)
    extent = chance.between(*_EXTENTS)
    points = torch.cat([part.points for part in parts]) * (extent / float(spread))
    counts = torch.tensor([0, *(len(part.points) for part in parts)]).cumsum(0).tolist()
    faces = torch.cat([part.faces + first for part, first in zip(parts, counts[:-1], strict=True)])
    owner = torch.arange(len(parts)).repeat_interleave(torch.tensor([len(part.faces) for part in parts]))
    distance = extent * math.exp(chance.between(*(math.log(end) for end in _DISTANCES))) + float(-points[:, 2].min())
    reach = 0.5 * extent / distance / _SHARE
    focal, centre = 0.5 * RENDERED_PX / reach, 0.5 * (RENDERED_PX - 1)
    intrinsics = torch.tensor([[focal, 0.0, centre], [0.0, focal, centre], [0.0, 0.0, 1.0]])
    camera = replace(assumed_camera(RENDERED_PX, RENDERED_PX, dtype=torch.float32), intrinsics=intrinsics)
    ahead = points + torch.tensor((0.0, 0.0, distance))
    seen = rasterize(ahead.contiguous(), faces, camera, owner, is_closed=True)
    albedo = torch.tensor([*(part.albedo for part in parts), 0.0])[seen.part]  # the last where nothing is: part -1
    if chance.happens(_STRIPED):
        albedo = albedo * _stripes(chance)
    return RenderedThings(
        label=(albedo > 0).to(torch.uint8),
        depth=stored_bytes(((seen.depth - distance) / _DEPTH_RANGE).clamp(-1, 1)),
        normal=stored_bytes(seen.normal[..., :2].movedim(-1, 0)),
        albedo=_stored_albedo(albedo),
    )


def _stripes(chance: _Chance) -> Float[Tensor, "side side"]:
    """Brightness of a texture of stripes, such as wood's, somewhat bent."""
    steps = torch.arange(RENDERED_PX) / RENDERED_PX
    turn, period, bend = chance.between(0.0, math.pi), chance.between(0.02, 0.2), chance.between(0.0, 0.05)
    across = math.cos(turn) * steps + math.sin(turn) * steps[:, None]
    along = math.cos(turn) * steps[:, None] - math.sin(turn) * steps
    wave = torch.sin(2 * math.pi * (across + bend * torch.sin(8 * along)) / period)
    return 1 - chance.between(0.05, 0.4) * (0.5 + 0.5 * wave)


def _stored_albedo(albedo: Tensor) -> UInt8[Tensor, "*shape"]:
    return (255 / _BRIGHTEST * albedo).clamp(0, 255).round().to(torch.uint8)


def _spots(generator: torch.Generator) -> RenderedThings:
    """Spots of smooth noise with a relief of noise, such as textures leave in a segmentation."""
    chance = _Chance(generator)
    noise = _noise(chance.number(*_CELLS), 1, generator)[0]
    label = noise > chance.between(-0.6, 1.0)
    relief = _noise(chance.number(*_CELLS), 3, generator).clamp(-2, 2) * torch.tensor((0.1, 0.3, 0.3))[:, None, None]
    relief = relief * chance.between(0.0, 1.0)
    albedo = _stripes(chance) if chance.happens(_STRIPED) else torch.ones_like(noise)
    return RenderedThings(
        label=label.to(torch.uint8),
        depth=stored_bytes(torch.where(label, relief[0], 1.0)),
        normal=stored_bytes(relief[1:]),
        albedo=_stored_albedo(albedo),
    )


def _noise(cells: int, count: int, generator: torch.Generator) -> Float[Tensor, "count side side"]:
    coarse = torch.randn(1, count, cells, cells, generator=generator)
    size = (RENDERED_PX, RENDERED_PX)
    return 1.4 * functional.interpolate(coarse, size=size, mode="bicubic", align_corners=False)[0]
