"""Plates of the empty scene and coloured screens."""

import pytest
import torch

from torchhand.image.segmentation.background import background_mask, chroma_mask, learn_background


def empty_scene(frames: int, generator: torch.Generator) -> torch.Tensor:
    """Wall with a quiet and a flickering half."""
    wall = torch.full((frames, 60, 80, 3), 150.0)
    noise = torch.randn(frames, 60, 80, 3, generator=generator)
    noise[:, :, 40:] *= 12.0
    return (wall + noise).clamp(0, 255).to(torch.uint8)


def test_noise_is_learned_per_pixel(generator: torch.Generator) -> None:
    plate = learn_background(empty_scene(25, generator))
    assert float(plate.noise[:, 40:].mean()) == pytest.approx(12.0, rel=0.15)
    assert float(plate.noise[:, :40].max()) == pytest.approx(2.5)
    frame = empty_scene(1, generator)[0]
    frame[10:30, 10:30] += 18
    frame[10:30, 50:70] += 18
    mask = background_mask(frame, plate, threshold=5.0)
    assert float(mask[10:30, 10:30].float().mean()) > 0.9
    assert float(mask[10:30, 50:70].float().mean()) < 0.1  # the same step drowns in the flicker
    assert float(mask[35:].float().mean()) < 0.01


def test_shadow_is_forgiven_a_hand_is_not(generator: torch.Generator) -> None:
    plate = learn_background(torch.tensor([160, 150, 140], dtype=torch.uint8).expand(1, 40, 60, 3).contiguous())
    frame = plate.colour.clone()
    frame[5:15, 5:15] = torch.tensor([112, 105, 98], dtype=torch.uint8)  # 0.7 of the wall
    frame[5:15, 25:35] = torch.tensor([170, 110, 90], dtype=torch.uint8)
    frame[5:15, 45:55] = torch.tensor([40, 37, 35], dtype=torch.uint8)  # 0.25: too dark for a shadow
    mask = background_mask(frame, plate)
    assert not mask[5:15, 5:15].any()
    assert mask[5:15, 25:35].all()
    assert mask[5:15, 45:55].all()
    assert int(mask.sum()) == 200
    assert int(background_mask(frame, plate, darkest_shadow=1.0).sum()) == 300


def test_screen_is_keyed_out_by_hue() -> None:
    image = torch.tensor([30, 80, 170], dtype=torch.uint8).expand(20, 30, 3).clone()
    image[5:10, 5:10] = torch.tensor([200, 140, 120], dtype=torch.uint8)
    image[5:10, 15:20] = torch.tensor([120, 122, 125], dtype=torch.uint8)  # grey with a touch of blue
    mask = chroma_mask(image, 218.0)
    assert mask[5:10, 5:10].all()
    assert mask[5:10, 15:20].all()
    assert int(mask.sum()) == 50


def test_key_hue_wraps_around() -> None:
    image = torch.tensor([[[200, 10, 12], [200, 12, 10], [10, 200, 10]]], dtype=torch.uint8)
    for key in (0.0, 360.0, 355.0, 4.0):
        assert chroma_mask(image, key, tolerance_deg=10.0).tolist() == [[False, False, True]]


def test_messages() -> None:
    plate = learn_background(torch.zeros(1, 4, 5, 3, dtype=torch.uint8))
    image = torch.zeros(4, 5, 3, dtype=torch.uint8)
    with pytest.raises(ValueError, match=r"one size \(height, width\), got \(6, 5\) and \(4, 5\)"):
        background_mask(torch.zeros(6, 5, 3, dtype=torch.uint8), plate)
    with pytest.raises(ValueError, match="darkest_shadow must lie in"):
        background_mask(image, plate, darkest_shadow=0.0)
    with pytest.raises(ValueError, match=r"key_hue_deg must lie in 0\.\.360, got 400"):
        chroma_mask(image, 400.0)
    with pytest.raises(ValueError, match="tolerance_deg must lie between 0 and 180"):
        chroma_mask(image, 40.0, tolerance_deg=0.0)
    with pytest.raises(ValueError, match="at least one frame"):
        learn_background(torch.zeros(0, 4, 5, 3, dtype=torch.uint8))


def test_one_picture_is_its_own_median_and_costs_no_indices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the median are eight times as large as the picture."""
    scene = empty_scene(1, torch.Generator().manual_seed(4))
    expected = learn_background(scene.expand(2, -1, -1, -1))
    monkeypatch.setattr(torch.Tensor, "median", None)
    plate = learn_background(scene)
    assert torch.equal(plate.colour, expected.colour)
    assert torch.equal(plate.noise, expected.noise)
