"""The signs: the table, the solved angles, and what the hand looks like as an observer would say it."""

import itertools
import json
import math
from pathlib import Path

import pytest
import torch
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files import load_hand_model
from torchhand.hand import (
    CONE_NAMES,
    DOFS,
    FINGERS,
    JOINT_DOFS,
    KEYPOINTS,
    Clearance,
    ConstraintSettings,
    PoseConstraints,
    Primitives,
    penetration,
    place_primitives,
    primitive_sizes,
)
from torchhand.signs.facing import sign_rotation
from torchhand.signs.file import load_signs, save_signs
from torchhand.signs.fit import solve_signs, table_angles
from torchhand.signs.skin_points import POINT_NAMES, POINTS, skin_points
from torchhand.signs.table import FACINGS, HANDSHAPES, SIGNS

MODEL = load_hand_model()
KINEMATICS = MODEL.kinematics(dtype=torch.float64)
SOLVED = load_signs()
STRAIGHT = 0.8


def _posed(sign: str) -> Tensor:
    return torch.cat((torch.zeros(6, dtype=torch.float64), SOLVED[sign]))


def _points(sign: str) -> dict[str, Tensor]:
    """Keypoints in the hand frame: x out of the back, y towards the fingers, z towards the thumb's side."""
    return dict(zip(KEYPOINTS, KINEMATICS(_posed(sign)).keypoints, strict=True))


def _depth(sign: str, one: str, other: str) -> float:
    found = penetration(
        place_primitives(KINEMATICS(_posed(sign)), primitive_sizes(MODEL.shape_space, KINEMATICS.default_shape))
    )
    name = f"{one} – {other}" if f"{one} – {other}" in found.names else f"{other} – {one}"
    return float(found.depth[found.names.index(name)])


def _is_up(sign: str, finger: str) -> bool:
    """Whether a finger stands up: the height of its tip over its knuckle, against the length of its bones."""
    p = _points(sign)
    chain = [p[f"{finger}_{joint}"] for joint in ("mcp", "pip", "dip", "tip")]
    length = sum(float((b - a).norm()) for a, b in itertools.pairwise(chain))
    return float((chain[-1] - chain[0])[1]) > STRAIGHT * length


def test_all_36_are_there() -> None:
    assert sorted(SIGNS) == sorted("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789")
    assert set(SOLVED) == set(SIGNS)


@pytest.mark.parametrize(
    ("fingers", "signs"),
    [
        ("", "AEMNSTO0"),
        ("index", "DLZ1"),
        ("little", "IJY"),
        ("index middle", "HUV23"),
        ("index middle ring", "W6"),
        ("index middle ring little", "B45"),
        ("middle ring little", "F9"),
        ("index middle little", "7"),
        ("index ring little", "8"),
    ],
)
def test_which_fingers_are_up(fingers: str, signs: str) -> None:
    for sign in signs:
        assert [finger for finger in FINGERS[1:] if _is_up(sign, finger)] == fingers.split(), sign


def test_limits_and_equation_2_hold() -> None:
    constraints = PoseConstraints(MODEL.skeleton, ConstraintSettings(bands="none"))
    violation = constraints.violation(torch.stack([_posed(sign) for sign in SIGNS]))
    assert float(violation.worst.max()) < 1e-4  # rounding of the file


def test_equation_3_holds_but_where_fingers_are_held_down_or_bend_far_alone() -> None:
    constraints = PoseConstraints(MODEL.skeleton, ConstraintSettings(bands="paper"))
    violation = constraints.violation(torch.stack([_posed(sign) for sign in SIGNS]))
    assert {sign for sign, worst in zip(SIGNS, violation.worst.tolist(), strict=True) if worst > 1e-4} == set("HRUV237")


def test_nothing_overlaps() -> None:
    deepest = Clearance(KINEMATICS).worst(torch.stack([SOLVED[sign] for sign in SIGNS]))
    assert float(deepest.max()) < 0.2e-3


