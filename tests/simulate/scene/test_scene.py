"""Rendered frames against the projection of the same hand."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import Hand, place_primitives, posed_mesh, posture
from torchhand.simulate.motion import Motion, facing, scripted_motion
from torchhand.simulate.scene.backgrounds import BACKGROUNDS, background_picture
from torchhand.simulate.scene.scene import SKIN_TONES, RenderedFrame, SceneSettings, render_sequence
from torchhand.view import HandProjector, raycast, silhouette

CAMERA = assumed_camera(120, 96, horizontal_fov_deg=48.0)
KINEMATICS = load_hand_model().kinematics("right", dtype=torch.float64)
FLAT = SceneSettings(background="dark", noise=0.0, ambient=1.0)
"""No light and shadow: the share of skin in a pixel can be read off its colour."""


def _motion(name: str = "free", frames: tuple[int, ...] = (0, 45), camera: Camera = CAMERA) -> Motion:
    motion = scripted_motion(name, 60, KINEMATICS, camera, torch.Generator().manual_seed(2))
    return replace(motion, poses=motion.poses[list(frames)])


def _render(motion: Motion, scene: SceneSettings, *, seed: int = 1, camera: Camera = CAMERA) -> list[RenderedFrame]:
    return list(render_sequence(KINEMATICS, motion, camera, scene, torch.Generator().manual_seed(seed)))


def _coverage(frame: RenderedFrame) -> Tensor:
    """Share of each pixel that is skin, of a FLAT picture."""
    skin = 255 * torch.tensor(SKIN_TONES["light"], dtype=torch.float64)
    ground = frame.image[0, 0].double()
    return (frame.image.double() - ground).sum(-1) / (skin - ground).sum()


def _centroid(weight: Tensor) -> Tensor:
    rows, columns = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in weight.shape), indexing="ij")
    return torch.stack(((columns * weight).sum(), (rows * weight).sum())) / weight.sum()


def _within(mask: Tensor, other: Tensor) -> bool:
    """Whether a mask lies within another one grown by a pixel."""
    grown = cv2.dilate(other.numpy().astype(np.uint8), np.ones((3, 3), dtype=np.uint8))
    return not bool((mask.numpy() & (grown == 0)).any())


def test_keypoints_are_those_of_the_kinematics() -> None:
    distortion = torch.tensor((-0.2, 0.05, 0.001, -0.001), dtype=torch.float64)
    camera = replace(CAMERA, distortion=distortion, translation=torch.tensor((0.0, 0.0, 0.1), dtype=torch.float64))
    motion = _motion(camera=camera)
    for frame in _render(motion, replace(FLAT, supersampling=1), camera=camera):
        points = KINEMATICS(motion.poses[frame.index], root_reference=motion.root_reference).keypoints
        torch.testing.assert_close(frame.keypoints_cam, points + camera.translation, rtol=0, atol=1e-14)
        expected, _ = cv2.projectPoints(
            frame.keypoints_cam.numpy(), np.zeros(3), np.zeros(3), camera.intrinsics.numpy(), distortion.numpy()
        )
        np.testing.assert_allclose(frame.keypoints_px.numpy(), expected[:, 0], rtol=0, atol=1e-8)
        inside = frame.keypoints_px.round().long()
        assert frame.mask[inside[:, 1], inside[:, 0]].all()


@pytest.mark.parametrize("name", ["free", "planar_point"])
def test_the_mask_is_the_silhouette(name: str) -> None:
    motion = _motion(name)
    projector = HandProjector(KINEMATICS, CAMERA)
    for frame in _render(motion, replace(FLAT, supersampling=1)):
        silhouette = projector.silhouette(motion.poses[frame.index], motion.root_reference)
        assert _within(frame.mask, silhouette)
        assert _within(silhouette, frame.mask)
        assert frame.mask.sum() > 500


def test_edges_are_honest_below_a_pixel() -> None:
    """Light, integrated over the pixels, has the area and the centroid of a mask of eight times the resolution.

    A third of a pixel is the distance of the rays: half of that is what a mistake in placing them would give.
    """
    motion = _motion("planar", (0, 50))
    fine = CAMERA.resized(8.0)
    for frame in _render(motion, FLAT):
        coverage = _coverage(frame)
        frames = KINEMATICS(motion.poses[frame.index], root_reference=motion.root_reference)
        sizes = HandProjector(KINEMATICS, fine).sizes
        mask = raycast(place_primitives(frames, sizes), fine).mask.double()
        assert float(coverage.sum()) == pytest.approx(float(mask.sum()) / 64, rel=0.003)
        middle = (_centroid(mask) + 0.5) / 8 - 0.5
        assert (_centroid(coverage) - middle).abs().max() < 0.02
        partly = (coverage > 0.05) & (coverage < 0.95)
        assert partly.sum() > 100


def test_the_same_seed_gives_the_same_bits() -> None:
    scene = SceneSettings(background="clutter", noise=3.0, supersampling=1)
    first, again, other = (_render(_motion(), scene, seed=seed) for seed in (1, 1, 2))
    for one, two, three in zip(first, again, other, strict=True):
        assert torch.equal(one.image, two.image)
        assert not torch.equal(one.image, three.image)
        assert torch.equal(one.mask, three.mask)


def test_noise_has_the_strength_asked_for() -> None:
    scenes = (SceneSettings(noise=noise, supersampling=1) for noise in (0.0, 4.0))
    clean, noisy = (_render(_motion(frames=(0,)), scene)[0] for scene in scenes)
    difference = noisy.image.double() - clean.image.double()
    assert float(difference.std()) == pytest.approx(4.0, abs=0.15)
    assert float(difference.mean()) == pytest.approx(0.0, abs=0.1)


def test_lens_blur_widens_edges_and_keeps_the_light() -> None:
    sharp, soft = (_coverage(_render(_motion(), replace(FLAT, blur_px=b))[1]) for b in (0.0, 1.5))
    assert float(soft.sum()) == pytest.approx(float(sharp.sum()), rel=0.005)
    assert soft.diff(dim=1).abs().max() < 0.5 * sharp.diff(dim=1).abs().max()


def test_an_open_shutter_smears_around_the_middle_of_the_exposure() -> None:
    start = _motion("planar", (0,))
    poses = start.poses.repeat(3, 1)
    step = 6 * start.poses[0, 2] / CAMERA.intrinsics[0, 0]  # six pixels a frame
    poses[:, 0] += step * torch.arange(3, dtype=torch.float64)
    motion = replace(start, poses=poses)
    sharp, smeared = (_render(motion, replace(FLAT, shutter=s, supersampling=2)) for s in (0.0, 1.0))
    for one, two in zip(sharp, smeared, strict=True):
        assert torch.equal(one.mask, two.mask)
    still, moved = _coverage(sharp[1]), _coverage(smeared[1])
    assert (_centroid(still) - _centroid(moved)).abs().max() < 0.1  # of six pixels
    assert float(moved.sum()) == pytest.approx(float(still.sum()), rel=0.005)
    assert ((moved > 0.1) & (moved < 0.9)).sum() > 1.5 * ((still > 0.1) & (still < 0.9)).sum()


def test_the_forearm_goes_on_from_the_wrist_and_is_not_in_the_mask() -> None:
    motion = _motion("planar", (0,))
    without, with_arm = (_render(motion, replace(FLAT, forearm=forearm))[0] for forearm in (False, True))
    wrist = without.keypoints_px[0].round().long()
    below = (int(wrist[1]) + 12, int(wrist[0]))
    assert _coverage(without)[below] == 0
    assert float(_coverage(with_arm)[below]) == pytest.approx(1.0, abs=0.01)
    assert not with_arm.mask[below]
    assert _coverage(with_arm)[-1].max() > 0.99  # it leaves the picture at the bottom
    # The palm's rounded end may be covered by it, no more.
    hidden = without.mask & ~with_arm.mask
    assert not (with_arm.mask & ~without.mask).any()
    assert hidden.nonzero()[:, 0].min() >= int(wrist[1]) - 4 if hidden.any() else True


def test_a_hand_out_of_the_picture_leaves_the_background() -> None:
    motion = _motion("leave", (30,))
    frame = _render(motion, replace(FLAT, forearm=True))[0]
    assert not frame.mask.any()
    assert (frame.image == frame.image[0, 0]).all()
    assert frame.keypoints_px.isfinite().all()


def test_a_hand_close_to_the_camera_fills_the_picture() -> None:
    pose = posture("flat", dtype=torch.float64)
    pose[:3] = torch.tensor((0.0, 0.08, 0.05))
    motion = Motion(name="near", poses=pose[None], root_reference=facing("back"), fps=30.0)
    frame = _render(motion, replace(FLAT, forearm=True))[0]
    assert frame.mask.double().mean() > 0.5


@pytest.mark.parametrize("kind", BACKGROUNDS)
def test_backgrounds(kind: str) -> None:
    pictures = [background_picture(kind, 90, 60, torch.Generator().manual_seed(s)) for s in (1, 1, 2)]  # type: ignore[arg-type]
    assert pictures[0].shape == (60, 90, 3)
    assert torch.equal(pictures[0], pictures[1])
    spread = float(pictures[0].double().std((0, 1)).mean())
    spreads = {
        "plain": (0, 0),
        "dark": (0, 0),
        "wall": (1, 20),
        "clutter": (40, 100),
        "blue": (1, 20),
        "room": (25, 60),
    }
    low, high = spreads[kind]
    assert low <= spread <= high
    assert torch.equal(pictures[0], pictures[2]) == (kind in ("plain", "dark"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"noise": -1.0}, "noise: expected 0 to 100, got -1.0"),
        ({"shutter": 1.5}, "shutter: expected 0 to 1, got 1.5"),
        ({"blur_px": float("nan")}, "blur_px: expected 0 to 50, got nan"),
        ({"supersampling": 0}, "supersampling: expected 1 to 8, got 0"),
        ({"light": (0.0, 0.0, 0.0)}, "light: expected a direction"),
    ],
)
def test_wrong_settings_are_named(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SceneSettings(**change)


def test_the_mesh_can_be_drawn_instead_of_the_primitives() -> None:
    """The same place and light, another surface; the mask is the mesh's own."""
    hand = load_hand_model().hand(dtype=torch.float64)
    motion = _motion("planar", (0,))
    scene = replace(FLAT, surface="mesh", shutter=0.5, supersampling=2)

    def render(scene: SceneSettings, hand: Hand | None) -> RenderedFrame:
        return next(render_sequence(KINEMATICS, motion, CAMERA, scene, torch.Generator().manual_seed(1), hand=hand))

    quadrics, skin = render(replace(scene, surface="primitives"), None), render(scene, hand)
    state = hand(motion.poses[0], root_reference=motion.root_reference)
    assert torch.equal(skin.mask, silhouette(posed_mesh(hand, state), CAMERA))
    torch.testing.assert_close(skin.keypoints_cam, quadrics.keypoints_cam, rtol=0, atol=1e-12)
    differs = (_coverage(skin) - _coverage(quadrics)).abs()
    assert 0 < float(differs.mean()) < 0.1 * float(_coverage(quadrics).mean())
    assert torch.equal(render(scene, hand).image, skin.image)


def test_the_mesh_needs_a_hand_of_the_same_side() -> None:
    scene = SceneSettings(surface="mesh")
    for hand, got in ((None, "none"), (load_hand_model().hand(side="left", dtype=torch.float64), "a left one")):
        with pytest.raises(ValueError, match=f"hand: expected the right hand whose mesh is to be drawn, got {got}"):
            next(render_sequence(KINEMATICS, _motion(), CAMERA, scene, torch.Generator(), hand=hand))
