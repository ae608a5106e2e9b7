"""The hand as a robot in URDF: limits, masses, inertias and closed meshes of the links. It holds no motion.

Links and joints are those of `skeleton_to_urdf` in the fitted shape: one revolute joint per angle, links named as the
bones; a joint of several angles has small links between its axes, which take a little of the bone's mass. Fingertips
are massless frames. Base link: wrist, our hand frame. MuJoCo reads the file too.
"""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from torchhand.export.clip import MotionClip
from torchhand.export.robots.link_solids import LinkSolid, link_solids
from torchhand.export.robots.meshes import written_meshes
from torchhand.files.disk import write_text
from torchhand.files.hands import skeleton_to_urdf
from torchhand.hand import BONES

EFFORT_NM, VELOCITY = 5.0, 20.0
"""Limits of every joint, N m and rad/s: more than a finger can do, so that simulators do not hold it back."""
_BETWEEN_FRACTION, _BETWEEN_RADIUS = 0.02, 0.005  # of the bone's mass; metres
_COLOUR = "0.80 0.58 0.47 1"


def write_urdf(clip: MotionClip, path: str | Path) -> tuple[LinkSolid, ...]:
    """Write the file and the folder of its meshes; returns the links."""
    path = Path(path)
    solids = link_solids(clip)
    with written_meshes(path, solids) as meshes:
        write_text(path, urdf_text(clip, solids, meshes))
    return solids


def urdf_text(clip: MotionClip, solids: tuple[LinkSolid, ...], meshes: str) -> str:
    """The robot with its links' meshes in the folder `meshes`."""
    root = ElementTree.fromstring(skeleton_to_urdf(clip.skeleton, "hand"))
    root.set("name", "_".join(clip.name.split()) or "hand")
    mujoco = ElementTree.Element("mujoco")
    ElementTree.SubElement(
        mujoco,
        "compiler",
        {"meshdir": meshes, "strippath": "true", "discardvisual": "false", "fusestatic": "false"},
    )
    root.insert(0, mujoco)
    material = ElementTree.Element("material", {"name": "skin"})
    ElementTree.SubElement(material, "color", {"rgba": _COLOUR})
    root.insert(1, material)
    between = {bone: [link for link in root.iter("link") if _is_between(link, bone)] for bone in BONES}
    for bone, solid in zip(BONES, solids, strict=True):
        kept = 1 - _BETWEEN_FRACTION * len(between[bone])
        link = next(link for link in root.iter("link") if link.get("name") == bone)
        _inertial(link, kept * solid.mass, solid.centre, kept * solid.inertia)
        for kind in ("visual", "collision"):
            part = ElementTree.SubElement(link, kind)
            geometry = ElementTree.SubElement(part, "geometry")
            ElementTree.SubElement(geometry, "mesh", {"filename": f"{meshes}/{bone}.obj"})
            if kind == "visual":
                ElementTree.SubElement(part, "material", {"name": "skin"})
        for small in between[bone]:
            mass = _BETWEEN_FRACTION * solid.mass
            _inertial(small, mass, np.zeros(3), 0.4 * mass * _BETWEEN_RADIUS**2 * np.eye(3))
    for limit in root.iter("limit"):
        limit.set("effort", f"{EFFORT_NM:g}")
        limit.set("velocity", f"{VELOCITY:g}")
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _is_between(link: ElementTree.Element, bone: str) -> bool:
    """Whether a link stands between the axes of the bone's joint; such links are called BONE_DOF."""
    name = link.get("name", "")
    return name not in BONES and name.startswith(f"{bone}_") and not name.endswith("_tip")


def _inertial(link: ElementTree.Element, mass: float, centre: np.ndarray, inertia: np.ndarray) -> None:
    element = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(element, "origin", {"xyz": " ".join(f"{x:.9g}" for x in centre), "rpy": "0 0 0"})
    ElementTree.SubElement(element, "mass", {"value": f"{mass:.9g}"})
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": f"{inertia[i, j]:.12g}" for i in range(3) for j in range(i, 3)}
    ElementTree.SubElement(element, "inertia", entries)
