"""What teaches without labels: silhouettes as each crop's own camera sees them, and steps that follow them."""

from dataclasses import replace

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera
from torchhand.learn import HandEstimate
from torchhand.learn.pictures import (
    PictureTraining,
    RecordedCrops,
    new_picture_training,
    picture_data,
    recorded_figures,
    simulated_data,
    train_from_pictures,
)
from torchhand.learn.pictures.simulated import LOOKS
from torchhand.learn.pictures.teaching import Teacher, TeachingWeights, projected
from torchhand.simulate import CropMaker, Crops
from torchhand.view import SoftRenderer

SIDE = 48


def plain_crops() -> Crops:
    generator = torch.Generator().manual_seed(2)
    settings = replace(LOOKS, forearm=0.0, occluder=0.0)
    return next(CropMaker(load_hand_model(), settings, generator).batches(4, generator))


def true_estimate(crops: Crops) -> HandEstimate:
    eye = torch.eye(3).expand(len(crops), 3, 3)
    return HandEstimate(pose=crops.pose, root_reference=eye, shape=crops.shape, keypoints=crops.keypoints)


def as_recorded(crops: Crops) -> RecordedCrops:
    """As if a detector without errors had seen them."""
    return RecordedCrops(
        image=crops.image,
        intrinsics=crops.intrinsics,
        points_px=crops.keypoints_px,
        mask=crops.mask.float(),
        known=torch.ones_like(crops.mask),
        scale=torch.ones(len(crops)),
        frame=torch.arange(len(crops)),
    )


def test_silhouettes_are_those_of_the_crops_own_cameras() -> None:
    crops, model = plain_crops(), load_hand_model()
    estimate = true_estimate(crops)
    covered = Teacher(model).silhouettes(estimate, crops.intrinsics)
    hand = model.hand(dtype=torch.float32)
    for index in range(4):
        camera = assumed_camera(SIDE, SIDE, dtype=torch.float32)
        camera.intrinsics.copy_(crops.intrinsics[index])
        vertices = hand(crops.pose[index], crops.shape[index]).vertices
        alone = SoftRenderer(hand.faces).silhouette(vertices, camera)
        torch.testing.assert_close(covered[index], alone, atol=2e-3, rtol=0)
    torch.testing.assert_close(projected(estimate, crops.intrinsics), crops.keypoints_px, atol=1e-2, rtol=0)


def test_the_truth_costs_least() -> None:
    """A hand that is moved, turned or bent costs more than the true one."""
    crops, teacher = plain_crops(), Teacher(load_hand_model())
    recorded, weights, rows = as_recorded(crops), TeachingWeights(prior=0.0), torch.arange(len(crops))
    hand = load_hand_model().hand(dtype=torch.float32)

    def cost(column: int, step: float) -> float:
        pose = crops.pose.clone()
        pose[:, column] += step
        state = hand(pose, crops.shape)
        moved = replace(true_estimate(crops), pose=pose, keypoints=state.keypoints)
        return float(teacher.loss(moved, recorded, rows, weights, 0))

    least = cost(0, 0.0)
    assert least < 0.5
    for column, step in ((0, 0.01), (2, 0.05), (3, 0.3), (7, 0.5)):
        assert cost(column, step) > 1.2 * least, column


def test_steps_on_a_recording_bring_the_network_to_its_silhouettes_and_points(small_training: PictureTraining) -> None:
    """Unlabelled crops alone: the simulator's part of the loss weighs next to nothing."""
    model, crops = load_hand_model(), plain_crops()
    nothing = replace(small_training.weights, keypoints=0.0, reprojection=0.0, distance=0.0, joints=0.0, energy=0.0)
    settings = replace(
        small_training, steps=1, recorded_steps=40, recorded_batch=16, recorded_rate=3e-3, weights=nothing
    )
    own, _ = simulated_data(settings, model)
    data = picture_data(settings, model, own, as_recorded(crops))
    training = new_picture_training(settings, model, own.joints.mean(0))
    points, overlaps = [], []
    for reached in train_from_pictures(training, data, pause_every=100):
        assert data.recorded is not None
        figures = recorded_figures(reached.network, data.recorded, data.teacher)
        points.append(figures["points_px"])
        overlaps.append(figures["overlap"])
    assert points[-1] < 0.85 * points[0]
    assert overlaps[-1] > overlaps[0]


def test_it_learns_the_same_on_any_device(device: torch.device) -> None:
    settings = PictureTraining(
        steps=1,
        recorded_steps=1,
        batch=2,
        recorded_batch=2,
        pool=8,
        held_out=8,
        width=4,
        hidden=16,
        blocks=1,
        energy_hands=2,
    )
    model, crops = load_hand_model(), as_recorded(plain_crops())
    simulated, _ = simulated_data(settings, model)
    ends = []
    for there in (torch.device("cpu"), device):
        data = picture_data(settings, model, simulated, crops, there)
        training = new_picture_training(settings, model, simulated.joints.mean(0), there)
        losses = [reached.loss for reached in train_from_pictures(training, data, pause_every=1)]
        assert data.recorded is not None
        ends.append((losses, recorded_figures(training.network, data.recorded, data.teacher)))
    assert ends[1][0] == pytest.approx(ends[0][0], rel=1e-3)
    assert ends[1][1] == pytest.approx(ends[0][1], rel=1e-2)
