"""Files of hand detectors: every usual form gives the same record, every broken one a clear line."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from torchhand.errors import InputError
from torchhand.files.detections.formats import read_detections, read_rig_detections

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(0.1, 0.9, (4, 21, 3))
WORLD = RNG.uniform(-0.1, 0.1, (4, 21, 3))


def _dicts(points: np.ndarray, **more: float) -> list[dict[str, float]]:
    return [{"x": float(x), "y": float(y), "z": float(z), **more} for x, y, z in points]


def _write(path: Path, content: Any) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def _solutions(frame: int) -> dict[str, Any]:
    """As the protobuf messages of MediaPipe's solutions print."""
    return {
        "frame": frame + 10,
        "multi_hand_landmarks": [{"landmark": _dicts(POINTS[frame])}],
        "multi_hand_world_landmarks": [{"landmark": _dicts(WORLD[frame])}],
        "multi_handedness": [{"classification": [{"index": 0, "score": 0.98, "label": "Left"}]}],
    }


def _tasks(frame: int) -> dict[str, Any]:
    """As its tasks' results print."""
    return {
        "hand_landmarks": [_dicts(POINTS[frame], visibility=0.0, presence=0.0)],
        "hand_world_landmarks": [_dicts(WORLD[frame])],
        "handedness": [[{"index": 0, "score": 0.98, "category_name": "Left", "display_name": "Left"}]],
    }


def _javascript(frame: int) -> dict[str, Any]:
    return {
        "landmarks": [_dicts(POINTS[frame])],
        "worldLandmarks": [_dicts(WORLD[frame])],
        "handednesses": [[{"score": 0.98, "categoryName": "Left"}]],
    }


@pytest.mark.parametrize("form", [_solutions, _tasks, _javascript])
def test_results_of_mediapipe(form: Any, tmp_path: Path) -> None:
    path = _write(tmp_path / "hands.json", [form(i) for i in range(4)])
    found = read_detections(path)
    np.testing.assert_array_equal(found.keypoints, WORLD)
    assert (found.units, found.side) == ("metres", "right")  # MediaPipe names hands as in a mirror
    assert (found.confidence == 1).all()
    assert found.frame.tolist() == [10, 11, 12, 13] if form is _solutions else [0, 1, 2, 3]
    picture = read_detections(path, points="picture", is_mirrored=True)
    np.testing.assert_array_equal(picture.keypoints, POINTS[..., :2])
    assert (picture.units, picture.side) == ("normalised", "left")
    one = read_detections(_write(tmp_path / "one.json", form(0)))
    np.testing.assert_array_equal(one.keypoints, WORLD[:1])
    wrapped = read_detections(_write(tmp_path / "wrapped.json", {"fps": 30, "frames": [form(i) for i in range(4)]}))
    np.testing.assert_array_equal(wrapped.keypoints, WORLD)


@pytest.mark.parametrize("has_names", [True, False])
def test_plain_lists(has_names: bool, tmp_path: Path) -> None:
    hands = [_dicts(hand) if has_names else hand.tolist() for hand in POINTS]
    one = read_detections(_write(tmp_path / "hand.json", hands[0]))
    np.testing.assert_array_equal(one.keypoints, POINTS[:1, :, :2])
    assert (one.units, one.side) == ("normalised", None)
    frames = read_detections(_write(tmp_path / "frames.json", hands))
    np.testing.assert_array_equal(frames.keypoints, POINTS[..., :2])
    deeper = read_detections(_write(tmp_path / "deeper.json", [[hand] for hand in hands]), points="space")
    np.testing.assert_array_equal(deeper.keypoints, POINTS)
    assert deeper.units == "metres"


def test_frames_without_a_hand_are_missing(tmp_path: Path) -> None:
    empty = {"multi_hand_landmarks": None, "multi_hand_world_landmarks": None, "multi_handedness": None}
    found = read_detections(_write(tmp_path / "hands.json", [_solutions(0), empty, None, {}, _solutions(3)]))
    assert found.confidence.sum(1).tolist() == [21, 0, 0, 0, 21]
    assert np.isnan(found.keypoints[1:4]).all()
    np.testing.assert_array_equal(found.keypoints[4], WORLD[3])


