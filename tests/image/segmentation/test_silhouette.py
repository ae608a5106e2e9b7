"""The whole way from a frame to one mask."""

import pytest
import torch

from torchhand.image.segmentation.background import learn_background
from torchhand.image.segmentation.silhouette import SilhouetteSettings, segment
from torchhand.image.segmentation.skin import learn_skin

SKIN, SCREEN = (205, 150, 125), (30, 80, 170)


def frame(generator: torch.Generator, size: tuple[int, int] = (240, 320)) -> tuple[torch.Tensor, torch.Tensor]:
    """Blue screen, a block of skin with a small hole and a larger ring hole, and a second smaller block."""
    height, width = size
    s = height // 240
    image = torch.tensor(SCREEN, dtype=torch.float32).expand(height, width, 3).clone()
    mask = torch.zeros(size, dtype=torch.bool)
    mask[60 * s : 200 * s, 80 * s : 200 * s] = True
    truth = mask.clone()
    truth[130 * s : 170 * s, 100 * s : 140 * s] = False
    seen = truth.clone()
    seen[80 * s : 86 * s, 150 * s : 156 * s] = False
    seen[20 * s : 40 * s, 250 * s : 270 * s] = True
    image = torch.where(seen[..., None], torch.tensor(SKIN, dtype=torch.float32), image)
    image = image + 4.0 * torch.randn(height, width, 3, generator=generator)
    return image.clamp(0, 255).to(torch.uint8), truth


@pytest.mark.parametrize("method", ["skin", "background", "chroma"])
def test_methods_find_the_block(generator: torch.Generator, method: str) -> None:
    image, truth = frame(generator)
    empty = torch.tensor(SCREEN, dtype=torch.uint8).expand(1, 240, 320, 3).contiguous()
    settings = SilhouetteSettings(method=method, key_hue_deg=218.0)  # pyright: ignore[reportArgumentType]
    mask = segment(image, settings, skin=learn_skin(image, truth), plate=learn_background(empty))
    assert float((mask & truth).sum()) / float((mask | truth).sum()) > 0.99
    assert bool(mask[82, 152])  # the small hole is filled
    assert not bool(mask[150, 120])  # the large one stays
    assert not bool(mask[30, 260])  # the smaller piece is left out


def test_settings_decide_on_pieces_and_holes(generator: torch.Generator) -> None:
    image, truth = frame(generator)
    skin = learn_skin(image, truth)
    assert bool(segment(image, SilhouetteSettings(largest_only=False), skin=skin)[30, 260])
    assert bool(segment(image, SilhouetteSettings(max_hole_fraction=0.1), skin=skin)[150, 120])
    assert not bool(segment(image, SilhouetteSettings(max_hole_fraction=0.0), skin=skin)[82, 152])


@pytest.mark.parametrize("gains", [(0.4, 0.42, 0.5), (1.35, 1.3, 1.25)])
def test_a_plate_is_that_of_the_scene_in_any_light(generator: torch.Generator, gains: tuple[float, ...]) -> None:
    """A camera that finds its exposure anew when a hand comes in changes all of the picture."""
    image, truth = frame(generator)
    empty = torch.tensor(SCREEN, dtype=torch.uint8).expand(1, 240, 320, 3).contiguous()
    other = (image * torch.tensor(gains)).clamp(0, 255).to(torch.uint8)
    settings = SilhouetteSettings(method="background", darkest_shadow=1.0)
    mask = segment(other, settings, plate=learn_background(empty))
    assert float((mask & truth).sum()) / float((mask | truth).sum()) > 0.98


@pytest.mark.parametrize("method", ["skin", "background"])
def test_large_pictures_are_worked_on_reduced(generator: torch.Generator, method: str) -> None:
    image, truth = frame(generator, (960, 1280))
    empty = torch.tensor(SCREEN, dtype=torch.uint8).expand(1, 960, 1280, 3).contiguous()
    settings = SilhouetteSettings(method=method, max_side_px=320)  # pyright: ignore[reportArgumentType]
    mask = segment(image, settings, skin=learn_skin(image, truth), plate=learn_background(empty))
    assert mask.shape == truth.shape
    assert float((mask & truth).sum()) / float((mask | truth).sum()) > 0.98


def test_nothing_there_is_an_empty_mask(generator: torch.Generator) -> None:
    image, truth = frame(generator)
    skin = learn_skin(image, truth)
    wall = torch.tensor(SCREEN, dtype=torch.uint8).expand(240, 320, 3).contiguous()
    assert not segment(wall, skin=skin).any()


def test_skin_in_the_shade_is_found_but_no_rim_of_its_hue(generator: torch.Generator) -> None:
    image, truth = frame(generator)
    skin = learn_skin(image, truth)
    assert skin.dark_value > 90
    dark = torch.full_like(image, 20)
    dark[60:120, 80:200] = torch.tensor(SKIN, dtype=torch.uint8)
    dark[120:150, 100:160] = (torch.tensor(SKIN) * 0.4).to(torch.uint8)  # a finger in the shade
    dark[60:120, 200:203] = (torch.tensor(SKIN) * 0.4).to(torch.uint8)  # colour that bled over an edge
    lit = segment(dark, SilhouetteSettings(), skin=skin)
    assert not lit[125:145, 105:155].any()
    mask = segment(dark, SilhouetteSettings(shaded_skin=0.5), skin=skin)
    assert mask[124:146, 104:156].all()
    assert not mask[65:115, 201:].any()
    assert not segment(dark, SilhouetteSettings(shaded_skin=0.9), skin=skin)[125:145, 105:155].any()


def test_missing_models_are_named() -> None:
    image = torch.zeros(20, 20, 3, dtype=torch.uint8)
    with pytest.raises(ValueError, match=r"needs skin=learn_skin"):
        segment(image)
    with pytest.raises(ValueError, match=r"needs plate=learn_background"):
        segment(image, SilhouetteSettings(method="background"))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("method", "magic", "method must be one of skin, background, chroma, got 'magic'"),
        ("skin_threshold", 1.2, "skin_threshold must lie in 0..1, got 1.2"),
        ("shaded_skin", 1.5, "shaded_skin must lie in 0..1, got 1.5"),
        ("darkest_shadow", 0.0, "darkest_shadow must lie in 0.01..1"),
        ("background_threshold", 0.0, "background_threshold must be > 0"),
        ("key_hue_deg", 500.0, "key_hue_deg must lie in 0..360"),
        ("key_tolerance_deg", 180.0, "key_tolerance_deg must lie between 0 and 180"),
        ("clean_radius_px", -1, "clean_radius_px must be >= 0"),
        ("max_hole_fraction", 2.0, "max_hole_fraction must lie in 0..1"),
        ("max_side_px", 4, "max_side_px must be >= 16"),
    ],
)
def test_settings_name_what_is_wrong(field: str, value: object, message: str) -> None:
    settings = SilhouetteSettings()
    object.__setattr__(settings, field, value)
    with pytest.raises(ValueError, match=message):
        settings.__post_init__()
