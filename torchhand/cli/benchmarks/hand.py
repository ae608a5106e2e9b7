"""Measures of `torchhand benchmark` on the hand: kinematics and skinning against their peers."""

import os
import shutil
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from torchhand.cli.benchmarks.figures import Figure, Peer, against_peer, peer_module
from torchhand.devices import HOST
from torchhand.files import load_hand_model, models_dir
from torchhand.hand import JOINT_DOFS, ROOT_DOFS

POSES = 4096
ROUNDS, SKINNING_ROUNDS = 15, 9
"""Repeats unless --repeats says otherwise."""
COMPILED_MUST, COMPILED_AIM = 6.0, 10.0

# A hand of the size of MANO: of its layout, not its data.
PEER_VERTICES, PEER_JOINTS, PEER_SHAPES = 778, 16, 10
PEER_PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)


def poses(count: int) -> Tensor:
    """Poses of which no angle is large."""
    return 0.3 * torch.randn(count, len(ROOT_DOFS) + len(JOINT_DOFS), generator=torch.Generator().manual_seed(0))


def peer_chain(pose: Tensor) -> tuple[Any, Tensor] | None:
    """pytorch-kinematics' chain of the same URDF on the device of the poses, and the joint angles in its order."""
    library = peer_module("pytorch_kinematics")
    if library is None:
        return None
    chain = library.build_chain_from_urdf((models_dir() / "generic_hand" / "hand.urdf").read_bytes())
    chain = chain.to(device=pose.device)
    columns = [len(ROOT_DOFS) + JOINT_DOFS.index(joint) for joint in chain.get_joint_parameter_names()]
    return chain, pose[:, columns].contiguous()


def kinematics_forward(name: str, repeats: int | None, device: torch.device = HOST) -> Figure:
    """Bone transforms and keypoints of many poses, float32, against the transforms of the peer's links."""
    kinematics, pose = load_hand_model().to(device=device).kinematics(), poses(POSES).to(device)
    candidates: dict[str, Callable[[], object]] = {"ours": torch.no_grad()(partial(kinematics, pose))}
    peer = peer_chain(pose)
    if peer is not None:
        candidates["peer"] = torch.no_grad()(partial(peer[0].forward_kinematics, peer[1]))
    return against_peer(
        name, repeats or ROUNDS, Peer("pytorch-kinematics"), candidates, must=4.0, aim=8.0, device=device
    )


def kinematics_forward_backward(name: str, repeats: int | None, device: torch.device = HOST) -> Figure:
    """Forward and backward with gradients to the pose and to a shape per pose, against the peer's analytical ones to
    joint angles alone."""
    kinematics = load_hand_model().to(device=device).kinematics()
    ours = _bones_there_and_back(kinematics, has_shapes=True, device=device)
    candidates = {"ours": ours} | _peer_there_and_back(device)
    return against_peer(
        name, repeats or ROUNDS, Peer("pytorch-kinematics"), candidates, must=3.0, aim=8.0, device=device
    )


def kinematics_compiled(name: str, repeats: int | None) -> Figure:
    """Forward and backward with ours compiled, and, as a variant, with gradients to the pose alone, as the peer's."""
    if not any(shutil.which(compiler) for compiler in (os.environ.get("CXX") or "g++", "g++", "clang++")):
        note = "torch.compile needs a C++ compiler (g++), which was not found"
        return Figure(name=name, value=None, unit="ratio", must=COMPILED_MUST, aim=COMPILED_AIM, repeats=0, note=note)
    compiled = torch.compile(load_hand_model().kinematics(), fullgraph=True)
    candidates = {
        "ours": _bones_there_and_back(compiled, has_shapes=True),
        "pose_alone": _bones_there_and_back(compiled, has_shapes=False),
    } | _peer_there_and_back()
    rounds = repeats or ROUNDS
    return against_peer(name, rounds, Peer("pytorch-kinematics"), candidates, must=COMPILED_MUST, aim=COMPILED_AIM)


