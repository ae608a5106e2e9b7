"""Brightness of a hand's surface as a measurement of pose and shape: shape from shading under an unknown light.

The outline of a finger hardly tells where its joints are; its shading does: the slope of the surface changes there.
Lambert's law with one distant light and one reflectance (as in de La Gorce, Fleet and Paragios 2011) holds for few
photographs to the noise: whoever uses these residuals asks first whether they are noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.fit.open_hand.creases import IS_JOINT, boundaries, creases, without_flat_joints
from torchhand.fit.open_hand.light import Light, fit_light
from torchhand.fit.open_hand.parts import NearestParts
from torchhand.fit.open_hand.pixels import PixelGrid
from torchhand.fit.open_hand.problem import OpenHandProblem
from torchhand.fit.open_hand.surface import dot, meet, quadric_numbers
from torchhand.hand import PRIMITIVE_NAMES, HandKinematics
from torchhand.image import dilate, square_kernel
from torchhand.view import HandProjector

_STEP = 1e-4  # of the numerical derivative, prior standard deviations
_NEAR = 1  # squares about a crease
_HIDDEN = torch.tensor([PRIMITIVE_NAMES.index("palm_wrist")])  # the forearm goes on there


@dataclass(frozen=True, kw_only=True)
class ShadingRows:
    """Grey levels of 255, one row for each square that can be explained."""

    residual: Float[Tensor, "rows"]
    """Picture minus model, under the light that explains most."""
    jacobian: Float[Tensor, "rows n"]
    """Of the model in the scaled unknowns."""
    under: Light
    """That one."""
    light: Float[Tensor, "rows 4"]
    """Of the model in the light."""
    variance: Float[Tensor, "rows"]
    """What the formula for creases adds to the noise's."""
    count: Float[Tensor, "rows"]
    """Squares that a residual is the mean of."""
    square: Int[Tensor, "rows"]
    candidates: int
    """Squares that show the hand, those that cannot be explained included."""
    lost: float
    """Squares that showed the hand when this `Shading` was first asked, and where the model has nothing now."""

    @property
    def noise(self) -> float:
        """Robust standard deviation of a single square's residual."""
        if len(self.residual) == 0:
            return float("inf")
        return 1.4826 * float((self.count.sqrt() * self.residual.abs()).median())


