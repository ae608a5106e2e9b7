"""The hands of `torchhand study ueda`: of our own simulator, and of a recording of someone else's."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.errors import InputError
from torchhand.evaluate import load_mask, load_truth, numbered_pictures
from torchhand.files import load_rig, open_rig
from torchhand.fit import PostureResiduals
from torchhand.fit.hull import (
    HullFitter,
    HullSettings,
    HullShapeSettings,
    HullTarget,
    JointPriors,
    find_in_hull,
    fit_shape,
    target_of,
    with_rays,
)
from torchhand.geometry import Camera, meeting_point, rotation_from_vector
from torchhand.hand import (
    DOFS,
    Hand,
    HandModel,
    HandPose,
    PoseConstraints,
    Side,
    named_pose_space,
    pose_space,
    posture,
)
from torchhand.hand.limits import clamp_to_limits
from torchhand.image import SilhouetteSettings, segment
from torchhand.simulate import (
    Motion,
    SceneSettings,
    Staging,
    facing,
    hand_length,
    noisy_mask,
    posed_motion,
    render_rig,
    sample_shape,
    stage_camera,
)
from torchhand.study import seed_of
from torchhand.study.ueda.bent import INDEX_KNUCKLE, BentFinger, knuckle_deg, phalanx_turn_deg, turn_of
from torchhand.study.ueda.compare import Subject
from torchhand.view import mesh_silhouette
from torchhand.volume import CarvingSettings, RootCube, carve, hull_field

ROOT_SIDE = 0.512
"""Of the cube that is divided, metres: leaves of 8, 4 and 2 mm at levels 6, 7 and 8 (Ueda et al. 2003, section 6.3)."""
SPACE = "dof31"
_TILT = 0.4  # radians, standard deviation about each axis
_SIZES = (0.92, 1.0, 1.08)
_START_LEVEL, _SHAPE_LEVEL = 7, 8
_SHAPE_POINTS = 1500
_BEYOND_WRIST_M = 0.03


@dataclass(frozen=True, kw_only=True)
class BentCase:
    """A bent finger, and the pictures that its silhouettes are made from."""

    finger: BentFinger
    pictures: Sequence[UInt8[Tensor, "_height _width 3"]]


def fingers() -> tuple[str, ...]:
    """Names of the joint angles of the 31-DOF hand of Ueda et al. (2003)."""
    return tuple(name for name in named_pose_space(SPACE).free_names if not name.startswith("root"))


def own_bent(model: HandModel, cameras: Sequence[Camera], angle_deg: float, seed: int) -> BentCase:
    """Section 6 of Ueda et al. 2003: the index bent at its knuckle, the others straight; place and shape are known."""
    hand = model.hand(dtype=torch.float64)
    kinematics = hand.kinematics
    straight, bent = posture("flat", dtype=torch.float64), posture("flat", dtype=torch.float64)
    bent[DOFS.index(INDEX_KNUCKLE)] = math.radians(angle_deg)
    stage = stage_camera(cameras, hand_length(kinematics))
    motion = posed_motion([straight, bent], 2, kinematics, stage, staging=Staging(view="palm"))
    only = Motion(name="bent", poses=motion.poses[1:], root_reference=motion.root_reference, fps=motion.fps)
    scene = SceneSettings(surface="mesh", background="blue", supersampling=2)
    generator = torch.Generator().manual_seed(seed_of(seed, "bent"))
    [views] = list(render_rig(kinematics, only, cameras, scene, generator, hand=hand))
    finger = BentFinger(
        cameras=cameras,
        masks=[view.mask for view in views],
        root=root_at(cameras),
        hand=hand,
        shape=kinematics.default_shape,
        space=pose_space("fingers", fingers()).about(motion.poses[0]),
        start=HandPose.of(motion.poses[0], motion.root_reference),
        measure=knuckle_deg,
        truth_deg=angle_deg,
    )
    return BentCase(finger=finger, pictures=[view.image for view in views])


def root_at(cameras: Sequence[Camera]) -> RootCube:
    """The cube of Ueda et al. (2003), where the cameras look."""
    x, y, z = meeting_point(cameras).tolist() if len(cameras) > 1 else (0.0, 0.0, 0.0)
    return RootCube(centre=(x, y, z), side=ROOT_SIDE)


# ------------------------------------------------------------------ another maker's hand


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Two frames of a rig's recording with truth: the palm is the same in both, the index is not."""

    folder: Path
    cameras: Sequence[Camera]
    pictures: Sequence[UInt8[Tensor, "_height _width 3"]]
    """Pictures of the second frame."""
    straight: Sequence[Bool[Tensor, "_height _width"]]
    bent: Sequence[Bool[Tensor, "_height _width"]]
    truth_deg: float
    """How far the index's proximal phalanx turns from the first to the second."""


