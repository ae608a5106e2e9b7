"""The hand as one module: a pose in, bones, keypoints, skin and primitives out."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from torchhand.devices import kept_property
from torchhand.errors import require_kind
from torchhand.geometry import batch_last, common_shape
from torchhand.hand.kinematics import DOFS, HandFrames, HandKinematics, ShapeSpace, Side, Skeleton
from torchhand.hand.primitives import Primitives, place_primitives, primitive_sizes
from torchhand.hand.skin import HandMesh, Skinning, mirrored_mesh
from torchhand.precision import own_precision, record


@record("faces", "shape_space", "is_left")
@dataclass(frozen=True, kw_only=True)
class HandState:
    """A posed hand in the world, metres; differentiable in pose and shape.

    A pytree: `torch.vmap` and `torch.func` take hands and give such records.
    """

    frames: HandFrames
    """Rotations and origins of the bones."""
    vertices: Float[Tensor, "*batch vertices 3"]
    """The skin. Not contiguous: x, y and z lie apart in memory."""
    faces: Int[Tensor, "faces 3"]
    """Triangles, counter-clockwise seen from outside; the same for every hand of one side."""
    shape: Float[Tensor, "*#batch shape"]
    """Parameters that the hand was made with."""
    shape_space: ShapeSpace
    is_left: bool

    @property
    def keypoints(self) -> Float[Tensor, "*batch 21 3"]:
        """The 21 keypoints."""
        return self.frames.keypoints

    @kept_property
    def primitives(self) -> Primitives:
        """The 37 truncated quadrics, made when they are first asked for."""
        return place_primitives(self.frames, primitive_sizes(self.shape_space, self.shape), is_left=self.is_left)


class Hand(nn.Module):
    """A hand of one side: pose in, `HandState` out; any batch shape, differentiable any number of times.

    The shape is the module's own, `hand.shape`: a parameter if it was given as one, a buffer otherwise (its gradient
    flows to the tensor that was given). It is all that `state_dict` holds. A left hand is the exact mirror of the
    right one: same pose numbers, z of the hand frame reversed.
    """

    shape: Tensor
    faces: Tensor

    def __init__(
        self,
        shape: Float[Tensor, "*batch shape"] | None = None,
        *,
        skeleton: Skeleton,
        shape_space: ShapeSpace,
        mesh: HandMesh,
        side: Side = "right",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """
        shape: parameters of the shape space, one hand or many; the default proportions where it is None.
        skeleton, shape_space, mesh: of a hand model; `HandModel.hand` gives them.
        dtype: what to compute in; a shape of another dtype is converted, its gradient flows on.
            Constants are rounded to it once, so for float64 say so here instead of converting the module later.

        Raises ValueError for a shape that is not finite or outside its bounds, for other dtypes, and for a parameter
        given as shape that has another dtype; TypeError for what is no tensor.
        """
        super().__init__()
        if shape is not None:
            require_kind("shape", shape, Tensor)
        if not (isinstance(dtype, torch.dtype) and dtype.is_floating_point):
            raise ValueError(f"dtype: expected one of floating-point numbers, got {dtype!r}")
        if isinstance(shape, nn.Parameter) and shape.dtype != dtype:
            raise ValueError(f"dtype: expected {shape.dtype}, that of the parameter given as shape, got {dtype}")
        self.side: Side = side
        self.shape_space = shape_space
        exact = HandKinematics(skeleton, shape_space.to(dtype=torch.float64), side).double()
        self.kinematics = HandKinematics(skeleton, shape_space.to(dtype=dtype), side).to(dtype)
        mesh = mesh.to(dtype=torch.float64) if side == "right" else mirrored_mesh(mesh.to(dtype=torch.float64))
        self.skinning = Skinning(mesh, exact).to(dtype)
        self.register_buffer("faces", mesh.faces.clone(), persistent=False)
        if isinstance(shape, nn.Parameter):
            self.shape = shape
        else:
            given = shape_space.default if shape is None else shape
            self.register_buffer("shape", given.to(dtype, copy=shape is None))
        self._check_width("shape", self.shape, len(self.shape_space.names))
        self.shape_space.check(self.shape)

    @own_precision
    def forward(
        self,
        pose: Float[Tensor, "*#batch 36"],
        shape: Float[Tensor, "*#batch shape"] | None = None,
        *,
        root_reference: Float[Tensor, "*#batch 3 3"] | None = None,
    ) -> HandState:
        """The hand in the world.

        pose: metres and radians in the order of DOFS; its rotation vector turns the hand frame, or `root_reference`
            where that is given (left perturbation: world_from_hand = exp(pose[3:6]) · root_reference).
        shape: in place of the module's own. Both broadcast; one shape for all poses is several times faster than a
            shape for each.

        Raises TypeError for what is no tensor, ValueError for wrong dimensions and for another dtype than the module's;
        within `torch.autocast` it computes in float32 all the same. NaN and infinite numbers go through to the results,
        because looking for them would make a GPU wait; see `check`.
        """
        self.check_sizes(pose, shape)
        shape = self.shape if shape is None else shape
        rotations = () if root_reference is None else (root_reference[..., 0, 0],)
        batch = common_shape(pose[..., 0], shape[..., 0], *rotations)
        pose = pose.expand(*batch, len(DOFS))
        is_shared = all(size == 1 for size in shape.shape[:-1])
        one_or_many = shape.reshape(-1) if is_shared else shape
        frames = self.kinematics(pose, one_or_many, root_reference=root_reference)
        vertices = self.skinning(
            batch_last(frames.rotation, 3, batch),
            batch_last(frames.position, 2, batch),
            batch_last(pose, 1, batch),
            batch_last(self.kinematics.metres(one_or_many), 1, batch),
        )
        return HandState(
            frames=frames,
            vertices=vertices.unflatten(0, batch) if batch else vertices[0],
            faces=self.faces,
            shape=shape,
            shape_space=self.shape_space,
            is_left=self.side == "left",
        )

    def check(
        self,
        pose: Float[Tensor, "*#batch 36"] | None = None,
        shape: Float[Tensor, "*#batch shape"] | None = None,
    ) -> None:
        """Raises ValueError where a pose or shape holds NaN or infinite numbers or a shape is outside its bounds.

        Waits for the device. `forward` does not do it; a shape given to the constructor has been checked.
        """
        if pose is not None:
            self._check_width("pose", pose, len(DOFS))
            _check_finite(pose)
        if shape is not None:
            self._check_width("shape", shape, len(self.shape_space.names))
            self.shape_space.check(shape)

    def check_sizes(self, pose: Tensor, shape: Tensor | None = None) -> None:
        """Raises ValueError for a pose or a shape of other dimensions or another dtype than the hand's, TypeError for
        what is no tensor."""
        self._check_width("pose", pose, len(DOFS))
        if shape is not None:
            self._check_width("shape", shape, len(self.shape_space.names))

    def _check_width(self, name: str, value: Tensor, width: int) -> None:
        require_kind(name, value, Tensor)
        if value.ndim == 0 or value.shape[-1] != width:
            raise ValueError(f"{name}: expected {width} numbers in the last dimension, got shape {tuple(value.shape)}")
        if value.dtype != self.skinning.weights.dtype:
            raise ValueError(
                f"{name}: expected {self.skinning.weights.dtype}, in which the hand computes, got {value.dtype}"
            )


def _check_finite(pose: Tensor) -> None:
    values = pose.detach().reshape(-1, len(DOFS))
    is_wrong = (~values.isfinite()).nonzero()
    if len(is_wrong):
        row, column = is_wrong[0].tolist()
        raise ValueError(f"pose: {DOFS[column]}: expected finite numbers, got {float(values[row, column])}")
