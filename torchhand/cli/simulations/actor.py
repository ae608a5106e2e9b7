"""The hand that `torchhand simulate` shows, what it does, and the single camera before it."""

from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.cli.simulations.order import DEFAULT_FOV_DEG, DEFAULT_FRAMES, Arguments
from torchhand.errors import InputError
from torchhand.files import load_cameras, load_hand, load_hand_model
from torchhand.files.pictures import size_problem
from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import Hand, HandKinematics, HandModel, ShapeSpace, Side
from torchhand.simulate import (
    Motion,
    Staging,
    parse_pose,
    posed_motion,
    recorded_motion,
    sample_shape,
    sampled_motion,
    scripted_motion,
)


@dataclass(frozen=True, kw_only=True)
class Actor:
    """The hand that moves."""

    kinematics: HandKinematics
    shape: Float[Tensor, "shape"]
    side: Side
    hand: Hand | None
    """Hand with its skin, where that is drawn."""
    model: HandModel


def actor_of(arguments: Arguments, generator: torch.Generator, device: torch.device) -> Actor:
    """The hand, whose skin is on the device that draws it.

    Raises InputError where --hand cannot be used, or the model has no skin to draw."""
    model = load_hand_model()
    side, shape = _hand(arguments, model.shape_space, generator)
    return Actor(
        kinematics=model.kinematics(side, dtype=torch.float64),
        shape=shape,
        side=side,
        hand=_skinned(model, side, device) if arguments.surface == "mesh" else None,
        model=model,
    )


def motion_of(arguments: Arguments, actor: Actor, camera: Camera, generator: torch.Generator) -> Motion:
    """Motion in the world of that camera. Raises InputError naming the option that cannot be met."""
    frames = arguments.frames or DEFAULT_FRAMES
    staging = Staging(view=arguments.view, fps=arguments.fps, pace=arguments.pace)
    how = {"shape": actor.shape, "staging": staging}
    if arguments.pose:
        poses = [parse_pose(text, actor.kinematics.skeleton) for text in arguments.pose]
        return posed_motion(poses, frames, actor.kinematics, camera, **how)
    if arguments.sampled:
        prior = actor.model.prior(dtype=torch.float64)
        return sampled_motion(prior, frames, actor.kinematics, camera, generator, turn_deg=arguments.turn_deg, **how)
    if arguments.recorded is None:
        perform = partial(scripted_motion, arguments.motion)
    else:
        perform = partial(recorded_motion, arguments.recorded, start_s=arguments.recorded_start)
    return perform(frames, actor.kinematics, camera, generator, **how)


def _skinned(model: HandModel, side: Side, device: torch.device) -> Hand:
    if model.mesh is None:
        raise InputError(f"--surface mesh: the hand model {model.name!r} has no mesh (mesh.npz in its folder)")
    return model.to(device=device).hand(side=side, dtype=torch.float64)


def _hand(arguments: Arguments, space: ShapeSpace, generator: torch.Generator) -> tuple[Side, Tensor]:
    """Side and shape."""
    if arguments.hand is None:
        shape = sample_shape(space, generator) if arguments.random_hand else space.default
        return arguments.side or "right", shape
    fitted = load_hand(arguments.hand, space.names)
    for name, value, low, high in zip(space.names, fitted.values.values(), space.lower, space.upper, strict=True):
        if not low <= value <= high:
            allowed = f"{float(low):g} to {float(high):g}"
            raise InputError(f"{arguments.hand}: shape.{name}: expected {allowed}, got {value:g}")
    own_side: Side = "left" if fitted.side == "left" else "right"
    return arguments.side or own_side, torch.tensor(list(fitted.values.values()), dtype=torch.float64)


def camera_of(arguments: Arguments) -> Camera:
    """The camera; the hand moves in its own frame, whatever place a file gives it."""
    if arguments.camera is not None:
        cameras = load_cameras(arguments.camera)
        if len(cameras) != 1:
            names = ", ".join(camera.name for camera in cameras)
            raise InputError(f"{arguments.camera}: expected one camera, got {len(cameras)} ({names})")
        if problem := size_problem(cameras[0].width, cameras[0].height):
            raise InputError(f"{arguments.camera}: {problem}")
        place = {"rotation": torch.eye(3, dtype=torch.float64), "translation": torch.zeros(3, dtype=torch.float64)}
        return replace(cameras[0], **place)
    width, height = arguments.size_px
    fov_deg = arguments.fov_deg or DEFAULT_FOV_DEG
    return replace(assumed_camera(width, height, horizontal_fov_deg=fov_deg), is_assumed=False)
