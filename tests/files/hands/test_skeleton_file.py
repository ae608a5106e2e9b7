"""skeleton.npz: what the parser read in the hand.urdf beside it, bit for bit; commands start without the parser."""

import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files.disk import models_dir
from torchhand.files.hands.skeleton_file import SKELETON_NAME, load_skeleton, save_parsed_skeleton
from torchhand.files.hands.urdf import read_skeleton

FOLDER = models_dir() / "generic_hand"


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    for name in ("hand.urdf", SKELETON_NAME):
        (tmp_path / name).write_bytes((FOLDER / name).read_bytes())
    return tmp_path / "hand.urdf"


def test_the_shipped_file_is_what_the_parser_reads() -> None:
    stored, parsed = load_skeleton(FOLDER / "hand.urdf"), read_skeleton(FOLDER / "hand.urdf")
    for field in fields(parsed):
        value, expected = getattr(stored, field.name), getattr(parsed, field.name)
        assert torch.equal(value, expected) if isinstance(expected, torch.Tensor) else value == expected, field.name


def test_a_model_loads_without_the_parser_and_what_it_brings() -> None:
    code = (
        "import sys; from torchhand.files import load_hand_model; load_hand_model();"
        "print([name for name in ('pytorch_kinematics', 'matplotlib', 'kornia', 'mujoco') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_an_edited_hand_is_parsed_anew(urdf: Path) -> None:
    before = load_skeleton(urdf)
    text = urdf.read_text()
    place = text.index('upper="') + len('upper="')
    urdf.write_text(text[:place] + "1.5" + text[text.index('"', place) :])
    assert float(load_skeleton(urdf).upper.sub(before.upper).abs().max()) > 0.01
    save_parsed_skeleton(urdf)
    assert torch.equal(load_skeleton(urdf).upper, read_skeleton(urdf).upper)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"axis": np.zeros((3, 3))}, "skeleton.npz: axis: expected numbers of shape"),
        ({"bone": np.zeros(30)}, "skeleton.npz: bone: expected integers"),
        ({"lower": np.full(30, np.nan)}, "skeleton.npz: expected finite numbers"),
    ],
)
def test_damaged_files_are_refused(urdf: Path, change: dict[str, np.ndarray], message: str) -> None:
    path = urdf.with_name(SKELETON_NAME)
    with np.load(path) as stored:
        arrays: dict[str, Any] = {**stored, **change}
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=message):
        load_skeleton(urdf)
    path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(InputError, match="is no parsed skeleton that can be read"):
        load_skeleton(urdf)
