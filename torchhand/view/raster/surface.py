"""One interface for both surfaces of a hand, the primitives and the skinned mesh (Ouhaddi and Horain 1998, figure
5)."""

from dataclasses import fields, replace

import torch
from jaxtyping import Bool
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import PosedMesh, Primitives
from torchhand.precision import own_precision
from torchhand.view.raster.raster import mesh_silhouette, rasterize
from torchhand.view.raster.raycast import Raycast, raycast

Surface = Primitives | PosedMesh
"""Of one hand or a batch, in the world; both have `moved` and `select`."""


@own_precision
def cast(surface: Surface, camera: Camera) -> Raycast:
    """What a camera sees of one hand (no batch dimension), pixel by pixel.

    `part` is an index into PRIMITIVE_NAMES for primitives, into BONES for a mesh, whose normals are smooth.
    """
    if isinstance(surface, Primitives):
        return raycast(surface, camera)
    normals = surface.vertex_normals()
    return rasterize(surface.vertices, surface.faces, camera, surface.part_of_face, normals, is_closed=True)


@own_precision
def silhouette(surface: Surface, camera: Camera) -> Bool[Tensor, "*batch height width"]:
    """Pixels whose centre sees the hand, of every hand of a batch; `cast(...).mask`, of meshes without the rest."""
    if isinstance(surface, PosedMesh):
        return mesh_silhouette(surface.vertices, surface.faces, camera, is_closed=True)
    batch, size = surface.position.shape[:-2], (camera.height, camera.width)
    flat = _flat(surface)
    masks = torch.zeros(len(flat.position), *size, dtype=torch.bool, device=flat.position.device)
    for index in range(len(masks)):
        masks[index] = raycast(flat.select(index), camera).mask
    return masks.reshape(*batch, *size)


def _flat(primitives: Primitives) -> Primitives:
    """The same hands in one row; sizes that all of them share stay one."""
    batch, sizes = primitives.position.shape[:-2], primitives.sizes
    lead = sizes.cone_length.ndim - 1
    if lead:
        values = {f.name: getattr(sizes, f.name) for f in fields(sizes)}
        wide = {name: value.expand(*batch, *value.shape[lead:]) for name, value in values.items()}
        sizes = replace(sizes, **{name: value.reshape(-1, *value.shape[len(batch) :]) for name, value in wide.items()})
    return Primitives(
        sizes=sizes,
        rotation=primitives.rotation.reshape(-1, *primitives.rotation.shape[-3:]),
        position=primitives.position.reshape(-1, *primitives.position.shape[-2:]),
    )