def open_recording(folder: Path, frames: tuple[int, int]) -> Recording:
    """Raises InputError naming what the folder lacks."""
    cameras = load_rig(folder)
    if len(cameras) < 2:
        raise InputError(f"{folder}: expected two cameras or more, got {len(cameras)}")
    truth = load_truth(folder / "truth.npz")
    keypoints = truth.keypoints3d
    if keypoints is None:
        raise InputError(f"{truth.source}: expected keypoints3d, which tell how far the finger is bent")
    for frame in frames:
        if not 0 <= frame < len(keypoints):
            raise InputError(f"--data-frames: expected frames 0 to {len(keypoints) - 1} of {folder}, got {frame}")
    (_, straight), (pictures, bent) = (_frame(folder, cameras, frame) for frame in frames)
    return Recording(
        folder=folder,
        cameras=cameras,
        pictures=pictures,
        straight=straight,
        bent=bent,
        truth_deg=float(phalanx_turn_deg(torch.from_numpy(keypoints[list(frames)]))[1]),
    )


def recorded_bent(model: HandModel, recording: Recording, side: Side) -> BentCase:
    """Our hand with shape and pose fitted on the first frame, to be fitted to the second one.

    Raises InputError where no hand fits the first frame.
    """
    hand, cameras = model.hand(side=side, dtype=torch.float64), recording.cameras
    start, shape = _fitted(recording.folder, model, hand, cameras, recording.straight)
    finger = BentFinger(
        cameras=cameras,
        masks=recording.bent,
        root=root_at(cameras),
        hand=hand,
        shape=shape,
        space=pose_space("fingers", fingers()).about(start.dofs),
        start=start,
        measure=turn_of(hand.kinematics, shape),
        truth_deg=recording.truth_deg,
        straight_masks=recording.straight,
    )
    return BentCase(finger=finger, pictures=recording.pictures)


def _frame(
    folder: Path, cameras: Sequence[Camera], frame: int
) -> tuple[list[UInt8[Tensor, "_height _width 3"]], list[Bool[Tensor, "_height _width"]]]:
    """Pictures and masks: of masks_K/ where there are some, else by the blue screen."""
    with open_rig(folder, cameras, start=frame, max_frames=1) as source:
        found = next(iter(source), None)
    if found is None:
        raise InputError(f"{folder}: no frame {frame}")
    problem = next((problem for problem in found.problems if problem is not None), None)
    images = [image for image in found.images if image is not None]
    if problem is not None or len(images) != len(cameras):
        raise InputError(f"{folder}: frame {frame}: {problem}")
    masks = []
    for index, image in enumerate(images):
        given = numbered_pictures(folder / f"masks_{index}")
        mask = segment(image, SilhouetteSettings(method="chroma"))
        if frame in given:
            mask = torch.from_numpy(np.ascontiguousarray(load_mask(given[frame])))
        if mask.shape != image.shape[:2] or not bool(mask.any()):
            raise InputError(f"{folder}: frame {frame}: no hand, or a mask of another size, in view {index}")
        masks.append(mask)
    return images, masks


