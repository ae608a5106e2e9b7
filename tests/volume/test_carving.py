"""Carving against a slow loop, dense carving, and the object itself: what is there is never carved away."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import Camera
from torchhand.hand import posed_mesh
from torchhand.view import silhouette
from torchhand.volume.carving import Carver, carve
from torchhand.volume.carving_settings import CarvingSettings
from torchhand.volume.cube import RootCube
from torchhand.volume.octree import BLACK, GRAY, UNKNOWN, WHITE, Octree

CUBE = RootCube(centre=(0.01, -0.02, 0.005), side=0.256)
CENTRE = torch.tensor((0.02, -0.01, 0.0), dtype=torch.float64)


def state_at(octree: Octree, points: Tensor, frame: int = 0) -> Tensor:
    """The state of the leaf that each point lies in; WHITE outside the root cube."""
    corner = torch.tensor(octree.root.corner, dtype=torch.float64)
    fraction = (points.double() - corner) / octree.root.side
    found = torch.full((len(points),), WHITE, dtype=torch.uint8)
    for level in octree.levels:
        grid = torch.full((2**level.level,) * 3, 255, dtype=torch.uint8)
        own = level.frames == frame
        grid[tuple(level.cells[own].long().T)] = level.states[own]
        cell = (fraction * 2**level.level).floor().long()
        inside = ((cell >= 0) & (cell < 2**level.level)).all(-1)
        there = grid[tuple(cell[inside].T)]
        place = inside.nonzero()[:, 0][there != 255]
        found[place] = there[there != 255]
    return found


def loop_states(
    masks: list[Tensor], cameras: list[Camera], root: RootCube, level: int, margin: int, min_views: int, tolerated: int
) -> np.ndarray:
    """The specification: every finest octant's pixels, one octant and view at a time, in float64."""
    n, side = 2**level, root.side / 2**level
    states = np.zeros((n, n, n), np.uint8)
    for cell in np.ndindex(n, n, n):
        out = bare = against = inner = 0
        for mask, camera in zip(masks, cameras, strict=True):
            centre = np.array(root.corner) + side * (np.array(cell) + 0.5)
            rotation = camera.rotation.numpy()
            x, y, z = rotation @ centre + camera.translation.numpy()
            rx, ry, rz = 0.5 * side * np.abs(rotation).sum(1)
            assert z - rz > 0
            depths = (z - rz, z + rz) if camera.kind == "pinhole" else (1.0, 1.0)
            (fx, _, cx), (_, fy, cy), _ = camera.intrinsics.tolist()
            columns = [fx * (x + s * rx) / d + cx for s in (-1, 1) for d in depths]
            rows = [fy * (y + s * ry) / d + cy for s in (-1, 1) for d in depths]
            left, right = (int(np.floor(f(columns) + 0.5)) + s * margin for f, s in ((min, -1), (max, 1)))
            top, bottom = (int(np.floor(f(rows) + 0.5)) + s * margin for f, s in ((min, -1), (max, 1)))
            height, width = mask.shape
            seen = mask.numpy()[max(top, 0) : max(bottom + 1, 0), max(left, 0) : max(right + 1, 0)]
            is_whole = left >= 0 and top >= 0 and right < width and bottom < height
            is_in, is_unseen = is_whole and bool(seen.all()), seen.size == 0
            bare += not seen.any()
            out += is_whole and not seen.any()
            inner += is_in
            against += not (is_in or is_unseen)
        if out > tolerated:
            states[cell] = WHITE
        elif bare > len(masks) - min_views:
            states[cell] = UNKNOWN
        else:
            states[cell] = BLACK if against <= tolerated and inner >= min_views else GRAY
    return states


def hull_and_core(octree: Octree, level: int, frame: int = 0) -> tuple[Tensor, Tensor]:
    whole = ((0, 0, 0), (2**level,) * 3)
    return octree.occupancy_in(*whole, frame=frame), octree.occupancy_in(*whole, frame=frame, inner=True)


