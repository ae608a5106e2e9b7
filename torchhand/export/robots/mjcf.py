"""The hand as a MuJoCo model (MJCF, .xml): limits, masses, actuators, couplings, contacts, and the motion as keyframes.

World: z up, metres. The wrist floats on a free joint. Without gravity a hand at rest stays where it is; with it, a weld
to the mocap body `wrist_target` holds the wrist. One hinge per angle, named as the DOF, in the order abduction,
flexion, twist from the outside in, with a position actuator of the same name whose force is what an adult's joint
bears. The last joints of the fingers may follow their middle ones, θ_DIP = ⅔ θ_PIP, and have no actuator then.
Phalanges touch as capsules, the palm as its meshes. Fingertips are sites. Every frame is a keyframe (free joint, then
the hinges as the model orders them), with the actuators' targets; one whose own pose was lost is called frame_N_held.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import torch
from torch import Tensor

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.robots.contacts import Capsule, apart, phalanx_capsules, touching_neighbours
from torchhand.export.robots.link_solids import LinkSolid, link_solids
from torchhand.export.robots.meshes import written_meshes
from torchhand.export.robots.strength import joint_torques
from torchhand.files.disk import write_text
from torchhand.geometry import quaternion_of_rotation, rotation_from_vector
from torchhand.hand import BONES, FINGERS, JOINT_DOFS, PARENTS

_DAMPING, _ARMATURE = "0.01", "0.0001"  # N m s/rad and kg m²: finger joints come to rest within tenths of a second
_FULL_FORCE_AT = 0.5  # radians off its target at which an actuator gives all its force
_COLOUR = "0.80 0.58 0.47 1"
_DIGITS = 12
_STANDARD_GRAVITY = 9.81  # m/s²
_COUPLED = {f"{finger}_dip_fe": f"{finger}_pip_fe" for finger in FINGERS[1:]}
_COUPLING = 2 / 3
"""Flexion of the last joint over that of the middle one (Ouhaddi and Horain 1998, eq. 1)."""


@dataclass(frozen=True, kw_only=True)
class MjcfSettings:
    """What a MuJoCo model holds besides the hand."""

    mass: float | None = None
    """Mass of the hand, kg; an adult's where it is None."""
    has_gravity: bool = False
    """Let gravity act on the hand, whose wrist a mocap body then holds."""
    has_couplings: bool = True
    """Let the last joints of the fingers follow their middle ones."""
    is_apart: bool = True
    """Move the keyframes' joints as little as it takes for no two digits to be in each other."""


def write_mjcf(
    clip: MotionClip, path: str | Path, settings: MjcfSettings | None = None
) -> tuple[tuple[LinkSolid, ...], float]:
    """Write the file and the folder of its meshes; returns the links, and by how much the keyframes' joint angles were
    changed at most, radians.
    """
    path, settings = Path(path), settings or MjcfSettings()
    solids = link_solids(clip, mass=settings.mass)
    poses = apart(clip) if settings.is_apart else clip.poses
    with written_meshes(path, solids) as meshes:
        write_text(path, mjcf_text(replace(clip, poses=poses), solids, meshes, settings))
    return solids, float((poses - clip.poses).abs().max())


def mjcf_text(clip: MotionClip, solids: tuple[LinkSolid, ...], meshes: str, settings: MjcfSettings) -> str:
    """The model with its links' meshes in the folder `meshes`."""
    upright = clip.placed("z-up")
    root = ElementTree.Element("mujoco", {"model": clip.name})
    compiler = {"angle": "radian", "autolimits": "true", "meshdir": meshes, "inertiafromgeom": "false"}
    ElementTree.SubElement(root, "compiler", compiler)
    gravity = {"gravity": _numbers(_gravity(upright))} if settings.has_gravity else {}
    ElementTree.SubElement(root, "option", {"integrator": "implicitfast"} | gravity)
    default = ElementTree.SubElement(root, "default")
    ElementTree.SubElement(default, "joint", {"type": "hinge", "damping": _DAMPING, "armature": _ARMATURE})
    ElementTree.SubElement(default, "geom", {"rgba": _COLOUR})
    asset = ElementTree.SubElement(root, "asset")
    for bone in BONES:
        ElementTree.SubElement(asset, "mesh", {"name": bone, "file": f"{bone}.obj"})
    world = ElementTree.SubElement(root, "worldbody")
    order: list[int] = []
    capsules = {capsule.bone: capsule for capsule in phalanx_capsules(clip)}
    _body(world, upright, 0, solids, capsules, order, has_gravity=settings.has_gravity)
    contact = ElementTree.SubElement(root, "contact")
    for one, other in touching_neighbours():
        ElementTree.SubElement(contact, "exclude", {"body1": one, "body2": other})
    if settings.has_gravity:
        ElementTree.SubElement(world, "body", {"name": "wrist_target", "mocap": "true"} | _place(upright, 0))
    if settings.has_gravity or settings.has_couplings:
        _equalities(ElementTree.SubElement(root, "equality"), settings)
    driven = [dof for dof in order if not (settings.has_couplings and JOINT_DOFS[dof] in _COUPLED)]
    _actuators(ElementTree.SubElement(root, "actuator"), clip, driven)
    _keyframes(ElementTree.SubElement(root, "keyframe"), upright, order, driven, has_target=settings.has_gravity)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _gravity(clip: MotionClip) -> np.ndarray:
    """Acceleration towards the side of the clip's frame that is down, m/s². Raises InputError in a frame that turns."""
    if clip.axes in ("wrist", "mano"):
        raise InputError(f"gravity: expected axes camera, y-up or z-up, got {clip.axes}, which turn with the hand")
    down = np.zeros(3)
    down["xyz".index(clip.up[-1])] = _STANDARD_GRAVITY if clip.up.startswith("-") else -_STANDARD_GRAVITY
    return down


