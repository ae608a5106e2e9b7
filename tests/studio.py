"""What the tests of fits and trackers share: people before cameras, and pictures of them with the truth."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector
from torchhand.hand import HandKinematics, posture
from torchhand.simulate import Motion, SceneSettings, Staging, facing, hand_length, render_sequence, scripted_motion
from torchhand.simulate.motion import View
from torchhand.view import HandProjector, OutlineTable, outline_table

WIDTH, HEIGHT = 200, 160


@dataclass(frozen=True, kw_only=True)
class StagedHand:
    """A hand in front of a camera."""

    kinematics: HandKinematics
    camera: Camera
    shape: Tensor
    pose: Tensor
    """With a zero rotation vector."""
    root_reference: Tensor

    @property
    def projector(self) -> HandProjector:
        return HandProjector(self.kinematics, self.camera, self.shape)

    @property
    def keypoints_px(self) -> Tensor:
        return self.camera.project(self.projector.frames(self.pose, self.root_reference).keypoints)

    @property
    def mask(self) -> Tensor:
        return self.projector.silhouette(self.pose, self.root_reference)

    @property
    def length_px(self) -> float:
        """Wrist to middle fingertip."""
        points = self.keypoints_px
        return float((points[12] - points[0]).norm())

    def picture(self, scene: SceneSettings | None = None, *, seed: int = 0) -> Tensor:
        """RGB."""
        generator = torch.Generator().manual_seed(seed)
        motion = Motion(name="still", poses=self.pose[None], root_reference=self.root_reference, fps=30.0)
        scene = scene or SceneSettings(supersampling=2)
        frames = render_sequence(self.kinematics, motion, self.camera, scene, generator, shape=self.shape)
        return next(iter(frames)).image


@dataclass(frozen=True, kw_only=True)
class Filmed:
    """A short sequence and its truth."""

    images: list[Tensor]
    keypoints_px: Tensor
    keypoints_cam: Tensor
    kinematics: HandKinematics
    camera: Camera


class Studio:
    """Hands and cameras by request; everything float64."""

    table: OutlineTable = outline_table(10, 12, without=("palm_wrist",))

    def kinematics(self, side: str = "right") -> HandKinematics:
        return load_hand_model().kinematics("left" if side == "left" else "right", dtype=torch.float64)

    def camera(self, width: int = WIDTH, height: int = HEIGHT, *, kind: str = "pinhole", lens: bool = False) -> Camera:
        """An orthographic one has the scale at which the default hand fills 0.6 of the height."""
        camera = replace(assumed_camera(width, height, horizontal_fov_deg=48.0), is_assumed=False)
        if lens:
            bent = torch.tensor((-0.18, 0.05, 0.002, -0.001, 0.0), dtype=torch.float64)
            camera = replace(camera, distortion=bent)
        if kind == "orthographic":
            scale = 0.6 * height / hand_length(self.kinematics())
            intrinsics = ((scale, 0.0, (width - 1) / 2), (0.0, scale, (height - 1) / 2), (0.0, 0.0, 1.0))
            tensor = torch.tensor(intrinsics, dtype=torch.float64)
            camera = replace(camera, intrinsics=tensor, kind="orthographic")
        return camera

    def placed(
        self,
        *,
        side: str = "right",
        view: View = "palm",
        angle_deg: float = 0.0,
        size: float = 0.6,
        at: tuple[float, float] = (0.0, 0.0),
        posed: str = "open",
        shape: Tensor | None = None,
        camera: Camera | None = None,
    ) -> StagedHand:
        """A hand turned clockwise in the picture, its length and the place of its middle as shares of the height."""
        kinematics, camera = self.kinematics(side), camera or self.camera()
        shape = kinematics.default_shape if shape is None else shape
        length = hand_length(kinematics, shape)
        turn = torch.tensor((0.0, 0.0, angle_deg), dtype=torch.float64).deg2rad()
        reference = rotation_from_vector(turn) @ facing(view)
        depth = float(camera.intrinsics[0, 0]) * length / (size * camera.height)
        middle_px = 0.5 * torch.tensor((camera.width - 1, camera.height - 1), dtype=torch.float64)
        plane = camera.plane_from_pixels(middle_px + camera.height * torch.tensor(at, dtype=torch.float64))
        middle = torch.cat((plane, torch.ones(1, dtype=torch.float64)))
        middle = middle if camera.kind == "orthographic" else depth * middle
        pose = posture(posed, dtype=torch.float64)
        pose[:3] = middle - reference @ torch.tensor((0.0, 0.48 * length, 0.0), dtype=torch.float64)
        return StagedHand(kinematics=kinematics, camera=camera, shape=shape, pose=pose, root_reference=reference)

    def film(
        self,
        script: str,
        frames: int,
        *,
        camera: Camera | None = None,
        scene: SceneSettings | None = None,
        seed: int = 3,
        total: int | None = None,
        pace: float = 1.0,
    ) -> Filmed:
        """The first `frames` of a scripted motion of `total` frames of the default right hand; it starts from rest."""
        kinematics, camera = self.kinematics(), camera or self.camera()
        generator = torch.Generator().manual_seed(seed)
        motion = scripted_motion(script, total or frames, kinematics, camera, generator, staging=Staging(pace=pace))
        motion = replace(motion, poses=motion.poses[:frames])
        scene = scene or SceneSettings(supersampling=2)
        rendered = list(render_sequence(kinematics, motion, camera, scene, generator))
        return Filmed(
            images=[frame.image for frame in rendered],
            keypoints_px=torch.stack([frame.keypoints_px for frame in rendered]),
            keypoints_cam=torch.stack([frame.keypoints_cam for frame in rendered]),
            kinematics=kinematics,
            camera=camera,
        )
