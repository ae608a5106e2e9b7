"""What tells that two results are not of one recording."""

from torchhand.evaluate import RecordingFacts, differences

PART = RecordingFacts(side="left", frames=40, sizes_px={(640, 480)})
WHOLE = RecordingFacts(side="left", frames=40, sizes_px={(640, 480), (720, 720)})


def test_every_difference_is_a_part_of_the_sentence() -> None:
    other = RecordingFacts(side="right", frames=41, sizes_px={(360, 288), (320, 240)})
    assert differences(WHOLE, other) == [
        "a left hand against a right one",
        "40 frames against 41",
        "pictures of 640x480 and 720x720 px against 320x240 and 360x288 px",
    ]


def test_some_cameras_of_a_rig_and_what_is_not_told_are_no_difference() -> None:
    assert differences(PART, WHOLE) == []
    assert differences(PART, RecordingFacts(side=None, frames=None, sizes_px=None)) == []
