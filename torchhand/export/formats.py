"""All export formats under one roof: which file ending means which, and `write` for any of them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import torch

from torchhand.errors import InputError
from torchhand.export.clip import (
    ANGLE_SUFFIX,
    KEYPOINT_SUFFIXES,
    MotionClip,
    mesh_paths,
    write_angles,
    write_keypoints,
    write_mesh_frames,
)
from torchhand.export.conventions import BapVersion, BvhNames, held_path, write_bap, write_bvh, write_mano, write_openxr
from torchhand.export.rigged import GlbSkeleton, X3DSkin, write_driven_glb, write_glb, write_x3d
from torchhand.export.robots import (
    JOINTS_SUFFIX,
    LinkSolid,
    MjcfSettings,
    WristAxes,
    meshes_folder,
    srdf_path,
    write_joints,
    write_mjcf,
    write_teleoperation,
    write_urdf,
)
from torchhand.export.stream import StreamSettings, write_stream
from torchhand.files.disk import expanded
from torchhand.hand import JOINT_DOFS
from torchhand.hand.conventions import Numbering

FormatName = Literal[
    "glb",
    "bvh",
    "urdf",
    "mjcf",
    "obj",
    "ply",
    "mano",
    "openxr",
    "keypoints",
    "joints",
    "teleoperation",
    "angles",
    "bap",
    "x3d",
    "stream",
]


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """What only some of the formats ask."""

    correctives: bool = True
    """glb: carry the skin's pose correctives as morph targets."""
    glb_skeleton: GlbSkeleton = "torchhand"
    """glb: nodes named as our bones, or the 25 joints of WebXR with its names and axes."""
    glb_mesh: Path | None = None
    """glb: a rigged hand mesh of others with WebXR's joint names (.glb), to be moved in place of ours."""
    bvh_names: BvhNames = "torchhand"
    """bvh: what the joints are called."""
    bap_numbering: Numbering = "final"
    """bap: numbering of the standard, or of the draft before it."""
    bap_version: BapVersion = "3.1"
    """bap: version in the header."""
    x3d_skin: X3DSkin = "coordinates"
    """x3d: every frame's points as they are, or a skin moved by its joints, which only players with H-Anim show."""
    mass_g: float | None = None
    """urdf, mjcf: mass of the hand, g; else that of an adult's hand of this size."""
    urdf_package: str | None = None
    """urdf: ROS package that the files are put into, for meshes as package://NAME/…; else paths beside the file."""
    mjcf_gravity: bool = False
    """mjcf: let gravity act; the wrist is then held by a mocap body."""
    mjcf_couplings: bool = True
    """mjcf: bend the last joints of the fingers with their middle ones."""
    mjcf_apart: bool = True
    """mjcf: move the keyframes' joints a little where digits are in each other."""
    teleop_axes: WristAxes = "mano"
    """teleoperation: axes of the points in the wrist's frame: MANO's, our hand frame's, or the operator's (x out of the
    palm, z to the fingers) that retargeting libraries use."""
    stream_step_deg: float = 3.5
    """stream: step of the joint angles, degrees. Smaller is finer and takes more bits."""
    stream_packet: int = 15
    """stream: poses of a packet, 1 to 255: a reader of a growing stream waits for so many; fewer take more bits."""

    def __post_init__(self) -> None:
        if self.mass_g is not None and not 0 < self.mass_g <= 1e5:
            raise ValueError(f"--mass-g: expected more than 0, 1e5 at most, got {self.mass_g:g}")
        if not 1 <= self.stream_packet <= 255:
            raise ValueError(f"--stream-packet: expected 1 to 255, got {self.stream_packet}")
        if not 0 < self.stream_step_deg <= 30:
            raise ValueError(f"--stream-step-deg: expected more than 0, 30 at most, got {self.stream_step_deg:g}")

    @property
    def mass(self) -> float | None:
        """Mass of the hand, kg, where it is given."""
        return None if self.mass_g is None else 1e-3 * self.mass_g