def assert_equals_dense(carver: Carver, masks: Any, is_there: Tensor | None = None) -> Octree:
    octree, dense = carver.carve(masks, is_there), carver.dense(masks, is_there)
    for frame, states in enumerate(dense.reshape(-1, *dense.shape[-3:])):
        hull, core = hull_and_core(octree, carver.settings.level, frame)
        assert torch.equal(hull, (states == GRAY) | (states == BLACK))
        assert not bool((core & (states != BLACK)).any())
        whites = state_at(octree, _centres(carver)[(states == UNKNOWN).reshape(-1)], frame)
        assert bool((whites == UNKNOWN).all())
    return octree


def _centres(carver: Carver) -> Tensor:
    n = 2**carver.settings.level
    cells = torch.cartesian_prod(*3 * [torch.arange(n, dtype=torch.float64)])
    return torch.tensor(carver.root.corner, dtype=torch.float64) + (cells + 0.5) * carver.root.side / n


@pytest.mark.parametrize(
    ("margin", "min_views", "tolerated", "kind"),
    [(1, 2, 0, "pinhole"), (0, 3, 0, "orthographic"), (2, 2, 1, "pinhole")],
)
def test_equals_a_loop_over_octants_and_views(
    margin: int, min_views: int, tolerated: int, kind: str, rigs: Any
) -> None:
    generator = torch.Generator().manual_seed(margin)
    cameras = rigs.random(generator, 3, width=48, height=36, focal=60.0, kind=kind)
    masks = [rigs.ball(camera, CENTRE, 0.05) for camera in cameras]
    masks[0] = rigs.ball(cameras[0], CENTRE + 0.03, 0.05)
    settings = CarvingSettings(level=4, margin_px=margin, min_views=min_views, tolerated_views=tolerated)
    states = Carver(cameras, CUBE, settings).dense(masks)
    expected = loop_states(masks, cameras, CUBE, 4, margin, min_views, tolerated)
    assert all((expected == state).any() for state in (WHITE, GRAY))
    # float32 may widen a rectangle over the edge of a pixel: then less is certain, never something else.
    differs = states.numpy() != expected
    assert differs.mean() < 0.003
    assert not (states.numpy()[differs] == WHITE).any()
    assert not (states.numpy()[differs] == BLACK).any()


@pytest.mark.parametrize("seed", range(3))
def test_leaves_are_those_of_dense_carving(seed: int, rigs: Any) -> None:
    """Cameras near and far, views that cut the object off, lenses, voting, missing views."""
    generator = torch.Generator().manual_seed(seed)
    cameras = rigs.random(generator, 4, lens=5 if seed % 2 else 0, focal=130.0 + 60 * seed)
    cameras[0] = rigs.looking((0.1, 0.02, 0.12), focal=90.0)  # inside or just outside the cube
    cameras[1] = rigs.looking((0.3, 0.1, 0.2), kind="orthographic", width=100, height=90)
    balls = CENTRE + 0.03 * torch.randn(4, 3, generator=generator, dtype=torch.float64)
    masks = [rigs.ball(camera, balls, torch.tensor((0.03, 0.02, 0.015, 0.01))) for camera in cameras]
    masks[3] &= torch.rand(masks[3].shape, generator=generator) < 0.995  # holes
    for tolerated, min_views in ((0, 1), (0, 2), (0, 4), (1, 2), (2, 1)):
        settings = CarvingSettings(level=6, tolerated_views=tolerated, min_views=min_views)
        octree = assert_equals_dense(Carver(cameras, CUBE, settings), masks)
        assert float(octree.volume()) > 0
    settings = CarvingSettings(level=3)
    assert_equals_dense(Carver(cameras, CUBE, settings), [masks[0], None, masks[2], masks[3]])


