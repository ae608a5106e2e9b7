"""Motion as X3D 4.0: an H-Anim 2 hand (ISO/IEC 19774) with its skin, moved by interpolators.

Frame: y up, metres. The humanoid stands in our hand frame at the open hand, in which the skin is bound: at rest all
joints' frames are parallel. The wrist's joint carries the hand's place and rotation in the world. The skin's points of
every frame are given as they are, by a CoordinateInterpolator beside the skeleton: any player shows them, those without
H-Anim too. With `skin="weights"` the joints move the skin, blended linearly: much smaller, for players with H-Anim.
"""

import math
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import torch
from torch import Tensor

from torchhand import __version__
from torchhand.export.clip import MotionClip
from torchhand.files.disk import write_text
from torchhand.geometry import vector_from_rotation
from torchhand.hand import BONES, FINGERS, JOINT_DOFS, PARENTS, HandFrames
from torchhand.hand.conventions import bone_turns, hanim_joints, hanim_segments

X3DSkin = Literal["weights", "coordinates"]
_HEADER = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<!DOCTYPE X3D PUBLIC "ISO//Web3D//DTD X3D 4.0//EN"'
    ' "https://www.web3d.org/specifications/x3d-4.0.dtd">\n'
)
_COLOUR = "0.80 0.58 0.47"
_DEF = "hand_"
_BOX_MARGIN = 0.03  # metres of skin beyond the keypoints
_FIELD_OF_VIEW = 0.8  # radians


def write_x3d(clip: MotionClip, path: str | Path, *, skin: X3DSkin = "coordinates") -> None:
    """Write the file."""
    upright = clip.placed("y-up")
    mesh = clip.model.mesh
    if mesh is None:
        raise ValueError(f"model: expected one with a mesh, {clip.model.name!r} has none")
    at_bind = clip.hand(mesh.bind_pose.double(), clip.shape)
    bind = at_bind.frames
    root = ElementTree.Element("X3D", {"profile": "Immersive", "version": "4.0"})
    head = ElementTree.SubElement(root, "head")
    ElementTree.SubElement(head, "component", {"name": "HAnim", "level": "1"})
    for name, content in (("title", f"{clip.name}.x3d"), ("generator", f"torchhand {__version__}")):
        ElementTree.SubElement(head, "meta", {"name": name, "content": content})
    scene = ElementTree.SubElement(root, "Scene")
    _viewpoint(scene, upright)
    names = hanim_joints(clip.side)
    humanoid = _add(scene, "HAnimHumanoid", "humanoid", {"name": clip.name, "version": "2.0"})
    base = _add(humanoid, "HAnimJoint", "humanoid_root", {"name": "humanoid_root", "containerField": "skeleton"})
    _joint(base, upright, 0, bind, names, at_bind_pose=mesh.bind_pose.double(), has_skin=skin == "weights")
    for joint in ("humanoid_root", *names):
        ElementTree.SubElement(humanoid, "HAnimJoint", {"USE": _DEF + joint, "containerField": "joints"})
    for segment in hanim_segments(clip.side):
        ElementTree.SubElement(humanoid, "HAnimSegment", {"USE": _DEF + segment, "containerField": "segments"})
    for finger in range(len(FINGERS)):
        ElementTree.SubElement(humanoid, "HAnimSite", {"USE": _DEF + _tip(clip, finger), "containerField": "sites"})
    if skin == "weights":
        points = {"DEF": "skin_points", "point": _numbers(at_bind.vertices), "containerField": "skinCoord"}
        ElementTree.SubElement(humanoid, "Coordinate", points)
        _shape(humanoid, clip, {"USE": "skin_points"}, {"containerField": "skin"} | _bounds(upright))
    else:
        first = clip.hand(upright.poses[0], clip.shape).vertices
        _shape(scene, clip, {"DEF": "skin_points", "point": _micrometres(first)}, _bounds(upright))
    if clip.held:
        numbers = " ".join(str(place) for place, is_own in enumerate(clip.is_own) if not is_own)
        ElementTree.SubElement(scene, "MetadataInteger", {"name": "held_frames", "value": numbers})
    if len(clip) > 1:
        _animate(scene, upright, bind, names, skin)
    ElementTree.indent(root, " ")
    write_text(Path(path), _HEADER + ElementTree.tostring(root, encoding="unicode") + "\n")


