"""Shading of open hands: its derivatives, what it adds on pictures of one light, and that it is left alone else."""

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import mask_plane
from torchhand.fit.detect import facing_rotation
from torchhand.fit.open_hand import shading as open_hand_shading
from torchhand.fit.open_hand.edges import Outline
from torchhand.fit.open_hand.fit import OpenHand, fit_open_hand
from torchhand.fit.open_hand.joints import moved_joints
from torchhand.fit.open_hand.light import Light, fit_light
from torchhand.fit.open_hand.parts import NearestParts
from torchhand.fit.open_hand.pixels import PixelGrid, pixel_grid, thinned
from torchhand.fit.open_hand.problem import OpenHandProblem
from torchhand.fit.open_hand.settings import OpenHandSettings
from torchhand.fit.open_hand.shading import Shading
from torchhand.fit.open_hand.shading_cost import JointCost, ShadingStage
from torchhand.fit.open_hand.soft import soft_silhouette
from torchhand.fit.open_hand.surface import meet, quadric_numbers
from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import DOFS, FINGERS, Anthropometry, HandKinematics, posture
from torchhand.simulate import Motion, SceneSettings, render_sequence, sample_shape
from torchhand.view import HandProjector, raycast

CAMERA = replace(assumed_camera(360, 320), is_assumed=False)
SETTINGS = OpenHandSettings(iterations=6, more_iterations=2, points_per_generator=5, points_per_arc=4)
BONES = [(4 * finger + 1 + k, 4 * finger + 2 + k) for finger in range(5) for k in range(3)]


@dataclass(frozen=True, kw_only=True)
class Scene:
    kinematics: HandKinematics
    camera: Camera
    image: Tensor
    mask: Tensor
    pose: Tensor
    shape: Tensor
    rotation: Tensor

    @property
    def problem(self) -> OpenHandProblem:
        """With the truth at zero."""
        about = OpenHandProblem.about(self.kinematics, Anthropometry(self.kinematics.shape_space), self.pose)
        return replace(about, shape=self.shape)

    def grid(self, step: int = 1) -> PixelGrid:
        found = pixel_grid(self.image, self.mask, self.camera, step)
        assert found is not None
        return found

    def numbers(self, grid: PixelGrid, values: Tensor | None = None) -> Tensor:
        problem = self.problem
        pose, shape = problem.split(torch.zeros(problem.size, dtype=torch.float64) if values is None else values)
        projector = HandProjector(self.kinematics, grid.camera, shape)
        return quadric_numbers(projector.primitives_cam(projector.frames(pose, self.rotation)))[..., 0]

    def fitted(self, image: Tensor | None) -> OpenHand:
        hand = fit_open_hand(self.mask, self.kinematics, self.camera, SETTINGS, image=image)
        assert isinstance(hand, OpenHand), hand
        return hand

    def bone_errors(self, hand: OpenHand) -> Tensor:
        """Of the bones' lengths, the hand's own length known; with its sign."""
        fit = hand.fit
        found = self.kinematics(fit.pose, fit.shape, root_reference=fit.root_reference).keypoints
        truth = self.kinematics(self.pose, self.shape, root_reference=self.rotation).keypoints
        ours, theirs = (torch.stack([(points[a] - points[b]).norm() for a, b in BONES]) for points in (found, truth))
        return ours / fit.shape[0] / (theirs / self.shape[0]) - 1


@cache
def scene(seed: int, noise: float = 2.0, blur_px: float = 0.0) -> Scene:
    """A random person's left hand, palm to the camera."""
    kinematics = load_hand_model().kinematics("left", dtype=torch.float64)
    generator = torch.Generator().manual_seed(seed)
    shape = sample_shape(kinematics.shape_space, generator)
    rotation = facing_rotation("palm")
    pose = posture("open")
    pose[:3] = torch.tensor((0.0, 0.0, 0.36)) - rotation @ torch.tensor((0.0, 0.09, 0.0), dtype=torch.float64)
    motion = Motion(name="still", poses=pose[None], root_reference=rotation, fps=30.0)
    look = SceneSettings(noise=noise, blur_px=blur_px)
    frame = next(iter(render_sequence(kinematics, motion, CAMERA, look, generator, shape=shape)))
    return Scene(
        kinematics=kinematics,
        camera=CAMERA,
        image=frame.image,
        mask=frame.mask,
        pose=pose,
        shape=shape,
        rotation=rotation,
    )


@cache
def without_shading(seed: int) -> OpenHand:
    return scene(seed).fitted(None)


