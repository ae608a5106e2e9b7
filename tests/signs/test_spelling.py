"""A text as a motion: holds, eased ways, traced letters, both hands, and texts that cannot be spelled."""

import itertools
import math

import pytest
import torch

from torchhand.errors import InputError
from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import KEYPOINTS
from torchhand.signs.facing import sign_rotation
from torchhand.signs.file import load_signs
from torchhand.signs.paths import TRACERS, hand_course
from torchhand.signs.spelling import SpellingSettings, check_text, sign_joints, spell, standing_pose, traced_poses
from torchhand.signs.table import SIGNS

MODEL = load_hand_model()
SOLVED = load_signs()
LOWER, UPPER = MODEL.skeleton.lower.double(), MODEL.skeleton.upper.double()


def test_holds_are_the_signs_and_ways_are_smooth() -> None:
    found = spell("Hello", MODEL, SOLVED)
    assert (found.text, found.fps) == ("HELLO", 25.0)
    joints, place = found.poses[:, 6:], torch.tensor(found.place)
    assert found.place[0] == 0
    assert found.place[-1] == 4
    assert sorted(found.place) == list(found.place)
    for number, sign in enumerate("HELLO"):
        held = ((joints - SOLVED[sign]).abs().amax(-1) < 1e-9) & (place == number)
        assert int(held.sum()) >= math.floor(0.55 * 25)
        rotations = rotation_from_vector(found.poses[held, 3:6])
        assert float((rotations[0] - sign_rotation(sign)).abs().max()) < 1e-12
    assert bool(((joints >= LOWER - 1e-9) & (joints <= UPPER + 1e-9)).all())
    assert float(found.overlap.max()) < 0.5e-3
    assert math.degrees(float(joints.diff(dim=0).abs().max())) < 25
    assert float(found.poses[:, :3].diff(dim=0).norm(dim=-1).max()) < 0.05


def test_the_same_every_time_and_at_any_rate() -> None:
    once, again = (spell("R2", MODEL, SOLVED) for _ in range(2))
    assert torch.equal(once.poses, again.poses)
    fast = spell("R2", MODEL, SOLVED, settings=SpellingSettings(fps=50.0))
    assert abs(len(fast.poses) - 2 * len(once.poses)) <= 1
    assert float((fast.poses[::2][: len(once.poses)] - once.poses).abs().max()) < 1e-9
    slow = spell("R2", MODEL, SOLVED, settings=SpellingSettings(seconds_per_sign=2.0))
    assert abs(len(slow.poses) - 2 * len(once.poses)) <= 2


def test_a_letter_twice_slides_and_a_space_is_a_pause() -> None:
    twice = spell("LL", MODEL, SOLVED)
    moved = twice.poses[-1] - twice.poses[0]
    assert float(moved[3:].abs().max()) < 1e-12
    assert float(moved[0]) == pytest.approx(-0.03)
    lengths = [len(spell(text, MODEL, SOLVED).poses) for text in ("AB", "A B")]
    assert lengths[1] - lengths[0] == pytest.approx(0.55 * 25, abs=1)


def test_j_and_z_are_traced() -> None:
    kinematics = MODEL.kinematics(dtype=torch.float64)
    fraction = torch.linspace(0, 1, 101, dtype=torch.float64)
    tips = {}
    for sign, tip in TRACERS.items():
        poses = traced_poses(sign, SOLVED[sign], MODEL, fraction)
        tips[sign] = kinematics(poses).keypoints[:, KEYPOINTS.index(tip)]
    z = tips["Z"]
    corner = [round(100 * k / 3) for k in range(4)]
    strokes = torch.stack([z[b] - z[a] for a, b in itertools.pairwise(corner)])
    assert strokes[0].tolist() == pytest.approx([-0.09, 0, 0], abs=2e-3)  # the viewer sees a Z mirrored
    assert strokes[1].tolist() == pytest.approx([0.09, 0.065, 0], abs=4e-3)
    assert strokes[2].tolist() == pytest.approx([-0.09, 0, 0], abs=2e-3)
    j = tips["J"]
    low = int(j[:, 1].argmax())
    assert float(j[low, 1] - j[0, 1]) > 0.05  # down,
    assert float(j[-1, 0] - j[0, 0]) > 0.03  # over,
    assert float(j[low, 1] - j[-1, 1]) > 0.01  # and up again
    assert low > 40
    palm = torch.tensor((-1.0, 0.0, 0.0), dtype=torch.float64)
    _, rotation = hand_course("J", fraction)
    assert float((rotation[0] @ palm)[2]) < -0.99
    assert float((rotation[-1] @ palm)[2]) > 0.1  # the palm has turned to the signer
    assert spell("AJ", MODEL, SOLVED).overlap.max() < 2e-3


def test_left_hands_spell_the_mirror_image() -> None:
    mirror = torch.tensor((-1.0, 1.0, 1.0), dtype=torch.float64)
    points = []
    for side in ("right", "left"):
        found = spell("JP", MODEL, SOLVED, side=side)
        points.append(MODEL.kinematics(side, dtype=torch.float64)(found.poses).keypoints)
    assert float((points[1] * mirror - points[0]).abs().max()) < 1e-9


def test_other_hands_spell_without_running_through_themselves() -> None:
    shape = MODEL.shape_space.default.double() * 1.0
    shape[MODEL.shape_space.names.index("hand_breadth")] *= 0.94
    joints = sign_joints(MODEL, "ST", SOLVED, shape)
    assert float((joints["S"] - SOLVED["S"]).abs().max()) > 1e-3
    found = spell("ST", MODEL, joints, shape=shape)
    assert float(found.overlap.max()) < 2e-3
    own = sign_joints(MODEL, "ST", SOLVED, MODEL.shape_space.default)
    assert torch.equal(own["T"], SOLVED["T"])


def test_standing_poses_have_the_middle_of_the_hand_in_the_middle() -> None:
    kinematics = MODEL.kinematics(dtype=torch.float64)
    for sign in SIGNS:
        points = kinematics(standing_pose(sign, SOLVED[sign], MODEL)).keypoints
        assert float((points[0] + points[9]).norm() / 2) < 0.07, sign


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("HÄ", r"got 'Ä' \(character 2 of 'HÄ'\)"),
        ("A-B", r"letters A to Z, digits 0 to 9 and spaces, got '-' \(character 2 of 'A-B'\)"),
        ("ß", "got 'ß'"),
        ("x" * 50 + "!", r"character 51 of 'x{37}\.\.\.'"),
        ("", "expected at least one letter A to Z or digit 0 to 9, got none"),
        ("  ", "got none"),
    ],
)
def test_texts_that_cannot_be_spelled(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_text(text)


def test_texts_are_put_in_order() -> None:
    assert check_text(" hi\tyou 2 ") == "HI YOU 2"


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("fps", 0.0, "more than 0, 1000 at most"),
        ("seconds_per_sign", 0.1, "0.2 to 20"),
        ("hold_fraction", 1.0, "0.1 to 0.9"),
        ("traced_seconds", math.nan, "0.2 to 20"),
    ],
)
def test_settings(name: str, value: float, allowed: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected {allowed}, got"):
        SpellingSettings(**{name: value})
