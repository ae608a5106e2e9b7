"""Several cameras from corners of a board with known noise: recovered, and what is wrong is named."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from torchhand.calibration.board import Board, BoardCorners
from torchhand.calibration.bundle import Bundle
from torchhand.calibration.camera import CameraViews, calibrate_camera
from torchhand.calibration.quality import QualityLimits, shortcomings
from torchhand.calibration.reprojection import Pose
from torchhand.calibration.rig import RigCalibration, calibrate_rig, shared_frames
from torchhand.errors import InputError
from torchhand.geometry import Camera, rotation_from_vector, vector_from_rotation

BOARD = Board(kind="chessboard", columns=9, rows=6, square=0.025)
NOISE_PX = 0.1
FRAMES = 14


def ring(count: int, *, coefficients: int = 4) -> list[Camera]:
    """Cameras 0.6 m around the origin, 25° apart, looking at it; the first is the world."""
    lens = torch.tensor([-0.12, 0.05, 0.001, -0.0007, 0.01, 0.0, 0.0, 0.0], dtype=torch.float64)[:coefficients]
    poses = []
    for i in range(count):
        turn = rotation_from_vector(torch.tensor((0.1 * i, math.radians(25.0 * i), 0.03 * i), dtype=torch.float64))
        poses.append(Pose(rotation=turn, translation=torch.tensor((0.0, 0.0, 0.6), dtype=torch.float64)))
    return [
        Camera(
            intrinsics=torch.tensor(
                [[620.0 + 8 * i, 0.0, 318.0 + i], [0.0, 618.0 + 8 * i, 243.0 - i], [0.0, 0.0, 1.0]], dtype=torch.float64
            ),
            rotation=(pose @ poses[0].inverse()).rotation,
            translation=(pose @ poses[0].inverse()).translation,
            distortion=lens.clone(),
            width=640,
            height=480,
            name=f"cam{i}",
        )
        for i, pose in enumerate(poses)
    ]


def board_poses(count: int, generator: torch.Generator, *, tilt: float = 0.6) -> list[Pose]:
    """World from board, the board's middle within 8 cm of the point 0.6 m before the first camera."""
    middle = BOARD.points().mean(0)
    poses = []
    for _ in range(count):
        vector = (2 * torch.rand(3, generator=generator, dtype=torch.float64) - 1) * tilt
        rotation = rotation_from_vector(vector)
        place = (2 * torch.rand(3, generator=generator, dtype=torch.float64) - 1) * torch.tensor((0.10, 0.08, 0.08))
        place = place + torch.tensor((0.0, 0.0, 0.6))
        poses.append(Pose(rotation=rotation, translation=place - rotation @ middle))
    return poses


def seen(
    cameras: list[Camera], boards: list[Pose], generator: torch.Generator, *, noise: float = NOISE_PX
) -> list[CameraViews]:
    """Corners of every board in every camera; of each some are hidden."""
    views = []
    for camera in cameras:
        corners = {}
        for frame, pose in enumerate(boards):
            pixels = camera.project(BOARD.points() @ pose.rotation.T + pose.translation)
            pixels = pixels + noise * torch.randn(pixels.shape, generator=generator, dtype=torch.float64)
            inside = ((pixels >= 0) & (pixels <= torch.tensor((639.0, 479.0)))).all(-1)
            ids = inside.nonzero()[:, 0]
            if len(ids) >= 20:
                corners[frame] = BoardCorners(ids=ids, points_px=pixels[ids])
        views.append(CameraViews(name=camera.name, width=camera.width, height=camera.height, corners=corners))
    return views


def only(view: CameraViews, frames: range) -> CameraViews:
    return view.without({frame for frame in view.corners if frame not in frames})


@pytest.fixture(scope="module")
def known() -> tuple[list[Camera], list[CameraViews], RigCalibration, list[Pose]]:
    generator = torch.Generator().manual_seed(3)
    cameras, boards = ring(4), board_poses(FRAMES, generator)
    views = seen(cameras, boards, generator)
    return cameras, views, calibrate_rig(views, BOARD, distortion=4), boards


