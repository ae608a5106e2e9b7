"""What a caller mistakes is told at the door: what was expected, and what was given.

In a process of its own, in which no types are checked, as a user has it.
"""

import json
import subprocess
import sys

import cv2
import pytest

from tests.studio import Studio

SETUP = """
import json, sys
from dataclasses import replace
import numpy as np, torch, torchhand
from torchhand import *
from torchhand.losses import silhouette_loss
from torchhand.track import HandKeypoints

model, camera = load_hand_model(), assumed_camera(64, 48)
hand, prior, kinematics = model.hand(), model.prior(), model.kinematics()
picture, points, pose = torch.zeros(48, 64, 3, dtype=torch.uint8), torch.zeros(1, 20, 2), torch.zeros(36)

def first(**options):
    return next(torchhand.track(sys.argv[1], side="right", **options))

def step(views, **options):
    return Tracker(hand, camera, settings_of("contour_full"), **options).step(None, views, 0.0)

def told(call):
    try:
        return f"taken: {eval(call)}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"

print(json.dumps({call: told(call) for call in json.loads(sys.stdin.read())}))
"""
TOLD = {
    "step([View(image=picture.numpy())])": (
        "TypeError: image: expected a tensor, RGB, uint8 (height, width, 3), got ndarray"
    ),
    "View(image=picture.float())": (
        "ValueError: image: expected RGB, uint8 (height, width, 3), got torch.float32 (48, 64, 3)"
    ),
    "View(image=picture[:, 0])": "ValueError: image: expected RGB, uint8 (height, width, 3), got torch.uint8 (48, 3)",
    "View(mask=picture[..., 0])": "ValueError: mask: expected bool (height, width), got torch.uint8 (48, 64)",
    "View(mask=np.zeros((48, 64), bool))": "TypeError: mask: expected a tensor, bool (height, width), got ndarray",
    "View(keypoints=points)": "TypeError: keypoints: expected HandKeypoints, got Tensor",
    "HandKeypoints(points_px=points[0])": "ValueError: points_px: expected shape (21, 2), got (20, 2)",
    "HandKeypoints(points_px=points[0].numpy())": "TypeError: points_px: expected Tensor, got ndarray",
    "HandKeypoints(points_px=torch.zeros(21, 2), points=torch.zeros(21, 2))": (
        "ValueError: points: expected shape (21, 3), got (21, 2)"
    ),
    "step(View(image=picture))": "TypeError: views: expected Sequence, got View",
    "step([picture])": "TypeError: views[0]: expected View, got Tensor",
    "step([View(image=picture)], shape=torch.zeros(52))": (
        "ValueError: shape: hand_length: expected 0.14 to 0.24 m, got 0"
    ),
    "first(shape=torch.zeros(52))": "ValueError: shape: hand_length: expected 0.14 to 0.24 m, got 0",
    "first(shape=torch.zeros(10))": "ValueError: shape: expected 52 numbers in the last dimension, got shape (10,)",
    "first(shape=hand.shape.expand(2, 52))": "ValueError: shape: expected that of one hand, (52,), got (2, 52)",
    "first(shape=np.zeros(52))": "TypeError: shape: expected Tensor, got ndarray",
    "first(settings='contour_full')": "TypeError: settings: expected TrackerSettings, got str",
    "first(camera=3)": "TypeError: camera: expected Camera or str or PathLike, got int",
    "first(keypoints=points)": "TypeError: keypoints: expected str or PathLike, got Tensor",
    "next(torchhand.track(None))": "TypeError: source: expected str or PathLike or int, got NoneType",
    "fit_pose(picture, shape=torch.zeros(52))": "ValueError: shape: hand_length: expected 0.14 to 0.24 m, got 0",
    "fit_pose(picture, camera=3)": "TypeError: camera: expected Camera or str or PathLike, got int",
    "fit_hand(sys.argv[1] + '/0.png', camera=3)": "TypeError: camera: expected Camera or str or PathLike, got int",
    "fit_keypoints(kinematics, [SeenKeypoints(camera=camera, points_px=points)])": (
        "ValueError: points_px: expected shape (*frames, 21, 2), got (1, 20, 2)"
    ),
    "fit_keypoints(kinematics, points.numpy())": "TypeError: keypoints: expected SeenKeypoints, got ndarray",
    "fit_keypoints(kinematics, pose.new_zeros(2, 21, 3), shape=hand.shape.expand(2, 52))": (
        "ValueError: shape: expected that of one hand, (52,), got (2, 52)"
    ),
    "fit_keypoints(hand, points)": "TypeError: kinematics: expected HandKinematics, got Hand",
    "SeenKeypoints(camera=camera, points_px=points.numpy())": "TypeError: points_px: expected Tensor, got ndarray",
    "SeenKeypoints(camera='cam0', points_px=points)": "TypeError: camera: expected Camera, got str",
    "assumed_camera(0, 10)": "ValueError: width: expected a whole number, 1 or more, got 0",
    "assumed_camera(10, 4.5)": "ValueError: height: expected a whole number, 1 or more, got 4.5",
    "replace(camera, intrinsics=np.eye(3))": "TypeError: intrinsics: expected Tensor, got ndarray",
    "replace(camera, intrinsics=torch.eye(4))": "ValueError: intrinsics: expected shape (*batch, 3, 3), got (4, 4)",
    "replace(camera, translation=camera.translation[:2])": (
        "ValueError: translation: expected shape (*batch, 3), got (2,)"
    ),
    "Rig(['left.json', 'right.json'])": "TypeError: cameras: expected Camera, got str",
    "Tracker(hand, 'cameras.json')": "TypeError: cameras: expected Camera, got str",
    "Tracker(model, camera)": "TypeError: hand: expected Hand, got HandModel",
    "Hand(10)": "TypeError: shape: expected Tensor, got int",
    "Hand(dtype='float32')": "ValueError: dtype: expected one of floating-point numbers, got 'float32'",
    "hand(pose.numpy())": "TypeError: pose: expected Tensor, got ndarray",
    "hand([0.0] * 36)": "TypeError: pose: expected Tensor, got list",
    "prior.energy(pose.numpy())": "TypeError: pose: expected Tensor, got ndarray",
    "silhouette_loss(torch.rand(48, 64), picture[..., 0])": (
        "ValueError: mask: expected bool, or shares as floating-point numbers, got torch.uint8"
    ),
    "silhouette_loss(torch.rand(48, 64), torch.ones(48, 64), picture[..., 0])": (
        "ValueError: known: expected bool, got torch.uint8"
    ),
}


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What every call came to."""
    folder = tmp_path_factory.mktemp("pictures")
    cv2.imwrite(str(folder / "0.png"), Studio().placed().picture().numpy()[..., ::-1])
    command = [sys.executable, "-c", SETUP, str(folder)]
    done = subprocess.run(command, input=json.dumps(list(TOLD)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("call", TOLD)
def test_a_mistake_is_told_in_a_line(call: str, told: dict[str, str]) -> None:
    assert told[call] == TOLD[call]