def _viewpoint(scene: ElementTree.Element, clip: MotionClip) -> None:
    """A viewpoint that sees the whole motion, and navigation around it."""
    points = clip.frames.keypoints.flatten(0, 1)
    low, high = points.amin(0), points.amax(0)
    centre, radius = 0.5 * (low + high), 0.5 * float((high - low).norm())
    back = torch.tensor((0.0, 0.0, radius / math.sin(0.5 * _FIELD_OF_VIEW)), dtype=torch.float64)
    view = {"description": clip.name, "fieldOfView": f"{_FIELD_OF_VIEW:g}", "position": _numbers(centre + back)}
    ElementTree.SubElement(scene, "Viewpoint", view | {"centerOfRotation": _numbers(centre)})
    ElementTree.SubElement(scene, "NavigationInfo", {"type": '"EXAMINE" "ANY"'})


def _bounds(clip: MotionClip) -> dict[str, str]:
    """A box about the hand in all frames: players that take the skin's box at rest do not draw a hand that left it."""
    points = clip.frames.keypoints.flatten(0, 1)
    low, high = points.amin(0) - _BOX_MARGIN, points.amax(0) + _BOX_MARGIN
    return {"bboxCenter": _numbers(0.5 * (low + high)), "bboxSize": _numbers(high - low)}


def _add(parent: ElementTree.Element, kind: str, name: str, attributes: dict[str, str]) -> ElementTree.Element:
    return ElementTree.SubElement(parent, kind, {"DEF": _DEF + name} | attributes)


def _tip(clip: MotionClip, finger: int) -> str:
    return f"{hanim_segments(clip.side)[BONES.index(f'{FINGERS[finger]}_distal')]}_tip"


def _joint(
    parent: ElementTree.Element,
    clip: MotionClip,
    bone: int,
    bind: HandFrames,
    names: tuple[str, ...],
    *,
    at_bind_pose: Tensor,
    has_skin: bool,
) -> None:
    """A bone's joint, posed as in the first frame, with its segment and all that hangs on it."""
    turn = bone_turns(clip.frames.rotation[0], bind.rotation)[bone]
    attributes = {"name": names[bone], "center": _numbers(bind.position[bone]), "rotation": _axis_angle(turn[None])}
    if bone == 0:
        attributes["translation"] = _numbers(clip.frames.position[0, 0])
    else:
        attributes |= _limits(clip, bone, bind.rotation[bone], at_bind_pose)
    if has_skin:
        weights = clip.hand.skinning.weights[bone]
        index = weights.nonzero().squeeze(-1)
        if len(index):
            attributes["skinCoordIndex"] = " ".join(map(str, index.tolist()))
            attributes["skinCoordWeight"] = _numbers(weights[index])
    joint = _add(parent, "HAnimJoint", names[bone], attributes)
    name = hanim_segments(clip.side)[bone]
    segment = _add(joint, "HAnimSegment", name, {"name": name})
    if BONES[bone].endswith("distal"):
        finger = FINGERS.index(BONES[bone].split("_")[0])
        place = _numbers(bind.position[bone] + bind.rotation[bone] @ clip.skeleton.tip_offset[finger])
        _add(segment, "HAnimSite", _tip(clip, finger), {"name": _tip(clip, finger), "translation": place})
    for child, own in enumerate(PARENTS):
        if own == bone:
            _joint(joint, clip, child, bind, names, at_bind_pose=at_bind_pose, has_skin=has_skin)


