from dataclasses import replace
from typing import Any

import pytest
import torch

from torchhand.geometry import Camera
from torchhand.image import SilhouetteSettings, learn_background
from torchhand.simulate import named_rig
from torchhand.track.scene import PackedMask, ViewSilhouettes

SKIN, WALL = (205, 150, 125), (40, 70, 120)


def _picture(camera: Camera, hand: torch.Tensor) -> torch.Tensor:
    picture = torch.tensor(WALL, dtype=torch.uint8).expand(camera.height, camera.width, 3).clone()
    noise = torch.Generator().manual_seed(3)
    picture[hand] = torch.tensor(SKIN, dtype=torch.uint8)
    jitter = torch.randint(-6, 7, picture.shape, generator=noise, dtype=torch.int16)
    return (picture.to(torch.int16) + jitter).clamp(0, 255).to(torch.uint8)


def _disc(camera: Camera, centre: tuple[float, float], radius: float) -> torch.Tensor:
    x, y = torch.arange(camera.width)[None], torch.arange(camera.height)[:, None]
    return (x - centre[0]) ** 2 + (y - centre[1]) ** 2 < radius**2


def _iou(a: torch.Tensor, b: torch.Tensor) -> float:
    return float((a & b).sum() / (a | b).sum())


@pytest.fixture(scope="module")
def cameras() -> list[Camera]:
    return named_rig("frame2", size=(320, 240))


def test_skin_is_learned_in_every_view_and_found_in_later_pictures(cameras):
    makes = ViewSilhouettes(cameras)
    first = [_disc(camera, (100, 90), 40) for camera in cameras]
    skins = makes.learn([_picture(c, m) for c, m in zip(cameras, first, strict=True)], [None, None])
    later = [_disc(camera, (200, 140), 35) for camera in cameras]
    masks = makes([_picture(c, m) for c, m in zip(cameras, later, strict=True)], skins)
    for mask, expected in zip(masks, later, strict=True):
        assert mask is not None
        assert _iou(mask, expected) > 0.95


def test_clearest_picture_counts(cameras):
    makes = ViewSilhouettes(cameras)
    pictures = [_picture(camera, _disc(camera, (100, 90), 40)) for camera in cameras]
    clear = makes.learn(pictures, [None, None])
    noise = torch.Generator().manual_seed(4)
    pale = [(0.5 * p.float() + 90 * torch.rand(p.shape, generator=noise)).to(torch.uint8) for p in pictures]
    again = makes.learn(pale, clear)
    for skin, old in zip(again, clear, strict=True):
        assert skin is not None
        assert old is not None
        assert skin.model.log_ratio is old.model.log_ratio


def test_skin_is_as_dark_as_in_the_darker_pictures_but_one(cameras):
    """A part in the shade shows in some pictures only; the darkest may be mistaken."""
    makes = ViewSilhouettes(cameras)
    disc, skins = _disc(cameras[0], (100, 90), 40), [None, None]
    for fraction in (1.0, 0.9, 0.8, 0.7, 0.6):
        picture = _picture(cameras[0], disc)
        picture[disc] = (fraction * picture[disc].float()).to(torch.uint8)
        skins = makes.learn([picture, None], skins)
    skin = skins[0]
    assert skin is not None
    assert len(skin.dark_values) == 5
    assert skin.model.dark_value == sorted(skin.dark_values)[1]
    assert skin.model.dark_value < 0.85 * max(skin.dark_values)


def test_views_that_are_missing_or_unknown_have_no_silhouette(cameras):
    makes = ViewSilhouettes(cameras)
    picture = _picture(cameras[0], _disc(cameras[0], (100, 90), 40))
    skins = makes.learn([picture, None], [None, None])
    assert skins[1] is None
    masks = makes([None, picture], skins)
    assert masks == [None, None]


@pytest.mark.parametrize("has_lens", [False, True])
def test_a_hand_before_things_of_its_skin_is_cut_out_about_its_points(studio: Any, has_lens: bool) -> None:
    """In views whose pictures showed such things once; without points it is found by its skin as ever."""
    camera = studio.camera(320, 240, lens=has_lens)
    placed = studio.placed(size=0.5, camera=camera)
    makes = ViewSilhouettes([camera])
    [seen] = makes.undistorted([placed.mask])
    points = placed.keypoints_px
    points = makes.cameras[0].pixels_from_plane(camera.plane_from_pixels(points)) if has_lens else points
    plain = placed.picture(seed=1)
    clutter = plain.clone()
    bar = torch.zeros_like(placed.mask)
    row = int(placed.keypoints_px[6, 1])
    bar[row - 12 : row + 12] = True
    clutter[bar & ~placed.mask] = plain[placed.mask].float().mean(0).to(torch.uint8)

    [apart] = makes.learn([plain], [None], [points])
    assert apart is not None
    assert not apart.is_shared
    [shared] = makes.learn([clutter], [apart], [points])
    assert shared is not None
    assert shared.is_shared
    ahead = torch.arange(240)[:, None] < placed.keypoints_px[0, 1]
    [cut], [by_skin], [without] = (
        makes([clutter], [one], [at])
        for one, at in ((shared, points), (replace(shared, is_shared=False), points), (shared, None))
    )
    assert cut is not None
    assert by_skin is not None
    assert without is not None
    assert torch.equal(without, by_skin)
    assert seen is not None
    assert _iou(cut & ahead, seen & ahead) > 0.8
    assert _iou(by_skin & ahead, seen & ahead) < 0.7


def test_difference_from_the_empty_scene(cameras):
    empty = [_picture(camera, torch.zeros(camera.height, camera.width, dtype=torch.bool)) for camera in cameras]
    plates = [learn_background(picture[None]) for picture in empty]
    makes = ViewSilhouettes(cameras, SilhouetteSettings(method="background"), plates=plates)
    expected = [_disc(camera, (150, 100), 40) for camera in cameras]
    masks = makes([_picture(c, m) for c, m in zip(cameras, expected, strict=True)], [None, None])
    for mask, true in zip(masks, expected, strict=True):
        assert mask is not None
        assert _iou(mask, true) > 0.9


def test_plates_are_needed_for_every_camera(cameras):
    with pytest.raises(ValueError, match="plate of the empty scene for every camera"):
        ViewSilhouettes(cameras, SilhouetteSettings(method="background"))


def test_distortion_is_taken_away(cameras):
    lens = torch.tensor((-0.25, 0.08, 0.0, 0.0, 0.0), dtype=torch.float64)
    bent = [replace(camera, distortion=lens) for camera in cameras]
    makes = ViewSilhouettes(bent)
    assert not any(camera.has_distortion for camera in makes.cameras)
    # A ball near the corner, as the lens shows it and as the camera without it would.
    y, x = torch.meshgrid(torch.arange(240.0), torch.arange(320.0), indexing="ij")
    pixels = torch.stack((x, y), -1).double()
    seen = [
        ((camera.plane_from_pixels(pixels) - torch.tensor((0.35, 0.25), dtype=torch.float64)).norm(dim=-1) < 0.1)
        for camera in (bent[0], makes.cameras[0])
    ]
    found = makes.undistorted([seen[0], None])
    assert found[1] is None
    assert found[0] is not None
    assert _iou(found[0], seen[1]) > 0.97
    assert _iou(seen[0], seen[1]) < 0.9


def test_packed_mask_comes_back_as_it_was(generator) -> None:
    mask = torch.rand((13, 21), generator=generator) > 0.5
    packed = PackedMask.of(mask)
    assert packed.bits.nbytes <= mask.numel() // 8 + 1
    torch.testing.assert_close(packed.mask(), mask)