class Shading:
    """The rows as a function of the scaled unknowns of an open hand."""

    def __init__(
        self,
        grid: PixelGrid,
        problem: OpenHandProblem,
        kinematics: HandKinematics,
        root_reference: Float[Tensor, "3 3"],
    ) -> None:
        self.grid, self._problem, self._kinematics, self._root_reference = grid, problem, kinematics, root_reference
        self._nearest: NearestParts | None = None
        self._light: Light | None = None
        self._shown: Bool[Tensor, "squares"] | None = None

    def __call__(self, values: Float[Tensor, "n"]) -> ShadingRows:
        """With the Jacobian, by forward differences of the parts' numbers."""
        steps = _STEP * torch.eye(len(values), dtype=values.dtype)
        numbers = self._numbers(torch.cat((values[None], values + steps)))
        return self._rows(numbers[..., 0], (numbers[..., 1:] - numbers[..., :1]) / _STEP)

    def without_slopes(self, values: Float[Tensor, "hands n"]) -> Iterator[ShadingRows]:
        """The same for one hand after the other, but the Jacobian has no columns: a third of the time."""
        for numbers in self._numbers(values).unbind(-1):
            yield self._rows(numbers, None)

    def _rows(self, numbers: Float[Tensor, "37 18"], change: Float[Tensor, "37 18 n"] | None) -> ShadingRows:
        """`change` is that of the numbers with the unknowns."""
        grid = self.grid
        part, is_used = self._parts(numbers)
        self._shown = is_used if self._shown is None else self._shown
        square = is_used.nonzero()[:, 0]
        seen = meet(numbers, part[square], grid.origin[square], grid.direction[square])
        is_sound = seen.depth.isfinite() & (seen.is_kept() | IS_JOINT[part[square]])
        light = self._light or fit_light(
            seen.normal[is_sound], grid.value[square][is_sound], grid.count[square][is_sound]
        )
        found = creases(grid, numbers, part, is_used, light)
        is_sound &= ~found.is_unclear[square]
        square, seen = square[is_sound], seen.select(is_sound)
        normal = seen.normal
        jacobian = normal[:, :0]
        if change is not None:
            # d brightness = light · dn, and n is the gradient over its length
            along = light.slope(normal)
            length = seen.gradient.norm(dim=-1, keepdim=True)
            across = (along - dot(along, normal)[:, None] * normal) / length
            jacobian = _chained(change, part[square], seen.gradient_slope(across))
            row = torch.full_like(part, -1)
            row[square] = torch.arange(len(square))
            is_row = row[found.square] >= 0
            at_creases = _chained(change, found.part[is_row], found.slope[is_row])
            jacobian.index_add_(0, row[found.square[is_row]], at_creases)
        return ShadingRows(
            residual=grid.value[square] - light.brightness(normal) - found.correction[square],
            jacobian=jacobian,
            under=light,
            light=light.basis(normal),
            variance=found.variance[square],
            count=grid.count[square],
            square=square,
            candidates=int(is_used.sum()),
            lost=float(grid.count[self._shown & (part < 0)].sum()),
        )

    def restricted(self, keep: Bool[Tensor, "squares"], rows: ShadingRows) -> "Shading":
        """To some squares, under the light of the rows."""
        grid = replace(self.grid, is_inside=self.grid.is_inside & keep)
        other = Shading(grid, self._problem, self._kinematics, self._root_reference)
        other._light = rows.under
        return other

    def parts(self, values: Float[Tensor, "n"]) -> Int[Tensor, "squares"]:
        """What every square shows; -1 where it is not compared."""
        part, is_used = self._parts(self._numbers(values[None])[..., 0])
        return torch.where(is_used, part, -1)

    def near_creases(self, values: Float[Tensor, "n"], finer: PixelGrid) -> Bool[Tensor, "finer"]:
        """Of a finer grid the squares near a boundary between parts, joints' balls left out."""
        part, is_used = self._parts(self._numbers(values[None])[..., 0])
        first, second, _ = boundaries(self.grid, part, is_used)
        plane = torch.zeros(len(part), dtype=torch.bool)
        plane[first] = plane[second] = True
        near = dilate(plane.reshape(self.grid.size), square_kernel(_NEAR))
        column, row = self.grid.camera.project(finer.origin + finer.direction).round().long().unbind(-1)
        height, width = self.grid.size
        return near[row.clamp(0, height - 1), column.clamp(0, width - 1)]

    def _parts(self, numbers: Float[Tensor, "37 18"]) -> tuple[Int[Tensor, "squares"], Bool[Tensor, "squares"]]:
        """What every square shows, and whether it is compared."""
        self._nearest = self._nearest or NearestParts(self.grid, numbers)
        part = self._nearest(numbers)
        is_used = (part >= 0) & ~torch.isin(part, _HIDDEN)
        return without_flat_joints(self.grid, numbers, part, is_used), is_used

    def _numbers(self, values: Float[Tensor, "hands n"]) -> Float[Tensor, "37 18 hands"]:
        """Numbers of every part of every hand."""
        poses, shapes = self._problem.split(values)
        projector = HandProjector(self._kinematics, self.grid.camera, shapes)
        return quadric_numbers(projector.primitives_cam(projector.frames(poses, self._root_reference)))


def _chained(
    change: Float[Tensor, "37 18 n"], part: Int[Tensor, "rows"], slope: Float[Tensor, "rows 18"]
) -> Float[Tensor, "rows n"]:
    """Chain rule from the numbers of each row's part to the unknowns."""
    order = part.argsort()
    sorted_slope = slope[order]
    counts = part.bincount(minlength=len(change)).tolist()
    blocks = sorted_slope.split(counts)
    found = torch.cat([block @ change[number] for number, block in enumerate(blocks) if len(block)] or [slope[:, :0]])
    return torch.empty_like(found).index_copy_(0, order, found)
