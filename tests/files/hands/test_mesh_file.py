"""mesh.npz: written and read again, the same bytes every time, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files.disk import models_dir
from torchhand.files.hands.hand_model import MESH_NAME, load_hand_model
from torchhand.files.hands.mesh_file import load_mesh, save_mesh
from torchhand.hand import HandMesh

NAMES = ("hand_length", "hand_breadth")


def _mesh() -> HandMesh:
    generator = torch.Generator().manual_seed(0)

    def normal(*sizes: int) -> torch.Tensor:
        return torch.randn(*sizes, generator=generator, dtype=torch.float64)

    weights = torch.rand(5, 4, generator=generator, dtype=torch.float64)
    return HandMesh(
        vertices=normal(5, 3),
        faces=torch.tensor([[0, 1, 2], [2, 3, 4]]),
        shape_basis=normal(5, 3, 2),
        skin_bones=torch.randint(20, (5, 4), generator=generator),
        skin_weights=weights / weights.sum(-1, keepdim=True),
        bind_pose=normal(36),
        corrective_dofs=(3, 17),
        corrective_basis=normal(5, 3, 2, 2),
    )


def _changed(path: Path, **changes: Any) -> Path:
    """The file with some arrays replaced, or left out where the change is None."""
    with np.load(path) as stored:
        arrays = dict(stored) | changes
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    return path


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    save_mesh(_mesh(), tmp_path / "mesh.npz", shape_names=NAMES)
    return tmp_path / "mesh.npz"


def test_a_mesh_comes_back(stored: Path, tmp_path: Path) -> None:
    mesh, found = _mesh(), load_mesh(stored, shape_names=NAMES)
    for name in ("vertices", "shape_basis", "bind_pose", "corrective_basis", "skin_weights"):
        assert getattr(found, name).dtype == torch.float64
        torch.testing.assert_close(getattr(found, name), getattr(mesh, name), atol=1e-7, rtol=1e-7)
    assert torch.equal(found.faces, mesh.faces)
    assert torch.equal(found.skin_bones, mesh.skin_bones)
    assert found.corrective_dofs == mesh.corrective_dofs
    torch.testing.assert_close(found.skin_weights.sum(-1), torch.ones(5).double(), atol=1e-15, rtol=0)
    save_mesh(mesh, tmp_path / "again.npz", shape_names=NAMES)
    assert (tmp_path / "again.npz").read_bytes() == stored.read_bytes()


def test_a_model_folder_may_lack_a_mesh(tmp_path: Path) -> None:
    for name in ("hand.urdf", "shape.json"):
        (tmp_path / name).write_bytes((models_dir() / "generic_hand" / name).read_bytes())
    assert load_hand_model(str(tmp_path)).mesh is None


def test_a_model_folder_with_a_foreign_mesh_is_refused(stored: Path) -> None:
    assert stored.name == MESH_NAME
    for name in ("hand.urdf", "shape.json"):
        (stored.parent / name).write_bytes((models_dir() / "generic_hand" / name).read_bytes())
    with pytest.raises(InputError, match=r"mesh.npz: shape_names: expected \d+ names, got 2"):
        load_hand_model(str(stored.parent))


def test_names_must_match(stored: Path) -> None:
    with pytest.raises(InputError, match="shape_names: expected 'a' at place 0, got 'hand_length'"):
        load_mesh(stored, shape_names=("a", "hand_breadth"))
    with pytest.raises(ValueError, match="shape_names: expected 2, one per column of shape_basis, got 1"):
        save_mesh(_mesh(), stored, shape_names=NAMES[:1])
    _changed(stored, corrective_dofs=np.array(["index_pip_fe", "elbow"]))
    with pytest.raises(InputError, match="corrective_dofs: expected joint angles, got 'elbow'"):
        load_mesh(stored, shape_names=NAMES)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"format": None}, "expected a mesh .* got a file without 'format'"),
        ({"format": np.array("other 7")}, "expected a mesh .* got 'other 7'"),
        ({"faces": None, "bind_pose": None}, "lacks bind_pose, faces"),
        ({"faces": np.array([[0, 1, 5]])}, "faces: expected indices from 0 to 4, got others"),
        ({"faces": np.array([[0.0, 1.0, 2.0]])}, "faces: expected whole numbers, got float64"),
        ({"vertices": np.zeros((5, 2))}, r"vertices: expected the dimensions \(5, 3\), got \(5, 2\)"),
        ({"vertices": np.zeros((0, 3))}, r"vertices: expected the dimensions \(.*, 3\), got \(0, 3\)"),
        ({"vertices": np.zeros((5, 3), int)}, "vertices: expected floating-point numbers, got int64"),
        ({"shape_basis": np.zeros((5, 3, 4))}, r"shape_basis: expected the dimensions \(5, 3, 2\), got \(5, 3, 4\)"),
        ({"skin_weights": np.full((5, 4), 0.3)}, "skin_weights: expected weights of at least 0 that sum to 1"),
        ({"skin_weights": np.array([[2.0, -1.0, 0, 0]] * 5)}, "skin_weights: expected weights of at least 0"),
        ({"skin_bones": np.full((5, 4), 20)}, "skin_bones: expected indices from 0 to 19, got others"),
        ({"bind_pose": np.full(36, np.nan)}, "bind_pose: expected finite numbers, got NaN or infinite ones"),
        ({"bone_names": np.array(["wrist"])}, "bone_names: expected 20 names, got 1"),
        ({"vertices": np.array([None] * 5)}, "is no mesh that can be read"),
    ],
)
def test_broken_meshes_are_refused(changes: dict[str, Any], words: str, stored: Path) -> None:
    with pytest.raises(InputError, match=words) as caught:
        load_mesh(_changed(stored, **changes), shape_names=NAMES)
    assert str(stored) in str(caught.value)


def test_what_is_no_archive_is_refused(stored: Path) -> None:
    whole = stored.read_bytes()
    for content in (b"", b"no archive", whole[:200], whole[: len(whole) // 2], whole[:300] + b"xx" + whole[302:]):
        stored.write_bytes(content)
        with pytest.raises(InputError, match="is no mesh that can be read"):
            load_mesh(stored, shape_names=NAMES)
    np.save(stored.with_suffix(".npy"), np.zeros(3))
    with pytest.raises(InputError, match="expected a mesh"):
        load_mesh(stored.with_suffix(".npy"), shape_names=NAMES)
    with pytest.raises(InputError, match="cannot be read"):
        load_mesh(stored.parent / "nothing.npz", shape_names=NAMES)
