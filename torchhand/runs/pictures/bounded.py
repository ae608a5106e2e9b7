"""Large photographs at a size that bounds memory and time; results in the pixels of the photograph."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.image import PicturePart
from torchhand.track import View
from torchhand.track.single import SinglePose, SinglePoseFitter

_MAX_PIXELS = 2_000_000  # full HD; an outline says no more of a hand in a larger picture


@dataclass(frozen=True, kw_only=True)
class BoundedView:
    """A picture and its camera as they are worked on."""

    view: View
    camera: Camera
    part: PicturePart

    @classmethod
    def of(cls, view: View, camera: Camera) -> "BoundedView":
        """The view itself where it is small enough."""
        part = PicturePart.of((0, 0), (camera.width, camera.height), _MAX_PIXELS)
        if part.size == part.part or view.image is None or tuple(view.image.shape[1::-1]) != part.part:
            return cls(view=view, camera=camera, part=part)
        keypoints = view.keypoints
        if keypoints is not None:
            scale = keypoints.points_px.new_tensor([part.size[axis] / part.part[axis] for axis in range(2)])
            keypoints = replace(keypoints, points_px=(keypoints.points_px + 0.5) * scale - 0.5)
        mask = None if view.mask is None else part.mask(view.mask)
        small = View(image=part.image(view.image), mask=mask, keypoints=keypoints)
        return cls(view=small, camera=camera.of_part(part.corner, part.part, part.size), part=part)

    def fitted(self, fitter: SinglePoseFitter, shape: Float[Tensor, "shape"] | None) -> SinglePose:
        """The hand; its keypoints in the pixels of the whole picture."""
        found = fitter(self.view, self.camera, shape=shape)
        points = found.estimate.keypoints_px
        if points is None or self.camera.width == self.part.part[0]:
            return found
        whole = torch.from_numpy(self.part.whole_px(points.cpu().numpy())).to(points)
        return replace(found, estimate=replace(found.estimate, keypoints_px=whole))
