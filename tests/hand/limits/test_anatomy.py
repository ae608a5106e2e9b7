"""The shipped skeleton: its file equals what the anatomy makes, its limits are the recommended ones."""

import math
import re
from pathlib import Path

import pytest
import torch

from torchhand.errors import InputError
from torchhand.files import load_hand_model, models_dir
from torchhand.files.hands import read_shape_space, read_skeleton, skeleton_to_urdf
from torchhand.hand.kinematics import BONES, FINGERS, JOINT_DOFS, KEYPOINTS, PARENTS, bone_offsets
from torchhand.hand.limits.anatomy import anatomical_skeleton

FOLDER = models_dir() / "generic_hand"
NUMBER = r"-?\d+\.\d+"

LIMITS_DEG = {  # between the norms of the AAOS and published hand models
    **{f"{finger}_mcp_fe": (-15, 100) for finger in FINGERS[1:]},
    # the outer fingers spread further, as published models do
    **{"index_mcp_aa": (-20, 30), "ring_mcp_aa": (-20, 20), "little_mcp_aa": (-20, 35)},
    **{f"{finger}_mcp_tw": (-10, 10) for finger in FINGERS[1:]},
    **{f"{finger}_pip_fe": (-5, 110) for finger in FINGERS[1:]},
    **{f"{finger}_dip_fe": (-10, 90) for finger in FINGERS[1:]},
    **{"middle_mcp_aa": (-12, 12), "index_cmc_fe": (0, 5), "middle_cmc_fe": (0, 5)},
    **{"ring_cmc_fe": (0, 15), "little_cmc_fe": (0, 25)},
    **{"thumb_cmc_fe": (-25, 80), "thumb_cmc_aa": (0, 60), "thumb_cmc_tw": (-20, 40)},
    **{"thumb_mcp_fe": (-10, 65), "thumb_mcp_aa": (-15, 15), "thumb_ip_fe": (-20, 85)},
}


def test_the_shipped_file_is_what_the_anatomy_makes() -> None:
    space = read_shape_space(FOLDER / "shape.json")
    shipped, made = (FOLDER / "hand.urdf").read_text(), skeleton_to_urdf(anatomical_skeleton(space), "generic_hand")
    assert re.sub(NUMBER, "#", shipped) == re.sub(NUMBER, "#", made)
    numbers = [[float(number) for number in re.findall(NUMBER, text)] for text in (shipped, made)]
    assert numbers[0] == pytest.approx(numbers[1], abs=2e-12)


def test_reading_gives_back_what_was_written() -> None:
    """To the float32 rounding of the parser."""
    space = read_shape_space(FOLDER / "shape.json")
    made, read = anatomical_skeleton(space), read_skeleton(FOLDER / "hand.urdf")
    assert made.bone == read.bone
    for name in ("rest_rotation", "rest_offset", "tip_offset", "axis", "lower", "upper"):
        torch.testing.assert_close(getattr(read, name), getattr(made, name), atol=3e-7, rtol=0)
    for bone in range(1, len(BONES)):
        own = [i for i in range(len(JOINT_DOFS)) if made.bone[i] == bone]
        assert sorted(own, key=lambda i: made.order[i]) == sorted(own, key=lambda i: read.order[i])


def test_offsets_are_those_of_the_default_shape() -> None:
    model = load_hand_model()
    rest = model.skeleton.rest_rotation[1:6]
    offsets, tips = bone_offsets(model.shape_space, model.shape_space.default, rest)
    torch.testing.assert_close(model.skeleton.rest_offset, offsets, atol=3e-7, rtol=0)
    torch.testing.assert_close(model.skeleton.tip_offset, tips, atol=3e-7, rtol=0)


def test_limits() -> None:
    skeleton = load_hand_model().skeleton
    assert set(LIMITS_DEG) == set(JOINT_DOFS)
    for i, dof in enumerate(JOINT_DOFS):
        limits = [math.degrees(float(bound[i])) for bound in (skeleton.lower, skeleton.upper)]
        assert limits == pytest.approx(LIMITS_DEG[dof], abs=1e-4), dof


def test_thirty_angles_on_nineteen_bones() -> None:
    skeleton = load_hand_model().skeleton
    assert len(JOINT_DOFS) == 30
    assert len(KEYPOINTS) == 21
    assert set(skeleton.bone) == set(range(1, len(BONES)))
    assert all(PARENTS[bone] < bone for bone in range(len(BONES)))
    torch.testing.assert_close(skeleton.axis.norm(dim=-1), torch.ones(30, dtype=torch.float64), atol=1e-6, rtol=0)


def test_the_thumbs_two_axes_are_skew() -> None:
    """Chang and Pollard 2008: 87° between flexion and abduction of the CMC joint."""
    skeleton = load_hand_model().skeleton
    flexion, abduction = (skeleton.axis[JOINT_DOFS.index(f"thumb_cmc_{role}")] for role in ("fe", "aa"))
    assert math.degrees(math.acos(float(flexion @ abduction))) == pytest.approx(87.0, abs=1e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "is no URDF file"),
        (
            '<robot name="arm"><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/>'
            '<child link="b"/><limit lower="1e" upper="1" effort="1" velocity="1"/></joint></robot>',
            r"is no URDF file \(ParseError in .*: could not convert string to float: '1e'\)$",  # one line of the two
        ),
        (
            '<robot name="arm"><link name="a"/><link name="b"/><joint name="j" type="fixed"><parent link="a"/>'
            '<child link="b"/></joint></robot>',
            "expected the links and joints of a torchhand hand, lacks wrist",
        ),
    ],
)
def test_another_robot_is_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "hand.urdf"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_skeleton(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('rpy="', 'rpy="nan '),
        ('<parent link="wrist"/><child link="thumb_metacarpal_thumb_cmc_aa"/>', '<parent link="thumb_tip"/>'),
        ('lower="', 'lower="inf" other="'),
    ],
)
def test_a_hand_whose_numbers_or_links_are_none_is_refused(old: str, new: str, tmp_path: Path) -> None:
    text = (FOLDER / "hand.urdf").read_text()
    assert old in text
    path = tmp_path / "hand.urdf"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=r"hand.urdf: "):
        read_skeleton(path)


def test_a_model_that_is_not_there() -> None:
    with pytest.raises(InputError, match=r"expected a folder or one of generic_hand.*, got 'no_such_hand'"):
        load_hand_model("no_such_hand")
    with pytest.raises(InputError, match="cannot be read"):
        read_skeleton(FOLDER / "nothing.urdf")
