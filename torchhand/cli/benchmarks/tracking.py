"""Measures of `torchhand benchmark` on tracking: the filter's update, frames per second, memory."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchhand.cli.benchmarks.figures import Figure, Peer, against_peer, peer_module
from torchhand.cli.benchmarks.runs import FRAMES_PER_SECOND, memory_figure, speed_figure, there_and_back, with_bar
from torchhand.devices import HOST
from torchhand.files import load_hand_model, save_cameras, write_video
from torchhand.geometry import Camera, assumed_camera
from torchhand.numerics import Gaussian, Measurement, UnscentedSettings, sigma_points, update
from torchhand.runs import settings_of
from torchhand.simulate import SceneSettings, Staging, render_sequence, scripted_motion
from torchhand.track import FurtherPass, HandKeypoints, Tracker, TrackerState, View

STATE, OBSERVED, MEASUREMENTS = 81, 27, 800
FOV_DEG = 48.0
MEMORY_SIZE_PX, MEMORY_FRAMES, MEMORY_RENDERED = (1280, 720), 621, 40
MEMORY_MUST_MIB = 1536.0
_POINT_ERROR_M = 0.005
FILTER_ROUNDS, TRACKING_ROUNDS = 15, 5
"""Repeats unless --repeats says otherwise."""


def filter_update(name: str, repeats: int | None) -> Figure:
    """Time of both updates from the same sigma points and the same observations, which are computed before."""
    generator = torch.Generator().manual_seed(0)
    normal = partial(torch.randn, generator=generator, dtype=torch.float64)
    root = 0.1 * normal(STATE, STATE)
    state = Gaussian(normal(STATE), root @ root.mT + 0.01 * torch.eye(STATE, dtype=torch.float64))
    mixing = 0.2 * normal(MEASUREMENTS, OBSERVED)
    variance = 0.5 + torch.rand(MEASUREMENTS, generator=generator, dtype=torch.float64)

    def observe(states: Tensor) -> Tensor:
        return (states[..., :OBSERVED] @ mixing.mT).sin()

    points = sigma_points(state, UnscentedSettings()).points
    seen = observe(points)
    # The points of the first components alone: the centre, then plus and minus of each column.
    kept = torch.cat((torch.arange(OBSERVED + 1), 1 + STATE + torch.arange(OBSERVED)))
    seen_by_few = seen[kept]
    measurement = Measurement(observe(state.mean) + 0.5 * normal(MEASUREMENTS), variance)
    candidates: dict[str, Callable[[], object]] = {
        "ours": lambda: update(state, lambda _: seen, measurement),
        f"observed_{OBSERVED}": lambda: update(state, lambda _: seen_by_few, measurement, observed=OBSERVED),
    }
    library = peer_module("filterpy.kalman")
    if library is not None:
        candidates["peer"] = _filterpy_update(library, state, points, seen, measurement)
    return against_peer(name, repeats or FILTER_ROUNDS, Peer("filterpy"), candidates, must=10.0, aim=15.0)


def _filterpy_update(
    library: Any, state: Gaussian, points: Tensor, seen: Tensor, measurement: Measurement
) -> Callable[[], object]:
    calls = count()
    observations = seen.numpy()
    spread = library.MerweScaledSigmaPoints(STATE, 1.0, 2.0, 0.0)
    peer = library.UnscentedKalmanFilter(
        STATE, MEASUREMENTS, 1.0, hx=lambda _: observations[next(calls) % len(observations)], fx=None, points=spread
    )
    noise = np.diag(measurement.noise.numpy())

    def run() -> object:
        peer.x, peer.P, peer.sigmas_f = state.mean.numpy().copy(), state.covariance.numpy().copy(), points.numpy()
        peer.update(measurement.value.numpy(), R=noise)
        return peer.x

    return run


@dataclass(frozen=True, kw_only=True)
class TrackingCase:
    """What a tracker is timed on."""

    config: str
    motion: str = "free"
    size: tuple[int, int] = (640, 480)
    frames: int = 20
    has_network: bool = True
    """Whether a network tells the posture of the followed hand."""
    has_points: bool = False
    """Whether a detector's points come with the pictures."""
    passes: int = 1
    """1, or 2 with the pass from the last frame to the first."""


