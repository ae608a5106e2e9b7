"""The compiled z-buffer: what the tensor operations draw, as numba runs it, and as Python runs the same lines."""

import inspect
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import posture
from torchhand.view import rasterize, rasterize_many
from torchhand.view.raster import compiled

Compiled = Callable[..., None]


def by_python() -> Compiled:
    def quiet(*arrays: np.ndarray) -> None:
        with np.errstate(all="ignore"):
            inspect.unwrap(compiled._fill)(*arrays)

    return quiet


def by_numba() -> Compiled:
    pytest.importorskip("numba", reason="needs numba: pip install torchhand[fast]")
    found = compiled._compiled()
    assert found is not None
    return found


@pytest.fixture(params=[by_python, by_numba])
def drawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Tensor, ...]]:
    """Faces and depths by the loop, and by tensor operations."""
    fill = request.param()

    def both(vertices: Tensor, faces: Tensor, camera: Camera, *, is_closed: bool) -> tuple[Tensor, ...]:
        monkeypatch.setattr(compiled, "_compiled", lambda: fill)
        own = rasterize_many(vertices, faces, camera, is_closed=is_closed)
        monkeypatch.setattr(compiled, "_compiled", lambda: None)
        return *own, *rasterize_many(vertices, faces, camera, is_closed=is_closed)

    return both


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("is_closed", [True, False])
def test_hands_are_drawn_as_by_tensor_operations(drawn: Callable, dtype: torch.dtype, is_closed: bool) -> None:
    """Also one that reaches behind the camera, which is cut, and one that leaves the picture."""
    hand = load_hand_model().hand(dtype=dtype)
    poses = torch.stack([posture(name) for name in ("open", "fist", "point", "open")]).to(dtype)
    poses[:, :3] = torch.tensor(((0.0, -0.08, 0.5), (0.02, -0.05, 0.4), (0.0, 0.0, 0.1), (0.1, -0.08, 0.3)))
    poses[2, 3] = -1.5
    vertices = hand(poses).vertices
    assert (vertices[2, :, 2] < 0).any()
    camera = assumed_camera(50, 40, dtype=dtype, horizontal_fov_deg=30.0)
    face, depth, other_face, other_depth = drawn(vertices, hand.faces, camera, is_closed=is_closed)
    assert torch.equal(face, other_face)
    torch.testing.assert_close(depth, other_depth, rtol=2e-6 if dtype == torch.float32 else 1e-13, atol=0)
    assert ((face >= 0).sum((1, 2)) > 100).all()


def test_corners_on_pixels_and_triangles_without_area(drawn: Callable) -> None:
    """Corners at the centres of pixels, level edges, equal depths (the first face counts), slivers and points; heights
    by which edges are cut without rounding, for fused products round otherwise."""
    generator = torch.Generator().manual_seed(0)
    points = torch.randint(-2, 12, (3, 40, 3), generator=generator).float()
    points[..., 1] = 4 * torch.randint(0, 3, (3, 40), generator=generator)
    points[..., 2] = 2 ** torch.randint(0, 3, (3, 40), generator=generator)
    points[..., :2] *= points[..., 2:]
    faces = torch.randint(0, 40, (60, 3), generator=generator)  # some with the same corner twice
    camera = assumed_camera(10, 9, dtype=torch.float32)
    camera.intrinsics.copy_(torch.eye(3))
    face, depth, other_face, other_depth = drawn(points, faces, camera, is_closed=False)
    assert torch.equal(face, other_face)
    torch.testing.assert_close(depth, other_depth, rtol=1e-6, atol=0)
    for own, seen in zip(points, face, strict=True):
        assert torch.equal(seen, rasterize(own, faces, camera).part)