@pytest.mark.parametrize("lens", [0, 5])
def test_never_white_where_balls_are(lens: int, rigs: Any) -> None:
    """The masks are marked where a pixel's centre sees the object; the margin of one pixel makes up for the rest."""
    for seed in range(0, 6, 2):
        generator = torch.Generator().manual_seed(seed)
        cameras = rigs.random(generator, 5, lens=lens, focal=110.0 + 40 * seed)
        balls = CENTRE + 0.05 * torch.randn(6, 3, generator=generator, dtype=torch.float64)
        radii = 0.004 + 0.03 * torch.rand(6, generator=generator, dtype=torch.float64)
        masks = [rigs.ball(camera, balls, radii) for camera in cameras]
        octree = carve(masks, cameras, CUBE, CarvingSettings(level=7))
        direction = torch.randn(6, 400, 3, generator=generator, dtype=torch.float64)
        points = (balls[:, None] + radii[:, None, None] * direction / direction.norm(dim=-1, keepdim=True)).reshape(
            -1, 3
        )
        corner = torch.tensor(CUBE.corner, dtype=torch.float64)
        points = points[((points > corner) & (points < corner + CUBE.side)).all(-1)]
        assert len(points) > 500
        assert not bool((state_at(octree, points) == WHITE).any())
        assert float(octree.volume()) > 0


def test_never_white_where_hands_are(rigs: Any) -> None:
    model = load_hand_model()
    hand, prior = model.hand(dtype=torch.float64), model.prior(dtype=torch.float64)
    poses, _ = prior.sample(4, torch.Generator().manual_seed(1))
    cube = RootCube(centre=(0.0, 0.0, 0.0), side=0.32)
    for seed, pose in enumerate(poses.double()):
        generator = torch.Generator().manual_seed(seed)
        pose[3:6] = torch.randn(3, generator=generator, dtype=torch.float64)
        state = hand(pose)
        surface = posed_mesh(hand, state).moved(torch.eye(3, dtype=torch.float64), -state.keypoints.mean(0))
        cameras = rigs.random(generator, 4, width=320, height=240, focal=250.0)
        masks = [silhouette(surface, camera) for camera in cameras]
        octree = carve(masks, cameras, cube, CarvingSettings(level=7))
        states = state_at(octree, surface.vertices)
        assert not bool((states == WHITE).any())
        assert float((states == GRAY).double().mean()) > 0.2  # a surface is on the border, not deep inside


def test_black_octants_are_inside(rigs: Any) -> None:
    cameras = rigs.random(torch.Generator().manual_seed(3), 6, width=320, height=240, focal=260.0)
    masks = [rigs.ball(camera, CENTRE, 0.06) for camera in cameras]
    octree = carve(masks, cameras, CUBE, CarvingSettings(level=6))
    leaves = octree.leaves(dtype=torch.float64)
    black = leaves.states == BLACK
    assert int(black.sum()) > 50
    corners = torch.cartesian_prod(*3 * [torch.tensor((-0.5, 0.5), dtype=torch.float64)])
    points = (leaves.centres[black, None] + leaves.sides[black, None, None] * corners).reshape(-1, 3)
    for camera in cameras:  # every corner is seen in the silhouette: nearer to the ray's axis than the ball is wide
        column, row = camera.project(points).round().long().unbind(-1)
        assert bool(rigs.ball(camera, CENTRE, 0.06)[row, column].all())


def test_hull_shrinks_to_the_ball_with_levels_and_views(rigs: Any) -> None:
    generator = torch.Generator().manual_seed(5)
    cameras = rigs.random(generator, 24, width=320, height=240, focal=260.0)
    masks = [rigs.ball(camera, CENTRE, 0.06) for camera in cameras]
    true = 4 / 3 * torch.pi * 0.06**3
    volumes = [float(carve(masks, cameras, CUBE, CarvingSettings(level=level)).volume()) for level in (4, 5, 6, 7)]
    assert all(finer < coarser for coarser, finer in pairwise(volumes))
    octree = carve(masks, cameras, CUBE, CarvingSettings(level=7))
    assert float(octree.volume("inner")) < true < float(octree.volume())
    # The shell is as wide inside as outside: its middle is the ball (its hull from 24 sides is a little more).
    middle = 0.5 * (float(octree.volume()) ** (1 / 3) + float(octree.volume("inner")) ** (1 / 3))
    assert middle == pytest.approx(true ** (1 / 3), rel=0.015)


