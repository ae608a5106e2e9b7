"""Measures of `torchhand benchmark` on tracking by several cameras: frames per second, memory."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from torchhand.cli.benchmarks.figures import Figure
from torchhand.cli.benchmarks.runs import FRAMES_PER_SECOND, memory_figure, speed_figure, there_and_back, with_bar
from torchhand.files import load_hand_model, save_cameras, save_hand, write_video
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import Hand, HandPose
from torchhand.runs import settings_of
from torchhand.simulate import Staging, named_rig, scripted_motion, stage_camera
from torchhand.track import Keyframe, ScenesAhead, Tracker, TrackerState, View, scenes_ahead
from torchhand.view import mesh_silhouette

RIG, SIZE_PX, MOTION = "frame4", (640, 480), "free"
FRAMES, ROUNDS = 24, 5
MEMORY_FRAMES, MEMORY_RENDERED = 1000, 24
MEMORY_MUST_MIB = 2048.0
_SKIN, _SCREEN = (205, 150, 125), (40, 70, 150)  # RGB
_NOISE = 6  # 8-bit levels


@dataclass(frozen=True, kw_only=True)
class _Recording:
    """A hand that moves before a coloured screen, as the cameras of a rig see it."""

    hand: Hand
    cameras: list[Camera]
    frames: list[list[Tensor]]
    """Pictures of all views, frame by frame."""
    start: HandPose


def _simulated(frames: int) -> _Recording:
    hand = load_hand_model().hand(side="right", dtype=torch.float64)
    cameras, generator = named_rig(RIG, size=SIZE_PX), torch.Generator().manual_seed(0)
    stage = stage_camera(cameras, float(hand.kinematics.shape_space.metric(hand.shape)["hand_length"]))
    course = scripted_motion(MOTION, frames, hand.kinematics, stage, generator, staging=Staging(fps=FRAMES_PER_SECOND))
    screen, skin = torch.tensor(_SCREEN), torch.tensor(_SKIN)
    noise = torch.randint(-_NOISE, _NOISE + 1, (SIZE_PX[1], SIZE_PX[0], 3), generator=generator)
    seen = []
    for pose in with_bar(course.poses, frames, "rendering"):
        vertices = hand(pose.double(), root_reference=course.root_reference.double()).vertices
        masks = [mesh_silhouette(vertices, hand.faces, camera) for camera in cameras]
        seen.append([(torch.where(mask[..., None], skin, screen) + noise).to(torch.uint8) for mask in masks])
    first = course.poses[0].double().clone()
    reference = rotation_from_vector(first[3:6]) @ course.root_reference.double()
    first[3:6] = 0.0
    start = HandPose(dofs=first, reference=reference)
    return _Recording(hand=hand, cameras=cameras, frames=seen, start=start)


def track_views(name: str, repeats: int | None, *, must: float, aim: float) -> Figure:
    """Frames per second from pictures to pose: silhouettes, octree, fit and judgement; the start is made. As in a
    recording, another process makes the next frame's silhouettes and octree and judges the last one's fingers, where
    there is a second core."""
    recording = _simulated(FRAMES)
    shape = recording.hand.shape
    make = partial(Tracker, recording.hand, recording.cameras, settings_of("hull_lm"), shape=shape)
    tracker = make()
    frames = [
        ([View(image=image) for image in images], index / FRAMES_PER_SECOND)
        for index, images in enumerate(recording.frames)
    ]
    known = TrackerState(shape=shape, keyframes=(Keyframe(time_s=0.0, pose=recording.start),))
    start, _ = tracker.step(known, *frames[0])

    def run(ahead: ScenesAhead | None) -> list[str]:
        state, statuses, all_whole = start, [], []
        if ahead is None:
            for frame in frames[1:]:
                state, estimate = tracker.step(state, *frame)
                statuses.append(estimate.status)
            return statuses
        for frame, following in zip(frames[1:], (*frames[2:], None), strict=True):
            state, _, whole = ahead.step(state, *frame, following)
            all_whole.append(whole)
        return [whole().status for whole in all_whole]

    with scenes_ahead(make, tracker) as ahead:
        if ahead is not None:
            ahead.wait()
        details = {"rig": RIG, "motion": MOTION, "processes": 1 if ahead is None else 2}
        return speed_figure(name, partial(run, ahead), repeats or ROUNDS, must=must, aim=aim, details=details)


def track_views_memory(name: str, repeats: int | None) -> Figure:
    """Resident memory of `torchhand track_multiview` over a long recording."""
    return memory_figure(name, _long_recording, must=MEMORY_MUST_MIB, frames=MEMORY_FRAMES, size=SIZE_PX)


def _long_recording(folder: Path) -> list[str]:
    """Written into a folder; the command that tracks it."""
    recording, rig = _simulated(MEMORY_RENDERED), folder / "rig"
    space, hand = recording.hand.kinematics.shape_space, folder / "hand.json"
    rig.mkdir()
    save_cameras(recording.cameras, rig / "cameras.json")
    save_hand(hand, space.names, recording.hand.shape.tolist(), "right", {}, units=space.units)
    for view, camera in enumerate(recording.cameras):
        path = rig / f"{camera.name}.mp4"
        with write_video(path, width=camera.width, height=camera.height, fps=FRAMES_PER_SECOND) as writer:
            for images in there_and_back(recording.frames, MEMORY_FRAMES, f"writing view {view}"):
                writer.write(images[view])
    return ["track_multiview", str(rig), "--hand", str(hand), "--set", "rig.shape_frames=1"]
