"""Labelled crops: labels that agree with each other and with the pictures, the same again from the same seed."""

import cv2
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from torchhand.devices import sent_to
from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera
from torchhand.hand import posture
from torchhand.image import intersection_over_union
from torchhand.simulate.crops import CropMaker, Crops, CropSettings, CropStream
from torchhand.view import SoftRenderer, rasterize, rasterize_many

PLAIN = CropSettings(forearm=0.0, occluder=0.0, noise=(0.0, 0.0), views=2)


def made(settings: CropSettings, people: int = 6, seed: int = 0) -> Crops:
    generator = torch.Generator().manual_seed(seed)
    return next(CropMaker(load_hand_model(), settings, generator).batches(people, generator))


@pytest.fixture(scope="module")
def plain() -> Crops:
    return made(PLAIN)


def test_the_labels_pose_the_hand_that_the_mask_shows(plain: Crops) -> None:
    """Pose, shape, side and camera give the keypoints, and the silhouette that the mask is."""
    model = load_hand_model()
    for index in range(len(plain)):
        hand = model.hand(side="left" if plain.is_left[index] else "right")
        state = hand(plain.pose[index], plain.shape[index])
        torch.testing.assert_close(state.keypoints, plain.keypoints[index], atol=2e-6, rtol=0)
        camera = assumed_camera(128, 128, dtype=torch.float32)
        camera.intrinsics.copy_(plain.intrinsics[index])
        torch.testing.assert_close(camera.project(state.keypoints), plain.keypoints_px[index], atol=0.02, rtol=0)
        exact = SoftRenderer(hand.faces).silhouette(state.vertices, camera) > 0.5
        assert float(intersection_over_union(exact, plain.mask[index])) > 0.97  # of areas here, of rays there
        depth = rasterize(state.vertices, hand.faces, camera, is_closed=True).depth
        both = exact & plain.mask[index] & depth.isfinite()
        assert float((depth - plain.depth[index])[both].abs().median()) < 1.5e-3
    assert plain.is_left.any()
    assert not plain.is_left.all()


def test_several_cameras_see_one_hand(plain: Crops) -> None:
    one, other = plain.keypoints[::2], plain.keypoints[1::2]
    assert torch.equal(plain.person[::2], plain.person[1::2])
    assert torch.equal(plain.pose[::2, 6:], plain.pose[1::2, 6:])
    torch.testing.assert_close(torch.cdist(one, one), torch.cdist(other, other), atol=1e-5, rtol=0)
    assert float((plain.pose[::2, 3:6] - plain.pose[1::2, 3:6]).norm(dim=-1).min()) > 0.1


def test_the_picture_shows_the_hand_where_the_mask_is(plain: Crops) -> None:
    """Inside and outside of the mask differ more in colour than each is spread over a few px along its edge."""
    for image, mask in zip(plain.image.numpy(), plain.mask.numpy().astype(np.uint8), strict=True):
        inner = cv2.erode(mask, np.ones((5, 5), np.uint8)) > 0
        assert inner.any()
        ratio = image[inner].astype(float).mean(0) + 1
        assert (ratio[0] >= 0.9 * ratio[2]).all()  # skin is redder than blue


def test_occluders_hide_parts_of_the_mask_and_forearms_do_not_count() -> None:
    settings = CropSettings(forearm=1.0, sleeve=0.0, occluder=1.0)
    crops, free = made(settings), made(PLAIN)
    arm = (crops.depth > 0) & ~crops.mask
    assert float(arm.sum((1, 2)).double().median()) > 100
    assert not (crops.mask & (crops.depth == 0)).any()
    assert torch.equal(free.mask, free.depth > 0)


def test_a_device_makes_the_crops_of_the_processor(device: torch.device) -> None:
    """Labels to rounding; pictures but for the pixels along outlines, which rounding gives to one side or the other."""
    settings = CropSettings(side_px=64, views=2)
    own = made(settings)
    generator = torch.Generator().manual_seed(0)
    there = next(CropMaker(load_hand_model(), settings, generator, device).batches(6, generator))
    assert {tensor.device.type for tensor in there.tensors().values()} == {device.type}
    crops = sent_to(there, torch.device("cpu"))
    for name in ("keypoints", "keypoints_px", "intrinsics", "pose", "shape"):
        torch.testing.assert_close(getattr(crops, name), getattr(own, name), atol=1e-3, rtol=1e-4)
    assert torch.equal(crops.is_left, own.is_left)
    assert float((crops.mask == own.mask).double().mean()) > 0.999
    assert float(((crops.image.int() - own.image.int()).abs() <= 2).double().mean()) > 0.99


def test_hands_can_be_held_upright() -> None:
    """Fingers upwards in the picture; from other sides as before."""
    crops = made(CropSettings(side_px=32, roll_deg=0.0, left=0.5), people=8)
    fingers = crops.keypoints[:, 9] - crops.keypoints[:, 0]
    across, up = fingers[:, 0], -fingers[:, 1]
    assert (up > 0).all()
    assert float((across.abs() / up).median()) < 0.15
    assert float(crops.pose[:, 3:6].std()) > 0.5


def test_the_same_seed_gives_the_same_crops_and_a_worker_its_own() -> None:
    settings = CropSettings(side_px=48)
    one, same, other = made(settings, 2), made(settings, 2), made(settings, 2, seed=1)
    for name, value in one.tensors().items():
        assert torch.equal(value, same.tensors()[name]), name
    assert not torch.equal(one.image, other.image)
    stream = CropStream(load_hand_model(), settings, batch=8, seed=3)
    first, again = (next(iter(DataLoader(stream, batch_size=None))) for _ in range(2))
    assert first["image"].shape == (8, 48, 48, 3)
    assert not torch.equal(first["image"], again["image"])
    with pytest.raises(ValueError, match="batch: expected a multiple of the 4 views, got 6"):
        CropStream(load_hand_model(), settings, batch=6)


def test_many_meshes_are_drawn_as_each_by_itself() -> None:
    hand = load_hand_model().hand()
    poses = torch.stack([posture(name) for name in ("open", "fist", "point")])
    poses[:, :3] = torch.tensor((0.0, -0.08, 0.5))
    vertices = hand(poses).vertices
    camera = assumed_camera(90, 70, dtype=torch.float32, horizontal_fov_deg=30.0)
    faces, depths = rasterize_many(vertices, hand.faces, camera, is_closed=True)
    for own, face, depth in zip(vertices, faces, depths, strict=True):
        alone = rasterize(own, hand.faces, camera, is_closed=True)
        assert torch.equal(alone.part, face)
        torch.testing.assert_close(alone.depth, depth)
    assert int((faces >= 0).sum()) > 300
