"""Table 1 of Ueda et al. 2003: how long each stage of a frame takes."""

from collections.abc import Callable, Sequence
from functools import partial

from jaxtyping import UInt8
from torch import Tensor

from torchhand.evaluate import time_interleaved
from torchhand.fit.hull import TRACKING, HullFitter, HullTorqueSettings, fit_by_torques, target_of, with_rays
from torchhand.image import SilhouetteSettings, segment
from torchhand.study.ueda.bent import BentFinger
from torchhand.volume import Carver, CarvingSettings, hull_field

STAGES = ("silhouettes", "octree", "field", "fit by torques", "fit by LM")
"""The last two are alternatives: either makes a frame whole."""
PAPER_MS = {"silhouettes": 130.0, "octree": 70.0, "fit by torques": 300.0}
"""What Ueda et al. (2003) print for four cameras and level 7 on two Pentium III of 1 GHz: image capture, construction
of the voxel model, pose estimation."""


def stage_times(
    case: BentFinger, pictures: Sequence[UInt8[Tensor, "_height _width 3"]], level: int, repeats: int
) -> dict[str, float]:
    """Median milliseconds of each stage, one thread, the repeats of all stages interleaved.

    pictures: of the case's cameras, before a screen of the default key's colour.
    """
    carver = Carver(case.cameras, case.root, CarvingSettings(level=level, min_views=len(case.cameras)))
    octree = carver.carve(case.masks)
    field = hull_field(octree, surface="middle")
    target = with_rays(target_of(field), case.cameras, case.masks)
    fitter = HullFitter(hand=case.hand, space=case.space, shape=case.shape, schedule=TRACKING)
    screen = SilhouetteSettings(method="chroma")
    skin, start = fitter.vertices.skin, case.start.reshape(1)
    torques = HullTorqueSettings(outside_fraction=0.0)
    stages: dict[str, Callable[[], object]] = {
        "silhouettes": lambda: [segment(picture, screen) for picture in pictures],
        "octree": partial(carver.carve, case.masks),
        "field": lambda: with_rays(target_of(hull_field(octree, surface="middle")), case.cameras, case.masks),
        "fit by torques": lambda: fit_by_torques(field, skin, case.space, start, torques),
        "fit by LM": lambda: fitter(target, start),
    }
    return {name: timing.median for name, timing in time_interleaved(stages, repeats).items()}