def test_the_side_chooses_among_two_hands(tmp_path: Path) -> None:
    both = {
        "hand_landmarks": [_dicts(POINTS[0]), _dicts(POINTS[1]), _dicts(POINTS[2])],
        "handedness": [[{"score": s, "category_name": n}] for s, n in ((0.9, "Left"), (0.7, "Right"), (0.8, "Right"))],
    }
    path = _write(tmp_path / "hands.json", [both])
    np.testing.assert_array_equal(read_detections(path, side="right").keypoints[0], POINTS[0, :, :2])
    np.testing.assert_array_equal(read_detections(path, side="left").keypoints[0], POINTS[2, :, :2])
    np.testing.assert_array_equal(read_detections(path).keypoints[0], POINTS[2, :, :2])  # seen more often
    only_left = {"hand_landmarks": [_dicts(POINTS[0])], "handedness": [[{"category_name": "Right"}]]}
    with pytest.raises(InputError, match=r"left.json: expected at least one right hand, got none in 1 frames"):
        read_detections(_write(tmp_path / "left.json", only_left), side="right")


def test_visibility_is_confidence_where_it_is_not_always_zero(tmp_path: Path) -> None:
    hand = _dicts(POINTS[0], visibility=0.25)
    hand[3]["visibility"] = 0.0
    found = read_detections(_write(tmp_path / "hand.json", hand))
    assert found.confidence[0, :4].tolist() == [0.25, 0.25, 0.25, 0.0]
    assert np.isnan(found.keypoints[0, 3]).all()


def test_shares_of_the_picture_become_pixels(tmp_path: Path) -> None:
    corners = np.full((21, 3), 0.5)
    corners[0], corners[1] = 0.0, 1.0
    found = read_detections(_write(tmp_path / "hand.json", _dicts(corners))).in_pixels(640, 480)
    assert found.keypoints[0, :3].tolist() == [[-0.5, -0.5], [639.5, 479.5], [319.5, 239.5]]
    assert (found.units, found.size) == ("px", (640, 480))
    np.testing.assert_array_equal(found.in_pixels(1, 1).keypoints, found.keypoints)
    with pytest.raises(ValueError, match="expected points of a picture, got metres"):
        read_detections(_write(tmp_path / "space.json", [_tasks(0)]), points="space").in_pixels(640, 480)


def _person(points: np.ndarray | None, side: str, confidence: float = 0.8) -> dict[str, Any]:
    hand = np.zeros((21, 3)) if points is None else np.column_stack((points[:, :2], np.full(21, confidence)))
    other = "left" if side == "right" else "right"
    return {
        "person_id": [-1],
        "pose_keypoints_2d": [0.0] * 75,
        f"hand_{side}_keypoints_2d": hand.flatten().tolist(),
        f"hand_{other}_keypoints_2d": [],
    }


def test_openpose_folder_in_natural_order(tmp_path: Path) -> None:
    points = 500 * POINTS
    for number, i in ((2, 0), (10, 1), (9, 2)):
        person = _person(points[i], "right")
        person["hand_right_keypoints_2d"][6:9] = [0, 0, 0]
        people = [_person(points[3], "right", 0.3), person]
        _write(tmp_path / f"video_{number}_keypoints.json", {"version": 1.3, "people": people})
    _write(tmp_path / "video_11_keypoints.json", {"version": 1.3, "people": []})
    _write(tmp_path / "notes.json", "{}")
    found = read_detections(tmp_path)
    assert found.frame.tolist() == [2, 9, 10, 11]
    assert (found.side, found.units) == ("right", "px")
    np.testing.assert_array_equal(found.keypoints[:3, 3:], points[[0, 2, 1], 3:, :2])
    assert np.isnan(found.keypoints[:3, 2]).all()
    assert found.confidence[0, :4].tolist() == [0.8, 0.8, 0.0, 0.8]
    assert not found.confidence[3].any()
    with pytest.raises(InputError, match="expected at least one left hand, got none in 4 frames"):
        read_detections(tmp_path, side="left")


