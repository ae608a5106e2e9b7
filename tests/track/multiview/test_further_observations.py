"""An observation that the tracker has never heard of, under every update rule and before any number of cameras."""

import pytest
import torch
from torch import Tensor

from tests.fingertip import TIP, FingertipRay
from tests.steps import FRAME_S
from torchhand.hand import HandPose, PoseJacobian
from torchhand.runs import settings_of
from torchhand.track import Tracker, TrackerState, View
from torchhand.track.scene import Scene

OFF_M = 0.008  # of the observed fingertip from the true one, away from the first camera


@pytest.mark.parametrize(
    ("config", "cameras"),
    [("contour_full", 1), ("contour_full", 4), ("distance_full", 1), ("distance_full", 4), ("hull_lm", 4)],
)
def test_a_fingertip_on_a_ray_from_aside(config: str, cameras: int, rig_hand, rig, pose_at, masks_of) -> None:
    """The tip is said to be 8 mm deeper than it is, which the first camera hardly sees. With that observation it comes
    nearer to the ray than a quarter of the way that it keeps without; before several cameras the silhouettes object."""
    pose, reference = pose_at("open")
    masks = masks_of((pose, reference))[:cameras]
    seen_from = -rig[1].rotation.T @ rig[1].translation
    world = torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    if cameras == 1:  # whose own frame is the world
        world = rig[0].rotation, rig[0].translation
    at = HandPose(dofs=pose.clone(), reference=world[0] @ reference)
    at.dofs[:3] = world[0] @ pose[:3] + world[1]
    kinematics = rig_hand.kinematics
    tip = kinematics(at.dofs, root_reference=at.reference).keypoints[TIP]
    deeper = tip + world[0] @ (OFF_M * rig[0].rotation[2])
    origin = world[0] @ seen_from + world[1]
    ray = FingertipRay(
        origin=origin,
        direction=torch.nn.functional.normalize(deeper - origin, dim=0),
        kinematics=kinematics,
        jacobian=PoseJacobian(kinematics),
        std_m=0.0003,
    )
    asked: list[float] = []

    def observations(scene: Scene) -> tuple[FingertipRay, ...]:
        asked.append(scene.time_s)
        return (ray,)

    def distance(**further) -> float:
        """Of the fingertip from the ray after two frames, metres."""
        tracker = Tracker(rig_hand, rig[:cameras], settings_of(config), shape=kinematics.default_shape, **further)
        state = TrackerState(shape=kinematics.default_shape, hand=tracker.parts.motion.started(at), has_started=True)
        places: list[Tensor] = []
        for frame in range(2):
            state, estimate = tracker.step(state, [View(mask=mask) for mask in masks], frame * FRAME_S)
            assert estimate.status == "tracked"
            assert estimate.keypoints is not None
            places.append(estimate.keypoints[TIP])
        apart = places[-1] - ray.origin
        return float((apart - (apart @ ray.direction) * ray.direction).norm())

    without, told = distance(), distance(observations=observations)
    assert without > 0.006
    assert told < 0.25 * without
    assert asked == [0.0, FRAME_S]
