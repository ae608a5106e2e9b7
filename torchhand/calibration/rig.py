"""Several cameras from pictures of one board: a first guess along shared boards, then all together by least squares."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.calibration.board import Board
from torchhand.calibration.bundle import Bundle, adjust
from torchhand.calibration.camera import CameraViews, FrameIndex, SingleCalibration, calibrate_camera
from torchhand.calibration.reprojection import Pose, central_pose
from torchhand.errors import InputError
from torchhand.geometry import Camera

_OUTLIER_RATIO = 5.0  # a picture's residual against the median
_OUTLIER_PX = 1.0
_ROUNDS = 4
_MAX_OUTLIERS = 0.25  # share of the pictures; more are no outliers


@dataclass(frozen=True, kw_only=True)
class RigCalibration:
    """The cameras, and what speaks for and against them."""

    cameras: tuple[Camera, ...]
    views: tuple[CameraViews, ...]
    """Views from which the cameras were computed."""
    alone: tuple[SingleCalibration, ...]
    """Each camera by itself."""
    world_from_board: Mapping[FrameIndex, Pose]
    residuals_px: Mapping[tuple[str, FrameIndex], Float[Tensor, "_found 2"]]
    """Residuals in the picture, seen minus computed, by camera and frame."""
    focal_std: tuple[float, ...]
    """Standard deviation of fx relative to it."""
    centre_std: tuple[float, ...]
    """Largest standard deviation of the camera's translation along an axis, metres; 0 of the first."""
    dropped: tuple[tuple[str, FrameIndex, float], ...]
    """Pictures left out, with their root mean square residual, px."""

    def rms_px(self, name: str | None = None) -> float:
        """Root mean square distance of corners, of one camera or of all."""
        found = [residual for (camera, _), residual in self.residuals_px.items() if name in (None, camera)]
        return float(torch.cat(found).square().sum(-1).mean().sqrt())

    def in_world_of_board(self, frame: FrameIndex) -> "RigCalibration":
        """The rig in the coordinates of the board as it was in one frame. Raises InputError where it was not seen."""
        if frame not in self.world_from_board:
            seen = ", ".join(map(str, list(self.world_from_board)[:10]))
            raise InputError(f"world: the board was not used in frame {frame}; it was in {seen}, ...")
        old_from_new = self.world_from_board[frame]
        poses = [Pose(rotation=c.rotation, translation=c.translation) @ old_from_new for c in self.cameras]
        return replace(
            self,
            cameras=tuple(
                replace(camera, rotation=pose.rotation, translation=pose.translation)
                for camera, pose in zip(self.cameras, poses, strict=True)
            ),
            world_from_board={m: old_from_new.inverse() @ pose for m, pose in self.world_from_board.items()},
        )


def calibrate_rig(
    views: Sequence[CameraViews], board: Board, *, distortion: int = 5, min_shared: int = 3
) -> RigCalibration:
    """Lens of each camera and poses of all, in the frame of the first.

    Each camera is calibrated by itself; pairs that saw the board together `min_shared` times or more are joined
    along the tree of those that share most; then lenses, cameras and boards together minimise the reprojection error.
    Pictures that fit far worse than the others are left out.

    Raises InputError: too few boards for a lens, cameras that no chain of shared boards joins, or a symmetric board
    with several cameras.
    """
    check_board(board, len(views))
    singles = [_alone(view, board, distortion) for view in views]
    dropped: list[tuple[str, FrameIndex, float]] = []
    for i, (view, single) in enumerate(zip(views, singles, strict=True)):
        bad = _outliers(single.residual_px)
        if bad:
            dropped += [(view.name, frame, single.residual_px[frame]) for frame in sorted(bad)]
            singles[i] = _alone(view.without(bad), board, distortion)
    kept = [view.without({frame for name, frame, _ in dropped if name == view.name}) for view in views]
    bundle = _start(kept, singles, board, min_shared)
    for _ in range(_ROUNDS):
        bundle = adjust(bundle)
        rms = {key: float(residual.square().sum(-1).mean().sqrt()) for key, residual in bundle.residuals().items()}
        bad_keys = _worst_of_moments(_outliers(rms), rms)
        if not bad_keys:
            break
        kept = [view.without({frame for c, frame in bad_keys if c == i}) for i, view in enumerate(kept)]
        if min(len(view.corners) for view in kept) < 3 or len(_components(kept, min_shared)) > 1:
            kept = list(bundle.views)
            break
        dropped += [(views[c].name, frame, rms[c, frame]) for c, frame in sorted(bad_keys)]
        bundle = bundle.of(kept)
    focal_std, centre_std = bundle.standard_deviations()
    names = [view.name for view in views]
    return RigCalibration(
        cameras=tuple(_cameras(bundle, views)),
        views=bundle.views,
        alone=tuple(singles),
        world_from_board={frame: bundle.world_from_board[i] for i, frame in enumerate(bundle.frames)},
        residuals_px={(names[c], frame): residual for (c, frame), residual in bundle.residuals().items()},
        focal_std=focal_std,
        centre_std=centre_std,
        dropped=tuple(dropped),
    )