def test_one_openpose_file(tmp_path: Path) -> None:
    path = _write(tmp_path / "a_keypoints.json", {"people": [_person(300 * POINTS[0], "left")]})
    found = read_detections(path)
    assert (found.side, len(found)) == ("left", 1)
    np.testing.assert_array_equal(found.keypoints[0], 300 * POINTS[0, :, :2])


@pytest.mark.parametrize("suffix", ["npy", "npz"])
def test_arrays(suffix: str, tmp_path: Path) -> None:
    def save(name: str, array: np.ndarray) -> Path:
        path = tmp_path / f"{name}.{suffix}"
        if suffix == "npy":
            np.save(path, array)
        else:
            np.savez(path, landmarks=array)
        return path

    world = WORLD.astype(np.float32)
    world[1, 5] = np.nan
    found = read_detections(save("world", world))
    np.testing.assert_array_equal(found.keypoints, world.astype(np.float64))
    assert found.units == "metres"
    assert found.confidence[1, 5] == 0
    assert found.confidence.sum() == 4 * 21 - 1
    single = read_detections(save("single", WORLD[0]))
    assert single.keypoints.shape == (1, 21, 3)
    assert read_detections(save("share", POINTS[..., :2])).units == "normalised"
    assert read_detections(save("px", 500 * POINTS[..., :2])).units == "px"
    dropped = read_detections(save("mediapipe", POINTS), units="normalised")
    np.testing.assert_array_equal(dropped.keypoints, POINTS[..., :2])


def test_named_arrays(tmp_path: Path) -> None:
    path = tmp_path / "both.npz"
    np.savez(
        path,
        keypoints3d=WORLD,
        keypoints2d=300 * POINTS[..., :2],
        confidence=np.tile([0.5] * 20 + [0.0], (4, 1)),
        frame=np.arange(4) * 5,
        side=np.array("left"),
    )
    found = read_detections(path)
    assert (found.units, found.side, found.frame.tolist()) == ("metres", "left", [0, 5, 10, 15])
    assert found.confidence[0, 19:].tolist() == [0.5, 0.0]
    assert read_detections(path, points="picture").units == "px"


def _detector_arrays(**changed: np.ndarray) -> dict[str, Any]:
    """What a detector's run over pictures leaves: the second has no hand, the third the other one."""
    px, world = (300 * POINTS[..., :2]).astype(np.float32), WORLD.astype(np.float32)
    px[1] = world[1] = np.nan
    arrays = {
        "points_px": px,
        "world": world,
        "label": np.array(("Left", "", "Right", "Left")),
        "score": np.array((0.9, 0.0, 0.6, 0.8), dtype=np.float32),
        "image": np.array(("b.jpg", "a.jpg", "c.jpg", "d.jpg")),
    }
    return arrays | changed


def test_a_detectors_arrays_hold_both_kinds(tmp_path: Path) -> None:
    """MediaPipe's names are those of a mirror image; a hand of the other name is not this one."""
    path, arrays = tmp_path / "mediapipe.npz", _detector_arrays()
    np.savez(path, **arrays)
    found = read_detections(path)
    assert found.picture is not None
    assert found.space is not None
    np.testing.assert_array_equal(found.picture[[0, 3]], arrays["points_px"][[0, 3]])
    np.testing.assert_array_equal(found.space[[0, 3]], arrays["world"][[0, 3]])
    assert np.isnan(found.picture[1:3]).all()
    assert found.confidence.any(1).tolist() == [True, False, False, True]
    assert (found.side, found.label) == ("right", ("right", None, "left", "right"))
    np.testing.assert_array_equal(found.score, arrays["score"])
    assert found.is_normalised is False
    assert read_detections(path, is_mirrored=True).side == "left"
    other = read_detections(path, side="left")
    assert other.confidence.any(1).tolist() == [False, False, True, False]
    assert read_detections(path, points="space").units == "metres"
    assert read_detections(path, points="picture").units == "px"