def test_outside_the_picture_nothing_is_known(rigs: Any) -> None:
    """The second camera sees the left half only: what the first sees of the right half stays."""
    whole = rigs.looking((0.0, 0.0, -0.5))
    narrow = replace(rigs.looking((0.0, 0.5, 0.0)), width=80)
    cameras = [whole, narrow]
    masks = [rigs.ball(camera, CENTRE, 0.05) for camera in cameras]
    masks[1][:] = False
    octree = carve(masks, cameras, CUBE, CarvingSettings(level=6, min_views=1))
    points = torch.tensor(CUBE.corner) + CUBE.side * torch.rand(3000, 3, generator=torch.Generator().manual_seed(0))
    column, row = narrow.project(points.double()).unbind(-1)
    states = state_at(octree, points)
    is_outside = (column < -8) | (column > 88) | (row < -8) | (row > 128)
    seen = whole.project(points.double()).round().long().clamp(min=torch.tensor((0, 0)), max=torch.tensor((159, 119)))
    is_object = masks[0][seen[:, 1], seen[:, 0]]
    assert int((is_outside & is_object).sum()) > 20
    assert bool((states[is_outside & is_object] != WHITE).all())
    deep = (column > 8) & (column < 71) & (row > 8) & (row < 111)
    assert bool((states[deep] == WHITE).all())
    # Where two views have to show the object, that is unknown instead.
    octree = carve(masks, cameras, CUBE, CarvingSettings(level=6, min_views=2))
    assert bool(octree.is_empty)
    assert float(octree.volume("unknown")) > 0


def test_what_lies_across_the_plane_of_a_camera_is_not_carved_away(rigs: Any) -> None:
    """A wide camera inside the cube that sees nothing: it carves what is before it, not what is beside or behind it.

    Its plane cuts an octant of the last level shortly behind the camera.
    """
    middle = torch.tensor(CUBE.centre, dtype=torch.float64) + 0.5 * CUBE.side / 64
    x, y, z = middle.tolist()
    z -= 0.0019
    camera = rigs.looking((x, y, z), at=(x, y, z + 1.0), focal=30.0)
    octree = carve([torch.zeros(120, 160, dtype=torch.bool)], [camera], CUBE, CarvingSettings(level=6, min_views=1))
    points = torch.tensor([(x, y, z + ahead) for ahead in (-0.05, -0.00005, 0.05)], dtype=torch.float64)
    assert state_at(octree, points).tolist() == [UNKNOWN, UNKNOWN, WHITE]


def test_a_lens_widens_the_margin_by_the_pixel_that_correcting_it_may_cost(rigs: Any) -> None:
    cameras = rigs.random(torch.Generator().manual_seed(4), 3)
    masks = [rigs.ball(camera, CENTRE, 0.05) for camera in cameras]
    hardly = torch.tensor((1e-12, 0.0, 0.0, 0.0), dtype=torch.float64)
    through_lenses = carve(
        masks, [replace(camera, distortion=hardly) for camera in cameras], CUBE, CarvingSettings(level=6)
    )
    wide, narrow = (carve(masks, cameras, CUBE, CarvingSettings(level=6, margin_px=margin)) for margin in (2, 1))
    assert torch.equal(hull_and_core(through_lenses, 6)[0], hull_and_core(wide, 6)[0])
    assert float(narrow.volume()) < float(wide.volume())


def test_correcting_a_barrel_lens_loses_no_pixel(rigs: Any) -> None:
    """What is seen in one pixel alone stays, although corrected pictures show the nearest pixels only."""
    lens = torch.tensor((-0.2, 0.03, 0.004, -0.003, 0.0), dtype=torch.float64)
    camera = replace(rigs.looking((0.0, 0.0, -0.5), focal=170.0), distortion=lens)
    settings = CarvingSettings(level=8, margin_px=0, min_views=1)
    cube = RootCube(centre=(0.0, 0.0, 0.0), side=0.24)
    generator = torch.Generator().manual_seed(0)
    pixels = torch.stack([torch.randint(30, n - 30, (80,), generator=generator) for n in (160, 120)], -1)
    masks = torch.zeros(80, 120, 160, dtype=torch.bool)
    masks[torch.arange(80), pixels[:, 1], pixels[:, 0]] = True
    origin, direction = camera.rays(pixels.double())
    points = (origin + 0.5 * direction - camera.translation) @ camera.rotation
    octree = Carver([camera], cube, settings).carve([masks])
    inside = (points.abs() < 0.5 * cube.side).all(-1).nonzero()[:, 0].tolist()
    assert len(inside) > 30
    for frame in inside:
        assert state_at(octree, points[frame : frame + 1], frame).tolist() != [WHITE]


