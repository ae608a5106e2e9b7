"""Open hands of known truth: which finger is which, proportions, pose and what the fit says about itself."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.fit.detect import facing_rotation, turned_in_picture
from torchhand.fit.open_hand.fit import OpenHand, facing_of, fit_open_hand
from torchhand.fit.open_hand.problem import OpenHandProblem
from torchhand.fit.open_hand.settings import OpenHandSettings
from torchhand.geometry import assumed_camera
from torchhand.hand import DOFS, Anthropometry, Side, posture
from torchhand.image import NoRegions
from torchhand.simulate import sample_shape, scripted_motion
from torchhand.view import HandProjector

CAMERA = assumed_camera(480, 400)
QUICK = OpenHandSettings(points_per_generator=8, points_per_arc=6)


def silhouette(
    side: Side, seed: int, *, turn: float = 0.0, distance: float = 0.42, view: str = "back", posed: str = "open"
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Mask, shape and keypoints (px) of a random person's hand turned in the picture about its middle."""
    kinematics = load_hand_model().kinematics(side, dtype=torch.float64)
    shape = sample_shape(kinematics.shape_space, torch.Generator().manual_seed(seed))
    rotation = turned_in_picture(facing_rotation(view), turn)
    pose = posture(posed)
    middle = rotation @ torch.tensor((0.0, 0.09, 0.0), dtype=torch.float64)
    pose[:3] = torch.tensor((0.0, 0.0, distance)) - middle
    projector = HandProjector(kinematics, CAMERA, shape)
    keypoints = CAMERA.project(projector.frames(pose, rotation).keypoints)
    return projector.silhouette(pose, rotation), shape, keypoints


def fitted(mask: torch.Tensor, side: Side, settings: OpenHandSettings = QUICK) -> OpenHand:
    hand = fit_open_hand(mask, load_hand_model().kinematics(side, dtype=torch.float64), CAMERA, settings)
    assert isinstance(hand, OpenHand), hand
    return hand


@pytest.mark.parametrize(
    ("side", "view", "turn", "distance"),
    [
        ("right", "back", 0.0, 0.42),
        ("right", "palm", 2.4, 0.36),
        ("left", "back", -1.3, 0.5),
        ("left", "palm", 0.7, 0.8),
    ],
)
def test_every_joint_is_found_at_any_angle_size_and_side(side: Side, view: str, turn: float, distance: float) -> None:
    mask, _, keypoints = silhouette(side, 3, turn=turn, distance=distance, view=view)
    hand = fitted(mask, side)
    assert hand.facing == view
    assert hand.overlap > 0.9
    kinematics = load_hand_model().kinematics(side, dtype=torch.float64)
    found = kinematics(hand.fit.pose, hand.fit.shape, root_reference=hand.fit.root_reference).keypoints
    error = (CAMERA.project(found) - keypoints).norm(dim=-1) / (keypoints[12] - keypoints[0]).norm()
    assert float(error[[4, 8, 12, 16, 20]].max()) < 0.02  # tips
    assert float(error.max()) < 0.09
    assert float(error.median()) < 0.03


def bone_ratios(shape: torch.Tensor) -> torch.Tensor:
    metric = load_hand_model().shape_space.metric(shape)
    finger = metric["middle_proximal"] + metric["middle_middle"] + metric["middle_distal"]
    fingers = ("index", "middle", "ring", "little")
    names = ["thumb_proximal", *(f"{f}_{bone}" for bone in ("proximal", "middle") for f in fingers)]
    return torch.stack([metric[name] / finger for name in names])


def thicknesses(shape: torch.Tensor) -> torch.Tensor:
    """Radii of the fingers' middle joints over that of the middle finger: what a picture shows best."""
    metric = load_hand_model().shape_space.metric(shape)
    return torch.stack([metric[f"{f}_pip_radius"] / metric["middle_pip_radius"] for f in ("index", "ring", "little")])


def test_proportions_are_read_and_the_deviations_are_honest() -> None:
    space = load_hand_model().shape_space
    errors, thick, guesses, scaled = [], [], [], []
    for seed in range(5):
        mask, shape, _ = silhouette("right", seed)
        hand = fitted(mask, "right", OpenHandSettings())
        truth = bone_ratios(shape)
        errors.append((bone_ratios(hand.fit.shape) / truth - 1).abs())
        known = thicknesses(shape)
        thick.append((thicknesses(hand.fit.shape) / known - 1).abs())
        guesses.append((thicknesses(space.default) / known - 1).abs())
        radii = [i for i, name in enumerate(space.names) if name.endswith(("pip_radius", "dip_radius"))]
        ratio = hand.fit.shape[radii] * hand.fit.shape[1] / hand.fit.shape[0] / (shape[radii] * shape[1] / shape[0])
        assert float((ratio - 1).abs().median()) < 0.07  # over hand length, of which the picture shows most
        held = hand.fit.shape_std > 0
        held[space.names.index("palm_thickness")] = False
        scaled.append(((hand.fit.shape - shape) / hand.fit.shape_std)[held])
    assert float(torch.cat(errors).median()) < 0.035
    assert float(torch.cat(thick).mean()) < 0.5 * float(torch.cat(guesses).mean())
    assert float(torch.cat(scaled).square().mean().sqrt()) < 2.5


