"""Measures of `torchhand benchmark` on hulls: carving an octree and making its distance field."""

import torch
from torch import Tensor

from torchhand.cli.benchmarks.figures import Figure
from torchhand.evaluate import time_interleaved
from torchhand.files import load_hand_model
from torchhand.geometry import Camera
from torchhand.hand import posed_mesh, posture
from torchhand.view import silhouette
from torchhand.volume import Carver, CarvingSettings, RootCube, hull_field

SIZE_PX, FOCAL_PX, DISTANCE = (640, 480), 520.0, 0.4
ROOT = RootCube(centre=(0.0, 0.0, 0.0), side=0.512)
POSTURES = ("open", "fist", "point", "pinch")
ROUNDS = 15
"""Repeats unless --repeats says otherwise."""


def octree(name: str, repeats: int | None, *, level: int, must: float, aim: float) -> Figure:
    """Milliseconds to carve a hull from four masks, the tables of the masks included; the slowest of some postures."""
    cameras = frame_cameras()
    carver = Carver(cameras, ROOT, CarvingSettings(level=level))
    postures = {posture_name: _masks(posture_name, cameras) for posture_name in POSTURES}
    calls = {posture_name: lambda masks=masks: carver.carve(masks) for posture_name, masks in postures.items()}
    repeats = repeats or ROUNDS
    times = time_interleaved(calls, repeats, warm_up=2)
    slowest = max(times, key=lambda posture_name: times[posture_name].median)
    found = carver.carve(postures[slowest])
    field = time_interleaved({"field": lambda: hull_field(found, surface="middle")}, 3)["field"].median
    details = {f"{posture_name}_ms": timing.median for posture_name, timing in times.items()}
    details |= {f"{posture_name}_fastest_ms": timing.fastest for posture_name, timing in times.items()}
    details |= {"slowest": slowest, "octants": sum(len(one.states) for one in found.levels), "field_ms": field}
    whole = ((0, 0, 0), (2**level,) * 3)
    dense = carver.dense(postures[slowest])
    is_same = torch.equal(found.occupancy_in(*whole), (dense == 1) | (dense == 2))
    return Figure(
        name=name,
        value=times[slowest].median,
        unit="ms",
        must=must,
        aim=aim,
        ours_ms=times[slowest].median,
        repeats=repeats,
        note="" if is_same else "the hull is not that of dense carving",
        details=details | {"equals_dense": is_same},
    )


def frame_cameras() -> list[Camera]:
    """Four cameras of a frame of 60 cm, as in Ueda et al. (2003): front, side, top, top at 45 degrees."""
    half = 0.5**0.5
    turns = {
        "front": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        "side": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)),
        "top": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
        "top45": ((1.0, 0.0, 0.0), (0.0, half, -half), (0.0, half, half)),
    }
    width, height = SIZE_PX
    intrinsics = ((FOCAL_PX, 0.0, (width - 1) / 2), (0.0, FOCAL_PX, (height - 1) / 2), (0.0, 0.0, 1.0))
    return [
        Camera(
            intrinsics=torch.tensor(intrinsics, dtype=torch.float64),
            rotation=torch.tensor(rotation, dtype=torch.float64),
            translation=torch.tensor((0.0, 0.0, DISTANCE), dtype=torch.float64),
            distortion=torch.zeros(0, dtype=torch.float64),
            width=width,
            height=height,
            name=name,
        )
        for name, rotation in turns.items()
    ]


def _masks(name: str, cameras: list[Camera]) -> list[Tensor]:
    """Silhouettes of the hand in a posture, its joints around the middle of the frame."""
    hand = load_hand_model().hand(dtype=torch.float64)
    state = hand(posture(name, dtype=torch.float64))
    identity = torch.eye(3, dtype=torch.float64)
    surface = posed_mesh(hand, state).moved(identity, -state.keypoints.mean(0))
    return [silhouette(surface, camera) for camera in cameras]