def simulated_views(motion: str, size: tuple[int, int], frames: int, scene: SceneSettings) -> tuple[Camera, list[View]]:
    """A camera and the views of a hand before a plain wall, with the points of a detector that errs by 5 mm."""
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    camera = replace(assumed_camera(*size, horizontal_fov_deg=FOV_DEG), is_assumed=False)
    generator = torch.Generator().manual_seed(0)
    course = scripted_motion(motion, frames, kinematics, camera, generator, staging=Staging(fps=FRAMES_PER_SECOND))
    rendered = list(with_bar(render_sequence(kinematics, course, camera, scene, generator), frames, "rendering"))
    views = []
    for frame in rendered:
        points = frame.keypoints_cam + _POINT_ERROR_M * torch.randn(21, 3, generator=generator, dtype=torch.float64)
        seen = HandKeypoints(points_px=camera.pixels_from_plane(camera.plane_from_cam(points)), points=points)
        views.append(View(image=frame.image, keypoints=seen))
    return camera, views


def tracking(
    name: str, repeats: int | None, device: torch.device = HOST, *, case: TrackingCase, must: float, aim: float
) -> Figure:
    """Frames per second of the tracker's steps alone: the pictures are there, the start is made."""
    camera, views = simulated_views(case.motion, case.size, case.frames, SceneSettings())
    views = views if case.has_points else [replace(view, keypoints=None) for view in views]
    settings = settings_of(case.config)
    settings = settings if case.has_network else replace(settings, learned_posture=False)
    tracker = Tracker(load_hand_model().to(device=device).hand(dtype=torch.float64), camera, settings)
    start, _ = tracker.step(None, views[:1], 0.0)
    spent: list[float] = []
    run = partial(_track_all, tracker, start, views[1:], case.passes, spent)
    figure = speed_figure(name, run, repeats or TRACKING_ROUNDS, must=must, aim=aim, details=asdict(case))
    cpu_ms = 1e3 * statistics.median(spent) / (len(views) - 1)
    return replace(figure, details=figure.details | {"cpu_ms_per_frame": cpu_ms})


def _track_all(
    tracker: Tracker, start: TrackerState, views: Sequence[View], passes: int, spent: list[float]
) -> list[str]:
    """Statuses of all frames; the seconds of CPU time are added to `spent`."""
    began = time.process_time()
    state, found = start, []
    for index, view in enumerate(views, 1):
        state, estimate = tracker.step(state, [view], index / FRAMES_PER_SECOND)
        found.append(estimate)
    if passes == 2:
        second = FurtherPass(tracker, state)
        for index in range(len(views), 0, -1):
            second.step(views[index - 1 : index], index / FRAMES_PER_SECOND, found[index - 1].pose)
    spent.append(time.process_time() - began)
    return [estimate.status for estimate in found]


def track_memory(name: str, repeats: int | None) -> Figure:
    """Resident memory of `torchhand track` over a long video."""
    frames, size = MEMORY_FRAMES, MEMORY_SIZE_PX
    return memory_figure(name, _long_video, must=MEMORY_MUST_MIB, frames=frames, size=size)


def _long_video(folder: Path) -> list[str]:
    """Written into a folder; the command that tracks it."""
    camera, views = simulated_views("planar", MEMORY_SIZE_PX, MEMORY_RENDERED, SceneSettings(supersampling=1))
    pictures = [view.image for view in views if view.image is not None]
    video, (width, height) = folder / "hand.mp4", MEMORY_SIZE_PX
    save_cameras([camera], folder / "cameras.json")
    with write_video(video, width=width, height=height, fps=FRAMES_PER_SECOND) as writer:
        for picture in there_and_back(pictures, MEMORY_FRAMES, "writing"):
            writer.write(picture)
    return ["track", str(video), "--config", "contour_planar", "--camera", str(folder / "cameras.json")]
