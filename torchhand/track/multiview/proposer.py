"""Hands that the views of one time are read to show: by the keypoints of all views, and by a network view by view."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from jaxtyping import Float
from torch import Tensor

from torchhand.files import load_proposal_network
from torchhand.fit.keypoints import KeypointSettings
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, HandPose
from torchhand.propose import Silhouette, propose_hands
from torchhand.track.scene import Scene, detected_hand


@dataclass(frozen=True, kw_only=True)
class HandProposer:
    """Proposes hands in the world of several cameras, for the silhouettes of all to choose from and to correct."""

    kinematics: HandKinematics
    cameras: Sequence[Camera]
    """As they see the scene's silhouettes."""
    keypoints: KeypointSettings = field(default_factory=KeypointSettings)
    has_network: bool = True
    """Whether the network is asked, which knows pinhole cameras only."""

    def __call__(self, scene: Scene, shape: Float[Tensor, "shape"]) -> HandPose | None:
        """Hands (n,) with zero rotation vectors, the one of the keypoints first; None where nothing is seen."""
        found = [] if not self.has_network else self._learned(scene, shape)
        detected = self.detected(scene, shape)
        if detected is not None:
            found.insert(0, detected)
        return HandPose.cat(found) if found else None

    def detected(self, scene: Scene, shape: Float[Tensor, "shape"]) -> HandPose | None:
        """The hand (1,) of the keypoints of all views alone; None where these tell of none."""
        found = detected_hand(scene, self.cameras, self.kinematics, self.keypoints, shape)
        return None if found is None else HandPose.stack([found])

    def _learned(self, scene: Scene, shape: Tensor) -> list[HandPose]:
        """The network's hypotheses for each view: what one view tells badly, such as its depth, another tells well."""
        views = zip(self.cameras, scene.masks, scene.views, strict=True)
        seen = [
            # A picture is as its camera took it, and fits the silhouette without distortion only where there is none.
            Silhouette(mask=mask, camera=camera, image=None if camera.has_distortion else view.image)
            for camera, mask, view in views
            if mask is not None and camera.kind == "pinhole" and bool(mask.any())
        ]
        if not seen:
            return []
        hands = propose_hands(load_proposal_network(device=shape.device), seen, self.kinematics, shape)
        return [hands.pose.reshape(-1)]
