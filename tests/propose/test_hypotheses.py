"""From silhouettes to hands in the world: cameras, sides, batches, and what a perfect network would give."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model, load_proposal_network
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector
from torchhand.hand import HandKinematics, Side
from torchhand.propose.hypotheses import HandHypotheses, Silhouette, propose_hands, sampled_channels
from torchhand.propose.network import ProposalNetwork, ViewedHands
from torchhand.propose.views import views_towards

MODEL = load_hand_model()
SHAPE = MODEL.shape_space.default
WIDTH, HEIGHT = 160, 120


def _kinematics(side: Side = "right") -> HandKinematics:
    return MODEL.kinematics(side, dtype=torch.float64)


def _blob() -> Tensor:
    """A thick and a thin part, off the middle of the picture."""
    mask = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    mask[50:90, 90:130] = True
    mask[20:50, 95:105] = True
    return mask


def _silhouette(camera: Camera | None = None) -> Silhouette:
    return Silhouette(mask=_blob(), camera=assumed_camera(WIDTH, HEIGHT) if camera is None else camera)


class _Fixed(ProposalNetwork):
    """Sees the same hands whatever it is shown."""

    def __init__(self, hypotheses: int = 3) -> None:
        super().__init__(MODEL.skeleton, width=1, hidden=1)
        generator = torch.Generator().manual_seed(3)
        self.turn = rotation_from_vector(torch.randn(hypotheses, 3, generator=generator))
        self.joints = 0.3 * torch.rand(hypotheses, 30, generator=generator)
        self.weight = torch.linspace(0, 1, hypotheses).log_softmax(-1)

    def forward(self, channels: Tensor) -> ViewedHands:
        def repeated(value: Tensor) -> Tensor:
            return value.expand(len(channels), *value.shape)

        count = len(self.weight)
        return ViewedHands(
            rotation=repeated(self.turn),
            joints=repeated(self.joints),
            place=torch.zeros(len(channels), count, 2),
            log_size=torch.full((len(channels), count), 0.7),
            spread=torch.ones(len(channels), count),
            log_weight=repeated(self.weight),
        )


def _proposed(
    *silhouettes: Silhouette, side: Side = "right", shape: Tensor | None = None, count: int = 6
) -> HandHypotheses:
    return propose_hands(load_proposal_network(), silhouettes, _kinematics(side), shape, count=count)


def test_hands_lie_before_the_silhouette() -> None:
    silhouette, kinematics = _silhouette(), _kinematics()
    found = propose_hands(_Fixed(), [silhouette], kinematics)
    points = kinematics(found.pose.dofs, SHAPE, root_reference=found.pose.reference).keypoints
    middle = silhouette.camera.project(points[0].mean(1))
    assert bool((middle[:, 0] > 70).all())
    assert bool((middle[:, 0] < 150).all())
    assert bool((points[..., 2] > 0.05).all())


def test_a_larger_hand_is_farther_away() -> None:
    """What is seen tells sizes over distances only."""
    row = MODEL.shape_space.names.index("hand_length")
    larger = SHAPE.clone()
    larger[row] *= 1.2
    usual, other = (propose_hands(_Fixed(1), [_silhouette()], _kinematics(), one, count=1) for one in (SHAPE, larger))
    points = [
        _kinematics()(one.pose.dofs, shape, root_reference=one.pose.reference).keypoints[0, 0]
        for one, shape in ((usual, SHAPE), (other, larger))
    ]
    palm = [one[[0, 5, 9, 13, 17]].mean(0) for one in points]
    torch.testing.assert_close(palm[1][2] / palm[0][2], torch.tensor(1.2).double(), rtol=0.05, atol=0)


def test_the_world_may_be_anywhere() -> None:
    here = assumed_camera(WIDTH, HEIGHT)
    turn = rotation_from_vector(torch.tensor([0.4, -1.1, 0.3], dtype=torch.float64))
    there = replace(here, rotation=turn, translation=torch.tensor([0.1, 0.2, -0.4]).double())
    own, other = _proposed(_silhouette(here)), _proposed(_silhouette(there))
    torch.testing.assert_close(
        there.cam_from_world(other.pose.dofs[..., :3]), own.pose.dofs[..., :3], atol=1e-6, rtol=0
    )
    torch.testing.assert_close(turn @ other.pose.reference, own.pose.reference, atol=1e-6, rtol=0)
    torch.testing.assert_close(other.pose.dofs[..., 6:], own.pose.dofs[..., 6:], atol=1e-6, rtol=0)


def test_left_hands_are_right_ones_in_the_mirror() -> None:
    right = _silhouette()
    left = replace(right, mask=right.mask.flip(1))
    own, other = _proposed(right), _proposed(left, side="left")
    points = _kinematics()(own.pose.dofs, root_reference=own.pose.reference).keypoints
    mirrored = _kinematics("left")(other.pose.dofs, root_reference=other.pose.reference).keypoints
    torch.testing.assert_close(mirrored * torch.tensor([-1.0, 1.0, 1.0]).double(), points, atol=1e-4, rtol=0)
    torch.testing.assert_close(other.weight, own.weight, atol=1e-4, rtol=0)


def test_the_picture_s_resolution_hardly_matters() -> None:
    small = _silhouette()
    fine = small.mask.repeat_interleave(3, 0).repeat_interleave(3, 1)
    large = Silhouette(mask=fine, camera=small.camera.resized(3.0))
    own, other = _proposed(small), _proposed(large)
    torch.testing.assert_close(other.pose.dofs[0, 0, :3], own.pose.dofs[0, 0, :3], atol=0.02, rtol=0)
    assert float(torch.trace(other.pose.reference[0, 0] @ own.pose.reference[0, 0].mT)) > 2.8


def test_many_silhouettes_equal_one_by_one_and_empty_ones_give_nothing() -> None:
    seen = _silhouette()
    silhouettes = [seen, replace(seen, mask=torch.zeros_like(seen.mask)), replace(seen, mask=seen.mask.roll(-40, 1))]
    whole = _proposed(*silhouettes)
    assert bool(whole.weight[1].isnan().all())
    assert bool(whole.pose.dofs[1].isnan().all())
    for row in (0, 2):
        alone = _proposed(silhouettes[row])
        torch.testing.assert_close(whole.pose.dofs[row], alone.pose.dofs[0], atol=1e-5, rtol=0)
        torch.testing.assert_close(whole.weight[row], alone.weight[0], atol=1e-5, rtol=0)


def test_weights_add_up_and_fall() -> None:
    found = _proposed(_silhouette(), count=8)
    torch.testing.assert_close(found.weight.sum(-1), torch.ones(1).double())
    assert bool((found.weight.diff(dim=-1) <= 0).all())


def test_hypotheses_that_are_alike_are_one() -> None:
    """All views show the same three hands: upright and upside down, about the whole and its thickest part."""
    found = propose_hands(_Fixed(), [_silhouette()], _kinematics(), count=4)
    points = _kinematics()(found.pose.dofs, root_reference=found.pose.reference).keypoints[0]
    held = found.weight[0] > 0
    apart = (points[:, None] - points).norm(dim=-1).mean(-1)[held][:, held]
    assert bool((apart[~torch.eye(len(apart), dtype=torch.bool)] > 0.014).all())


def test_other_cameras_are_refused() -> None:
    camera = replace(assumed_camera(WIDTH, HEIGHT), kind="orthographic")
    with pytest.raises(ValueError, match="camera: expected a pinhole camera, got orthographic"):
        _proposed(_silhouette(camera))


@pytest.mark.parametrize("behind", [False, True])
def test_a_straight_view_is_sampled_as_through_a_lens_that_bends_nothing(behind: bool) -> None:
    camera = assumed_camera(WIDTH, HEIGHT)
    lens = replace(camera, distortion=torch.tensor((1e-12, 0.0, 0.0, 0.0), dtype=torch.float64))
    image = torch.randint(256, (HEIGHT, WIDTH, 3), generator=torch.Generator().manual_seed(0)).to(torch.uint8)
    centre, up = torch.tensor(((0.1, 0.05, 1.0), (-0.4, 0.3, 1.0))), torch.tensor(((0.2, -1.0, 0.0), (1.0, 0.3, 0.0)))
    reach = torch.tensor((0.2, 3.0 if behind else 0.5))  # beyond a right angle some rays point backwards
    views = views_towards(centre, up, reach)
    straight, bent = (
        sampled_channels(Silhouette(mask=_blob(), camera=one, image=image), views) for one in (camera, lens)
    )
    torch.testing.assert_close(straight, bent, rtol=0, atol=2e-4)