@pytest.mark.parametrize(
    ("sign", "one", "other"),
    [
        *(("A", "thumb_distal", "index_proximal"), ("D", "thumb_distal", "middle_distal")),
        *(("F", "thumb_distal", "index_distal"), ("9", "thumb_distal", "index_distal")),
        *(("8", "thumb_distal", "middle_distal"), ("7", "thumb_distal", "ring_distal")),
        *(("O", "thumb_distal", "index_distal"), ("O", "thumb_distal", "middle_distal")),
        *(("E", "thumb_distal", "middle_distal"), ("E", "thumb_distal", "ring_distal")),
        *(("K", "thumb_distal", "middle_proximal"), ("S", "thumb_distal", "middle_middle")),
        *(("T", "thumb_distal", "middle_proximal"), ("N", "thumb_distal", "ring_proximal")),
        *(("M", "thumb_distal", "little_proximal"), ("R", "thumb_distal", "ring_middle")),
        *(("U", "thumb_distal", "ring_middle"), ("V", "thumb_distal", "ring_middle")),
        *(("W", "thumb_distal", "little_middle"), ("6", "thumb_distal", "little_distal")),
        *(("U", "index_middle", "middle_middle"), ("I", "thumb_distal", "index_middle")),
    ],
)
def test_what_touches(sign: str, one: str, other: str) -> None:
    assert abs(_depth(sign, one, other)) < 0.6e-3


def test_thumbs_are_in_the_right_place() -> None:
    for sign in "L3Y5":  # out to the side
        p = _points(sign)
        assert float((p["thumb_tip"] - p["index_mcp"])[2]) > 0.05, sign
    a = _points("A")  # beside the fist, pointing up
    assert float((a["thumb_tip"] - a["thumb_mcp"])[1]) > 0.035
    assert float((a["thumb_tip"] - a["index_pip"])[2]) > 0.005
    for sign in "SIX1":  # in front of the fist
        p = _points(sign)
        middle = p["middle_pip"] if sign != "I" else p["index_pip"]
        assert float((p["thumb_tip"] - middle)[0]) < 0, sign


def _bend(sign: str, finger: str) -> tuple[Tensor, Tensor]:
    """PIP joint, and unit vectors (rows): the axis about which the finger bends, towards the thumb's side; out of the
    palmar sides of its proximal and middle segments."""
    p = _points(sign)
    mcp, pip, dip = (p[f"{finger}_{joint}"] for joint in ("mcp", "pip", "dip"))
    axis = torch.linalg.cross(dip - pip, pip - mcp)
    axis = axis * axis[2].sign() / axis.norm()
    palmar = [torch.linalg.cross(axis, bone / bone.norm()) for bone in (pip - mcp, dip - pip)]
    return pip, torch.stack((axis, *palmar))


@pytest.mark.parametrize(
    ("sign", "above", "behind"),
    [("T", ("index",), "middle"), ("N", ("index", "middle"), "ring"), ("M", ("index", "middle", "ring"), "little")],
)
def test_thumbs_come_out_between_two_fingers(sign: str, above: tuple[str, ...], behind: str) -> None:
    p = _points(sign)
    thumb = [p[f"thumb_{joint}"] for joint in ("mcp", "ip", "tip")]
    for finger in above:  # the thumb passes through the plane of every finger above it inside that finger's bend
        pip, axes = _bend(sign, finger)
        heights = [float((point - pip) @ axes[0]) for point in thumb]
        (k,) = (k for k in range(2) if heights[k] > 0 > heights[k + 1])
        share = heights[k] / (heights[k] - heights[k + 1])
        crossing = thumb[k] + share * (thumb[k + 1] - thumb[k]) - pip
        assert min((axes[1:] @ crossing).tolist()) > 0.004, finger
    primitives = place_primitives(
        KINEMATICS(_posed(sign)), primitive_sizes(MODEL.shape_space, KINEMATICS.default_shape)
    )
    tip, radius = _tip_ball(primitives, "thumb")
    pip, axes = _bend(sign, above[-1])
    assert float((tip - pip) @ axes[0]) < -0.003  # beyond the last of them
    pip, axes = _bend(sign, behind)
    assert float((tip - pip) @ axes[0]) > 0.003  # and before the next one
    (gap, one), (other_gap, other) = (_nearest(primitives, tip, finger) for finger in (above[-1], behind))
    assert max(gap, other_gap) - radius < 0.005  # near both, with one on either side
    cosine = (one - tip) @ (other - tip) / ((one - tip).norm() * (other - tip).norm())
    assert math.degrees(math.acos(float(cosine))) > 115


def _tip_ball(primitives: Primitives, digit: str) -> tuple[Tensor, float]:
    tip, ball = CONE_NAMES.index(f"{digit}_distal"), primitives.sizes
    radius = float(ball.cone_start[tip, 0] * ball.cone_end_scale[tip])
    return primitives.cone_position[tip] + primitives.cone_rotation[tip, :, 1] * ball.cone_length[tip], radius