@pytest.mark.parametrize("bad", ["black", "missing", "missing_in_frame"])
def test_a_bad_or_missing_view_is_tolerated(bad: str, rigs: Any) -> None:
    generator = torch.Generator().manual_seed(7)
    cameras = rigs.random(generator, 6, focal=150.0)
    masks: list[Any] = [rigs.ball(camera, CENTRE, 0.04) for camera in cameras]
    good = carve(masks, cameras, CUBE, CarvingSettings(level=6))
    others = carve(masks[:2] + masks[3:], cameras[:2] + cameras[3:], CUBE, CarvingSettings(level=6))
    is_there = None
    masks[2] = None if bad == "missing" else torch.zeros_like(masks[2])
    if bad == "missing_in_frame":
        is_there = torch.arange(6) != 2
    tolerated = int(bad == "black")
    found = carve(masks, cameras, CUBE, CarvingSettings(level=6, tolerated_views=tolerated), is_there=is_there)
    direction = torch.randn(500, 3, generator=generator, dtype=torch.float64)
    points = CENTRE + 0.039 * direction / direction.norm(dim=-1, keepdim=True)
    assert not bool((state_at(found, points) == WHITE).any())
    if bad == "black":
        assert bool(carve(masks, cameras, CUBE, CarvingSettings(level=6)).is_empty)
        assert float(good.volume()) < float(found.volume()) < 2 * float(good.volume())
    else:
        for one, other in zip(hull_and_core(found, 6), hull_and_core(others, 6), strict=True):
            assert torch.equal(one, other)


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...], rigs: Any) -> None:
    generator = torch.Generator().manual_seed(8)
    cameras = rigs.random(generator, 3)
    cameras[1] = replace(cameras[1], width=150, height=110)
    count = int(torch.Size(batch).numel())
    centres = CENTRE + 0.03 * torch.randn(count, 3, generator=generator, dtype=torch.float64)
    centres[-1] += 1.0  # seen by nobody
    flat = [torch.stack([rigs.ball(camera, centre, 0.04) for centre in centres]) for camera in cameras]
    masks = [mask.reshape(*batch, *mask.shape[1:]) for mask in flat]
    there = torch.rand(*batch, 3, generator=generator) < 0.8
    carver = Carver(cameras, CUBE, CarvingSettings(level=5, min_views=1))
    together = assert_equals_dense(carver, masks, there)
    assert together.volume().shape == together.is_empty.shape == batch
    for frame in range(count):
        alone = carver.carve([mask[frame] for mask in flat], there.reshape(-1, 3)[frame])
        for one, other in zip(together.levels, alone.levels, strict=False):
            own = one.frames == frame
            assert torch.equal(one.states[own], other.states)
            assert torch.equal(one.cells[own], other.cells)
        assert float(together.volume().reshape(-1)[frame]) == pytest.approx(float(alone.volume()), rel=1e-12)
        assert len(alone.leaves().sides) == len(together.leaves(frame=frame).sides)


@pytest.mark.parametrize("lens", [None, (-0.25, 0.08, 0.001, -0.001)])
def test_a_carver_moved_is_one_made_there(lens: tuple[float, ...] | None, rigs: Any) -> None:
    """Also where the cube reaches behind a camera there, or a view is missing."""
    cameras = rigs.random(torch.Generator().manual_seed(3), 3)
    if lens is not None:
        cameras[1] = replace(cameras[1], distortion=torch.tensor(lens, dtype=torch.float64))
    masks = [rigs.ball(camera, CENTRE, 0.04) for camera in cameras]
    settings = CarvingSettings(level=5, min_views=1)
    carver = Carver(cameras, CUBE, settings)
    behind = (-cameras[0].rotation.T @ cameras[0].translation).tolist()
    for centre in ((0.03, -0.04, 0.02), tuple(behind), CUBE.centre):
        root = RootCube(centre=centre, side=CUBE.side)
        for seen in (masks, [masks[0], None, masks[2]]):
            one, other = carver.moved(root).carve(seen), Carver(cameras, root, settings).carve(seen)
            assert one.root == root
            for ours, theirs in zip(one.levels, other.levels, strict=True):
                assert torch.equal(ours.cells, theirs.cells)
                assert torch.equal(ours.states, theirs.states)
    with pytest.raises(ValueError, match=r"root: expected a side of 0.256 m, got 0.3 m"):
        carver.moved(RootCube(centre=CUBE.centre, side=0.3))


