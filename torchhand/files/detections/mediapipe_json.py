"""What people save of MediaPipe's hand landmarks as JSON: results of both its interfaces, and plain lists."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from torchhand.errors import InputError
from torchhand.files.detections.record import COUNT, Detections, HandDetection, Side, detections_of, majority_side
from torchhand.files.disk import read_number, short

_PICTURE_KEYS = ("multi_hand_landmarks", "multiHandLandmarks", "hand_landmarks", "handLandmarks", "landmarks")
_SPACE_KEYS = (
    *("multi_hand_world_landmarks", "multiHandWorldLandmarks"),
    *("hand_world_landmarks", "handWorldLandmarks", "worldLandmarks", "world_landmarks"),
)
_HAND_KEY = "landmark"  # of one hand, where protobuf's MessageToDict wrote it
_SIDE_KEYS = ("multi_handedness", "multiHandedness", "handedness", "handednesses")
_LABEL_KEYS = ("label", "category_name", "categoryName", "display_name", "displayName")
_NUMBER_KEYS = ("frame", "frame_number", "frame_index", "frame_id", "index")
_FORMS = (
    "expected MediaPipe's hand landmarks: an object with multi_hand_landmarks or hand_landmarks (also world ones),"
    " a list of such objects, or lists of 21 {x, y, z}"
)


def mediapipe_detections(
    path: Path,
    content: Any,
    *,
    side: Side | None = None,
    points: Literal["auto", "space", "picture"] = "auto",
    is_mirrored: bool = False,
) -> Detections:
    """One hand of a file's content; see `read_detections`.

    Plain lists are image landmarks, unless points = "space". Without a side, the one seen in more frames is taken; of
    two hands of that side, the one with the higher score. Visibilities are used only where not all are 0, which is what
    MediaPipe writes for hands.
    """
    frames = _frames(path, content)
    has_space = any(_found(frame, _SPACE_KEYS) is not None for _, _, frame in frames if isinstance(frame, Mapping))
    has_picture = not has_space or any(
        _found(f, _PICTURE_KEYS) is not None for _, _, f in frames if isinstance(f, Mapping)
    )
    kinds = (points == "space" or (points == "auto" and has_space), points != "space" and has_picture)
    hands = [(number, _hands_of_both(where, frame, *kinds, is_mirrored)) for number, where, frame in frames]
    if side is None:
        side = majority_side([hand.label for _, found in hands for hand in found])
    rows = []
    for number, found in hands:
        own = [hand for hand in found if hand.label in (side, None)]
        rows.append((number, max(own, key=lambda hand: np.nan_to_num(hand.score), default=None)))
    return detections_of(str(path), rows, side=side, is_normalised=True)


def _hands_of_both(
    where: str, frame: Any, has_space: bool, has_picture: bool, is_mirrored: bool
) -> list[HandDetection]:
    """Hands of a frame; of both kinds the hands stand in the same order. What does not tell its kind is in space."""
    if not isinstance(frame, Mapping) or _HAND_KEY in frame:
        has_picture = has_picture and not has_space
    space = _hands(where, frame, True, is_mirrored) if has_space else []
    picture = _hands(where, frame, False, is_mirrored) if has_picture else []
    both = [
        replace(own, picture=other.picture, confidence=other.confidence if own.confidence is None else own.confidence)
        for own, other in zip(space, picture, strict=False)
    ]
    return [*both, *space[len(both) :], *picture[len(both) :]]


def _frames(path: Path, content: Any) -> list[tuple[int, str, Any]]:
    """(number, where, content) of every frame."""
    if isinstance(content, Mapping) and isinstance(content.get("frames"), list | Mapping):
        content = content["frames"]
    if isinstance(content, Mapping) and content and all(str(key).isdecimal() and len(key) < 19 for key in content):
        return [(int(key), f"{path}: frame {key}", frame) for key, frame in content.items()]
    if isinstance(content, Mapping):
        if not {_HAND_KEY, *_PICTURE_KEYS, *_SPACE_KEYS} & set(content):
            keys = ", ".join(map(str, list(content)[:4])) or "nothing"
            raise InputError(f"{path}: {_FORMS}; got an object with {keys}")
        return [(0, str(path), content)]
    if not isinstance(content, list) or not content:
        raise InputError(f"{path}: {_FORMS}; got {short(content)}")
    if _is_points(content) or (_is_hand(content[0]) and len(content) < 3):
        return [(0, str(path), content)]  # one hand, or the one or two hands of one frame
    frames = []
    for i, frame in enumerate(content):
        number = _found(frame, _NUMBER_KEYS) if isinstance(frame, Mapping) else None
        if not isinstance(number, int) or isinstance(number, bool):
            number = i
        if abs(number) >= 2**63:
            raise InputError(f"{path}: frame {i}: expected a frame number below 2^63, got {short(number)}")
        frames.append((number, f"{path}: frame {i}", frame))
    return frames


def _is_hand(value: Any) -> bool:
    return _is_points(value.get(_HAND_KEY)) if isinstance(value, Mapping) else _is_points(value)


def _is_points(value: Any) -> bool:
    """Whether a list is one of points rather than of hands or frames."""
    first = value[0] if isinstance(value, list) and value else None
    is_point = isinstance(first, Mapping) and "x" in first
    return is_point or (isinstance(first, list) and bool(first) and isinstance(first[0], int | float))


def _found(content: Mapping[str, Any], keys: tuple[str, ...]) -> Any:
    return next((content[key] for key in keys if content.get(key) is not None), None)


def _hands(where: str, frame: Any, in_space: bool, is_mirrored: bool) -> list[HandDetection]:
    if frame is None:
        return []
    labels: Any = []
    if isinstance(frame, Mapping) and _HAND_KEY in frame:
        hands = [frame]
    elif isinstance(frame, Mapping):
        labels = _found(frame, _SIDE_KEYS) or []
        hands = _found(frame, _SPACE_KEYS if in_space else _PICTURE_KEYS)
        known = {*_PICTURE_KEYS, *_SPACE_KEYS, *_SIDE_KEYS, *_NUMBER_KEYS}
        if frame and not known & set(frame):
            raise InputError(f"{where}: {_FORMS}; got an object with {', '.join(map(str, list(frame)[:4]))}")
        hands = hands or []
    else:
        hands = frame
    if not isinstance(hands, list):
        raise InputError(f"{where}: {_FORMS}; got {short(hands)}")
    if _is_points(hands):
        hands = [hands]
    if not isinstance(labels, list):
        labels = [labels]
    result = []
    for i, hand in enumerate(hands):
        points, confidence = _points(f"{where}: hand {i}", hand)
        side, score = _label(f"{where}: hand {i}", labels[i] if i < len(labels) else None)
        if side is not None and not is_mirrored:
            side = "left" if side == "right" else "right"
        kinds = {"space": points if in_space else None, "picture": None if in_space else points}
        result.append(HandDetection(**kinds, confidence=confidence, label=side, score=score))
    return result


def _points(where: str, hand: Any) -> tuple[np.ndarray, np.ndarray | None]:
    if isinstance(hand, Mapping):
        hand = next((hand[key] for key in (_HAND_KEY, "landmarks", "keypoints") if key in hand), hand)
    if not isinstance(hand, list) or len(hand) != COUNT:
        got = f"{len(hand)}" if isinstance(hand, list) else short(hand)
        raise InputError(f"{where}: expected {COUNT} points, got {got}")
    points, confidence = np.zeros((COUNT, 3)), np.zeros(COUNT)
    for k, point in enumerate(hand):
        at = f"{where}: point {k}"
        if isinstance(point, Mapping):
            if "x" not in point or "y" not in point:
                raise InputError(f"{at}: expected x, y and z, got {short(dict(point))}")
            points[k] = [read_number(f"{at}.{axis}", point.get(axis, 0.0)) for axis in "xyz"]
            visibility = point.get("visibility")
            confidence[k] = 0.0 if visibility is None else read_number(f"{at}.visibility", visibility)
        elif isinstance(point, list) and len(point) in (2, 3):
            points[k, : len(point)] = [read_number(f"{at}[{i}]", number) for i, number in enumerate(point)]
        else:
            raise InputError(f"{at}: expected x, y and z, got {short(point)}")
    return points, confidence.clip(0, 1) if confidence.any() else None


def _label(where: str, label: Any) -> tuple[Side | None, float]:
    """Side as the file names it, and its score; NaN where there is none."""
    if isinstance(label, Mapping) and isinstance(label.get("classification"), list):
        label = label["classification"]
    if isinstance(label, list):
        label = label[0] if label else None
    if label is None:
        return None, float("nan")
    name = _found(label, _LABEL_KEYS) if isinstance(label, Mapping) else label
    if not isinstance(name, str) or name.casefold() not in ("left", "right"):
        raise InputError(f"{where}: handedness: expected Left or Right, got {short(name)}")
    score = label.get("score") if isinstance(label, Mapping) else None
    side: Side = "left" if name.casefold() == "left" else "right"
    return side, float("nan") if score is None else read_number(f"{where}: handedness.score", score)