def test_points_in_pictures_without_those_in_space(tmp_path: Path) -> None:
    """Pixels stay pixels, however few."""
    arrays = _detector_arrays(points_px=POINTS[..., :2])
    del arrays["world"], arrays["label"]
    np.savez(tmp_path / "px.npz", **arrays)
    found = read_detections(tmp_path / "px.npz")
    assert found.space is None
    assert (found.units, found.side, found.label) == ("px", None, (None,) * 4)
    np.testing.assert_array_equal(found.in_pixels(640, 480).keypoints, POINTS[..., :2])


def test_a_hand_is_found_by_the_number_of_its_frame(tmp_path: Path) -> None:
    path, arrays = tmp_path / "mediapipe.npz", _detector_arrays(frame=np.array((3, 5, 7, 9)))
    np.savez(path, **arrays)
    found = read_detections(path)
    hand = found.at_frame(9)
    assert hand is not None
    assert hand.space is not None
    np.testing.assert_array_equal(hand.space, arrays["world"][3])
    np.testing.assert_array_equal(hand.picture, arrays["points_px"][3])
    assert (hand.label, hand.score) == ("right", pytest.approx(0.8))
    assert [found.at_frame(number) for number in (0, 4, 5, 7)] == [None] * 4  # not there, no hand, the other hand


