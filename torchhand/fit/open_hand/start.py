"""First pose of an open hand (Ouhaddi and Horain 1998, section 7.1)."""

import math

import torch

from torchhand.fit.detect import facing_rotation, turned_in_picture
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, HandPose, posture
from torchhand.image import HandRegions


def placed_open_hand(regions: HandRegions, kinematics: HandKinematics, camera: Camera, facing: str) -> HandPose:
    """The open posture at the measured wrist, angle and size, square to the camera."""
    pose = posture("open", dtype=torch.float64).to(kinematics.default_shape.device)
    space = kinematics.shape_space
    length = float(space.default[space.names.index("hand_length")])
    focal_px = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
    is_pinhole = camera.kind == "pinhole"
    depth = focal_px * length / regions.hand_length if is_pinhole else 1.0
    plane = camera.plane_from_pixels(pose.new_tensor(regions.wrist))
    pose[:2], pose[2], pose[3:6] = plane * (depth if is_pinhole else 1.0), depth, 0.0
    angle = math.atan2(float(regions.axis[0]), -float(regions.axis[1]))
    return HandPose.of(pose, turned_in_picture(facing_rotation(facing), angle).to(pose.device))
