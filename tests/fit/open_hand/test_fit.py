"""Open hands of known truth: which finger is which, proportions, pose and what the fit says about itself."""

import math

import numpy as np
import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.fit import mask_plane
from torchhand.fit.detect import facing_rotation, turned_in_picture
from torchhand.fit.open_hand.edges import match_edges
from torchhand.fit.open_hand.fit import OpenHand, facing_of, fit_open_hand
from torchhand.fit.open_hand.problem import OpenHandProblem, linearized
from torchhand.fit.open_hand.start import DigitResiduals, fit_digits, placed_open_hand
from torchhand.geometry import assumed_camera
from torchhand.hand import DOFS, Anthropometry, Side, posture
from torchhand.image import HandRegions, NoRegions, divide_hand
from torchhand.simulate import sample_shape, scripted_motion
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


def problem_of(seed: int) -> tuple[OpenHandProblem, HandRegions]:
    """The problem that a random person's silhouette poses, and its measured digits."""
    mask, _, _ = silhouette("right", seed)
    regions = divide_hand(mask)
    assert isinstance(regions, HandRegions)
    kinematics = load_hand_model().kinematics("right", dtype=torch.float64)
    placed = placed_open_hand(regions, kinematics, CAMERA, "back")
    return OpenHandProblem.about(kinematics, CAMERA, *placed), regions


def test_values_are_the_scaled_unknowns_and_the_prior_adds_what_leaves_its_interval() -> None:
    kinematics = load_hand_model().kinematics("right", dtype=torch.float64)
    identity = torch.eye(3, dtype=torch.float64)
    problem = OpenHandProblem.about(kinematics, CAMERA, posture("open", dtype=torch.float64), identity)
    values = 2.5 * torch.randn(3, problem.size, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    residual = problem.prior(values)
    assert bool((residual[:, : problem.size] == values).all())
    population = Anthropometry(kinematics.shape_space)
    shapes = problem.split(values)[1]
    rows = (
        population.matrix[-2 * len(population.mean) :] @ shapes.T - population.bound[-2 * len(population.mean) :, None]
    )
    assert bool(((residual[:, problem.size :] > 0) == (rows.T > 0)).all())
    assert bool((rows > 0).any())
    pose, shape = problem.split(0 * values[0])
    assert bool((pose == posture("open", dtype=torch.float64)).all())
    assert float(shape[0]) == pytest.approx(0.187)


def test_jacobians_are_the_change_of_the_residuals(generator: torch.Generator) -> None:
    """Of digits, edges and prior; here differences are taken to both sides and ten times as wide."""
    problem, regions = problem_of(3)
    values = 0.2 * torch.randn(problem.size, generator=generator, dtype=torch.float64)
    edges = match_edges(mask_plane(regions.mask), problem, values)
    assert edges is not None
    direction = torch.randn(problem.size, generator=generator, dtype=torch.float64)
    there = torch.stack((values + 1e-3 * direction, values - 1e-3 * direction))
    for term in (DigitResiduals(regions, problem), edges.residuals, problem.prior):
        more, less = term(there)
        residual, jacobian = linearized((term,), values)
        torch.testing.assert_close(residual, term(values[None])[0])
        expected = (more - less) / 2e-3
        assert float((jacobian @ direction - expected).norm() / expected.norm()) < 1e-3


def test_corrected_digits_of_the_models_own_silhouette_have_no_bias() -> None:
    """Where the picture is the model's own, digits freed of the measurement's bias lie where the model has them."""
    problem, regions = problem_of(3)
    digits = DigitResiduals(regions, problem)
    values = fit_digits(digits, problem)
    projector, pose = problem.projected(values)
    drawn = divide_hand(projector.silhouette(pose, problem.root_reference))
    assert isinstance(drawn, HandRegions)
    own = DigitResiduals(drawn, problem)
    tips_and_bases = slice(0, 14)
    assert float(own(values)[tips_and_bases].abs().max()) > 0.5
    torch.testing.assert_close(
        own.corrected(values, drawn)(values)[tips_and_bases], torch.zeros(14).double(), rtol=0, atol=1e-9
    )


def test_edges_of_the_models_own_silhouette_lie_on_its_contour() -> None:
    problem, _ = problem_of(3)
    zero = torch.zeros(problem.size, dtype=torch.float64)
    projector, pose = problem.projected(zero)
    plane = mask_plane(projector.silhouette(pose, problem.root_reference))
    edges = match_edges(plane, problem, zero)
    assert edges is not None
    assert edges.found_fraction > 0.97
    assert edges.residual_px < 0.3
    none = match_edges(torch.zeros_like(plane), problem, zero)
    assert none is not None
    assert none.found_fraction == 0.0
    assert none.residual_px == math.inf
