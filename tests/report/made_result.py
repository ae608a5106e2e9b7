"""A result of a simulated motion, as a command would leave it, with losses and a finger that is not determined."""

from pathlib import Path

import numpy as np
import torch

from torchhand.files import FrameRecord, TrackHeader, TrackWriter, load_hand_model, save_hand, write_video
from torchhand.hand import DOFS, posture

FRAMES, FPS = 40, 20.0
LOST = (12, 13, 14)
OPEN_FINGER = 2
CAMERA = {
    "name": "cam0",
    "width": 640,
    "height": 480,
    "K": [[600.0, 0.0, 319.5], [0.0, 600.0, 239.5], [0.0, 0.0, 1.0]],
    "R": np.eye(3).tolist(),
    "t": [0.0, 0.0, 0.0],
    "is_assumed": True,
}


def poses(shift_deg: float = 0.0) -> np.ndarray:
    """A hand that closes, turns and moves."""
    share = torch.linspace(0, 1, FRAMES, dtype=torch.float64)[:, None]
    pose = (1 - share) * posture("open") + share * posture("fist")
    pose[:, :3] = torch.tensor((0.02, -0.01, 0.5), dtype=torch.float64) + 0.05 * share
    pose[:, 3:6] = torch.tensor((0.3, 2.9, 0.4), dtype=torch.float64) * (0.8 + 0.4 * share)
    pose[:, DOFS.index("index_pip_fe")] += np.deg2rad(shift_deg)
    return pose.numpy()


def write_result(folder: Path, *, side: str = "right", shift_deg: float = 0.0, has_video: bool = True) -> Path:
    """A result folder of `torchhand track`."""
    model = load_hand_model()
    shape = model.shape_space.default.double()
    kinematics = model.kinematics("left" if side == "left" else "right", dtype=torch.float64)
    header = TrackHeader(
        dof_names=DOFS, source="<wave>.mp4", side=side, camera=CAMERA, made_with={"frames_per_second": FPS}
    )
    free = np.array([not name.endswith(("_tw", "cmc_fe")) for name in DOFS])
    with TrackWriter(folder, header) as writer:
        save_hand(
            writer.folder / "hand.json",
            model.shape_space.names,
            shape.tolist(),
            side,
            {"method": "contour fit"},
            units=model.shape_space.units,
        )
        (writer.folder / "config.yaml").write_text("run:\n  config: contour_full\n  side_is: given\n")
        for frame, pose in enumerate(poses(shift_deg)):
            if frame in LOST:
                writer.append(FrameRecord.empty(frame, "lost", dofs=36, seconds=0.1))
                continue
            quality = np.full(5, 0.9)
            quality[OPEN_FINGER] = 0.2
            writer.append(
                FrameRecord(
                    frame=frame,
                    status="recovered" if frame == LOST[-1] + 1 else "tracked",
                    pose=pose,
                    pose_std=np.where(free, np.deg2rad(3.0), 0.0),
                    keypoints3d=kinematics(torch.from_numpy(pose), shape).keypoints.numpy(),
                    keypoints2d=np.zeros((21, 2)),
                    keypoints3d_cov=np.tile(1e-6 * np.eye(3), (21, 1, 1)),
                    seconds=0.1,
                    finger_quality=quality,
                )
            )
        if has_video:
            with write_video(writer.folder / "overlay.mp4", width=320, height=240, fps=FPS) as video:
                for frame in range(FRAMES):
                    image = torch.zeros(240, 320, 3, dtype=torch.uint8)
                    image[:, : 8 * frame] = 200
                    video.write(image)
    return folder