def test_cameras_are_recovered(known: tuple) -> None:
    cameras, _, found, boards = known
    assert found.rms_px() == pytest.approx(NOISE_PX * math.sqrt(2), rel=0.1)
    assert found.dropped == ()
    for i, (true, camera) in enumerate(zip(cameras, found.cameras, strict=True)):
        assert (camera.name, camera.width, camera.height) == (true.name, 640, 480)
        turn = vector_from_rotation(camera.rotation @ true.rotation.T).norm()
        assert math.degrees(float(turn)) < 0.25
        assert float((camera.translation - true.translation).norm()) < 2.5e-3
        assert float((camera.intrinsics - true.intrinsics).abs().max()) < 2.5
        # The errors are those that the calibration itself states.
        assert abs(float(camera.intrinsics[0, 0] / true.intrinsics[0, 0]) - 1) < 4 * found.focal_std[i]
        assert float((camera.translation - true.translation).abs().max()) <= 4 * found.centre_std[i] + 1e-12
    for frame, pose in found.world_from_board.items():
        assert float((pose.translation - boards[frame].translation).norm()) < 3e-3


def test_together_is_better_than_alone(known: tuple) -> None:
    cameras, _, found, _ = known
    focal = torch.tensor([float(camera.intrinsics[0, 0]) for camera in cameras])
    together = torch.tensor([float(camera.intrinsics[0, 0]) for camera in found.cameras])
    alone = torch.tensor([float(single.lens[0]) for single in found.alone])
    assert float((together - focal).abs().mean()) < float((alone - focal).abs().mean())


def test_exact_corners_give_the_exact_rig() -> None:
    generator = torch.Generator().manual_seed(5)
    cameras = ring(2, coefficients=5)
    found = calibrate_rig(seen(cameras, board_poses(8, generator), generator, noise=0.0), BOARD, distortion=5)
    for true, camera in zip(cameras, found.cameras, strict=True):
        torch.testing.assert_close(camera.intrinsics, true.intrinsics, atol=1e-4, rtol=0.0)
        torch.testing.assert_close(camera.rotation, true.rotation, atol=1e-7, rtol=0.0)
        torch.testing.assert_close(camera.translation, true.translation, atol=1e-7, rtol=0.0)
        torch.testing.assert_close(camera.distortion, true.distortion, atol=1e-5, rtol=0.0)


def test_bundle_has_the_gradient_of_its_cost(known: tuple) -> None:
    _, _, found, _ = known
    bundle = Bundle(
        views=found.views[:2],
        board=BOARD,
        lenses=tuple(single.lens for single in found.alone[:2]),
        cam_from_world=Pose.stacked([Pose(rotation=c.rotation, translation=c.translation) for c in found.cameras[:2]]),
        world_from_board=Pose.stacked(list(found.world_from_board.values())),
        frames=tuple(found.world_from_board),
    )
    size = bundle._size
    generator = torch.Generator().manual_seed(1)
    values = 1e-2 * torch.randn(size, generator=generator, dtype=torch.float64)
    step = torch.randn(size, generator=generator, dtype=torch.float64)
    gradient = bundle.normal_equations(values).gradient
    h = 1e-6
    up, down = (float(bundle.normal_equations(values + sign * h * step).cost) for sign in (1, -1))
    assert float(gradient @ step) == pytest.approx((up - down) / (2 * h), rel=1e-5)


def test_camera_alone_agrees_with_opencv(known: tuple) -> None:
    _, views, _, _ = known
    single = calibrate_camera(views[0], BOARD, distortion=5)
    points = BOARD.points().numpy().astype(np.float32)
    objects = [points[found.ids.numpy()][:, None] for found in views[0].corners.values()]
    pictures = [found.points_px.numpy().astype(np.float32)[:, None] for found in views[0].corners.values()]
    rms, matrix, *_ = cv2.calibrateCamera(objects, pictures, (640, 480), np.eye(3), np.zeros(5))
    assert float(single.lens[0]) == pytest.approx(float(matrix[0, 0]), rel=1e-6)
    assert single.rms_px == pytest.approx(rms, rel=0.02)


