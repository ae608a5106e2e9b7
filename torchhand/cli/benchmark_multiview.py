"""Measures of `torchhand benchmark` on tracking by several cameras: frames per second, memory."""

import sys
import tempfile
from dataclasses import dataclass
from functools import partial
from itertools import count, islice
from pathlib import Path

import torch
from torch import Tensor

from torchhand.cli.benchmark_tracking import FRAMES_PER_SECOND, lines_of, own_environment, with_bar
from torchhand.files import load_hand_model, load_settings, load_track, save_cameras, save_hand, write_video
from torchhand.files.locations import find_config
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import Hand
from torchhand.simulate import named_rig, scripted_motion, stage_camera
from torchhand.study.figures import Figure
from torchhand.study.timing import PROC, time_interleaved, watch_memory
from torchhand.track.multiview import MultiViewMemory, MultiViewSettings, MultiViewTracker, ViewSilhouettes
from torchhand.track.multiview.fitting import Anchor
from torchhand.view import mesh_silhouette

RIG, SIZE_PX, MOTION = "frame4", (640, 480), "free"
FRAMES, ROUNDS = 24, 5
MEMORY_FRAMES, MEMORY_RENDERED, MEMORY_SKIP = 1000, 24, 100
MEMORY_MUST_MIB = 2048.0
_SKIN, _SCREEN = (205, 150, 125), (40, 70, 150)  # RGB
_NOISE = 6  # 8-bit levels


@dataclass(frozen=True, kw_only=True)
class _Recording:
    """A hand that moves before a coloured screen, as the cameras of a rig see it."""

    hand: Hand
    cameras: list[Camera]
    moments: list[list[Tensor]]
    """Pictures of all views."""
    start: Anchor


def _simulated(frames: int) -> _Recording:
    hand = load_hand_model().hand(side="right", dtype=torch.float64)
    cameras, generator = named_rig(RIG, size=SIZE_PX), torch.Generator().manual_seed(0)
    stage = stage_camera(cameras, float(hand.kinematics.shape_space.metric(hand.shape)["hand_length"]))
    course = scripted_motion(MOTION, frames, hand.kinematics, stage, generator, fps=FRAMES_PER_SECOND)
    screen, skin = torch.tensor(_SCREEN), torch.tensor(_SKIN)
    noise = torch.randint(-_NOISE, _NOISE + 1, (SIZE_PX[1], SIZE_PX[0], 3), generator=generator)
    moments = []
    for pose in with_bar(course.poses, frames, "rendering"):
        vertices = hand(pose.double(), root_reference=course.root_reference.double()).vertices
        masks = [mesh_silhouette(vertices, hand.faces, camera) for camera in cameras]
        moments.append([(torch.where(mask[..., None], skin, screen) + noise).to(torch.uint8) for mask in masks])
    first = course.poses[0].double().clone()
    reference = rotation_from_vector(first[3:6]) @ course.root_reference.double()
    first[3:6] = 0.0
    start = Anchor(pose=first, root_reference=reference)
    return _Recording(hand=hand, cameras=cameras, moments=moments, start=start)


def track_views(name: str, repeats: int | None, *, must: float, aim: float) -> Figure:
    """Frames per second from pictures to pose: silhouettes, octree, fit and judgement; the start is made."""
    recording = _simulated(FRAMES)
    settings = load_settings(MultiViewSettings(), find_config("hull_lm"))
    silhouettes = ViewSilhouettes(recording.cameras, settings.silhouette)
    tracker = MultiViewTracker(recording.hand, silhouettes.cameras, FRAMES_PER_SECOND, settings)
    with torch.inference_mode():
        skins = silhouettes.learn(recording.moments[0], [None] * len(recording.cameras))
        memory = MultiViewMemory(shape=recording.hand.shape)
        masks = silhouettes(recording.moments[0], skins)
        start, memory, _ = tracker.step(None, memory, masks, {0: recording.start}, 0)

        def run() -> list[str]:
            state, own, statuses = start, memory, []
            for images in recording.moments[1:]:
                state, own, estimate = tracker.step(state, own, silhouettes(images, skins))
                statuses.append(estimate.status)
            return statuses

        statuses = run()
        repeats = repeats or ROUNDS
        [timing] = time_interleaved({"ours": run}, repeats, warm_up=0).values()
    per_frame = timing.median / len(statuses)
    tracked = statuses.count("tracked")
    return Figure(
        name=name,
        value=1e3 / per_frame,
        unit="frames/s",
        must=must,
        aim=aim,
        ours_ms=per_frame,
        repeats=repeats,
        note="" if tracked == len(statuses) else f"only {tracked} of {len(statuses)} frames were tracked",
        details={"rig": RIG, "motion": MOTION, "frames": len(statuses), "tracked": tracked}
        | {"ours_fastest_ms": timing.fastest / len(statuses)},
    )


def track_views_memory(name: str, repeats: int | None) -> Figure:
    """Resident memory of `torchhand track_multiview` over a long recording; nothing may grow with its length."""
    if not PROC.is_dir():
        note = f"resident memory is read from {PROC}, which this system does not have"
        return Figure(name=name, value=None, unit="MiB", must=MEMORY_MUST_MIB, repeats=0, note=note)
    recording = _simulated(MEMORY_RENDERED)
    there_and_back = recording.moments + recording.moments[-2:0:-1]
    with tempfile.TemporaryDirectory() as name_of_folder:
        folder = Path(name_of_folder)
        out, rig, space = folder / "out", folder / "rig", recording.hand.kinematics.shape_space
        rig.mkdir()
        save_cameras(recording.cameras, rig / "cameras.json")
        save_hand(folder / "hand.json", space.names, recording.hand.shape.tolist(), "right", {}, units=space.units)
        for view, camera in enumerate(recording.cameras):
            with write_video(
                rig / f"{camera.name}.mp4", width=camera.width, height=camera.height, fps=FRAMES_PER_SECOND
            ) as writer:
                repeated = islice((moment[view] for _ in count() for moment in there_and_back), MEMORY_FRAMES)
                for picture in with_bar(repeated, MEMORY_FRAMES, f"writing view {view}"):
                    writer.write(picture)
        del recording, there_and_back
        call = [sys.executable, "-m", "torchhand.cli", "track_multiview", str(rig), "--out", str(out), "--no-overlay"]
        call += ["--hand", str(folder / "hand.json"), "--set", "shape_frames=1"]
        call += ["--threads", str(torch.get_num_threads())]
        with with_bar(None, MEMORY_FRAMES, "tracking") as bar:
            used = watch_memory(
                call,
                partial(lines_of, out),
                skip=MEMORY_SKIP,
                environment=own_environment(),
                progress=lambda frames: bar.update(frames - bar.n),
            )
        tracked = int((load_track(out).status == "tracked").sum())
    growth = "unknown" if used.growth is None else f"{used.growth:+.2f} MiB per 100 frames"
    return Figure(
        name=name,
        value=used.peak,
        unit="MiB",
        must=MEMORY_MUST_MIB,
        repeats=1,
        note=f"growth from frame {MEMORY_SKIP} on: {growth}",
        details={
            "growth_mib_per_100_frames": used.growth,
            "frames": used.frames,
            "tracked": tracked,
            "picture": list(SIZE_PX),
        },
    )
