"""Large photographs at a size that bounds memory and time; results in the pixels of the photograph."""

from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.image import WORKING_PIXELS
from torchhand.track import View
from torchhand.track.scene import WorkingViews
from torchhand.track.single import SinglePose, SinglePoseFitter


@dataclass(frozen=True, kw_only=True)
class BoundedView:
    """A picture and its camera as they are worked on."""

    view: View
    camera: Camera
    working: WorkingViews | None = None
    """What made the view from the picture; None where it is the picture."""

    @classmethod
    def of(cls, view: View, camera: Camera) -> "BoundedView":
        """The view itself where it is small enough."""
        if view.image is None or tuple(view.image.shape[:2]) != (camera.height, camera.width):
            return cls(view=view, camera=camera)
        working = WorkingViews((camera,), WORKING_PIXELS)
        (used,) = working.cameras
        return cls(view=working.of(view, 0, used), camera=used, working=working)

    def fitted(self, fitter: SinglePoseFitter, shape: Float[Tensor, "shape"] | None) -> SinglePose:
        """The hand; its keypoints in the pixels of the whole picture."""
        found = fitter(self.view, self.camera, shape=shape)
        points = found.estimate.keypoints_px
        if points is None or self.working is None:
            return found
        whole = self.working.whole_px(points, 0)
        return replace(found, estimate=replace(found.estimate, keypoints_px=whole))
