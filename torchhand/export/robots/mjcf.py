"""The hand as a MuJoCo model (MJCF, .xml): limits, masses, inertias, closed meshes, and the motion as keyframes.

World: z up, metres. The wrist floats on a free joint and gravity is compensated, so a hand at rest stays where it is.
One hinge per angle, named as the DOF, in the order abduction, flexion, twist from the outside in. Fingertips are sites.
Every frame is a keyframe (free joint, then the hinges as the model orders them).
"""

from itertools import combinations, pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import torch
from torch import Tensor

from torchhand.export.clip import MotionClip
from torchhand.export.robots.link_solids import LinkSolid, link_solids
from torchhand.export.robots.meshes import written_meshes
from torchhand.files.disk import write_text
from torchhand.geometry import quaternion_of_rotation, rotation_from_vector
from torchhand.hand import BONES, FINGERS, JOINT_DOFS, PARENTS

_DAMPING, _ARMATURE = "0.01", "0.0001"  # N m s/rad and kg m²: finger joints come to rest within tenths of a second
_COLOUR = "0.80 0.58 0.47 1"
_DIGITS = 12


def write_mjcf(clip: MotionClip, path: str | Path) -> tuple[LinkSolid, ...]:
    """Write the file and the folder of its meshes; returns the links."""
    path = Path(path)
    solids = link_solids(clip)
    with written_meshes(path, solids) as meshes:
        write_text(path, mjcf_text(clip, solids, meshes))
    return solids


def mjcf_text(clip: MotionClip, solids: tuple[LinkSolid, ...], meshes: str) -> str:
    """The model with its links' meshes in the folder `meshes`."""
    upright = clip.with_up("z")
    root = ElementTree.Element("mujoco", {"model": clip.name})
    compiler = {"angle": "radian", "autolimits": "true", "meshdir": meshes, "inertiafromgeom": "false"}
    ElementTree.SubElement(root, "compiler", compiler)
    default = ElementTree.SubElement(root, "default")
    ElementTree.SubElement(default, "joint", {"type": "hinge", "damping": _DAMPING, "armature": _ARMATURE})
    ElementTree.SubElement(default, "geom", {"type": "mesh", "rgba": _COLOUR})
    asset = ElementTree.SubElement(root, "asset")
    for bone in BONES:
        ElementTree.SubElement(asset, "mesh", {"name": bone, "file": f"{bone}.obj"})
    order: list[int] = []
    _body(ElementTree.SubElement(root, "worldbody"), upright, 0, solids, order)
    contact = ElementTree.SubElement(root, "contact")
    for one, other in _neighbours():
        ElementTree.SubElement(contact, "exclude", {"body1": one, "body2": other})
    keyframe = ElementTree.SubElement(root, "keyframe")
    places = _wxyz(rotation_from_vector(upright.poses[:, 3:6]))
    rows = torch.cat((upright.poses[:, :3], places, upright.poses[:, 6:][:, order]), 1)
    for number, second, row in zip(clip.frame, clip.seconds.tolist(), rows, strict=True):
        key = {"name": f"frame_{number}", "time": f"{second:.9g}", "qpos": _numbers(row)}
        ElementTree.SubElement(keyframe, "key", key)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _body(
    parent: ElementTree.Element, clip: MotionClip, bone: int, solids: tuple[LinkSolid, ...], order: list[int]
) -> None:
    """A bone with all that hangs on it; `order` gathers the joint angles as the model will order them."""
    skeleton = clip.skeleton
    position, rotation = skeleton.rest_offset[bone], skeleton.rest_rotation[bone]
    if bone == 0:
        position, rotation = clip.poses[0, :3], rotation_from_vector(clip.poses[0, 3:6])
    name = BONES[bone]
    attributes = {"name": name, "pos": _numbers(position), "quat": _numbers(_wxyz(rotation)), "gravcomp": "1"}
    body = ElementTree.SubElement(parent, "body", attributes)
    if bone == 0:
        ElementTree.SubElement(body, "freejoint", {"name": "root"})
    own = [dof for dof in range(len(JOINT_DOFS)) if skeleton.bone[dof] == bone]
    for dof in sorted(own, key=lambda dof: skeleton.order[dof]):
        order.append(dof)
        limits = f"{skeleton.lower[dof]:.{_DIGITS}g} {skeleton.upper[dof]:.{_DIGITS}g}"
        axis = _numbers(skeleton.axis[dof])
        ElementTree.SubElement(body, "joint", {"name": JOINT_DOFS[dof], "axis": axis, "range": limits})
    solid = solids[bone]
    moments = [solid.inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    ElementTree.SubElement(
        body,
        "inertial",
        {"pos": _numbers(solid.centre), "mass": f"{solid.mass:.9g}", "fullinertia": _numbers(np.array(moments))},
    )
    ElementTree.SubElement(body, "geom", {"name": name, "mesh": name})
    if name.endswith("distal"):
        finger = name.split("_")[0]
        place = _numbers(skeleton.tip_offset[FINGERS.index(finger)])
        ElementTree.SubElement(body, "site", {"name": f"{finger}_tip", "pos": place, "size": "0.002"})
    for child, above in enumerate(PARENTS):
        if above == bone:
            _body(body, clip, child, solids, order)


def _neighbours() -> list[tuple[str, str]]:
    """Bodies that touch by being of one palm or side by side at its edge: their contacts mean nothing."""
    palm = ["wrist", *(f"{finger}_metacarpal" for finger in FINGERS)]
    proximal = [f"{finger}_proximal" for finger in FINGERS]
    pairs = [*combinations(palm, 2), *((one, other) for one in palm for other in proximal)]
    return [*pairs, *pairwise(proximal)]


def _wxyz(rotation: Tensor) -> Tensor:
    return quaternion_of_rotation(rotation).roll(1, -1)


def _numbers(values: Tensor | np.ndarray) -> str:
    return " ".join(f"{float(value) + 0.0:.{_DIGITS}g}" for value in values)
