"""Open hands of known truth: which finger is which, proportions, pose and what the fit says about itself."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.fit import PosedHands, Stage
from torchhand.fit.detect import facing_rotation, turned_in_picture
from torchhand.fit.open_hand.digits import DigitObservation
from torchhand.fit.open_hand.fit import OpenHand, facing_of, fit_open_hand
from torchhand.fit.open_hand.problem import open_hand_problem
from torchhand.fit.open_hand.start import placed_open_hand
from torchhand.geometry import assumed_camera
from torchhand.hand import DOFS, Anthropometry, HandKinematics, HandPose, Side, posture
from torchhand.image import HandRegions, NoRegions, divide_hand
from torchhand.simulate import Staging, sample_shape, scripted_motion
from torchhand.view import HandProjector

CAMERA = assumed_camera(480, 400)


def silhouette(
    side: Side, seed: int, *, turn: float = 0.0, distance: float = 0.42, view: str = "back", posed: str = "open"
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Mask, shape and keypoints (px) of a random person's hand turned in the picture about its middle."""
    kinematics = load_hand_model().kinematics(side, dtype=torch.float64)
    shape = sample_shape(kinematics.shape_space, torch.Generator().manual_seed(seed))
    rotation = turned_in_picture(facing_rotation(view), turn)
    pose = posture(posed, dtype=torch.float64)
    middle = rotation @ torch.tensor((0.0, 0.09, 0.0), dtype=torch.float64)
    pose[:3] = torch.tensor((0.0, 0.0, distance)) - middle
    projector = HandProjector(kinematics, CAMERA, shape)
    keypoints = CAMERA.project(projector.frames(pose, rotation).keypoints)
    return projector.silhouette(pose, rotation), shape, keypoints


def fitted(mask: torch.Tensor, side: Side) -> OpenHand:
    hand = fit_open_hand(mask, load_hand_model().kinematics(side, dtype=torch.float64), CAMERA)
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
        hand = fitted(mask, "right")
        truth = bone_ratios(shape)
        errors.append((bone_ratios(hand.fit.shape) / truth - 1).abs())
        known = thicknesses(shape)
        thick.append((thicknesses(hand.fit.shape) / known - 1).abs())
        guesses.append((thicknesses(space.default) / known - 1).abs())
        radii = [i for i, name in enumerate(space.names) if name.endswith(("pip_radius", "dip_radius"))]
        ratio = hand.fit.shape[radii] * hand.fit.shape[1] / hand.fit.shape[0] / (shape[radii] * shape[1] / shape[0])
        assert float((ratio - 1).abs().median()) < 0.07  # over hand length, of which the picture shows most
        is_fitted = hand.fit.shape_std > 0
        is_fitted[space.names.index("palm_thickness")] = False
        scaled.append(((hand.fit.shape - shape) / hand.fit.shape_std)[is_fitted])
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
    motion = scripted_motion(
        "planar", 1, kinematics, CAMERA, torch.Generator().manual_seed(0), staging=Staging(view="palm")
    )
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


def measured(seed: int) -> tuple[HandKinematics, HandPose, HandRegions]:
    """The start that a random person's silhouette gives, and its measured digits."""
    mask, _, _ = silhouette("right", seed)
    regions = divide_hand(mask)
    assert isinstance(regions, HandRegions)
    kinematics = load_hand_model().kinematics("right", dtype=torch.float64)
    return kinematics, placed_open_hand(regions, kinematics, CAMERA, "back"), regions


def test_people_are_believed_to_be_as_the_tables_say_and_the_length_stays() -> None:
    """What is believed costs nothing at the start; proximal phalanges are those of the tables, not the model's."""
    kinematics, start, _ = measured(3)
    problem = open_hand_problem(kinematics, Anthropometry(kinematics.shape_space), start)
    assert problem.shared is not None
    names, default = kinematics.shape_space.names, kinematics.default_shape
    assert names.index("hand_length") not in problem.shared.columns
    assert len(problem.shared.columns) == len(names) - 1
    found = problem.shared.prior_equations(problem.shared.vector(problem.shape), problem.shape)
    own = problem.shared.prior_equations(problem.shared.vector(default), default)
    assert float(found.gradient.abs().max()) == 0.0
    assert float(own.cost) > float(found.cost)
    moved = (problem.shape != default).nonzero()[:, 0].tolist()
    assert {names[i] for i in moved} == {f"{finger}_proximal" for finger in ("index", "middle", "ring", "little")}


def test_equations_of_digits_are_the_change_of_their_residuals(generator: torch.Generator) -> None:
    """In the pose and in the shape; here differences are taken to both sides and a hundred times as wide."""
    kinematics, start, regions = measured(3)
    digits = replace(DigitObservation.of(regions, kinematics, CAMERA), trust=0.5)
    problem = open_hand_problem(kinematics, Anthropometry(kinematics.shape_space), start)
    assert problem.shared is not None
    hands = PosedHands(pose=start.reshape(1), shape=problem.shape, unknowns=problem.shared, extra=problem.shared.extra)
    factor = digits.associate(hands, Stage())
    found = factor.equations(hands)
    step = 1e-2 * torch.randn(36, generator=generator, dtype=torch.float64)
    columns = list(problem.shared.columns)
    change = torch.zeros_like(problem.shape)
    change[columns] = 1e-2 * torch.randn(len(columns), generator=generator, dtype=torch.float64)
    change *= kinematics.shape_space.std

    def residual(sign: float) -> torch.Tensor:
        dofs = (start.dofs + sign * 1e-2 * step)[None]
        return digits.residuals(dofs, problem.shape + sign * 1e-2 * change, start.reference)[0]

    here, slope = residual(0.0), (residual(1.0) - residual(-1.0)) / 2e-2
    assert found.mixed is not None
    assert found.shared_gradient is not None
    assert found.shared_matrix is not None
    own = change[columns]
    torch.testing.assert_close(found.cost[0], 0.5 * here.square().sum())
    torch.testing.assert_close(
        found.gradient[0] @ step + found.shared_gradient[0] @ own, here @ slope, rtol=1e-3, atol=0
    )
    curvature = step @ found.matrix[0] @ step + 2 * step @ found.mixed[0] @ own + own @ found.shared_matrix[0] @ own
    torch.testing.assert_close(curvature, slope @ slope, rtol=1e-3, atol=0)


def test_corrected_digits_of_the_models_own_silhouette_have_no_bias() -> None:
    """Where the picture is the model's own, digits freed of the measurement's bias lie where the model has them."""
    kinematics, start, regions = measured(3)
    drawn = divide_hand(HandProjector(kinematics, CAMERA).silhouette(start.dofs, start.reference))
    assert isinstance(drawn, HandRegions)
    own, shape = DigitObservation.of(drawn, kinematics, CAMERA), kinematics.default_shape
    tips_and_bases = slice(0, 14)

    def residual(digits: DigitObservation) -> torch.Tensor:
        return digits.residuals(start.dofs[None], shape, start.reference)[0, tips_and_bases]

    assert float(residual(own).abs().max()) > 0.5
    torch.testing.assert_close(
        residual(own.corrected(start, shape, drawn)), torch.zeros(14).double(), rtol=0, atol=1e-9
    )
    assert float(residual(DigitObservation.of(regions, kinematics, CAMERA)).abs().max()) > 0.5
