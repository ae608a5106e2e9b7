"""A hand that is changed number by number: limits hold, led angles follow, what is told is true."""

import json
import math

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, JOINT_DOFS, POSTURES, Side, posture
from torchhand.signs import SIGNS, load_signs
from torchhand.viewer import EditedHand


@pytest.fixture
def hand() -> EditedHand:
    return EditedHand(load_hand_model())


def test_joint_angles_stop_at_their_limits_and_the_wrist_does_not(hand: EditedHand) -> None:
    for dof in JOINT_DOFS:
        low, high = hand.limits(dof)
        hand.set_dof(dof, 10.0)
        assert float(hand.pose[DOFS.index(dof)]) == high
        hand.set_dof(dof, -10.0)
        assert float(hand.pose[DOFS.index(dof)]) == low
    before = hand.state().keypoints
    hand.set_dof("root_tx", 0.25)
    torch.testing.assert_close(hand.state().keypoints - before, torch.tensor([0.25, 0.0, 0.0]).double().expand(21, 3))


def test_angles_that_are_led_follow_while_they_are_to(hand: EditedHand) -> None:
    hand.set_dof("index_pip_fe", 0.9)
    assert "index_dip_fe" in hand.told()["angles that do not follow"]
    hand.set_follows(True)
    assert hand.told()["angles that do not follow"] == "none"
    hand.set_dof("index_pip_fe", 0.6)
    assert float(hand.pose[DOFS.index("index_dip_fe")]) == pytest.approx(0.4)
    hand.set_follows(False)
    hand.set_dof("index_pip_fe", 0.3)
    assert float(hand.pose[DOFS.index("index_dip_fe")]) == pytest.approx(0.4)


def test_proportions_change_the_hand_within_their_bounds(hand: EditedHand) -> None:
    space = hand.model.shape_space
    before = (hand.state().keypoints[12] - hand.state().keypoints[0]).norm()
    hand.set_parameter("hand_length", 99.0)
    assert float(hand.shape[space.names.index("hand_length")]) == float(space.upper[space.names.index("hand_length")])
    after = (hand.state().keypoints[12] - hand.state().keypoints[0]).norm()
    assert float(after / before) > 1.1
    hand.reset_shape()
    torch.testing.assert_close(hand.shape, space.default.double())


def test_postures_and_signs_are_those_of_the_library(hand: EditedHand) -> None:
    hand.set_dof("root_tx", 0.1)
    for name in POSTURES:
        hand.take_posture(name)
        torch.testing.assert_close(hand.pose[6:], posture(name, dtype=torch.float64)[6:])
    hand.take_sign("A")
    torch.testing.assert_close(hand.pose[6:], load_signs()["A"], atol=2e-5, rtol=0)
    assert float(hand.pose[0]) == 0.1
    assert hand.told()["couplings broken"] == "none"  # its file's angles are rounded, and may be beyond by that much
    assert hand.told()["log-density"] != "impossible"


@pytest.mark.parametrize("side", ["right", "left"])
def test_signs_stand_before_the_viewer_of_the_palm(side: Side) -> None:
    """As the page's camera looks at a hand that is not turned: from -x, y up; +z is to its right."""
    hand = EditedHand(load_hand_model(), side=side)
    for sign in SIGNS:
        hand.take_sign(sign)
        fingers, back = rotation_from_vector(hand.pose[3:6])[:, 1], rotation_from_vector(hand.pose[3:6])[:, 0]
        lies, hangs = sign in "GH", sign in "PQ"
        assert (float(fingers[1]) > 0.8) == (not lies and not hangs), sign
        if lies:  # across, to the right of a right hand's viewer
            assert float(fingers[2]) * (1 if side == "right" else -1) > 0.8, sign
        if sign in "12345GH":
            assert float(back[0]) < -0.8, sign
        elif sign in "ABFIKLRSUVWY6789":
            assert float(back[0]) > 0.8, sign


def test_what_is_drawn_is_possible_and_the_seed_decides(hand: EditedHand) -> None:
    other = EditedHand(load_hand_model())
    for one in (hand, other):
        one.draw(with_shape=True)
    torch.testing.assert_close(hand.pose, other.pose, rtol=0, atol=0)
    told = hand.told()
    assert math.isfinite(float(told["log-density"]))
    assert told["couplings broken"] == told["proportions outside people's"] == "none"


def test_an_impossible_posture_is_told_and_mended(hand: EditedHand) -> None:
    hand.take_posture("fist")
    hand.set_dof("middle_mcp_fe", 0.0)
    assert hand.told()["log-density"] == "impossible"
    assert "middle_mcp_fe" in hand.told()["couplings broken"]
    hand.make_feasible()
    assert hand.told()["couplings broken"] == "none"


def test_the_files_hold_the_hand(hand: EditedHand) -> None:
    hand.take_posture("point")
    content = json.loads(hand.as_json())
    assert [content["pose"][dof] for dof in DOFS] == hand.pose.tolist()
    assert content["pose_deg"]["index_pip_fe"] == pytest.approx(math.degrees(content["pose"]["index_pip_fe"]))
    lines = hand.as_obj().splitlines()
    vertices = torch.tensor([[float(word) for word in line.split()[1:]] for line in lines if line[0] == "v"])
    torch.testing.assert_close(vertices.double(), hand.state().vertices, rtol=0, atol=1e-6)
    faces = torch.tensor([[int(word) - 1 for word in line.split()[1:]] for line in lines if line[0] == "f"])
    assert torch.equal(faces, hand.state().faces)