def test_mediapipes_results_hold_both_kinds(tmp_path: Path) -> None:
    found = read_detections(_write(tmp_path / "hands.json", [_tasks(i) for i in range(4)]))
    assert found.picture is not None
    assert found.space is not None
    np.testing.assert_array_equal(found.space, WORLD)
    np.testing.assert_allclose(found.in_pixels(640, 480).keypoints[..., 0], 640 * POINTS[..., 0] - 0.5)
    assert found.score.tolist() == [0.98] * 4


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"points_px": POINTS[:3, :, :2]}, r"points_px: expected 4 frames as in world, got 3"),
        ({"points_px": POINTS[:, :20, :2]}, r"points_px: expected an array \(frames, 21, 2 or 3\), got \(4, 20, 2\)"),
        ({"world": WORLD[0, 0]}, r"world: expected an array \(frames, 21, 2 or 3\), got \(3,\)"),
        ({"label": np.array(["Left"] * 3)}, r"label: expected texts of shape \(4,\), got <U4 of \(3,\)"),
        ({"label": np.zeros(4)}, r"label: expected texts of shape \(4,\), got float64 of \(4,\)"),
        ({"label": np.array(["Left", "Both", "", ""])}, r"label: expected Left, Right or nothing .*, got 'Both'"),
        ({"score": np.zeros(3)}, r"score: expected numbers of shape \(4, 21\) or \(4,\), got float64 of \(3,\)"),
        ({"image": np.arange(4)}, r"image: expected texts of shape \(4,\), got int64 of \(4,\)"),
        ({"frame": np.arange(3)}, r"frame: expected numbers of shape \(4,\), got int64 of \(3,\)"),
        ({"world": WORLD * np.nan, "points_px": WORLD[..., :2] * np.nan}, r"world: expected numbers, got NaN"),
    ],
)
def test_wrong_arrays_of_a_detector(changed: dict[str, np.ndarray], message: str, tmp_path: Path) -> None:
    path = tmp_path / "mediapipe.npz"
    np.savez(path, **_detector_arrays(**changed))
    with pytest.raises(InputError, match=message) as error:
        read_detections(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


BROKEN = {
    "truncated": ('[{"multi_hand_landmarks": [{"landmark": [{"x": 0.1', r"line 1: is no valid JSON"),
    "empty": ("[]", r"expected MediaPipe's hand landmarks.*; got \[\]"),
    "number": ("3", r"expected MediaPipe's hand landmarks.*; got 3"),
    "foreign": ('{"cameras": [1, 2]}', r"expected MediaPipe's hand landmarks.*; got an object with cameras"),
    "foreign frames": ('[{"a": 1, "b": 2}]', r"frame 0: expected MediaPipe's hand landmarks.*with a, b"),
    "twenty points": (json.dumps({"hand_landmarks": [_dicts(POINTS[0])[:20]]}), r"hand 0: expected 21 points, got 20"),
    "no x": (
        json.dumps({"hand_landmarks": [[{"u": 1}] * 21]}),
        r"hand 0: point 0: expected x, y and z, got \{'u': 1\}",
    ),
    "nan": (
        json.dumps({"hand_landmarks": [_dicts(np.full((21, 3), np.nan))]}),
        r"hand 0: point 0\.x: expected a finite number, got nan",
    ),
    "text": (json.dumps({"hand_landmarks": "none"}), r"expected MediaPipe's hand landmarks.*; got 'none'"),
    "side": (
        json.dumps({"hand_landmarks": [_dicts(POINTS[0])], "handedness": ["Both"]}),
        r"hand 0: handedness: expected Left or Right, got 'Both'",
    ),
    "no people": ('{"people": 3}', r"expected OpenPose's keypoints \('people': \[\.\.\.\]\), got \{'people': 3\}"),
    "nobody": ('{"people": []}', r"expected at least one hand, got none in 1 frames"),
    "person": ('{"people": [7]}', r"people\[0\]: expected an object with hand_left_keypoints_2d, got 7"),
    "sixty": (
        json.dumps({"people": [{"hand_left_keypoints_2d": [0.5] * 60}]}),
        r"people\[0\]\.hand_left_keypoints_2d: expected a list of 63, got 60",
    ),
    "null": (
        json.dumps({"people": [{"hand_right_keypoints_2d": [None] * 63}]}),
        r"people\[0\]\.hand_right_keypoints_2d\[0\]: expected a finite number, got None",
    ),
    "negative": (
        json.dumps({"people": [{"hand_right_keypoints_2d": [-1.0] * 63}]}),
        r"expected confidences of 0 or more, got -1",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_json(name: str, tmp_path: Path) -> None:
    text, message = BROKEN[name]
    path = _write(tmp_path / "hands.json", text)
    with pytest.raises(InputError, match=message) as error:
        read_detections(path)
    assert str(path) in str(error.value)


def test_broken_arrays(tmp_path: Path) -> None:
    def check(name: str, message: str, **arrays: Any) -> None:
        path = tmp_path / name
        np.savez(path, **arrays)
        with pytest.raises(InputError, match=message) as error:
            read_detections(path)
        assert str(path) in str(error.value)

    check(
        "shape.npz", r"landmarks: expected an array \(frames, 21, 2 or 3\), got \(4, 20, 3\)", landmarks=WORLD[:, :20]
    )
    check("none.npz", r"expected an array \(frames, 21, 2 or 3\), got \(0, 21, 3\)", landmarks=WORLD[:0])
    check("name.npz", "expected an array named keypoints3d, .*, got a, b", a=WORLD, b=WORLD)
    check(
        "nan.npz",
        "expected numbers, got NaN, infinity or a mark of a missing point everywhere",
        landmarks=np.full((2, 21, 3), np.nan),
    )
    check("text.npz", "expected numbers, got <U1", landmarks=np.full((2, 21, 3), "a"))
    check(
        "trust.npz",
        r"score: expected numbers of shape \(4, 21\) or \(4,\), got float64 of \(4, 3\)",
        landmarks=WORLD,
        score=WORLD[:, 0],
    )
    check("below.npz", "confidence: expected 0 or more, got -1", landmarks=WORLD, confidence=-np.ones((4, 21)))
    for name in ("text.npy", "cut.npz", "cut.npy"):
        path = tmp_path / name
        path.write_bytes(
            b"not an array" if name == "text.npy" else b"PK\x03\x04" if name == "cut.npz" else b"\x93NUMPY"
        )
        with pytest.raises(InputError, match=f"{name}: expected an array file of numpy"):
            read_detections(path)


def test_wrong_paths(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing\.json: no such file or folder"):
        read_detections(tmp_path / "missing.json")
    with pytest.raises(InputError, match=r"expected OpenPose's files \*_keypoints\.json, found none"):
        read_detections(tmp_path)
    with pytest.raises(InputError, match=r"a\.csv: expected keypoints as \.json .*, got \.csv"):
        read_detections(_write(tmp_path / "a.csv", "1,2"))
    np.save(tmp_path / "flat.npy", POINTS[..., :2])
    with pytest.raises(InputError, match="expected three columns for metres, got two"):
        read_detections(tmp_path / "flat.npy", units="metres")


HAND = [{"x": 0.5 + 0.01 * i, "y": 0.4, "z": 0.0} for i in range(21)]


@pytest.mark.parametrize(
    ("content", "frames"),
    [
        ({"landmark": HAND}, [0]),
        ([{"landmark": HAND}, {"landmark": HAND}], [0]),
        ([{"landmark": HAND}] * 3, [0, 1, 2]),
        ([[{"landmark": HAND}], []], [0, 1]),
        ({"3": {"landmarks": [HAND]}, "5": {"landmarks": []}}, [3, 5]),
        ({"frames": {"0": [HAND], "7": [HAND]}}, [0, 7]),
    ],
)
def test_more_forms_of_mediapipe(content: object, frames: list[int], tmp_path: Path) -> None:
    """Hands as protobuf's MessageToDict gives them, and frames by number."""
    path = _write(tmp_path / "hands.json", json.dumps(content))
    found = read_detections(path)
    assert found.frame.tolist() == frames
    np.testing.assert_allclose(found.keypoints[0, :, 0], [point["x"] for point in HAND])


@pytest.mark.parametrize("text", ["[" * 100_000, '{"people": ' + "[" * 100_000, "1" * 5000])
def test_json_that_python_cannot_hold(text: str, tmp_path: Path) -> None:
    path = _write(tmp_path / "hands.json", text)
    with pytest.raises(InputError, match=r"hands.json: is no JSON that can be read"):
        read_detections(path)


def test_a_byte_order_mark_is_no_mistake(tmp_path: Path) -> None:
    path = tmp_path / "hands.json"
    path.write_text(json.dumps({"landmark": HAND}), encoding="utf-8-sig")
    assert len(read_detections(path)) == 1


def test_frame_numbers_that_are_none(tmp_path: Path) -> None:
    path = _write(tmp_path / "hands.json", json.dumps([{"frame": 10**30, "landmarks": [HAND]}]))
    with pytest.raises(InputError, match="frame 0: expected a frame number below"):
        read_detections(path)
    for wrong in (np.nan, np.inf, 1e300, 0.5):
        np.savez(tmp_path / "points.npz", keypoints3d=np.random.default_rng(0).random((1, 21, 3)), frame=[wrong])
        with pytest.raises(InputError, match="frame: expected whole numbers"):
            read_detections(tmp_path / "points.npz")


def test_one_frame_with_its_confidences(tmp_path: Path) -> None:
    points = np.random.default_rng(0).random((21, 3))
    np.savez(tmp_path / "points.npz", keypoints=points, confidence=np.full(21, 0.5), side="Left")
    found = read_detections(tmp_path / "points.npz")
    np.testing.assert_allclose(found.confidence, np.full((1, 21), 0.5))
    assert found.side == "left"


def test_openpose_confidences_beyond_one_do_not_overflow(tmp_path: Path) -> None:
    content = {"people": [{"hand_left_keypoints_2d": [1e308] * 63}]}
    found = read_detections(_write(tmp_path / "hands.json", json.dumps(content)))
    np.testing.assert_array_equal(found.confidence, np.ones((1, 21)))


@pytest.mark.parametrize("mark", [(0.0, 0.0), (-1.0, -1.0)])
@pytest.mark.parametrize("views", [(), (2,)])
def test_marks_of_missing_points_are_none_and_points_a_little_outside_are(
    mark: tuple[float, float], views: tuple[int, ...], tmp_path: Path
) -> None:
    points = np.random.default_rng(0).uniform(10, 400, (*views, 3, 21, 2))
    points[..., 0, 4, :], points[..., 1, 8, :] = mark, (-3.0, -2.0)
    np.save(tmp_path / "points.npy", points)
    found = read_rig_detections(tmp_path / "points.npy") or [read_detections(tmp_path / "points.npy")]
    for view, own in zip(found, points.reshape(-1, 3, 21, 2), strict=True):
        own[0, 4] = np.nan
        assert view.picture is not None
        np.testing.assert_array_equal(view.picture, own)
        assert view.confidence[0, 4] == 0