def test_silhouettes_that_do_not_meet_are_a_frame_without_hull(rigs: Any) -> None:
    cameras = [rigs.looking((0.0, 0.0, -0.5)), rigs.looking((0.5, 0.0, 0.0))]
    shift = torch.tensor((0.0, 0.06, 0.0), dtype=torch.float64)
    masks = [rigs.ball(cameras[0], shift, 0.02), rigs.ball(cameras[1], -shift, 0.02)]
    octree = carve(masks, cameras, CUBE)
    assert bool(octree.is_empty)
    assert float(octree.volume()) == 0
    assert len(octree.leaves().sides) == 0
    assert not bool(carve([masks[0], rigs.ball(cameras[1], torch.zeros(3).double(), 0.1)], cameras, CUBE).is_empty)


def test_children_are_those_of_gray_octants_only(rigs: Any) -> None:
    cameras = rigs.random(torch.Generator().manual_seed(2), 4)
    octree = carve([rigs.ball(camera, CENTRE, 0.05) for camera in cameras], cameras, CUBE, CarvingSettings(level=6))
    assert octree.levels[0].cells.tolist() == [[0, 0, 0]]
    for above, below in pairwise(octree.levels):
        parents = above.cells[above.states == GRAY]
        assert len(below.cells) == 8 * len(parents)
        assert torch.equal(below.cells.reshape(-1, 8, 3) // 2, parents[:, None].expand(-1, 8, 3))
    assert octree.level == 6


def test_noise_ends_at_a_coarser_level(rigs: Any) -> None:
    generator = torch.Generator().manual_seed(0)
    cameras = rigs.random(generator, 3)
    masks = [torch.rand(120, 160, generator=generator) < 0.5 for _ in cameras]
    octree = carve(masks, cameras, CUBE, CarvingSettings(level=8, max_octants=300_000))
    assert octree.level == 6
    assert len(octree.levels[-1].states) <= 300_000
    assert octree.leaf_side == pytest.approx(CUBE.side / 64)


def test_says_what_is_wrong(rigs: Any) -> None:
    camera = rigs.looking((0.0, 0.0, -0.5), name="front")
    mask = torch.zeros(120, 160, dtype=torch.bool)
    with pytest.raises(ValueError, match="cameras: expected 1 to 255, got 0"):
        carve([], [], CUBE)
    with pytest.raises(ValueError, match="masks: expected 1, one per camera, got 2"):
        carve([mask, mask], [camera], CUBE)
    with pytest.raises(ValueError, match=r"masks\[0\]: expected 160x120 px, the size of camera 'front', got 120x160"):
        carve([mask.T], [camera], CUBE)
    with pytest.raises(ValueError, match=r"masks\[1\]: expected the batch \(\) of the views before it, got \(2,\)"):
        carve([mask, mask.expand(2, -1, -1)], [camera, camera], CUBE)
    with pytest.raises(ValueError, match="at least one view, got none"):
        carve([None], [camera], CUBE)
    with pytest.raises(ValueError, match=r"is_there: expected the shape \(1,\), got \(2,\)"):
        carve([mask], [camera], CUBE, is_there=torch.ones(2, dtype=torch.bool))
    with pytest.raises(ValueError, match="tolerated_views: expected fewer than the 1 cameras, got 1"):
        carve([mask], [camera], CUBE, CarvingSettings(tolerated_views=1))
    with pytest.raises(ValueError, match="level: expected a whole number from 1 to 10, got 11"):
        CarvingSettings(level=11)
    with pytest.raises(ValueError, match="frame: expected 0 to 0, got 1"):
        carve([mask], [camera], CUBE, CarvingSettings(level=2)).leaves(frame=1)