@dataclass(frozen=True, kw_only=True)
class Format:
    """One file format."""

    name: FormatName
    suffixes: tuple[str, ...]
    """Endings; the first is the usual one. Those that several formats share need a second one before: .mano.npz."""
    write: Callable[[MotionClip, Path, ExportOptions], list[str]]
    """Writes the file and returns notes for the user: what the format could not hold."""
    files: Callable[[MotionClip, Path], list[Path]] = field(default=lambda clip, path: [path])
    """Names of the files that are written."""
    without_axes: str = ""
    """Why no frame can be asked of the format; empty where one can."""


def _glb(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    if options.glb_mesh is not None:
        write_driven_glb(clip, expanded(options.glb_mesh), path)
        return [f"the mesh of {options.glb_mesh.name}, moved; its own animations are left out"]
    skin = write_glb(clip, path, has_correctives=options.correctives, skeleton=options.glb_skeleton)
    notes = [f"skin within {1e3 * skin.error:.2f} mm of torchhand's with {len(skin.targets)} morph targets"]
    return notes + ([f"without them within {1e3 * skin.linear_error:.2f} mm"] if len(skin.targets) else [])


def _bvh(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    write_bvh(clip, path, names=options.bvh_names)
    return clip.gap_notes()


def _urdf(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    solids = write_urdf(clip, path, mass=options.mass, package=options.urdf_package)
    motion = ["holds the hand, not its motion"] if len(clip) > 1 else []
    return [_links(solids, path), *motion]


def _mjcf(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    settings = MjcfSettings(
        mass=options.mass,
        has_gravity=options.mjcf_gravity,
        has_couplings=options.mjcf_couplings,
        is_apart=options.mjcf_apart,
    )
    solids, moved = write_mjcf(clip, path, settings)
    notes = [_links(solids, path)]
    if moved > 1e-4:
        notes.append(f"joint angles of keyframes changed by up to {math.degrees(moved):.1f} degrees to part digits")
    return notes


def _links(solids: tuple[LinkSolid, ...], path: Path) -> str:
    mass = sum(solid.mass for solid in solids)
    return f"{len(solids)} links of {1e3 * mass:.0f} g together, meshes in {meshes_folder(path).name}"


def _meshes(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    write_mesh_frames(clip, path)
    return []


def _mano(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    off = float(write_mano(clip, path).residual.max())
    return [f"MANO's palm does not bend: keypoints off by {1e3 * off:.2f} mm at most"] if off > 1e-5 else []


def _openxr(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    write_openxr(clip, path)
    return []


def _keypoints(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    write_keypoints(clip, path)
    return []


def _angles(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    write_angles(clip, path)
    return [] if clip.pose_std is not None else ["no standard deviations are known: their columns are empty"]


def _bap(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    lost = write_bap(clip, path, numbering=options.bap_numbering, version=options.bap_version).abs().amax(0)
    names = [JOINT_DOFS[i] for i in (lost > 1e-4).nonzero().squeeze(-1).tolist()]
    if not names:
        return clip.gap_notes()
    return [
        *clip.gap_notes(),
        f"BAPs have no {', '.join(names)}: lost up to {float(torch.rad2deg(lost.max())):.1f} degrees",
    ]


def _joints(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    write_joints(clip, path)
    return []


def _teleoperation(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    write_teleoperation(clip, path, axes=options.teleop_axes)
    return []


def _x3d(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    write_x3d(clip, path, skin=options.x3d_skin)
    return []


def _stream(clip: MotionClip, path: Path, options: ExportOptions) -> list[str]:
    step = options.stream_step_deg
    default = StreamSettings()
    finer = min(1.0, step / default.step_deg)  # the root with the joints, never coarser than usual
    settings = StreamSettings(
        step_deg=step,
        root_step_deg=finer * default.root_step_deg,
        root_step_mm=finer * default.root_step_mm,
        packet_poses=options.stream_packet,
    )
    figures = write_stream(clip, path, settings)
    return [
        *clip.gap_notes(),
        f"{figures.motion_kbit_per_s:.2f} kbit/s and a header of {figures.header_bytes} bytes; joint angles off by"
        f" {figures.mean_deg:.2f} degrees on average, {figures.worst_deg:.1f} at most",
    ]


FORMATS: tuple[Format, ...] = (
    Format(name="glb", suffixes=(".glb",), write=_glb),
    Format(
        name="bvh",
        suffixes=(".bvh",),
        write=_bvh,
        files=lambda clip, path: [path, *([held_path(path)] if clip.held else [])],
    ),
    Format(
        name="urdf",
        suffixes=(".urdf",),
        write=_urdf,
        files=lambda clip, path: [path, srdf_path(path), meshes_folder(path)],
        without_axes="its base link has the axes of the hand",
    ),
    Format(
        name="mjcf",
        suffixes=(".xml", ".mjcf"),
        write=_mjcf,
        files=lambda clip, path: [path, meshes_folder(path)],
    ),
    Format(name="obj", suffixes=(".obj",), write=_meshes, files=mesh_paths),
    Format(name="ply", suffixes=(".ply",), write=_meshes, files=mesh_paths),
    Format(name="mano", suffixes=(".mano.npz", ".npz"), write=_mano),
    Format(name="openxr", suffixes=(".openxr.json", ".json"), write=_openxr),
    Format(
        name="keypoints",
        suffixes=(".keypoints.json", ".keypoints.npz", ".csv", ".npy", *KEYPOINT_SUFFIXES[:2]),
        write=_keypoints,
    ),
    Format(name="joints", suffixes=(JOINTS_SUFFIX,), write=_joints),
    Format(name="teleoperation", suffixes=(".teleop.jsonl",), write=_teleoperation),
    Format(name="angles", suffixes=(ANGLE_SUFFIX,), write=_angles, without_axes="it holds joint angles alone"),
    Format(name="bap", suffixes=(".bap",), write=_bap),
    Format(name="x3d", suffixes=(".x3d",), write=_x3d),
    Format(name="stream", suffixes=(".thp",), write=_stream),
)


def format_of(path: str | Path, name: FormatName | None = None) -> Format:
    """The format of this name, or the one that the file's ending means.

    Raises InputError for an ending that means none or several, and for one that is not the named format's.
    """
    path = Path(path)
    if name is not None:
        chosen = next(entry for entry in FORMATS if entry.name == name)
        if not path.name.lower().endswith(chosen.suffixes):
            raise InputError(f"{path}: expected an ending {_listed(chosen.suffixes)} for {name}, got {path.suffix!r}")
        return chosen
    longest = max((s for f in FORMATS for s in f.suffixes if path.name.lower().endswith(s)), key=len, default="")
    fitting = [entry for entry in FORMATS if longest in entry.suffixes]
    is_bare = longest.startswith(".") and path.name.lower() == longest
    if not longest or is_bare:
        endings = [suffix for entry in FORMATS for suffix in entry.suffixes]
        allowed = ", ".join(ending for ending in endings if endings.count(ending) == 1)  # what leaves nothing open
        raise InputError(f"{path}: expected a file name with a known ending ({allowed}), got {path.suffix!r}")
    if len(fitting) > 1:
        choices = " or ".join(f"{entry.name} ({_own_suffix(entry, longest)})" for entry in fitting)
        raise InputError(f"{path}: {longest} may be {choices}: name the format, or give that ending")
    return fitting[0]


def write(
    clip: MotionClip, path: str | Path, format: FormatName | None = None, options: ExportOptions | None = None
) -> list[str]:
    """Write a clip in any format; returns notes for the user: what the format could not hold.

    Raises InputError for a file name that fits no format, for axes that the format cannot have, and where the disk
    refuses.
    """
    path = Path(path)
    chosen = format_of(path, format)
    if clip.axes is not None and chosen.without_axes:
        raise InputError(f"{path}: axes: expected none for {chosen.name} ({chosen.without_axes}), got {clip.axes}")
    return chosen.write(clip, path, options or ExportOptions())


def _own_suffix(entry: Format, ending: str) -> str:
    return next(s for s in entry.suffixes if s.endswith(ending) and s != ending)


def _listed(names: Sequence[str]) -> str:
    return " or ".join(names)