def _bones_there_and_back(
    kinematics: Callable[..., Any], *, has_shapes: bool, device: torch.device = HOST
) -> Callable[[], object]:
    pose = poses(POSES).to(device).requires_grad_()
    default = load_hand_model().shape_space.default.float()
    people = 1 + 0.02 * torch.randn(POSES, 1, generator=torch.Generator().manual_seed(1))
    inputs = (pose, (people * default).to(device).requires_grad_()) if has_shapes else (pose,)

    def run() -> object:
        frames = kinematics(*inputs)
        return torch.autograd.grad(frames.keypoints.sum() + frames.rotation.sum(), inputs)

    return run


def _peer_there_and_back(device: torch.device = HOST) -> dict[str, Callable[[], object]]:
    peer = peer_chain(poses(POSES).to(device))
    if peer is None:
        return {}
    chain, angles = peer[0], peer[1].requires_grad_()

    def run() -> object:
        # All links' matrices as one tensor: its quickest way.
        return torch.autograd.grad(chain.forward_kinematics_tensor(angles)[..., :3, :].sum(), angles)

    return {"peer": run}


def skinning(
    name: str,
    repeats: int | None,
    device: torch.device = HOST,
    *,
    count: int,
    has_gradients: bool,
    must: float,
    aim: float,
) -> Figure:
    """Poses to vertices, float32, one shape for all poses; against linear blend skinning of a hand of MANO's size.

    Ratios are per vertex. Gradients go to poses and shape. The variant has a shape per pose, as the peer always has.
    """
    hand = load_hand_model().to(device=device).hand()
    pose = poses(count).to(device).requires_grad_(has_gradients)
    people = 1 + 0.02 * torch.randn(count, 1, generator=torch.Generator().manual_seed(1)).to(device)
    candidates = {}
    for variant, shape in (("ours", hand.shape), ("shape_each", people * hand.shape)):
        leaf = shape.clone().requires_grad_(has_gradients)
        candidates[variant] = _vertices(lambda pose, shape: hand(pose, shape).vertices, pose, leaf)
    library = peer_module("smplx.lbs")
    if library is not None:
        candidates["peer"] = _peer_skinning(library, count, has_gradients=has_gradients, device=device)
    work = hand.skinning.weights.shape[1] / PEER_VERTICES
    note = f"per vertex; ours has {hand.skinning.weights.shape[1]}, the peer {PEER_VERTICES}"
    rounds = repeats or SKINNING_ROUNDS
    return against_peer(name, rounds, Peer("smplx.lbs", work), candidates, must=must, aim=aim, note=note, device=device)


def _peer_skinning(library: Any, count: int, *, has_gradients: bool, device: torch.device) -> Callable[[], object]:
    generator = torch.Generator().manual_seed(0)
    normal, uniform = partial(torch.randn, generator=generator), partial(torch.rand, generator=generator)
    template, directions = 0.1 * normal(PEER_VERTICES, 3), 0.01 * normal(PEER_VERTICES, 3, PEER_SHAPES)
    correctives = 0.01 * normal(9 * (PEER_JOINTS - 1), 3 * PEER_VERTICES)
    regressor, weights = uniform(PEER_JOINTS, PEER_VERTICES), uniform(PEER_VERTICES, PEER_JOINTS)
    regressor, weights = (x / x.sum(1, keepdim=True) for x in (regressor, weights))
    parents = torch.tensor(PEER_PARENTS, device=device)
    numbers = (template, directions, correctives, regressor, weights)
    template, directions, correctives, regressor, weights = (x.to(device) for x in numbers)

    def vertices(pose: Tensor, shape: Tensor) -> Tensor:
        return library.lbs(shape, pose, template, directions, correctives, regressor, parents, weights)[0]

    pose = (0.3 * normal(count, 3 * PEER_JOINTS)).to(device).requires_grad_(has_gradients)
    return _vertices(vertices, pose, normal(count, PEER_SHAPES).to(device).requires_grad_(has_gradients))


def _vertices(function: Callable[[Tensor, Tensor], Tensor], pose: Tensor, shape: Tensor) -> Callable[[], object]:
    """A call that makes vertices and, where the inputs ask for them, gradients."""

    def run() -> object:
        with torch.set_grad_enabled(pose.requires_grad):
            vertices = function(pose, shape)
        return torch.autograd.grad(vertices.sum(), (pose, shape)) if pose.requires_grad else vertices

    return run
