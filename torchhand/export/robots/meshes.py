"""The folder of link meshes that stands beside a robot file."""

import contextlib
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from torchhand.export.robots.link_solids import LinkSolid
from torchhand.files.disk import explained_errors
from torchhand.hand import BONES

_DIGITS = 9


def meshes_folder(path: Path) -> Path:
    """Folder of the meshes of a robot file: hand.urdf has hand_urdf_meshes beside it."""
    return path.with_name(f"{path.stem}_{path.suffix[1:]}_meshes")


@contextlib.contextmanager
def written_meshes(path: Path, solids: Sequence[LinkSolid]) -> Iterator[str]:
    """Writes the links' meshes as OBJ beside the robot file `path`; yields the name of their folder.

    The folder takes its place when the block ends well; the robot file is to be written as the last thing in it.
    """
    import trimesh  # half a second, which the commands that write no meshes need not wait for

    folder = meshes_folder(path)
    new, old = folder.with_name(f".{folder.name}.partial"), folder.with_name(f".{folder.name}.old")
    with explained_errors(folder):
        try:
            for stale in (new, old):
                shutil.rmtree(stale, ignore_errors=True)
            new.mkdir()
            for bone, solid in zip(BONES, solids, strict=True):
                mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
                mesh.export(new / f"{bone}.obj", file_type="obj", digits=_DIGITS, include_normals=False)
            if folder.exists():
                folder.rename(old)
            new.rename(folder)
            try:
                yield folder.name
            except BaseException:
                shutil.rmtree(folder, ignore_errors=True)
                if old.exists():
                    old.rename(folder)
                raise
        finally:
            for stale in (new, old):
                shutil.rmtree(stale, ignore_errors=True)
