"""The hand as a robot in URDF: limits, masses, inertias and closed meshes of the links. It holds no motion.

Links and joints are those of `skeleton_to_urdf` in the fitted shape: one revolute joint per angle, links named as the
bones; a joint of several angles has small links between its axes, which take a little of the bone's mass, and so do
the frames of the fingertips. Every link has an inertia: PyBullet takes 1 kg for one without. Limits of effort are what
the joints of an adult bear. Base link: wrist, our hand frame. MuJoCo reads the file too. The SRDF beside it names
groups and pairs of links whose collisions mean nothing.
"""

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.robots.link_solids import LinkSolid, link_solids
from torchhand.export.robots.meshes import written_meshes
from torchhand.export.robots.srdf import srdf_text
from torchhand.export.robots.strength import VELOCITY, joint_torques
from torchhand.files.disk import write_text
from torchhand.files.hands import skeleton_to_urdf
from torchhand.hand import BONES, JOINT_DOFS

_SMALL_FRACTION, _SMALL_RADIUS = 0.02, 0.005  # of the bone's mass; metres
_PACKAGE_NAME = re.compile("[a-z][a-z0-9_]*")
_COLOUR = "0.80 0.58 0.47 1"


def write_urdf(
    clip: MotionClip, path: str | Path, *, mass: float | None = None, package: str | None = None
) -> tuple[LinkSolid, ...]:
    """Write the file, the folder of its meshes and the SRDF; returns the links.

    mass: of the hand, kg; an adult's where it is None. package: name of the ROS package that the files are put into,
    whose meshes are then `package://NAME/…`; paths beside the file where it is None.
    """
    path = Path(path)
    if package is not None and not _PACKAGE_NAME.fullmatch(package):
        raise InputError(f"package: expected a name of lower-case letters, digits and underscores, got {package!r}")
    solids = link_solids(clip, mass=mass)
    with written_meshes(path, solids) as meshes:
        folder = meshes if package is None else f"package://{package}/{meshes}"
        write_text(path, urdf_text(clip, solids, folder))
        write_text(srdf_path(path), srdf_text(_robot_name(clip)))
    return solids


def srdf_path(path: Path) -> Path:
    """The SRDF beside a URDF file."""
    return path.with_suffix(".srdf")


def urdf_text(clip: MotionClip, solids: tuple[LinkSolid, ...], meshes: str) -> str:
    """The robot with its links' meshes in the folder `meshes`."""
    root = ElementTree.fromstring(skeleton_to_urdf(clip.skeleton, "hand"))
    root.set("name", _robot_name(clip))
    mujoco = ElementTree.Element("mujoco")
    ElementTree.SubElement(
        mujoco,
        "compiler",
        {"meshdir": meshes.split("/")[-1], "strippath": "true", "discardvisual": "false", "fusestatic": "false"},
    )
    root.insert(0, mujoco)
    material = ElementTree.Element("material", {"name": "skin"})
    ElementTree.SubElement(material, "color", {"rgba": _COLOUR})
    root.insert(1, material)
    small = {bone: [link for link in root.iter("link") if _is_small(link, bone)] for bone in BONES}
    for bone, solid in zip(BONES, solids, strict=True):
        kept = 1 - _SMALL_FRACTION * len(small[bone])
        link = next(link for link in root.iter("link") if link.get("name") == bone)
        _inertial(link, kept * solid.mass, solid.centre, kept * solid.inertia)
        for kind in ("visual", "collision"):
            part = ElementTree.SubElement(link, kind)
            geometry = ElementTree.SubElement(part, "geometry")
            ElementTree.SubElement(geometry, "mesh", {"filename": f"{meshes}/{bone}.obj"})
            if kind == "visual":
                ElementTree.SubElement(part, "material", {"name": "skin"})
        for one in small[bone]:
            mass = _SMALL_FRACTION * solid.mass
            _inertial(one, mass, np.zeros(3), 0.4 * mass * _SMALL_RADIUS**2 * np.eye(3))
    torques = dict(zip(JOINT_DOFS, joint_torques(clip).tolist(), strict=True))
    for joint in root.iter("joint"):
        for limit in joint.iter("limit"):
            limit.set("effort", f"{torques[joint.attrib['name']]:.4g}")
            limit.set("velocity", f"{VELOCITY:g}")
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _robot_name(clip: MotionClip) -> str:
    return "_".join(clip.name.split()) or "hand"


def _is_small(link: ElementTree.Element, bone: str) -> bool:
    """Whether a link stands between the axes of the bone's joint (such links are called BONE_DOF) or at its tip."""
    name = link.get("name", "")
    finger, _, part = name.partition("_")
    return (name not in BONES and name.startswith(f"{bone}_")) or (part == "tip" and bone == f"{finger}_distal")


def _inertial(link: ElementTree.Element, mass: float, centre: np.ndarray, inertia: np.ndarray) -> None:
    element = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(element, "origin", {"xyz": " ".join(f"{x:.9g}" for x in centre), "rpy": "0 0 0"})
    ElementTree.SubElement(element, "mass", {"value": f"{mass:.9g}"})
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": f"{inertia[i, j]:.12g}" for i in range(3) for j in range(i, 3)}
    ElementTree.SubElement(element, "inertia", entries)
