"""The hand that detected keypoints tell of, whatever was followed: one camera or several."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchhand.fit.detect import FitSettings, NoStart, start_at_pose
from torchhand.fit.keypoints import KeypointSettings
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandKinematics, HandPose
from torchhand.track.knowledge import TrackerState
from torchhand.track.proposals.protocol import Occasion, Proposals, Proposed
from torchhand.track.scene import Candidate, Scene, detected_hand
from torchhand.view import OutlineTable

_SLANT = 0.6  # radians between bones and the picture's plane up to which an outline tells their length: cos is 0.83
_FLEXIONS = [i for i, name in enumerate(DOFS) if name.endswith(("mcp_fe", "pip_fe", "dip_fe"))]


@dataclass(frozen=True, kw_only=True)
class KeypointHand:
    """A hand in the posture and place of the points."""

    kinematics: HandKinematics
    cameras: Sequence[Camera]
    """Cameras of the scene, one per view."""
    settings: KeypointSettings

    @property
    def occasion(self) -> Occasion:
        return "detected"

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """At most one hand; none of one camera before the first, which has to bring its colours."""
        if len(self.cameras) == 1 and not state.has_started:
            return Proposals()
        shape = self.kinematics.default_shape if state.shape is None else state.shape
        pose = detected_hand(scene, self.cameras, self.kinematics, self.settings, shape)
        if pose is None:
            return Proposals()
        new_shape = shape if state.shape is None else None
        return Proposals(hands=(Proposed(pose=pose, shape=new_shape),), has_foreground=True)


@dataclass(frozen=True, kw_only=True)
class KeypointStart:
    """One camera: the first hand, where the points are, with its colours, and its proportions where these are not
    known."""

    kinematics: HandKinematics
    camera: Camera
    settings: KeypointSettings
    table: OutlineTable
    fit: FitSettings
    known_shape: Float[Tensor, "shape"] | None = None

    @property
    def occasion(self) -> Occasion:
        return "degraded"

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """At most one hand; none once there was one."""
        image = scene.views[0].image
        if state.has_started or image is None:
            return Proposals()
        shape = self.kinematics.default_shape if self.known_shape is None else self.known_shape
        pose = detected_hand(scene, (self.camera,), self.kinematics, self.settings, shape)
        if pose is None:
            return Proposals()
        fit_shape = self.known_shape is None and shows_proportions(pose, self.camera)
        where = (self.kinematics, self.camera, shape, self.table)
        start = start_at_pose(image, pose, *where, fit_shape=fit_shape, settings=self.fit)
        if isinstance(start, NoStart):
            return Proposals(reason=start.reason, has_foreground=start.has_foreground)
        fitted = HandPose.of(start.fit.pose, start.fit.root_reference)
        proposed = Proposed(pose=fitted, shape=start.fit.shape, appearance=start.appearance)
        return Proposals(hands=(proposed,), has_foreground=True)


def shows_proportions(pose: HandPose, camera: Camera) -> bool:
    """Whether the outline of a hand tells its proportions: an open hand, parallel to the picture."""
    palm = float((camera.rotation.to(pose.rotation) @ pose.rotation)[2, 0].abs())
    return palm > math.cos(_SLANT) and float(pose.dofs[_FLEXIONS].max()) < _SLANT
