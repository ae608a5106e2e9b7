"""Hulls as PLY and GLB files, for any viewer of meshes."""

from pathlib import Path
from typing import Literal

from torchhand.errors import InputError
from torchhand.files.disk import replacing
from torchhand.volume import Octree, hull_mesh

HULL_SUFFIXES = (".ply", ".glb")


def save_hull(
    octree: Octree, path: str | Path, *, frame: int = 0, what: Literal["surface", "points"] = "surface"
) -> None:
    """Write the hull of one frame: its closed surface of octant faces, or the centres of its leaves; metres.

    Raises InputError for another suffix than .ply and .glb, and for a frame without hull; ValueError for other things
    to write.
    """
    path = Path(path)
    if path.suffix.lower() not in HULL_SUFFIXES:
        raise InputError(f"{path}: expected a name that ends with {' or '.join(HULL_SUFFIXES)}, got {path.suffix!r}")
    if what not in ("surface", "points"):
        raise ValueError(f"what: expected 'surface' or 'points', got {what!r}")
    import trimesh  # half a second, which the commands that write no meshes need not wait for

    leaves = octree.leaves(frame=frame)
    if not len(leaves.sides):
        raise InputError(f"{path}: frame {frame} has no hull to write: its silhouettes do not meet")
    if what == "points":
        content = trimesh.PointCloud(leaves.centres.cpu().numpy())
    else:
        vertices, faces = (x.cpu().numpy() for x in hull_mesh(octree, frame=frame))
        content = trimesh.Trimesh(vertices, faces, process=False)
    with replacing(path) as temporary:
        content.export(temporary, file_type=path.suffix.lower()[1:])
