"""Measures of `torchhand benchmark` on pictures: soft silhouettes with gradients, and labelled crops by the second."""

import tempfile
import time
from pathlib import Path

import torch

from torchhand.cli.benchmarks.figures import Figure, peer_module
from torchhand.evaluate import time_interleaved
from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera
from torchhand.simulate.crops import CropSettings, Shard, write_shard
from torchhand.view import SoftRenderer

HANDS, PICTURE_PX, FIELD_OF_VIEW_DEG, DISTANCE = 64, 128, 25.0, 0.6
ROUNDS, CROPS = 9, 960


def soft_silhouettes(name: str, repeats: int | None) -> Figure:
    """Milliseconds per picture, forward and backward from pixels to poses: skinned meshes, postures of the prior turned
    any way."""
    model = load_hand_model()
    hand, generator = model.hand(), torch.Generator().manual_seed(0)
    poses, _ = model.prior().sample(HANDS, generator)
    poses[:, 3:6] = 1.5 * torch.randn(HANDS, 3, generator=generator)
    poses[:, :3] = torch.tensor((0.0, 0.0, DISTANCE)) - hand(poses).keypoints.mean(1)
    camera = assumed_camera(PICTURE_PX, PICTURE_PX, horizontal_fov_deg=FIELD_OF_VIEW_DEG, dtype=torch.float32)
    renderer = SoftRenderer(hand.faces)

    def silhouettes() -> None:
        leaf = poses.clone().requires_grad_()
        renderer.silhouette(hand(leaf).vertices, camera).square().sum().backward()

    def depths() -> None:
        leaf = poses.clone().requires_grad_()
        picture = renderer.picture(hand(leaf).vertices, camera)
        (picture.coverage + picture.depth).sum().backward()

    rounds = repeats or ROUNDS
    times = time_interleaved({"silhouettes": silhouettes, "depths": depths}, rounds, warm_up=2)
    value = times["silhouettes"].median / HANDS
    details = {
        "fastest_ms": times["silhouettes"].fastest / HANDS,
        "with_depth_ms": times["depths"].median / HANDS,
        "with_depth_fastest_ms": times["depths"].fastest / HANDS,
    }
    note = f"batch {HANDS}, {PICTURE_PX} px; with depth {details['with_depth_ms']:.1f} ms"
    return Figure(name=name, value=value, unit="ms", must=25.0, aim=8.0, repeats=rounds, note=note, details=details)


def crops(name: str, repeats: int | None) -> Figure:
    """CPU milliseconds for a labelled crop in a shard; two cores are to make a thousand of them a second."""
    cpu_ms, wall_ms = [], []
    with tempfile.TemporaryDirectory() as folder:
        settings = CropSettings()
        for index in range((repeats or ROUNDS) + 1):
            shard = Shard(folder=Path(folder), index=index, crops=CROPS, seed=0, settings=settings)
            cpu, wall = time.process_time(), time.perf_counter()
            write_shard(shard)
            cpu_ms.append(1e3 * (time.process_time() - cpu) / CROPS)
            wall_ms.append(1e3 * (time.perf_counter() - wall) / CROPS)
            shard.path.unlink()
    del cpu_ms[0], wall_ms[0]  # with what every process does once
    value = sorted(cpu_ms)[len(cpu_ms) // 2]
    details = {"fastest_ms": min(cpu_ms), "wall_ms": sorted(wall_ms)[len(wall_ms) // 2]}
    how = f"numba {peer.__version__}" if (peer := peer_module("numba")) else "without numba"
    note = f"{settings.side_px} px, written; CPU time, {how}; two such cores {2e3 / value:.0f} crops/s"
    return Figure(name=name, value=value, unit="ms", must=2.0, repeats=len(cpu_ms), note=note, details=details)