def _fitted(
    folder: Path, model: HandModel, hand: Hand, cameras: Sequence[Camera], masks: Sequence[Tensor]
) -> tuple[HandPose, Float[Tensor, "shape"]]:
    """Pose and shape of our hand in one frame, without a guess."""

    def hull(level: int, points: int) -> HullTarget:
        settings = CarvingSettings(level=level, min_views=len(cameras))
        field = hull_field(carve(masks, cameras, root_at(cameras), settings), surface="middle")
        return with_rays(target_of(field, points=points), cameras, masks)

    target = hull(_START_LEVEL, 500)
    space, default = model.shape_space, model.shape_space.default.double()
    metric = torch.tensor([unit == "m" for unit in space.units])
    sizes = torch.stack([torch.where(metric, size * default, default) for size in _SIZES])
    sizes = sizes.clamp(space.lower.double(), space.upper.double())
    fitter = HullFitter(
        hand=hand,
        space=named_pose_space(SPACE),
        settings=HullSettings(beyond_wrist_m=_BEYOND_WRIST_M),
        joints=_joints(model),
    )
    starts = find_in_hull(target, fitter, sizes)
    if not starts:
        raise InputError(f"{folder}: the silhouettes leave no hand that could be fitted")
    best = starts[0]
    found = fit_shape(
        replace(fitter, shape=sizes[best.size]),
        [hull(_SHAPE_LEVEL, _SHAPE_POINTS)],
        best.found.pose.reshape(1),
        model.prior().population,
        HullShapeSettings(gross_m=(0.02, 0.006)),
    )
    return found.pose[0], found.shape


def _joints(model: HandModel) -> JointPriors:
    return JointPriors(
        constraints=PoseConstraints(model.skeleton),
        postures=PostureResiduals.of(model.prior().postures),
    )


# ------------------------------------------------------------------ random people


def subject(
    model: HandModel, cameras: Sequence[Camera], number: int, seed: int, *, noise_px: float, off: tuple[float, float]
) -> Subject:
    """A random person in a random posture, and a guess that is off by so many degrees and mm (standard deviations).

    Angles and the palm's turn are off by the first, the palm's place by the second. The same seed and number give the
    same, whatever else is asked for.
    """
    generator = torch.Generator().manual_seed(seed_of(seed, "sitter", number))
    hand, space = model.hand(dtype=torch.float64), named_pose_space(SPACE)
    shape = sample_shape(model.shape_space, generator).double()
    drawn, _ = model.prior(dtype=torch.float64).sample(1, generator)
    pose = clamp_to_limits(space.dof(space.free(drawn[0].double())), model.skeleton)
    pose[:6] = 0
    tilt = _TILT * torch.randn(3, generator=generator, dtype=torch.float64)
    reference = rotation_from_vector(tilt) @ facing("palm")
    vertices = hand(pose, shape, root_reference=reference).vertices
    shift = meeting_point(cameras) - 0.5 * (vertices.amax(0) + vertices.amin(0))
    pose[:3] += shift
    masks = [mesh_silhouette(vertices + shift, hand.faces, camera, is_closed=True) for camera in cameras]
    masks = [noisy_mask(mask, noise_px, generator) for mask in masks]
    truth = HandPose.of(pose, reference)
    return Subject(
        cameras=cameras,
        masks=masks,
        root=root_at(cameras),
        hand=hand,
        shape=shape,
        space=space,
        joints=_joints(model),
        truth=truth,
        guess=_guess(model, truth, generator, off),
    )


def _guess(model: HandModel, truth: HandPose, generator: torch.Generator, off: tuple[float, float]) -> HandPose:
    deg, mm = off
    space = named_pose_space(SPACE)
    shift, turn, bend = (torch.randn(n, generator=generator, dtype=torch.float64) for n in (3, 3, space.size))
    is_joint = torch.tensor([not name.startswith("root") for name in space.free_names])
    moved = space.dof(space.free(truth.dofs) + math.radians(deg) * bend * is_joint)
    moved[:3] = truth.dofs[:3] + 1e-3 * mm / math.sqrt(3) * shift
    turned = rotation_from_vector(math.radians(deg) / math.sqrt(3) * turn) @ truth.reference
    return HandPose(dofs=clamp_to_limits(moved, model.skeleton), reference=turned)