def _nearest(primitives: Primitives, point: Tensor, digit: str) -> tuple[float, Tensor]:
    """Distance of a point from a digit's skin, and the middle of the ball of the digit that is nearest."""
    share = torch.linspace(0, 1, 401, dtype=torch.float64)[:, None]
    found = []
    for cone in (i for i, name in enumerate(CONE_NAMES) if name.startswith(digit)):
        sizes = primitives.sizes
        middles = (
            primitives.cone_position[cone] + share * sizes.cone_length[cone] * primitives.cone_rotation[cone, :, 1]
        )
        radii = sizes.cone_start[cone, 0] * (1 + share[:, 0] * (sizes.cone_end_scale[cone] - 1))
        gaps = (middles - point).norm(dim=-1) - radii
        found.append((float(gaps.min()), middles[int(gaps.argmin())]))
    return min(found, key=lambda pair: pair[0])


@pytest.mark.parametrize("sign", ["E", "O", "0"])
def test_fingertips_lie_on_the_thumb(sign: str) -> None:
    primitives = place_primitives(
        KINEMATICS(_posed(sign)), primitive_sizes(MODEL.shape_space, KINEMATICS.default_shape)
    )
    for finger in FINGERS[1:]:
        tip, radius = _tip_ball(primitives, finger)
        assert abs(_nearest(primitives, tip, "thumb")[0] - radius) < 0.5e-3, finger


def test_g_points_with_two_parallel_digits() -> None:
    p = _points("G")
    index, thumb = p["index_tip"] - p["index_mcp"], p["thumb_tip"] - p["thumb_ip"]
    assert math.degrees(math.acos(float(index @ thumb / (index.norm() * thumb.norm())))) < 15
    primitives = place_primitives(KINEMATICS(_posed("G")), primitive_sizes(MODEL.shape_space, KINEMATICS.default_shape))
    tip, radius = _tip_ball(primitives, "thumb")
    assert 0.005 < _nearest(primitives, tip, "index")[0] - radius < 0.025


def test_r_is_crossed() -> None:
    p = _points("R")
    assert float((p["middle_tip"] - p["index_tip"])[2]) > 0.008  # on the thumb's side of the index
    assert float((p["middle_tip"] - p["index_tip"])[0]) > 0.005  # and behind it
    assert float((p["index_mcp"] - p["middle_mcp"])[2]) > 0.01


def test_v_is_wider_than_u_and_x_is_hooked() -> None:
    gap = {s: float((_points(s)["index_tip"] - _points(s)["middle_tip"])[2]) for s in "UV"}
    assert gap["V"] > gap["U"] + 0.025
    x = _points("X")
    assert float((x["index_pip"] - x["index_mcp"])[1]) > 0.03
    assert float((x["index_tip"] - x["index_pip"])[1]) < 0.005


def test_where_hands_turn() -> None:
    palm = torch.tensor((-1.0, 0.0, 0.0), dtype=torch.float64)
    fingers = torch.tensor((0.0, 1.0, 0.0), dtype=torch.float64)
    for sign in SIGNS:
        rotation = sign_rotation(sign)
        assert float((rotation @ rotation.T - torch.eye(3)).abs().max()) < 1e-12
        assert float(torch.linalg.det(rotation)) == pytest.approx(1.0)
        if sign not in FACINGS:
            assert float((rotation @ palm)[2]) < -0.99  # towards the viewer
            assert float((rotation @ fingers)[1]) < -0.99  # up
    for sign in "PQ":
        assert float((sign_rotation(sign) @ palm)[1]) > 0.8  # down
    for sign in "CO0":
        assert float((sign_rotation(sign) @ palm)[0]) > 0.7  # to the viewer's right
    for sign in "GH":
        assert float((sign_rotation(sign) @ fingers)[0]) > 0.9  # to the viewer's right, ...
        assert float((sign_rotation(sign) @ palm)[2]) > 0.9  # ... the back to the viewer
    for sign in "12345":
        assert float((sign_rotation(sign) @ palm)[2]) > 0.99  # to the signer
        assert float((sign_rotation(sign) @ fingers)[1]) < -0.99


