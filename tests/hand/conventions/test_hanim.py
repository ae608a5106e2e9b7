"""Names of H-Anim as ISO/IEC 19774 gives them."""

from torchhand.hand.conventions.hanim import hanim_joints, hanim_segments
from torchhand.hand.kinematics import BONES


def test_version_2_counts_the_digits() -> None:
    joints = dict(zip(BONES, hanim_joints("left"), strict=True))
    assert joints["wrist"] == "l_radiocarpal"
    assert joints["thumb_metacarpal"] == "l_carpometacarpal_1"
    assert joints["thumb_proximal"] == "l_metacarpophalangeal_1"
    assert joints["thumb_distal"] == "l_carpal_interphalangeal_1"
    assert joints["index_metacarpal"] == "l_carpometacarpal_2"
    assert joints["middle_proximal"] == "l_metacarpophalangeal_3"
    assert joints["ring_middle"] == "l_carpal_proximal_interphalangeal_4"
    assert joints["little_distal"] == "l_carpal_distal_interphalangeal_5"
    assert len({*hanim_joints("left"), *hanim_joints("right")}) == 40


def test_version_1_names_them() -> None:
    joints = dict(zip(BONES, hanim_joints("right", "1"), strict=True))
    assert joints["wrist"] == "r_wrist"
    assert [joints[f"thumb_{level}"] for level in ("metacarpal", "proximal", "distal")] == [
        "r_thumb1",
        "r_thumb2",
        "r_thumb3",
    ]
    levels = ("metacarpal", "proximal", "middle", "distal")
    assert [joints[f"index_{level}"] for level in levels] == ["r_index0", "r_index1", "r_index2", "r_index3"]
    assert [joints[f"little_{level}"] for level in levels] == ["r_pinky0", "r_pinky1", "r_pinky2", "r_pinky3"]


def test_segments() -> None:
    segments = dict(zip(BONES, hanim_segments("right"), strict=True))
    assert segments["wrist"] == "r_carpal"
    assert segments["thumb_metacarpal"] == "r_metacarpal_1"
    assert segments["thumb_distal"] == "r_carpal_distal_phalanx_1"
    assert segments["index_proximal"] == "r_carpal_proximal_phalanx_2"
    assert segments["little_middle"] == "r_carpal_middle_phalanx_5"
    assert len(set(segments.values())) == 20
