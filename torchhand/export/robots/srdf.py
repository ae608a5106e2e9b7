"""The semantic description (SRDF) beside a URDF hand: groups of joints, and collisions that planners need not see.

MoveIt and others read it: the hand and each finger as groups, and pairs of links that touch by being neighbours.
"""

from xml.etree import ElementTree

from torchhand.export.robots.contacts import jointed_bones, touching_neighbours
from torchhand.hand import FINGERS


def srdf_text(robot: str) -> str:
    """The description of the robot of that name."""
    root = ElementTree.Element("robot", {"name": robot})
    for finger in FINGERS:
        group = ElementTree.SubElement(root, "group", {"name": finger})
        ElementTree.SubElement(group, "chain", {"base_link": "wrist", "tip_link": f"{finger}_tip"})
    hand = ElementTree.SubElement(root, "group", {"name": "hand"})
    for finger in FINGERS:
        ElementTree.SubElement(hand, "group", {"name": finger})
    jointed = {frozenset(pair) for pair in jointed_bones()}
    for one, other in jointed_bones():
        _disable(root, one, other, "Adjacent")
    for one, other in touching_neighbours():
        if frozenset((one, other)) not in jointed:
            _disable(root, one, other, "Default")
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _disable(root: ElementTree.Element, one: str, other: str, reason: str) -> None:
    ElementTree.SubElement(root, "disable_collisions", {"link1": one, "link2": other, "reason": reason})
