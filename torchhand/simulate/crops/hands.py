"""Random hands before the cameras of their crops."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.geometry import rotation_from_vector, rotation_of_quaternion
from torchhand.hand import Hand
from torchhand.simulate.crops.draws import Draws
from torchhand.simulate.crops.forearms import FIRST_OF_FOREARM, LAST_OF_FOREARM, forearm_meshes
from torchhand.simulate.crops.settings import CropSettings

HAND = 1
"""Label of the hand's faces."""
_SHIFT = 0.15  # of the middle of the hand's box from that of the crop, over the crop's side: largest


@dataclass(frozen=True, kw_only=True)
class CropHands:
    """Right hands, one for each crop; those of left hands are mirrored when the crop is done."""

    points: Float[Tensor, "crops points 3"]
    """Vertices of hand and forearm in the camera frame, metres."""
    faces: Int[Tensor, "faces 3"]
    normals: Float[Tensor, "people faces 3"]
    """Means of the unit normals at each face's corners, in the frames of the hands."""
    labels: Int[Tensor, "faces"]
    """1 of the hand, 2 to 255 of the forearm from the wrist to its end."""
    hand_faces: int
    """Number of the hand's faces, which come first."""
    keypoints: Float[Tensor, "crops 21 3"]
    """Keypoints in the camera frame, metres."""
    rotation: Float[Tensor, "crops 3 3"]
    """cam_from_hand"""
    joints: Float[Tensor, "crops 30"]
    shape: Float[Tensor, "crops shape"]
    arm: int
    """First point of the forearm."""
    focal: Float[Tensor, "crops"]
    """Focal length of each crop's camera, px."""
    centre: Float[Tensor, "crops 2"]
    """Principal point of each crop's camera, px."""
    is_left: Bool[Tensor, "crops"]
    person: Int[Tensor, "crops"]
    """Index of the hand that a crop shows, in the batch."""


def crop_hands(
    hand: Hand,
    people: tuple[Float[Tensor, "people 36"], Float[Tensor, "people shape"]],
    settings: CropSettings,
    draws: Draws,
) -> CropHands:
    """Hands in postures of theirs, each before `settings.views` cameras."""
    (poses, shapes), device = people, draws.device
    with torch.no_grad():
        state = hand(poses, shapes)
    breadth = hand.shape_space.metric(shapes)["wrist_breadth"]
    arms, arm_faces, arm_labels = forearm_meshes(breadth, draws.generator)
    person = torch.arange(len(poses), device=device).repeat_interleave(settings.views)
    count = len(person)
    turn = rotation_of_quaternion(torch.nn.functional.normalize(draws.normal(count, 4), dim=-1))
    if settings.roll_deg is not None:
        turn = _rolled(turn, settings.roll_deg, draws)
    nearest, farthest = settings.distance
    distance = torch.exp(draws.between((math.log(nearest), math.log(farthest)), count))
    ahead = torch.stack((0 * distance, 0 * distance, distance), -1)
    place = ahead - (turn @ state.keypoints.mean(1)[person][..., None]).squeeze(-1)
    vertices, faces = (
        torch.cat((state.vertices, arms), 1),
        torch.cat((state.faces, arm_faces + state.vertices.shape[1])),
    )
    points = vertices[person] @ turn.mT + place[:, None]
    plane = points[:, : state.vertices.shape[1]]
    plane = plane[..., :2] / plane[..., 2:]
    least, most = plane.amin(1), plane.amax(1)
    share = draws.between(settings.fill, count)
    focal = settings.side_px * share / (most - least).amax(-1)
    shift = settings.side_px * _SHIFT * (2 * draws.uniform(count, 2) - 1)
    centre = 0.5 * (settings.side_px - 1) + shift - focal[:, None] * 0.5 * (least + most)
    return CropHands(
        points=points,
        faces=faces,
        normals=_smooth_normals(vertices, faces),
        labels=torch.cat((torch.full_like(state.faces[:, 0], HAND), arm_labels)),
        hand_faces=len(state.faces),
        keypoints=state.keypoints[person] @ turn.mT + place[:, None],
        rotation=turn,
        joints=poses[person, 6:],
        shape=shapes[person],
        arm=state.vertices.shape[1],
        focal=focal,
        centre=centre,
        is_left=(draws.uniform(len(poses)) < settings.left)[person],
        person=person,
    )


def last_labels(count: int, settings: CropSettings, draws: Draws) -> tuple[Int[Tensor, "crops"], Int[Tensor, "crops"]]:
    """Last label that is skin, and last one that is there at all, of each crop."""
    has_arm = draws.uniform(count) < settings.forearm
    has_sleeve = draws.uniform(count) < settings.sleeve
    begin = draws.whole(FIRST_OF_FOREARM, LAST_OF_FOREARM // 2, count)
    skin = torch.where(has_arm, torch.where(has_sleeve, begin, LAST_OF_FOREARM), HAND)
    return skin, torch.where(has_arm, LAST_OF_FOREARM, HAND)


def _smooth_normals(
    vertices: Float[Tensor, "people points 3"], faces: Int[Tensor, "faces 3"]
) -> Float[Tensor, "people faces 3"]:
    vertices = vertices.movedim(0, 1).contiguous()  # whole rows are gathered and added
    a, b, c = (vertices.index_select(0, corner) for corner in faces.unbind(-1))
    of_faces, at_points = torch.linalg.cross(b - a, c - a).flatten(1), torch.zeros_like(vertices).flatten(1)
    for corner in faces.unbind(-1):
        at_points.index_add_(0, corner, of_faces)
    at_points = torch.nn.functional.normalize(at_points.view_as(vertices), dim=-1)
    a, b, c = (at_points.index_select(0, corner) for corner in faces.unbind(-1))
    return a.add_(b).add_(c).div_(3).movedim(0, 1)


def _rolled(turn: Float[Tensor, "crops 3 3"], std_deg: float, draws: Draws) -> Float[Tensor, "crops 3 3"]:
    """Turned about the line of sight until the fingers (y of the hand) point upwards, and then by a random angle."""
    upwards = torch.atan2(-turn[:, 0, 1], -turn[:, 1, 1])  # from the way the fingers point to -y of the picture
    angle = upwards + math.radians(std_deg) * draws.normal(len(turn))
    about = torch.stack((0 * angle, 0 * angle, angle), -1)
    return rotation_from_vector(about) @ turn
