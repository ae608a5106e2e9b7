"""What a tracker knows between two frames, what it says of one, and both as plain tensors on disk."""

from dataclasses import dataclass
from typing import Any

from jaxtyping import Float
from torch import Tensor

from torchhand.files import FrameStatus
from torchhand.image import ColourModel
from torchhand.numerics import Gaussian
from torchhand.track.appearance import Appearance


@dataclass(frozen=True, kw_only=True)
class TrackerState:
    """Everything the tracker knows between two frames while it follows a hand."""

    belief: Gaussian
    """Over [free, free', free'']: changes from `base`, the root's rotation a left perturbation of `reference`."""
    base: Float[Tensor, "36"]
    """Pose of the start; metres and radians, camera frame."""
    reference: Float[Tensor, "3 3"]
    """cam_from_hand of the last estimate."""
    start_reference: Float[Tensor, "3 3"]
    """cam_from_hand of the start."""
    failures: int = 0
    """Frames in a row that failed the tests."""
    density: Float[Tensor, "free"] | None = None
    """Of the process noise, as learned so far; None where a tracker does not learn it."""
    turn: int = 0
    """Frames followed: whose turn it is where hypotheses take turns."""


@dataclass(frozen=True, kw_only=True)
class Memory:
    """What outlasts a loss."""

    shape: Float[Tensor, "shape"] | None = None
    """The fitted proportions."""
    appearance: Appearance | None = None
    """Colours learned at the start, and since then."""
    posture: Float[Tensor, "36"] | None = None
    """The posture of the start as it was fitted, which a restart looks for."""
    overlap: float = 1.0
    """Overlap of the last start, against which a track is measured."""
    frames_since_search: int = 0
    """Frames since a doubtful track was last compared with a fresh search."""
    frames_since_lesson: int = 0
    """Good frames since the colours were last learned."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """One frame's result. Where status is lost or no_hand everything but the reason is None."""

    status: FrameStatus
    pose: Float[Tensor, "36"] | None = None
    """Full pose in the camera frame with the root's rotation vector; metres and radians."""
    pose_std: Float[Tensor, "36"] | None = None
    """Standard deviations of the filter, 0 for DOFs that are held; those of the root's rotation are of a small turn in
    the camera's axes."""
    root_rotation: Float[Tensor, "3 3"] | None = None
    """cam_from_hand"""
    keypoints: Float[Tensor, "21 3"] | None = None
    """Metres, camera frame."""
    keypoints_px: Float[Tensor, "21 2"] | None = None
    keypoints_cov: Float[Tensor, "21 3 3"] | None = None
    """Square metres, camera frame: the filter's covariance and what the filter cannot know."""
    overlap: float | None = None
    """Intersection over union with the picture's silhouette, forearm cut at the wrist."""
    unexplained: float | None = None
    """Area of the picture's hand outside the model, in pieces as thick as a finger, in squares of the hand's length."""
    found: float | None = None
    """Share of the outer contour with an accepted edge."""
    nis: float | None = None
    """Normalised innovation squared per accepted measurement; None on the picture of a start."""
    reason: str = ""
    """Why a frame is lost or without a hand."""


_COUNTERS = ("overlap", "frames_since_search", "frames_since_lesson")


def saved_state(state: TrackerState | None, memory: Memory) -> dict[str, Any]:
    """Plain tensors and numbers (torch.save, weights_only) from which `restored_state` goes on exactly."""
    saved: dict[str, Any] = {"shape": memory.shape, "posture": memory.posture}
    saved |= {name: getattr(memory, name) for name in _COUNTERS}
    saved["colours"] = None if memory.appearance is None else memory.appearance.colours.log_ratio
    if state is not None:
        saved |= {"mean": state.belief.mean, "covariance": state.belief.covariance, "base": state.base}
        saved |= {"reference": state.reference, "start_reference": state.start_reference, "failures": state.failures}
        saved["turn"] = state.turn
        saved |= {} if state.density is None else {"density": state.density}
    return saved


def restored_state(saved: dict[str, Any]) -> tuple[TrackerState | None, Memory]:
    """The inverse of `saved_state`. Raises KeyError for a dictionary that lacks something."""
    colours = saved["colours"]
    memory = Memory(
        shape=saved["shape"],
        posture=saved["posture"],
        appearance=None if colours is None else Appearance(colours=ColourModel(log_ratio=colours)),
        **{name: saved[name] for name in _COUNTERS},
    )
    if "mean" not in saved:
        return None, memory
    state = TrackerState(
        belief=Gaussian(saved["mean"], saved["covariance"]),
        base=saved["base"],
        reference=saved["reference"],
        start_reference=saved["start_reference"],
        failures=saved["failures"],
        density=saved.get("density"),
        turn=saved["turn"],
    )
    return state, memory