def test_left_hands_are_mirror_images() -> None:
    left = MODEL.kinematics("left", dtype=torch.float64)
    for sign in "AHKP":
        right_points = KINEMATICS(_posed(sign)).keypoints @ sign_rotation(sign).T
        left_points = left(_posed(sign)).keypoints @ sign_rotation(sign, "left").T
        assert float((left_points * torch.tensor((-1.0, 1.0, 1.0)) - right_points).abs().max()) < 1e-12


def test_the_file_is_what_is_solved() -> None:
    """Solved anew, each sign on its own comes out as in the file."""
    for sign in "F":
        found = solve_signs(KINEMATICS, sign)
        assert math.degrees(float((found.joints[0] - SOLVED[sign]).abs().max())) < 0.05
        assert float(found.overlap.depth.max()) < 0.2e-3


def test_other_hands_are_solved_from_the_file() -> None:
    shape = MODEL.shape_space.default.double().clone()
    for name, factor in (("index_distal", 1.06), ("thumb_proximal", 0.94), ("hand_length", 1.05)):
        shape[MODEL.shape_space.names.index(name)] *= factor
    start = torch.stack([SOLVED[sign] for sign in "FR"])
    before = Clearance(KINEMATICS, shape).worst(start)
    found = solve_signs(KINEMATICS, "FR", shape, start=start)
    assert float(found.overlap.depth.max()) < 0.3e-3
    assert float(found.contact.max()) < 6e-3
    assert float((found.joints - start).abs().max()) > 0.01
    assert float(before.max()) > float(found.overlap.depth.max())


def test_table_angles() -> None:
    angles = dict(zip(JOINT_DOFS, torch.rad2deg(table_angles(HANDSHAPES["V"])).tolist(), strict=True))
    assert angles["index_mcp_fe"] == angles["middle_pip_fe"] == 0
    assert angles["index_mcp_aa"] == pytest.approx(13)
    assert (angles["ring_mcp_fe"], angles["ring_pip_fe"]) == (pytest.approx(62), pytest.approx(80))


def test_skin_points_lie_on_the_skin() -> None:
    shape = KINEMATICS.default_shape
    primitives = place_primitives(KINEMATICS(_posed("5")), primitive_sizes(MODEL.shape_space, shape))
    points = skin_points(primitives)
    assert points.shape == (len(POINT_NAMES), 3)
    for name, point in POINTS.items():
        cone = CONE_NAMES.index(point.segment)
        local = primitives.cone_rotation[cone].T @ (points[POINT_NAMES.index(name)] - primitives.cone_position[cone])
        start, end = (
            float(primitives.sizes.cone_start[cone, 0] * k) for k in (1, primitives.sizes.cone_end_scale[cone])
        )
        assert float(local[[0, 2]].norm()) == pytest.approx(start + point.along * (end - start))
        side = {"pad": (-1, 0), "back": (1, 0), "side": (0, 1)}[name.split("_")[1]]
        assert float(local[0] * side[0] + local[2] * side[1]) == pytest.approx(float(local[[0, 2]].norm()))
    batch = skin_points(place_primitives(KINEMATICS(_posed("5").expand(2, 3, 36)), primitives.sizes))
    assert torch.allclose(batch[1, 2], points, rtol=0, atol=1e-15)


def test_the_file_comes_back_and_wrong_ones_are_refused(tmp_path: Path) -> None:
    joints = torch.stack([SOLVED["A"], SOLVED["B"]])
    save_signs(tmp_path / "signs.json", "AB", joints)
    back = load_signs(tmp_path / "signs.json")
    assert list(back) == ["A", "B"]
    assert math.degrees(float((torch.stack(list(back.values())) - joints).abs().max())) <= 0.51e-3
    record = json.loads((tmp_path / "signs.json").read_text())
    for change, message in (
        ({"format": "x"}, "format: expected 'torchhand signs 1', got 'x'"),
        ({"joints": list(DOFS)}, "joints: expected the 30 joint angles in their order, got others"),
        ({"signs": []}, r"signs: expected an object of lists of angles, got \[\]"),
        ({"signs": {"A": [1.0]}}, "signs: A: expected a list of 30, got 1"),
    ):
        (tmp_path / "wrong.json").write_text(json.dumps(record | change))
        with pytest.raises(InputError, match=message):
            load_signs(tmp_path / "wrong.json")
    (tmp_path / "wrong.json").write_text("[1]")
    with pytest.raises(InputError, match="format: expected"):
        load_signs(tmp_path / "wrong.json")
