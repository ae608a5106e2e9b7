"""The shape vector: published ratios, bounds, and the lengths that it gives the skeleton."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from torchhand.errors import InputError
from torchhand.files import load_hand_model
from torchhand.files.hands import read_shape_space
from torchhand.hand.kinematics.shape import TIP_DEPTH, ShapeSpace, bone_offsets, offset_matrix
from torchhand.hand.kinematics.skeleton import BONES, FINGERS

# Buchholz, Armstrong and Goldstein 1992, fractions of hand length.
PHALANGES = {
    "thumb": (0.196, None, 0.158),
    "index": (0.245, 0.143, 0.097),
    "middle": (0.266, 0.170, 0.108),
    "ring": (0.244, 0.165, 0.107),
    "little": (0.204, 0.117, 0.093),
}
KNUCKLES = {"index": (0.447, 0.251), "middle": (0.446, 0.0), "ring": (0.409, -0.206), "little": (0.368, -0.402)}


def _space() -> ShapeSpace:
    return load_hand_model().shape_space


def _default(name: str) -> float:
    return float(_space().default[_space().names.index(name)])


def test_published_ratios() -> None:
    for finger, (proximal, middle, distal) in PHALANGES.items():
        assert _default(f"{finger}_proximal") == proximal
        assert _default(f"{finger}_distal") == distal
        if middle is not None:
            assert _default(f"{finger}_middle") == middle
    for finger, (along, across) in KNUCKLES.items():
        assert _default(f"{finger}_metacarpal") == along
        assert _default(f"{finger}_mcp_radial") == across
    assert _default("thumb_metacarpal") == 0.251
    assert (_default("hand_length"), _default("hand_breadth")) == (0.187, 0.083)


def test_bounds_hold_the_defaults_and_the_population() -> None:
    space = _space()
    assert bool((space.lower < space.default).all())
    assert bool((space.default < space.upper).all())
    assert bool((space.std > 0).all())
    assert len(set(space.names)) == len(space.names) == len(space.units)
    length, breadth = space.names.index("hand_length"), space.names.index("hand_breadth")
    assert float(space.lower[length]) < 0.145  # smallest and largest of ANSUR II
    assert float(space.upper[length]) > 0.239
    assert float(space.lower[breadth]) < 0.067
    assert float(space.upper[breadth]) > 0.105


def test_bones_have_the_lengths_of_the_shape() -> None:
    model = load_hand_model()
    shape = model.shape_space.default
    offsets, tips = bone_offsets(model.shape_space, shape, model.skeleton.rest_rotation[1:6])
    length, breadth = 0.187, 0.083
    for i, (finger, (proximal, middle, distal)) in enumerate(PHALANGES.items()):
        if middle is not None:
            assert float(offsets[BONES.index(f"{finger}_middle")].norm()) == pytest.approx(proximal * length)
            assert float(offsets[BONES.index(f"{finger}_distal")].norm()) == pytest.approx(middle * length)
        assert float(tips[i].norm()) == pytest.approx((distal - TIP_DEPTH) * length)
        if finger != "thumb":  # wrist to knuckle in the palm's plane
            metacarpal, base = (offsets[BONES.index(f"{finger}_{bone}")] for bone in ("proximal", "metacarpal"))
            knuckle = model.skeleton.rest_rotation[BONES.index(f"{finger}_metacarpal")] @ metacarpal + base
            expected = (KNUCKLES[finger][0] * length, KNUCKLES[finger][1] * breadth)
            assert knuckle[1:].tolist() == pytest.approx(expected, abs=1e-6)


def test_units() -> None:
    space = _space()
    metres = space.metric(space.default)
    assert float(metres["hand_length"]) == 0.187
    assert float(metres["index_proximal"]) == pytest.approx(0.245 * 0.187)
    assert float(metres["index_mcp_radius"]) == pytest.approx(0.1155 * 0.083)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop_and_the_matrix(batch: tuple[int, ...], generator: torch.Generator) -> None:
    model = load_hand_model()
    space, rest = model.shape_space, model.skeleton.rest_rotation[1:6]
    noise = torch.randn(*batch, len(space.names), generator=generator, dtype=torch.float64)
    shape = space.default + space.std * noise
    offsets, tips = bone_offsets(space, shape, rest)
    flat = [bone_offsets(space, row, rest) for row in shape.reshape(-1, len(space.names))]
    torch.testing.assert_close(offsets, torch.stack([o for o, _ in flat]).reshape(offsets.shape), atol=1e-16, rtol=0)
    torch.testing.assert_close(tips, torch.stack([t for _, t in flat]).reshape(tips.shape), atol=1e-16, rtol=0)
    product = (offset_matrix(space, rest) @ space.metres(shape)[..., None, :, None]).squeeze(-1)
    torch.testing.assert_close(torch.cat((offsets, tips), -2), product, atol=1e-15, rtol=0)


def test_derivatives() -> None:
    model = load_hand_model()
    shape = model.shape_space.default.clone().requires_grad_()
    rest = model.skeleton.rest_rotation[1:6]
    assert torch.autograd.gradcheck(lambda shape: bone_offsets(model.shape_space, shape, rest), (shape,))


def test_what_a_space_refuses(tmp_path: Path) -> None:
    space = _space()
    with pytest.raises(ValueError, match="units: expected m, /HL, /HB, got inch"):
        replace(space, units=("inch", *space.units[1:]))
    with pytest.raises(ValueError, match="lacks hand_length"):
        replace(space, names=("size", *space.names[1:]))
    path = tmp_path / "shape.json"
    path.write_text("{}")
    with pytest.raises(InputError, match="expected JSON with a list 'parameters'"):
        read_shape_space(path)
    path.write_text(
        json.dumps({"parameters": [{"name": "hand_length", "unit": "m", "default": 0.2, "lower": 0.1, "upper": 1}]})
    )
    with pytest.raises(InputError, match="parameter 'hand_length' lacks a number 'std'"):
        read_shape_space(path)
    with pytest.raises(InputError, match="no such file"):
        read_shape_space(tmp_path / "nothing.json")


def test_every_finger_has_its_parameters() -> None:
    for finger in FINGERS:
        for part in ("metacarpal", "proximal", "distal", "mcp_radius", "tip_radius"):
            assert f"{finger}_{part}" in _space().names
