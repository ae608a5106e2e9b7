"""Finding skin with nothing known: painted hands, bare walls."""

import cv2
import numpy as np
import pytest
import torch

from torchhand.image.segmentation.skin_start import bootstrap_skin, is_grey, otsu_cr_mask

WALLS = {"grey": (140, 140, 140), "lilac": (150, 145, 160), "greenish": (120, 128, 118), "dark": (25, 25, 27)}
SKINS = {"pale": (225, 175, 155), "brown": (140, 95, 72), "dark": (90, 58, 44), "pink": (215, 140, 120)}


def scene(
    wall: tuple[int, int, int],
    skin: tuple[int, int, int] | None,
    generator: torch.Generator,
    size: tuple[int, int] = (240, 320),
) -> tuple[torch.Tensor, torch.Tensor]:
    """Vignetted, noisy wall with a hand-like shape of fingers on a palm, and a smaller yellow disc."""
    height, width = size
    shape = np.zeros(size, np.uint8)
    scale = height / 240.0
    if skin is not None:
        cv2.circle(shape, (int(160 * scale), int(150 * scale)), int(38 * scale), 1, -1)
        for tip in (90, 125, 160, 195, 232):
            start, end = (int(160 * scale), int(150 * scale)), (int(tip * scale), int(60 * scale))
            cv2.line(shape, start, end, 1, int(14 * scale))
    image = np.empty((height, width, 3), np.float32)
    image[:] = wall
    if skin is not None:
        cv2.circle(image, (int(40 * scale), int(200 * scale)), int(15 * scale), (230.0, 200.0, 40.0), -1)
        image[shape > 0] = skin
    y, x = np.mgrid[0:height, 0:width]
    image *= (1.0 - 0.35 * np.hypot(x / width - 0.5, y / height - 0.5))[..., None]
    image += 3.0 * torch.randn(height, width, 3, generator=generator).numpy()
    return torch.from_numpy(np.clip(image, 0, 255).astype(np.uint8)), torch.from_numpy(shape > 0)


@pytest.mark.parametrize("wall", WALLS)
@pytest.mark.parametrize("skin", SKINS)
def test_painted_hand_is_found(generator: torch.Generator, wall: str, skin: str) -> None:
    image, truth = scene(WALLS[wall], SKINS[skin], generator)
    start = bootstrap_skin(image)
    assert start.has_skin
    assert start.reason == ""
    overlap = float((start.mask & truth).sum()) / float((start.mask | truth).sum())
    assert overlap > 0.93
    assert start.separability > 1.2
    assert start.area_fraction == pytest.approx(float(truth.float().mean()), rel=0.07)


@pytest.mark.parametrize("wall", [*WALLS.values(), (200, 190, 175), (90, 110, 150)])
def test_bare_wall_has_no_skin(generator: torch.Generator, wall: tuple[int, int, int]) -> None:
    image, _ = scene(wall, None, generator)
    split = otsu_cr_mask(image)
    assert 0.05 < float(split.mask.float().mean()) < 0.95  # Otsu splits it all the same ...
    assert split.contrast < 6.0
    start = bootstrap_skin(image)
    assert not start.has_skin
    assert start.reason
    assert not start.mask.any()


def test_skin_coloured_wall_is_no_hand(generator: torch.Generator) -> None:
    image, _ = scene((205, 160, 140), None, generator)
    assert not bootstrap_skin(image).has_skin


def test_flat_picture_is_no_hand() -> None:
    start = bootstrap_skin(torch.full((40, 50, 3), 7, dtype=torch.uint8))
    assert not start.has_skin
    assert otsu_cr_mask(torch.full((40, 50, 3), 7, dtype=torch.uint8)).contrast == 0.0


def test_work_at_reduced_size_gives_a_mask_of_full_size(generator: torch.Generator) -> None:
    image, truth = scene(WALLS["lilac"], SKINS["pale"], generator, size=(480, 640))
    start = bootstrap_skin(image, max_side_px=200)
    assert start.mask.shape == (480, 640)
    assert float((start.mask & truth).sum()) / float((start.mask | truth).sum()) > 0.95


def test_otsu_measures_match_their_definition(generator: torch.Generator) -> None:
    image, truth = scene(WALLS["grey"], SKINS["pink"], generator)
    split = otsu_cr_mask(image)
    red, green, blue = image.double().unbind(-1)
    cr = (0.713 * (red - (0.299 * red + 0.587 * green + 0.114 * blue)) + 128.0).round().clamp(0, 255)
    inside, outside = cr[split.mask], cr[~split.mask]
    assert split.contrast == pytest.approx(float(inside.mean() - outside.mean()), abs=0.1)
    assert float((split.mask & truth).sum()) > 0.98 * float(truth.sum())


def test_a_grey_picture_is_called_grey(generator: torch.Generator) -> None:
    """Not one of skin's size that is missing: the user can do something about it. A dull but coloured one is not."""
    image, _ = scene(WALLS["grey"], SKINS["pink"], generator)
    grey = image.double().mean(-1, keepdim=True).round().to(torch.uint8).expand(-1, -1, 3).contiguous()
    start = bootstrap_skin(grey)
    assert is_grey(grey)
    assert not start.has_skin
    assert start.reason.startswith("the picture is grey")
    assert "--" not in start.reason  # each command has options of its own
    assert not is_grey(image)
    wall, _ = scene((205, 160, 140), None, generator)
    assert "grey" not in bootstrap_skin(wall).reason
