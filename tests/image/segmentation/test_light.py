"""The light of a picture against that of an earlier one: gains found, other changes left alone."""

import pytest
import torch
from torch import Tensor

from torchhand.image import Light
from torchhand.image.segmentation import light as light_module

_GAINS = torch.tensor([0.4, 0.5, 0.6])


def _scene() -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.randint(60, 240, (120, 160, 3), generator=generator, dtype=torch.uint8)


def _in_light(image: Tensor, gains: Tensor) -> Tensor:
    return (image * gains).round().to(torch.uint8)


def test_another_light_is_told_and_undone_though_a_quarter_of_the_scene_changes() -> None:
    scene = _scene()
    later = _in_light(scene, _GAINS)
    later[:60, :80] = 100
    light = Light.of(scene)
    assert torch.allclose(light.gains_of(later), _GAINS, rtol=0.02)
    error = (light.undone(later).float() - scene.float()).abs()
    assert float(error[60:].max()) <= 5


def test_devices_without_opencv_see_the_same_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = _scene()
    later, light = _in_light(scene, _GAINS), Light.of(scene)
    by_opencv = light.undone(later)
    monkeypatch.setattr(light_module, "suits_opencv", lambda *_: False)
    assert torch.equal(light.undone(later), by_opencv)


def test_the_same_light_leaves_pictures_as_they_are() -> None:
    scene = _scene()
    assert Light.of(scene).undone(scene) is scene


def test_another_scene_is_no_light() -> None:
    scene = _scene()
    assert bool((Light.of(scene).gains_of(scene.flip(0) // 2) == 1).all())


def test_light_is_kept_from_picture_to_picture_and_at_any_size() -> None:
    scene = _scene()
    dark = _in_light(scene, _GAINS)
    later = Light.of(scene).later(dark)
    larger = dark.repeat_interleave(2, 0).repeat_interleave(2, 1)
    assert torch.allclose(later.gains_of(larger), _GAINS, rtol=0.02)
    assert torch.allclose(later.gains_of(scene), torch.ones(3), rtol=0.03)
