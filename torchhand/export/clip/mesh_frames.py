"""The skin of posed frames as OBJ or PLY: one file per frame, or of one frame. Metres, in the frame of the poses."""

from pathlib import Path

from torchhand.export.clip.motion_clip import MotionClip
from torchhand.files.disk import replacing

_DIGITS = 9


def mesh_paths(clip: MotionClip, path: str | Path) -> list[Path]:
    """The files that `write_mesh_frames` writes: `path` for a clip of one frame, else NAME_000012.obj per frame."""
    path = Path(path)
    if len(clip) == 1:
        return [path]
    return [path.with_name(f"{path.stem}_{number:06d}{path.suffix}") for number in clip.frame]


def write_mesh_frames(clip: MotionClip, path: str | Path) -> list[Path]:
    """Write the files, each whole or not at all; returns their names. The ending says which format."""
    import trimesh  # half a second, which the commands that write no meshes need not wait for

    paths = mesh_paths(clip, path)
    faces = clip.hand.faces.numpy()
    for place, target in enumerate(paths):
        vertices = clip.hand(clip.poses[place], clip.shape).vertices.numpy()
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        kind = target.suffix.lower()[1:]
        with replacing(target) as temporary:
            if kind == "obj":
                mesh.export(temporary, file_type=kind, digits=_DIGITS, include_normals=False)
            else:
                mesh.export(temporary, file_type=kind)
    return paths
