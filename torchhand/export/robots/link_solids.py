"""The hand as twenty solid links for robot simulators: closed meshes cut from the skin, masses and inertias.

Each face of the skin belongs to the bone that carries it most. Digits are cut off the palm and then cut up, one cut
after the other; both sides of a cut are closed by the same fan to its middle, so that links touch without gap at the
bind pose and add up to the hand. Planes cut the palm into the wrist, up to the bases of the metacarpals, and the four
metacarpals, half way between neighbours.

Masses are those of a real hand, in proportion to the links' volumes. Our skin holds less than a real one: 256 ml at the
default proportions, where a hand of 400 g and 1160 kg/m³ (Winter 2009) has 345 ml. It is 187 mm about the knuckles,
where people have 200 mm (ANSUR II), flat at the balls of thumb and little finger, and rounded off at the wrist.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from torchhand.export.clip import MotionClip
from torchhand.export.robots.closed_parts import above_plane, closed_part
from torchhand.export.robots.strength import HAND_MASS
from torchhand.hand import BONES, FINGERS, HandFrames, posed_mesh

_PALM = tuple(BONES.index(f"{finger}_metacarpal") for finger in FINGERS[1:])


@dataclass(frozen=True, kw_only=True)
class LinkSolid:
    """One bone's part of the hand, in the bone's frame."""

    vertices: Float64[np.ndarray, "vertices 3"]
    """Vertices of the solid, metres."""
    faces: Int[np.ndarray, "faces 3"]
    """Counter-clockwise seen from outside; every edge has two faces."""
    mass: float
    """Mass, kg."""
    centre: Float64[np.ndarray, "3"]
    """Centre of mass, metres."""
    inertia: Float64[np.ndarray, "3 3"]
    """About the centre of mass, kg m²."""


def link_solids(clip: MotionClip, *, mass: float | None = None) -> tuple[LinkSolid, ...]:
    """The links of a clip's hand in the order of BONES.

    mass: of all together, kg; that of an adult's hand, by volume, where it is None.
    """
    mesh = clip.model.mesh
    if mesh is None:
        raise ValueError(f"model: expected one with a mesh, {clip.model.name!r} has none")
    state = clip.hand(mesh.bind_pose.double(), clip.shape)
    part = posed_mesh(clip.hand, state).part_of_face.numpy()
    whole = _Piece(state.vertices.contiguous().numpy(), state.faces.numpy(), np.where(np.isin(part, _PALM), 0, part))
    pieces, palm = {}, whole
    for finger in FINGERS:
        digit, palm = palm.cut(_digit(finger), own=_digit(finger)[0], other=0)
        for inner, outer in pairwise(_digit(finger)):
            digit, pieces[inner] = digit.cut([bone for bone in _digit(finger) if bone >= outer], own=outer, other=inner)
        pieces[_digit(finger)[-1]] = digit
    pieces |= _palm(palm, state.frames)
    rotation, position = state.frames.rotation.numpy(), state.frames.position.numpy()
    volume = _volume(whole.vertices, whole.faces)
    if mass is None:
        default = clip.hand(mesh.bind_pose.double(), clip.model.shape_space.default.double())
        mass = HAND_MASS * volume / _volume(default.vertices.contiguous().numpy(), whole.faces)
    density = mass / volume
    return tuple(
        _solid((pieces[bone].vertices - position[bone]) @ rotation[bone], pieces[bone].faces, density)
        for bone in range(len(BONES))
    )


class _Piece(NamedTuple):
    """A closed mesh whose faces know their bones."""

    vertices: np.ndarray
    faces: np.ndarray
    bones: np.ndarray

    def cut(self, bones: list[int], *, own: int, other: int) -> "tuple[_Piece, _Piece]":
        """The faces of these bones, and the rest; what closes them is given to the bones `own` and `other`."""
        is_in = np.isin(self.bones, bones)
        return self._closed(is_in, own), self._closed(~is_in, other)

    def _closed(self, chosen: np.ndarray, bone: int) -> "_Piece":
        vertices, faces = closed_part(self.vertices, self.faces[chosen])
        added = np.full(len(faces) - int(chosen.sum()), bone)
        return _Piece(vertices, faces, np.concatenate((self.bones[chosen], added)))

    def above(self, normal: np.ndarray, point: np.ndarray) -> "_Piece":
        """The part beyond a plane; bones are forgotten."""
        vertices, faces = above_plane(self.vertices, self.faces, normal, point)
        return _Piece(vertices, faces, np.zeros(len(faces), dtype=np.int64))


def _digit(finger: str) -> list[int]:
    """Bones of a digit that are no part of the palm, from base to tip."""
    levels = ("metacarpal", "proximal", "distal") if finger == "thumb" else ("proximal", "middle", "distal")
    return [BONES.index(f"{finger}_{level}") for level in levels]


def _palm(palm: _Piece, frames: HandFrames) -> dict[int, _Piece]:
    """The wrist and the four metacarpals, in the frame of the palm."""
    position = frames.position.numpy()
    bases, knuckles = position[list(_PALM)], position[[bone + 5 for bone in _PALM]]
    y = np.array((0.0, 1.0, 0.0))
    border = bases.mean(0)
    pieces = {0: palm.above(-y, border)}
    rest = palm.above(y, border)
    for i in range(len(_PALM) - 1):
        base, knuckle = 0.5 * (bases[i] + bases[i + 1]), 0.5 * (knuckles[i] + knuckles[i + 1])
        normal = np.cross(knuckle - base, (1.0, 0.0, 0.0))
        normal *= np.sign(normal @ (knuckles[i] - knuckles[i + 1])) / np.linalg.norm(normal)
        pieces[_PALM[i]] = rest.above(normal, base)
        rest = rest.above(-normal, base)
    return pieces | {_PALM[-1]: rest}


def _volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Of a closed mesh, m³."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


def _solid(vertices: np.ndarray, faces: np.ndarray, density: float) -> LinkSolid:
    import trimesh  # half a second, which the commands that write no meshes need not wait for

    properties = trimesh.triangles.mass_properties(vertices[faces], density=density)
    return LinkSolid(
        vertices=np.ascontiguousarray(vertices),
        faces=faces,
        mass=float(properties["mass"]),
        centre=np.asarray(properties["center_mass"], dtype=np.float64),
        inertia=np.asarray(properties["inertia"], dtype=np.float64),
    )