def _limits(clip: MotionClip, bone: int, rotation: Tensor, at_bind_pose: Tensor) -> dict[str, str]:
    """Limits of the turn since the bind pose about the bone's own axes, which `limitOrientation` gives."""
    low, high = torch.zeros(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    skeleton = clip.skeleton
    for dof in range(len(JOINT_DOFS)):
        if skeleton.bone[dof] != bone:
            continue
        start = at_bind_pose[6 + dof]
        ends = torch.stack((skeleton.lower[dof] - start, skeleton.upper[dof] - start))
        axis = int(skeleton.axis[dof].abs().argmax())
        ends = ends if skeleton.axis[dof, axis] > 0 else -ends.flip(0)
        low[axis], high[axis] = ends[0], ends[1]
    return {"limitOrientation": _axis_angle(rotation[None]), "llimit": _numbers(low), "ulimit": _numbers(high)}


def _shape(parent: ElementTree.Element, clip: MotionClip, points: dict[str, str], attributes: dict[str, str]) -> None:
    shape = ElementTree.SubElement(parent, "Shape", attributes)
    ElementTree.SubElement(ElementTree.SubElement(shape, "Appearance"), "Material", {"diffuseColor": _COLOUR})
    index = " ".join(f"{a} {b} {c} -1" for a, b, c in clip.hand.faces.tolist())
    faces = ElementTree.SubElement(shape, "IndexedFaceSet", {"coordIndex": index, "creaseAngle": "3.14159"})
    ElementTree.SubElement(faces, "Coordinate", points)


def _animate(
    scene: ElementTree.Element, clip: MotionClip, bind: HandFrames, names: tuple[str, ...], skin: X3DSkin
) -> None:
    """One clock, one interpolator for each joint that moves, and one for the wrist's place."""
    last = float(clip.seconds[-1])
    key = _numbers(clip.seconds / last, digits=9)
    _add(scene, "TimeSensor", "clock", {"cycleInterval": f"{last:.9g}", "loop": "true"})
    turns = bone_turns(clip.frames.rotation, bind.rotation)

    def drive(kind: str, name: str, values: str, field: str, target: str) -> None:
        _add(scene, kind, name, {"key": key, "keyValue": values})
        for source, out, sink, into in (
            (f"{_DEF}clock", "fraction_changed", _DEF + name, "set_fraction"),
            (_DEF + name, "value_changed", target, field),
        ):
            route = {"fromNode": source, "fromField": out, "toNode": sink, "toField": into}
            ElementTree.SubElement(scene, "ROUTE", route)

    drive("PositionInterpolator", "place", _numbers(clip.frames.position[:, 0]), "translation", _DEF + names[0])
    for bone, name in enumerate(names):
        if bool((turns[:, bone] != turns[0, bone]).any()):
            drive("OrientationInterpolator", f"{name}_turn", _axis_angle(turns[:, bone]), "rotation", _DEF + name)
    if skin == "coordinates":
        drive("CoordinateInterpolator", "skin", _micrometres(clip.vertices()), "point", "skin_points")


def _axis_angle(rotation: Tensor) -> str:
    """Axis and angle of each rotation; some axis where it does not turn."""
    vector = vector_from_rotation(rotation)
    angle = vector.norm(dim=-1, keepdim=True)
    still = torch.tensor((0.0, 1.0, 0.0), dtype=vector.dtype).expand_as(vector)
    axis = torch.where(angle > 0, vector / angle.clamp_min(1e-300), still)
    return _numbers(torch.cat((axis, angle), -1), digits=9)


def _numbers(values: Tensor, *, digits: int = 7) -> str:
    return " ".join(f"{value + 0.0:.{digits}g}" for value in values.reshape(-1).tolist())


def _micrometres(points: Tensor) -> str:
    """Metres with six places: most of a file are these."""
    return " ".join(f"{value:.6f}" for value in points.reshape(-1).tolist())