def test_light_is_found_though_some_pixels_are_no_skin(generator: torch.Generator) -> None:
    normal = torch.nn.functional.normalize(torch.randn(3000, 3, generator=generator, dtype=torch.float64), dim=-1)
    normal[:, 2] = -normal[:, 2].abs()
    towards = torch.tensor((-40.0, -60.0, -70.0), dtype=torch.float64)
    value = 80 + (normal @ towards).clamp_min(0) + 0.5 * torch.randn(3000, generator=generator, dtype=torch.float64)
    value[:300] = 20.0
    light = fit_light(normal, value)
    assert light.ambient == pytest.approx(80, abs=0.5)
    torch.testing.assert_close(light.towards, towards, atol=0.7, rtol=0)
    found = light.brightness(normal[300:])
    assert float((found - value[300:]).abs().median()) < 0.5


@pytest.mark.parametrize("step", [1, 2])
def test_parts_are_those_of_the_ray_caster(step: int) -> None:
    case = scene(0)
    grid = case.grid(step)
    projector = HandProjector(case.kinematics, grid.camera, case.shape)
    seen = raycast(projector.primitives_cam(projector.frames(case.pose, case.rotation)), grid.camera)
    moved = 0.02 * torch.randn(case.problem.size, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    for nearest in (NearestParts(grid, case.numbers(grid)), NearestParts(grid, case.numbers(grid, moved))):
        part = nearest(case.numbers(grid))
        assert bool((part == seen.part.flatten())[grid.is_inside].all())
        assert bool((part[~grid.is_inside] == -1).all())


def test_rays_meet_surfaces_with_exact_derivatives(generator: torch.Generator) -> None:
    case = scene(0)
    grid = case.grid(3)
    numbers = case.numbers(grid)
    part = NearestParts(grid, numbers)(numbers)
    square = (part >= 0).nonzero()[::7, 0]
    rays = grid.origin[square], grid.direction[square]
    seen = meet(numbers, part[square], *rays)
    keep = seen.is_kept()
    assert float(keep.double().mean()) > 0.9  # else the farther root is the one that is seen
    square, seen = square[keep], seen.select(keep)
    rays = grid.origin[square], grid.direction[square]
    weight = torch.randn(len(square), 3, generator=generator, dtype=torch.float64)
    change = torch.randn(37, 18, generator=generator, dtype=torch.float64) * numbers.abs() * 1e-6

    def measures(of: Tensor) -> list[Tensor]:
        at = meet(of, part[square], *rays)
        return [at.depth, (weight * at.gradient).sum(-1), at.room()]

    slopes = (seen.depth_slope(), seen.gradient_slope(weight), seen.room_slope())
    above, below = measures(numbers + change), measures(numbers - change)
    for slope, more, less in zip(slopes, above, below, strict=True):
        expected = 0.5 * (more - less)
        found = (slope * change[part[square]]).sum(-1)
        sound = expected.isfinite() & (seen.normal[:, 2] < -0.2)  # at the rim depth is no smooth function
        error = (found - expected)[sound].abs().median() / expected[sound].abs().median()
        assert float(error) < 1e-4


def test_jacobian_is_the_change_of_the_brightness(monkeypatch: pytest.MonkeyPatch) -> None:
    """In every square that goes on showing one part; under one light."""
    case = scene(1, noise=0.0)
    grid, problem = case.grid(2), case.problem
    shading = Shading(grid, problem, case.kinematics, case.rotation)
    zero = torch.zeros(problem.size, dtype=torch.float64)
    rows = shading(zero)
    assert rows.noise < 1.5
    assert len(rows.square) > 0.9 * rows.candidates
    found = torch.linalg.lstsq(rows.light, grid.value[rows.square][:, None]).solution[:, 0]
    light = Light(ambient=float(found[0]), towards=found[1:])
    monkeypatch.setattr(open_hand_shading, "fit_light", lambda *_: light)
    rows = shading(zero)
    generator = torch.Generator().manual_seed(2)
    for _ in range(3):
        direction = torch.randn(problem.size, generator=generator, dtype=torch.float64)
        more, less = shading(0.003 * direction), shading(-0.003 * direction)
        change = torch.full((len(grid.value), 2), torch.nan, dtype=torch.float64)
        change[more.square, 0], change[less.square, 1] = more.residual, less.residual
        measured = (change[:, 1] - change[:, 0])[rows.square] / 0.006
        predicted = rows.jacobian @ direction
        both = measured.isfinite() & (rows.variance == 0)
        error = (measured - predicted)[both].abs() / predicted[both].std()
        assert float(error.median()) < 0.01
        assert float((error < 0.05).double().mean()) > 0.85  # another part came into sight in the others


def test_thinned_squares_are_means_of_nine_or_single() -> None:
    case = scene(1, noise=0.0)
    grid = case.grid()
    near = torch.zeros_like(grid.is_inside).reshape(grid.size)
    near[40:60] = True
    thin = thinned(grid, near.flatten())
    assert bool((thin.is_inside & near.flatten() == grid.is_inside & near.flatten()).all())
    single = thin.is_inside & (thin.count == 1)
    assert bool((thin.value == grid.value)[single].all())
    assert not bool((single & ~near.flatten()).any())
    mean = torch.from_numpy(cv2.blur(grid.image(grid.value).numpy(), (3, 3))).flatten()
    cell = thin.is_inside & (thin.count == 9)
    torch.testing.assert_close(thin.value[cell], mean[cell])
    inner = cv2.erode(grid.is_inside.reshape(grid.size).numpy().astype(np.uint8), np.ones((3, 3), np.uint8))
    assert bool(torch.from_numpy(inner).bool().flatten()[cell].all())
    outside = int((grid.is_inside & ~near.flatten()).sum())
    assert 0.5 < 9 * int(cell.sum()) / outside < 1


def test_joints_far_from_their_places_are_moved_back() -> None:
    """The last ones of the fingers by 3 mm, where all else is right."""
    case = scene(3)
    problem = case.problem
    shading = Shading(case.grid(), problem, case.kinematics, case.rotation)
    names = [case.kinematics.shape_space.names[i] for i in problem.free_shape.tolist()]
    middle, distal = (
        torch.tensor([len(problem.free_pose) + names.index(f"{finger}_{bone}") for finger in FINGERS[1:]])
        for bone in ("middle", "distal")
    )
    off = torch.zeros(problem.size, dtype=torch.float64)
    off[middle], off[distal] = 0.015 / problem.std[middle], -0.015 / problem.std[distal]
    moved = moved_joints(shading, problem, off, next(shading.without_slopes(off[None])), 2.0)
    assert float((moved[middle].abs() / off[middle]).mean()) < 0.5
    assert float((moved[distal].abs() / off[distal].abs()).mean()) < 0.5
    still = torch.zeros_like(off)
    torch.testing.assert_close(moved_joints(shading, problem, still, shading(still), 2.0), still)


def test_rows_are_the_same_without_slopes() -> None:
    case = scene(3)
    shading = Shading(case.grid(2), case.problem, case.kinematics, case.rotation)
    values = 0.05 * torch.stack((torch.zeros(case.problem.size).double(), torch.ones(case.problem.size).double()))
    for rows, own in zip(shading.without_slopes(values), values, strict=True):
        expected = shading(own)
        assert rows.jacobian.shape == (len(expected.residual), 0)
        torch.testing.assert_close(rows.square, expected.square)
        torch.testing.assert_close(rows.residual, expected.residual, rtol=0, atol=1e-9)


def bent(case: Scene, radians: float) -> Tensor:
    """Values with the index finger bent at its middle joint."""
    problem = case.problem
    number = problem.free_pose.tolist().index(DOFS.index("index_pip_fe"))
    values = torch.zeros(problem.size, dtype=torch.float64)
    values[number] = radians / problem.std[number]
    return values


def test_squares_that_a_bent_finger_has_left_cost_as_much_as_the_grossest() -> None:
    case = scene(3)
    problem = case.problem
    shading = Shading(case.grid(2), problem, case.kinematics, case.rotation)
    straight, off = (shading(values) for values in (bent(case, 0.0), bent(case, 1.2)))
    assert straight.lost == 0
    assert off.lost > 10
    outline = Outline(mask_plane(case.mask), problem, case.kinematics, case.camera, case.rotation, SETTINGS)
    term = outline.term(bent(case, 0.0), SETTINGS.final_search_share, is_fine=True)
    assert term is not None
    cost = JointCost(shading, ShadingStage(side=1.0, most=6.0), problem, term, 2.0)
    with_lost, without = (cost.equations(bent(case, 1.2), replace(off, lost=lost)) for lost in (off.lost, 0.0))
    assert float(with_lost.cost - without.cost) == pytest.approx(0.5 * off.lost * 3.0**2)


def test_outline_away_from_where_its_edges_were_found(generator: torch.Generator) -> None:
    """The cost's gradient is that of the edges found; bending, which the linear model hardly sees, costs."""
    case = scene(3)
    outline = Outline(mask_plane(case.mask), case.problem, case.kinematics, case.camera, case.rotation, SETTINGS)
    start = bent(case, 0.0)
    term = outline.term(start, SETTINGS.final_search_share, is_fine=True)
    assert term is not None
    here = term.equations(start)
    torch.testing.assert_close(here.gradient, -term.pull)
    torch.testing.assert_close(here.matrix, term.information)
    way = 1e-4 * torch.randn(len(start), generator=generator, dtype=torch.float64)
    change = 0.5 * (term.equations(start + way).cost - term.equations(start - way).cost)
    torch.testing.assert_close(change, here.gradient @ way, rtol=1e-3, atol=1e-6)
    off = bent(case, 1.2)
    linear = here.cost + here.gradient @ off + 0.5 * off @ (here.matrix @ off)
    assert float(term.equations(off).cost) > 2 * float(linear)


def test_joints_are_where_the_shading_has_them_and_deviations_are_honest() -> None:
    case = scene(3)
    plain, shaded = without_shading(3), case.fitted(case.image)
    assert not plain.is_shaded
    assert shaded.is_shaded
    errors = case.bone_errors(shaded).abs()
    assert float(errors.median()) < 0.03
    assert float(errors.mean()) < 0.65 * float(case.bone_errors(plain).abs().mean())
    space = case.kinematics.shape_space
    bones = [i for i, name in enumerate(space.names) if name.endswith(("proximal", "middle", "distal"))]
    scaled = ((shaded.fit.shape - case.shape) / shaded.fit.shape_std)[bones]
    assert 0.2 < float(scaled.square().mean().sqrt()) < 2.5


def no_lambertian(image: Tensor, mask: Tensor, kind: str) -> Tensor:
    """Other pictures of the same silhouette."""
    picture = image.numpy().astype(np.float32)
    rng = np.random.default_rng(0)
    inside = mask.numpy()[..., None]
    if kind == "skin with veins":
        texture = cv2.GaussianBlur(rng.normal(size=mask.shape).astype(np.float32), (0, 0), 4.0)
        picture = np.where(inside, picture * (1 + 0.15 * texture / texture.std())[..., None], picture)
    elif kind == "soft light":  # as in the shade: brightness falls towards the edges, whatever the surface's slope
        depth = cv2.distanceTransform(mask.numpy().astype(np.uint8), cv2.DIST_L2, 5)
        picture = np.where(inside, 150 + 12 * np.sqrt(depth)[..., None] + rng.normal(0, 2, picture.shape), picture)
    else:
        second = np.linspace(0.6, 1.3, mask.shape[1], dtype=np.float32)[None, :, None]
        picture = np.where(inside, picture * second, picture)
    return torch.from_numpy(picture.clip(0, 255).astype(np.uint8))


@pytest.mark.parametrize("kind", ["skin with veins", "soft light", "light from nearby"])
def test_shading_that_no_single_light_explains_is_left_alone(kind: str) -> None:
    case = scene(3)
    other = case.fitted(no_lambertian(case.image, case.mask, kind))
    assert not other.is_shaded
    torch.testing.assert_close(other.fit.shape, without_shading(3).fit.shape, atol=0, rtol=0)


def test_a_picture_without_a_hand_to_compare_is_left_alone() -> None:
    case = scene(3)
    assert pixel_grid(case.image, torch.zeros_like(case.mask), case.camera, 2) is None
    assert pixel_grid(case.image, case.mask, case.camera, 1000) is None


def test_soft_edges_are_where_the_colours_change(generator: torch.Generator) -> None:
    """Of a disc drawn with soft edges and a mask that is off by a pixel or two."""
    rows, columns = torch.meshgrid(torch.arange(160.0), torch.arange(200.0), indexing="ij")
    radius = ((rows - 80) ** 2 + (columns - 100) ** 2).sqrt()
    share = (50.3 - radius + 0.5).clamp(0, 1)
    own, other = torch.tensor((200.0, 150.0, 120.0)), torch.tensor((90.0, 110.0, 130.0))
    colour = share[..., None] * own + (1 - share[..., None]) * other + 2 * torch.randn(160, 200, 3, generator=generator)
    image = colour.clamp(0, 255).to(torch.uint8)
    for off in (-1.5, 0.0, 1.5):
        soft = soft_silhouette(image, radius < 50.3 + off)
        assert soft is not None
        assert float((soft - share).abs().mean()) < 0.01
        assert float(soft.sum()) == pytest.approx(float(share.sum()), rel=0.01)
    assert soft_silhouette(torch.full((160, 200, 3), 100, dtype=torch.uint8), radius < 50) is None


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("squares_along", 10),
        ("shading_iterations", 0),
        ("most_shading_misfit", 0.0),
        ("most_shading_rest", -1.0),
        ("most_shading_excess", 1.0),
        ("shading_std_factor", 0.5),
    ],
)
def test_settings_name_what_is_wrong(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        replace(OpenHandSettings(), **{field: value})
