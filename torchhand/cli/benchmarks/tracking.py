"""Measures of `torchhand benchmark` on tracking: the filter's update, frames per second, memory."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from torchhand.cli.benchmarks.figures import Figure, against_peer, peer_module
from torchhand.cli.benchmarks.runs import FRAMES_PER_SECOND, memory_figure, speed_figure, there_and_back, with_bar
from torchhand.files import load_hand_model, save_cameras, write_video
from torchhand.geometry import Camera, assumed_camera
from torchhand.numerics import Gaussian, UnscentedSettings, sigma_points, update
from torchhand.runs import settings_of
from torchhand.simulate import SceneSettings, render_sequence, scripted_motion
from torchhand.track import Tracker, TrackerState, View

STATE, OBSERVED, MEASUREMENTS = 81, 27, 800
FOV_DEG = 48.0
MEMORY_SIZE_PX, MEMORY_FRAMES, MEMORY_RENDERED = (1280, 720), 621, 40
MEMORY_MUST_MIB = 1536.0
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
    measurement = observe(state.mean) + 0.5 * normal(MEASUREMENTS)
    candidates: dict[str, Callable[[], object]] = {
        "ours": lambda: update(state, lambda _: seen, measurement, variance),
        f"observed_{OBSERVED}": lambda: update(state, lambda _: seen_by_few, measurement, variance, observed=OBSERVED),
    }
    library = peer_module("filterpy.kalman")
    if library is not None:
        candidates["peer"] = _filterpy_update(library, state, points, seen, measurement, variance)
    return against_peer(name, repeats or FILTER_ROUNDS, "filterpy", candidates, must=10.0, aim=15.0)


def _filterpy_update(
    library: Any, state: Gaussian, points: Tensor, seen: Tensor, measurement: Tensor, variance: Tensor
) -> Callable[[], object]:
    calls = count()
    observations = seen.numpy()
    spread = library.MerweScaledSigmaPoints(STATE, 1.0, 2.0, 0.0)
    peer = library.UnscentedKalmanFilter(
        STATE, MEASUREMENTS, 1.0, hx=lambda _: observations[next(calls) % len(observations)], fx=None, points=spread
    )
    noise = np.diag(variance.numpy())

    def run() -> object:
        peer.x, peer.P, peer.sigmas_f = state.mean.numpy().copy(), state.covariance.numpy().copy(), points.numpy()
        peer.update(measurement.numpy(), R=noise)
        return peer.x

    return run


def _simulated(motion: str, size: tuple[int, int], frames: int, scene: SceneSettings) -> tuple[Camera, list[Tensor]]:
    """A camera and the pictures of a hand before a plain wall."""
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    camera = replace(assumed_camera(*size, horizontal_fov_deg=FOV_DEG), is_assumed=False)
    generator = torch.Generator().manual_seed(0)
    course = scripted_motion(motion, frames, kinematics, camera, generator, fps=FRAMES_PER_SECOND)
    rendered = render_sequence(kinematics, course, camera, scene, generator)
    return camera, [frame.image for frame in with_bar(rendered, frames, "rendering")]


def tracking(
    name: str,
    repeats: int | None,
    *,
    config: str,
    motion: str,
    size: tuple[int, int],
    frames: int,
    must: float,
    aim: float,
) -> Figure:
    """Frames per second of the tracker's steps alone: the pictures are there, the start is made."""
    camera, pictures = _simulated(motion, size, frames, SceneSettings())
    tracker = Tracker(load_hand_model().hand(dtype=torch.float64), camera, settings_of(config))
    start, _ = tracker.step(None, [View(image=pictures[0])], 0.0)
    return speed_figure(
        name,
        partial(_track_all, tracker, start, pictures[1:]),
        repeats or TRACKING_ROUNDS,
        must=must,
        aim=aim,
        details={"config": config, "motion": motion},
    )


def _track_all(tracker: Tracker, start: TrackerState, pictures: Sequence[UInt8[Tensor, "height width 3"]]) -> list[str]:
    state, statuses = start, []
    for index, picture in enumerate(pictures, 1):
        state, estimate = tracker.step(state, [View(image=picture)], index / FRAMES_PER_SECOND)
        statuses.append(estimate.status)
    return statuses


def track_memory(name: str, repeats: int | None) -> Figure:
    """Resident memory of `torchhand track` over a long video."""
    frames, size = MEMORY_FRAMES, MEMORY_SIZE_PX
    return memory_figure(name, _long_video, must=MEMORY_MUST_MIB, frames=frames, size=size)


def _long_video(folder: Path) -> list[str]:
    """Written into a folder; the command that tracks it."""
    camera, pictures = _simulated("planar", MEMORY_SIZE_PX, MEMORY_RENDERED, SceneSettings(supersampling=1))
    video, (width, height) = folder / "hand.mp4", MEMORY_SIZE_PX
    save_cameras([camera], folder / "cameras.json")
    with write_video(video, width=width, height=height, fps=FRAMES_PER_SECOND) as writer:
        for picture in there_and_back(pictures, MEMORY_FRAMES, "writing"):
            writer.write(picture)
    return ["track", str(video), "--config", "contour_planar", "--camera", str(folder / "cameras.json")]