def test_shape_is_feasible_and_the_thumb_gives_the_thickness() -> None:
    mask, _, _ = silhouette("right", 1)
    hand = fitted(mask, "right")
    space = load_hand_model().shape_space
    values = dict(zip(space.names, hand.fit.shape.tolist(), strict=True))
    assert bool(Anthropometry(space).is_feasible(hand.fit.shape))
    low = float(space.lower[space.names.index("palm_thickness")])
    assert values["palm_thickness"] == pytest.approx(max(low, 2 * values["thumb_mcp_radius"]))
    assert values["hand_length"] == pytest.approx(0.187)
    stds = dict(zip(space.names, hand.fit.shape_std.tolist(), strict=True))
    assert stds["hand_length"] == 0.0
    assert stds["middle_pip_radius"] < 0.7 * float(space.std[space.names.index("middle_pip_radius")])


def test_ragged_mask_with_arm_is_fitted(generator: torch.Generator) -> None:
    mask, _, keypoints = silhouette("right", 2)
    mask = mask.clone()
    wrist = keypoints[0].round().int().tolist()
    mask[wrist[1] - 10 :, wrist[0] - 30 : wrist[0] + 30] = True
    mask &= torch.rand(mask.shape, generator=generator) > 0.01
    hand = fitted(mask, "right")
    assert hand.overlap > 0.85
    tips = np.stack([digit.tip for digit in hand.regions.digits])
    assert np.hypot(*(tips - keypoints[4::4].numpy()).T).max() < 10


def test_pointing_hand_is_refused_by_name() -> None:
    mask, _, _ = silhouette("right", 0, posed="point")
    refused = fit_open_hand(mask, load_hand_model().kinematics("right", dtype=torch.float64), CAMERA)
    assert isinstance(refused, NoRegions)
    assert refused.reason


def test_motion_script_frame_is_fitted_as_a_left_hand() -> None:
    kinematics = load_hand_model().kinematics("left", dtype=torch.float64)
    motion = scripted_motion("planar", 1, kinematics, CAMERA, torch.Generator().manual_seed(0), view="palm")
    mask = HandProjector(kinematics, CAMERA).silhouette(motion.poses[0], motion.root_reference)
    hand = fitted(mask, "left")
    joints = torch.rad2deg(hand.fit.pose - motion.poses[0])
    spread = [i for i, dof in enumerate(DOFS) if dof.endswith("mcp_aa") and not dof.startswith("thumb")]
    assert float(joints[spread].abs().max()) < 5.0
    turn = hand.fit.root_reference @ motion.root_reference.T
    assert math.degrees(math.acos(min(1.0, 0.5 * (float(turn.diagonal().sum()) - 1)))) < 8.0


def test_facing_follows_from_side_and_thumb() -> None:
    assert facing_of("right", False) == "back"
    assert facing_of("right", True) == "palm"
    assert facing_of("left", False) == "palm"
    assert facing_of("left", True) == "back"


def test_prior_rows_are_the_derivative_and_the_scaled_unknowns() -> None:
    kinematics = load_hand_model().kinematics("right", dtype=torch.float64)
    people = Anthropometry(kinematics.shape_space)
    problem = OpenHandProblem.about(kinematics, people, posture("open"))
    values = 2.5 * torch.randn(problem.size, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    residual, jacobian = problem.prior(values)
    assert bool((residual[: problem.size] == values).all())
    assert int((residual[problem.size :] > 0).sum()) > 0
    numeric = torch.autograd.functional.jacobian(lambda x: problem.prior(x)[0], values)
    assert float((numeric - jacobian).abs().max()) < 1e-9
    pose, shape = problem.split(torch.stack((values, 0 * values)))
    assert bool((pose[1] == posture("open")).all())
    assert float(shape[0, 0]) == pytest.approx(0.187)
    inside = problem.clamped(1e3 * values)
    assert bool(problem.on_bound(inside)[problem.upper.isfinite()].all())


@pytest.mark.parametrize(
    ("field", "value"),
    [("tip_std", 0.0), ("search_share", -1.0), ("iterations", 1), ("least_edge_std_px", 0.0), ("digit_share", -0.1)],
)
def test_settings_name_what_is_wrong(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        replace(OpenHandSettings(), **{field: value})