def check_board(board: Board, cameras: int) -> None:
    """Raise InputError where so many cameras cannot agree on the board's corners."""
    if cameras > 1 and board.is_symmetric:
        raise InputError(
            f"board: {board.columns}x{board.rows} squares look the same upside down, so several cameras cannot agree on"
            " its corners; use an odd and an even number such as 9x6, or a ChArUco board"
        )


def shared_frames(views: Sequence[CameraViews]) -> dict[tuple[int, int], list[FrameIndex]]:
    """Frames, for every pair of cameras, in which both saw the board."""
    return {
        (a, b): sorted(set(views[a].corners) & set(views[b].corners)) for a, b in combinations(range(len(views)), 2)
    }


def _alone(view: CameraViews, board: Board, distortion: int) -> SingleCalibration:
    if len(view.corners) < 3:
        raise InputError(f"{view.name}: expected pictures of the board in 3 places or more, got {len(view.corners)}")
    try:
        return calibrate_camera(view, board, distortion=distortion)
    except cv2.error as error:
        raise InputError(
            f"{view.name}: no lens explains the pictures of the board; do they show it tilted to different sides?"
        ) from error


def _outliers(rms: Mapping) -> set:
    """Keys of residuals far above the median; none where there are many."""
    values = torch.tensor(list(rms.values()), dtype=torch.float64)
    limit = max(_OUTLIER_PX, _OUTLIER_RATIO * float(values.median()))
    bad = {key for key, value in rms.items() if value > limit}
    return bad if len(bad) <= _MAX_OUTLIERS * len(rms) else set()


def _worst_of_moments(keys: set, rms: Mapping) -> set:
    """One camera per frame: a bad picture spoils the board's place, and with it the residuals of the good ones."""
    worst: dict[FrameIndex, tuple[int, FrameIndex]] = {}
    for key in keys:
        if key[1] not in worst or rms[key] > rms[worst[key[1]]]:
            worst[key[1]] = key
    return set(worst.values())


def _components(views: Sequence[CameraViews], min_shared: int) -> list[list[int]]:
    """Groups of cameras that shared boards join."""
    groups = [{i} for i in range(len(views))]
    for (a, b), frames in shared_frames(views).items():
        if len(frames) >= min_shared:
            first = next(group for group in groups if a in group)
            second = next(group for group in groups if b in group)
            if first is not second:
                groups.remove(second)
                first |= second
    return [sorted(group) for group in groups]


def _start(views: Sequence[CameraViews], singles: Sequence[SingleCalibration], board: Board, min_shared: int) -> Bundle:
    groups = _components(views, min_shared)
    if len(groups) > 1:
        texts = " | ".join(", ".join(views[i].name for i in group) for group in groups)
        raise InputError(
            f"the cameras are not joined by boards that two of them saw at the same time ({min_shared} or more):"
            f" {texts}"
        )
    shared = shared_frames(views)
    length = board.square * max(board.columns, board.rows)
    cam_from_world = {0: Pose.identity()}
    while len(cam_from_world) < len(views):  # Prim: the pair that shares most, of one placed and one not
        a, b = max(
            (pair for pair in shared if (pair[0] in cam_from_world) != (pair[1] in cam_from_world)),
            key=lambda pair: len(shared[pair]),
        )
        old, new = (a, b) if a in cam_from_world else (b, a)
        frames = shared[a, b]
        relative = Pose.stacked(
            [singles[new].cam_from_board[m] @ singles[old].cam_from_board[m].inverse() for m in frames]
        )
        cam_from_world[new] = relative[central_pose(relative, length=length)] @ cam_from_world[old]
    frames = sorted({frame for view in views for frame in view.corners})
    boards = []
    for frame in frames:
        seen = [i for i, view in enumerate(views) if frame in view.corners]
        best = min(seen, key=lambda i: singles[i].residual_px[frame])
        boards.append(cam_from_world[best].inverse() @ singles[best].cam_from_board[frame])
    return Bundle(
        views=tuple(views),
        board=board,
        lenses=tuple(single.lens for single in singles),
        cam_from_world=Pose.stacked([cam_from_world[i] for i in range(len(views))]),
        world_from_board=Pose.stacked(boards),
        frames=tuple(frames),
    )


def _cameras(bundle: Bundle, views: Sequence[CameraViews]) -> list[Camera]:
    cameras = []
    for i, (view, lens) in enumerate(zip(views, bundle.lenses, strict=True)):
        fx, fy, cx, cy = lens[:4].tolist()
        cameras.append(
            Camera(
                intrinsics=torch.tensor([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]], dtype=torch.float64),
                rotation=bundle.cam_from_world.rotation[i],
                translation=bundle.cam_from_world.translation[i],
                distortion=lens[4:].clone(),
                width=view.width,
                height=view.height,
                name=view.name,
            )
        )
    return cameras
