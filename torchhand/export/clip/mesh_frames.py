"""The skin of posed frames as OBJ or PLY, one file per frame, or of one frame. Metres, in the frame of the poses.

Both have normals; OBJ has texture coordinates too. A frame that holds another's pose, its own being lost, says so in a
comment at its beginning.
"""

from pathlib import Path

from torch import Tensor

from torchhand.export.clip.motion_clip import MotionClip
from torchhand.export.clip.texture import TextureAtlas, texture_atlas
from torchhand.files.disk import replacing, write_text
from torchhand.hand import PosedMesh

_DIGITS = 9
_HELD = "held: this frame was lost and repeats another's pose"


def mesh_paths(clip: MotionClip, path: str | Path) -> list[Path]:
    """The files that `write_mesh_frames` writes: `path` for a clip of one frame, else NAME_000012.obj per frame."""
    path = Path(path)
    if len(clip) == 1:
        return [path]
    return [path.with_name(f"{path.stem}_{number:06d}{path.suffix}") for number in clip.frame]


def write_mesh_frames(clip: MotionClip, path: str | Path) -> list[Path]:
    """Write the files, each whole or not at all; returns their names. The ending says which format."""
    paths, placed = mesh_paths(clip, path), clip.placed("camera")
    is_obj = Path(path).suffix.lower() == ".obj"
    atlas = texture_atlas(clip.model, clip.side) if is_obj else None
    for place, target in enumerate(paths):
        vertices = placed.hand(placed.poses[place], placed.shape).vertices.contiguous()
        faces = placed.hand.faces
        normals = PosedMesh(vertices=vertices, faces=faces, part_of_face=faces[:, 0]).vertex_normals()
        note = [] if clip.is_own[place] else [_HELD]
        if atlas is not None:
            write_text(target, _obj(vertices, normals, faces, atlas, note))
        else:
            _write_ply(target, vertices, normals, faces, note)
    return paths


def _obj(vertices: Tensor, normals: Tensor, faces: Tensor, atlas: TextureAtlas, notes: list[str]) -> str:
    lines = [f"# {note}" for note in notes]
    for kind, rows in (("v", vertices), ("vt", atlas.uv), ("vn", normals)):
        lines += [f"{kind} " + " ".join(f"{value + 0.0:.{_DIGITS}f}" for value in row) for row in rows.tolist()]
    for face, corners in zip((faces + 1).tolist(), (atlas.corners + 1).tolist(), strict=True):
        lines.append("f " + " ".join(f"{v}/{t}/{v}" for v, t in zip(face, corners, strict=True)))
    return "\n".join(lines) + "\n"


def _write_ply(path: Path, vertices: Tensor, normals: Tensor, faces: Tensor, notes: list[str]) -> None:
    import trimesh  # half a second, which the commands that write no meshes need not wait for

    mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy(), vertex_normals=normals.numpy(), process=False)
    data = mesh.export(file_type="ply", vertex_normal=True)
    assert isinstance(data, bytes)
    head, _, body = data.partition(b"\nelement")
    with replacing(path) as temporary:
        temporary.write_bytes(b"".join((head, *(f"\ncomment {note}".encode() for note in notes), b"\nelement", body)))
