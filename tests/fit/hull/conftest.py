"""What the tests of the fits into hulls share: a rig around a hand, and what its silhouettes leave."""

import math
from dataclasses import dataclass

import cv2
import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import PostureResiduals
from torchhand.fit.hull.joint_priors import JointPriors
from torchhand.fit.hull.target import HullTarget, target_of, with_rays
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import Hand, HandModel, HandPose, PoseConstraints
from torchhand.image import distance_map
from torchhand.view import mesh_silhouette
from torchhand.volume import Carver, CarvingSettings, RootCube, hull_field

UPRIGHT = ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0))  # rows: the hand's x, y and z in the world


def looking(name: str, place: tuple[float, float, float], up: tuple[float, float, float]) -> Camera:
    """640 × 480 pixels, looking at the origin."""
    centre, above = (torch.tensor(x, dtype=torch.float64) for x in (place, up))
    ahead = -centre / centre.norm()
    down = torch.nn.functional.normalize((above @ ahead) * ahead - above, dim=0)
    rotation = torch.stack((torch.linalg.cross(down, ahead), down, ahead))
    intrinsics = torch.tensor(((520.0, 0, 319.5), (0, 520.0, 239.5), (0, 0, 1)), dtype=torch.float64)
    none = torch.zeros(0, dtype=torch.float64)
    shift = -rotation @ centre
    return Camera(
        intrinsics=intrinsics, rotation=rotation, translation=shift, distortion=none, width=640, height=480, name=name
    )


CENTRE, RADIUS = torch.tensor((0.02, -0.01, 0.03), dtype=torch.float64), 0.06


def ball(camera: Camera) -> Tensor:
    """Silhouette of a ball, by each pixel's ray, near where it is."""
    left, top = (int(value) - 110 for value in camera.project(CENTRE))
    y, x = torch.meshgrid(torch.arange(top, top + 220), torch.arange(left, left + 220), indexing="ij")
    origin, along = camera.rays(torch.stack((x, y), -1).double())
    along = along / along.norm(dim=-1, keepdim=True)
    offset = camera.cam_from_world(CENTRE) - origin
    mask = torch.zeros(480, 640, dtype=torch.bool)
    mask[y, x] = (offset - (offset * along).sum(-1, keepdim=True) * along).norm(dim=-1) < RADIUS
    return mask