def _equalities(parent: ElementTree.Element, settings: MjcfSettings) -> None:
    """What holds the wrist, and what bends the fingers' last joints with their middle ones."""
    if settings.has_gravity:
        ElementTree.SubElement(parent, "weld", {"name": "wrist_hold", "body1": "wrist_target", "body2": BONES[0]})
    if settings.has_couplings:
        law = f"0 {_COUPLING:.{_DIGITS}g} 0 0 0"
        for last, middle in _COUPLED.items():
            ElementTree.SubElement(
                parent, "joint", {"name": f"{last}_coupling", "joint1": last, "joint2": middle, "polycoef": law}
            )


def _actuators(parent: ElementTree.Element, clip: MotionClip, driven: list[int]) -> None:
    """A position servo for each of these joint angles, critically damped."""
    torques = joint_torques(clip)
    for dof in driven:
        torque = float(torques[dof])
        servo = {"name": JOINT_DOFS[dof], "joint": JOINT_DOFS[dof], "dampratio": "1"}
        servo |= {"kp": f"{torque / _FULL_FORCE_AT:.4g}", "forcerange": f"{-torque:.4g} {torque:.4g}"}
        ElementTree.SubElement(parent, "position", servo | {"inheritrange": "1"})


def _keyframes(
    parent: ElementTree.Element, clip: MotionClip, order: list[int], driven: list[int], *, has_target: bool
) -> None:
    joints = clip.poses[:, -len(JOINT_DOFS) :]
    quaternions = _wxyz(rotation_from_vector(clip.poses[:, 3:6]))
    rows = torch.cat((clip.poses[:, :3], quaternions, joints[:, order]), 1)
    for t, (number, second) in enumerate(zip(clip.frame, clip.seconds.tolist(), strict=True)):
        held = "_held" if number in set(clip.held) else ""
        key = {"name": f"frame_{number}{held}", "time": f"{second:.9g}", "qpos": _numbers(rows[t])}
        key["ctrl"] = _numbers(joints[t, driven])
        if has_target:
            key |= {"mpos": _numbers(clip.poses[t, :3]), "mquat": _numbers(quaternions[t])}
        ElementTree.SubElement(parent, "key", key)


def _place(clip: MotionClip, frame: int) -> dict[str, str]:
    """Of the wrist in a frame."""
    pose = clip.poses[frame]
    return {"pos": _numbers(pose[:3]), "quat": _numbers(_wxyz(rotation_from_vector(pose[3:6])))}


def _body(
    parent: ElementTree.Element,
    clip: MotionClip,
    bone: int,
    solids: tuple[LinkSolid, ...],
    capsules: dict[str, Capsule],
    order: list[int],
    *,
    has_gravity: bool,
) -> None:
    """A bone with all that hangs on it; `order` gathers the joint angles as the model will order them."""
    skeleton = clip.skeleton
    name = BONES[bone]
    rest = {
        "pos": _numbers(skeleton.rest_offset[bone]),
        "quat": _numbers(_wxyz(skeleton.rest_rotation[bone])),
    }
    weight = {} if has_gravity else {"gravcomp": "1"}
    body = ElementTree.SubElement(parent, "body", {"name": name} | (rest if bone else _place(clip, 0)) | weight)
    if bone == 0:
        ElementTree.SubElement(body, "freejoint", {"name": "root"})
    own = [dof for dof in range(len(JOINT_DOFS)) if skeleton.bone[dof] == bone]
    for dof in sorted(own, key=lambda dof: skeleton.order[dof]):
        order.append(dof)
        limits = f"{skeleton.lower[dof]:.{_DIGITS}g} {skeleton.upper[dof]:.{_DIGITS}g}"
        axis = _numbers(skeleton.axis[dof])
        ElementTree.SubElement(body, "joint", {"name": JOINT_DOFS[dof], "axis": axis, "range": limits})
    _matter(body, name, solids[bone], capsules.get(name))
    if name.endswith("distal"):
        finger = name.split("_")[0]
        place = _numbers(skeleton.tip_offset[FINGERS.index(finger)])
        ElementTree.SubElement(body, "site", {"name": f"{finger}_tip", "pos": place, "size": "0.002"})
    for child, above in enumerate(PARENTS):
        if above == bone:
            _body(body, clip, child, solids, capsules, order, has_gravity=has_gravity)


def _matter(body: ElementTree.Element, name: str, solid: LinkSolid, capsule: Capsule | None) -> None:
    """Inertia, what is seen, and what touches."""
    moments = [solid.inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    inertial = {"pos": _numbers(solid.centre), "mass": f"{solid.mass:.9g}", "fullinertia": _numbers(np.array(moments))}
    ElementTree.SubElement(body, "inertial", inertial)
    seen = {"name": name, "type": "mesh", "mesh": name}
    if capsule is not None:
        seen |= {"contype": "0", "conaffinity": "0", "group": "2"}
        touched = {"name": f"{name}_capsule", "type": "capsule", "size": f"{capsule.radius:.{_DIGITS}g}", "group": "3"}
        touched["fromto"] = f"{_numbers(capsule.start)} {_numbers(capsule.end)}"
        ElementTree.SubElement(body, "geom", touched)
    ElementTree.SubElement(body, "geom", seen)


def _wxyz(rotation: Tensor) -> Tensor:
    return quaternion_of_rotation(rotation).roll(1, -1)


def _numbers(values: Tensor | np.ndarray) -> str:
    return " ".join(f"{float(value) + 0.0:.{_DIGITS}g}" for value in values)