def test_chain_of_cameras_joined_in_pairs() -> None:
    """Cameras 0 and 2 never see the board together; camera 1 joins them."""
    generator = torch.Generator().manual_seed(7)
    cameras = ring(3)
    views = seen(cameras, board_poses(20, generator), generator)
    views = [only(views[0], range(10)), views[1], only(views[2], range(10, 20))]
    assert shared_frames(views)[0, 2] == []
    found = calibrate_rig(views, BOARD, distortion=4)
    for true, camera in zip(cameras, found.cameras, strict=True):
        assert float((camera.translation - true.translation).norm()) < 5e-3


def test_unconnected_cameras_are_named() -> None:
    generator = torch.Generator().manual_seed(7)
    views = seen(ring(3), board_poses(20, generator), generator)
    views = [only(views[0], range(10)), only(views[1], range(12)), only(views[2], range(12, 20))]
    with pytest.raises(InputError, match=r"not joined by boards.*: cam0, cam1 \| cam2"):
        calibrate_rig(views, BOARD, distortion=4)


def test_one_bad_picture_is_left_out(known: tuple) -> None:
    cameras, views, _, _ = known
    bad = views[1].corners[4]
    corners = dict(views[1].corners) | {4: BoardCorners(ids=bad.ids, points_px=bad.points_px.flip(0))}
    spoilt = [views[0], replace(views[1], corners=corners), *views[2:]]
    found = calibrate_rig(spoilt, BOARD, distortion=4)
    assert [(name, frame) for name, frame, _ in found.dropped] == [("cam1", 4)]
    assert float((found.cameras[1].translation - cameras[1].translation).norm()) < 2.5e-3


def test_world_of_the_board(known: tuple) -> None:
    cameras, _, found, boards = known
    moved = found.in_world_of_board(5)
    torch.testing.assert_close(moved.world_from_board[5].rotation, torch.eye(3).double(), atol=1e-12, rtol=0.0)
    points = BOARD.points()
    for camera, true in zip(moved.cameras, cameras, strict=True):
        expected = true.project(points @ boards[5].rotation.T + boards[5].translation)
        assert float((camera.project(points) - expected).norm(dim=-1).max()) < 0.3
    with pytest.raises(InputError, match="the board was not used in frame 99"):
        found.in_world_of_board(99)


def test_good_calibration_has_no_shortcomings(known: tuple) -> None:
    assert shortcomings(known[2], QualityLimits()) == []


def test_shortcomings_name_camera_and_figure() -> None:
    generator = torch.Generator().manual_seed(2)
    cameras = ring(2)
    flat = calibrate_rig(seen(cameras, board_poses(8, generator, tilt=0.02), generator), BOARD, distortion=0)
    lines = shortcomings(flat, QualityLimits())
    assert any(line.startswith("cam0: the board has one orientation only (within ") for line in lines)
    few = calibrate_rig(seen(cameras, board_poses(4, generator), generator), BOARD, distortion=0)
    assert "cam0: the board was found in 4 pictures, expected 6 or more" in shortcomings(few, QualityLimits())
    noisy = calibrate_rig(seen(cameras, board_poses(8, generator), generator, noise=2.0), BOARD, distortion=0)
    assert any("cam1: reprojection error 2" in line for line in shortcomings(noisy, QualityLimits()))


def test_unsynchronised_cameras_are_told_apart_from_bad_pictures() -> None:
    generator = torch.Generator().manual_seed(4)
    views = seen(ring(2), board_poses(12, generator), generator)
    late = {frame + 1: corners for frame, corners in views[1].corners.items()}
    found = calibrate_rig([views[0], replace(views[1], corners=late)], BOARD, distortion=4)
    assert any("cam1: 0.1" in line and "not of the same time" in line for line in shortcomings(found, QualityLimits()))


def test_symmetric_board_with_several_cameras_is_refused(known: tuple) -> None:
    with pytest.raises(InputError, match="look the same upside down"):
        calibrate_rig(known[1], replace(BOARD, columns=8), distortion=4)


def test_too_few_boards_for_a_lens(known: tuple) -> None:
    views = known[1]
    with pytest.raises(InputError, match="cam2: expected pictures of the board in 3 places or more, got 2"):
        calibrate_rig([views[0], only(views[2], range(2))], BOARD)