@dataclass(frozen=True)
class Rig:
    """Front, side, top, and top at 45° of a frame of Ueda et al. 2003 (section 7.1)."""

    model: HandModel
    hand: Hand
    cameras: tuple[Camera, ...]
    joints: JointPriors

    @property
    def upright(self) -> Tensor:
        """world_from_hand of an upright hand, palm to the front camera."""
        return torch.tensor(UPRIGHT, dtype=torch.float64).T.contiguous()

    def vertices(self, pose: HandPose, shape: Tensor | None = None) -> Tensor:
        return self.hand(pose.dofs, shape, root_reference=pose.reference).vertices

    def masks(self, pose: HandPose, shape: Tensor | None = None) -> list[Tensor]:
        vertices = self.vertices(pose, shape)
        return [mesh_silhouette(vertices, self.hand.faces, camera, is_closed=True) for camera in self.cameras]

    def target(self, pose: HandPose, shape: Tensor | None = None, *, level: int = 7, points: int = 500) -> HullTarget:
        return self.target_of_masks(self.masks(pose, shape), level=level, points=points)

    def target_of_masks(self, masks: list[Tensor], *, level: int = 7, points: int = 500) -> HullTarget:
        root = RootCube(centre=(0.0, 0.0, 0.0), side=0.512)
        carver = Carver(self.cameras, root, CarvingSettings(level=level))
        return target_of(hull_field(carver.carve(masks), surface="middle"), points=points)

    def with_edges(self, masks: list[Tensor], *, rays: int = 300) -> HullTarget:
        """The hull with the edges of its silhouettes."""
        return with_rays(self.target_of_masks(masks), self.cameras, masks, count=rays)

    def noisy(self, masks: list[Tensor], seed: int, *, std_px: float = 1.0) -> list[Tensor]:
        """The silhouettes with edges that are off by smooth noise."""
        generator = torch.Generator().manual_seed(seed)
        found = []
        for mask in masks:
            noise = torch.randn(mask.shape, generator=generator, dtype=torch.float64).numpy()
            noise = cv2.GaussianBlur(noise, (0, 0), 1.5)
            outside, inside = distance_map(mask), distance_map(~mask)
            signed = torch.where(mask, 0.5 - inside, outside - 0.5)
            found.append(signed + std_px * torch.from_numpy(noise / noise.std()) < 0)
        return found

    def balls(self) -> list[Tensor]:
        """The silhouettes of a ball."""
        return [ball(camera) for camera in self.cameras]

    def person(self, seed: int, *, turn: float = 0.4) -> tuple[HandPose, Tensor]:
        """Pose and shape of a random person's hand in the middle of the rig."""
        generator = torch.Generator().manual_seed(seed)
        dofs, shape = (x[0].double() for x in self.model.prior(dtype=torch.float64).sample(1, generator))
        spin = turn * torch.randn(3, generator=generator, dtype=torch.float64)
        pose = HandPose.of(dofs, rotation_from_vector(spin) @ self.upright)
        return self.in_the_middle(pose, shape), shape

    def in_the_middle(self, pose: HandPose, shape: Tensor) -> HandPose:
        """Moved there."""
        vertices, dofs = self.vertices(pose, shape), pose.dofs.clone()
        dofs[:3] += -0.5 * (vertices.amax(0) + vertices.amin(0))
        return HandPose(dofs=dofs, reference=pose.reference)

    def moved(self, pose: HandPose, seed: int, *, deg: float, mm: float) -> HandPose:
        """A start off by so much in every angle, in the palm's turn and in its place."""
        generator = torch.Generator().manual_seed(seed)

        def normal(count: int) -> Tensor:
            return torch.randn(count, generator=generator, dtype=torch.float64)

        start = pose.dofs.clone()
        start[:3] += 1e-3 * mm / math.sqrt(3) * normal(3)
        start[6:] = self.model.skeleton.within_limits(start[6:] + math.radians(deg) * normal(30))
        return HandPose(
            dofs=start, reference=rotation_from_vector(math.radians(deg) / math.sqrt(3) * normal(3)) @ pose.reference
        )

    def keypoints(self, pose: HandPose, shape: Tensor | None = None) -> Tensor:
        return self.hand.kinematics(pose.dofs, shape, root_reference=pose.reference).keypoints

    def error_mm(self, found: HandPose, truth: HandPose, shape: Tensor | None) -> float:
        """Mean distance of the keypoints."""
        distance = (self.keypoints(found, shape) - self.keypoints(truth, shape)).norm(dim=-1)
        return 1e3 * float(distance.mean())

    def flexion_deg(self, pose: HandPose, shape: Tensor | None) -> Tensor:
        """Angles between the bones of each digit that follow each other."""
        chains = [[0, *range(4 * finger + 1, 4 * finger + 5)] for finger in range(5)]
        bones = self.keypoints(pose, shape)[torch.tensor(chains)].diff(dim=1)
        bones = torch.nn.functional.normalize(bones, dim=-1)
        return (bones[:, :-1] * bones[:, 1:]).sum(-1).clamp(-1, 1).acos().rad2deg()


@pytest.fixture(scope="session")
def rig() -> Rig:
    return make_rig()


def make_rig() -> Rig:
    model = load_hand_model()
    high = 0.4 / math.sqrt(2)
    cameras = (
        looking("front", (0.0, 0.0, -0.4), (0.0, -1.0, 0.0)),
        looking("side", (0.4, 0.0, 0.0), (0.0, -1.0, 0.0)),
        looking("top", (0.0, -0.4, 0.0), (0.0, 0.0, 1.0)),
        looking("above", (0.0, -high, -high), (0.0, -1.0, 0.0)),
    )
    return Rig(
        model=model,
        hand=model.hand(dtype=torch.float64),
        cameras=cameras,
        joints=JointPriors(
            constraints=PoseConstraints(model.skeleton),
            postures=PostureResiduals.of(model.prior().postures),
        ),
    )
