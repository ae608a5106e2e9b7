"""Render a seeded sequence of a hand before one or several cameras, with exact truth."""

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import torch
from tqdm import tqdm

import torchhand
from torchhand.cli.command import DONE, command, parse, threads
from torchhand.cli.simulations import (
    Actor,
    Arguments,
    actor_of,
    camera_of,
    motion_of,
    rig_cameras,
    rig_complaints,
    with_mask_noise,
)
from torchhand.devices import HOST, device_named, sent_to
from torchhand.errors import InputError
from torchhand.evaluate import flexion_deg
from torchhand.geometry import Camera
from torchhand.simulate import (
    Motion,
    MovingHand,
    SceneSettings,
    SequenceFolder,
    check_sequence_folder,
    hand_length,
    render_rig,
    render_sequence,
    stage_camera,
    write_rig_sequence,
    write_sequence,
)

Frame = TypeVar("Frame")

_OPTIONAL = {"rig": None, "pose": (), "sampled": False, "turn_deg": 40.0, "mask_noise": 0.0}
"""Options that about.json names only where they are used."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Render one sequence into a folder."""
    given = parse(Arguments, argv, name="simulate")
    arguments = given.resolved()
    try:
        scene = arguments.scene
    except ValueError as error:
        raise InputError(str(error)) from error
    device_named(arguments.device)  # a mistake is told before the work
    with threads(arguments.threads):
        check_sequence_folder(arguments.out, overwrite=arguments.overwrite)
        if arguments.rig is None:
            _render(arguments, scene)
        else:
            size = None if given.size is None else given.size_px
            _render_rig(arguments, scene, rig_cameras(arguments.rig, size=size, fov_deg=given.fov_deg))
    print(f"saved {arguments.frames} frames in {arguments.out}")
    return DONE


def _render(arguments: Arguments, scene: SceneSettings) -> None:
    generator = torch.Generator().manual_seed(arguments.seed)
    device = device_named(arguments.device)
    actor = actor_of(arguments, generator, device)
    camera = camera_of(arguments)
    motion = motion_of(arguments, actor, camera, generator)
    kinematics, moving, there, shape = sent_to((actor.kinematics, motion, camera, actor.shape), device)
    drawn = render_sequence(kinematics, moving, there, scene, generator, shape=shape, hand=actor.hand)
    rendered = (sent_to(frame, HOST) for frame in drawn)
    if arguments.mask_noise:
        noise = torch.Generator().manual_seed(arguments.seed)
        rendered = (with_mask_noise(frame, arguments.mask_noise, noise) for frame in rendered)
    write_sequence(
        _folder(arguments),
        iter(_with_bar(rendered, arguments)),
        MovingHand(kinematics=actor.kinematics, shape=actor.shape, motion=motion),
        camera,
        with_video=arguments.video,
        about=_about(arguments, actor, motion),
        measures={"flexion_deg": flexion_deg},
    )


def _render_rig(arguments: Arguments, scene: SceneSettings, cameras: list[Camera]) -> None:
    generator = torch.Generator().manual_seed(arguments.seed)
    device = device_named(arguments.device)
    actor = actor_of(arguments, generator, device)
    stage = stage_camera(cameras, hand_length(actor.kinematics, actor.shape))
    motion = motion_of(arguments, actor, stage, generator)
    kinematics, moving, there, shape = sent_to((actor.kinematics, motion, cameras, actor.shape), device)
    drawn = render_rig(kinematics, moving, there, scene, generator, shape=shape, hand=actor.hand)
    rendered = (sent_to(frames, HOST) for frames in drawn)
    if arguments.mask_noise:
        noise = torch.Generator().manual_seed(arguments.seed)
        rendered = (
            tuple(with_mask_noise(frame, arguments.mask_noise, noise) for frame in frames) for frames in rendered
        )
    record = write_rig_sequence(
        _folder(arguments),
        iter(_with_bar(rendered, arguments)),
        MovingHand(kinematics=actor.kinematics, shape=actor.shape, motion=motion),
        cameras,
        about=_about(arguments, actor, motion),
        measures={"flexion_deg": flexion_deg},
    )
    for line in rig_complaints(record, cameras):
        print(f"torchhand simulate: {line}", file=sys.stderr)


def _folder(arguments: Arguments) -> SequenceFolder:
    return SequenceFolder(path=arguments.out, picture_format=arguments.pictures, overwrite=arguments.overwrite)


def _with_bar(rendered: Iterator[Frame], arguments: Arguments) -> Iterable[Frame]:
    return tqdm(rendered, total=arguments.frames, desc="rendering", unit="frame", disable=not sys.stderr.isatty())


def _about(arguments: Arguments, actor: Actor, motion: Motion) -> dict[str, Any]:
    given = {
        name: value
        for name, value in asdict(arguments).items()
        if name not in ("out", "overwrite", "threads", "device")
    }
    given = {name: value for name, value in given.items() if name not in _OPTIONAL or value != _OPTIONAL[name]}
    about = {name: str(value) if isinstance(value, Path) else value for name, value in given.items()}
    return {"torchhand": torchhand.__version__, "hand": actor.side, "motion": motion.name, "arguments": about}
