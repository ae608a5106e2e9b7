"""Pictures of the skin alone: the window is no other picture, and words are where they ought to be."""

import numpy as np
import torch

from torchhand.draw.hand_picture import PAPER, SKIN, HandPainter, draw_trace, write_sign, write_word
from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera
from torchhand.hand import posed_mesh, posture
from torchhand.view import cast, shade

MODEL = load_hand_model()


def _pose(x: float = 0.0, z: float = 0.5) -> torch.Tensor:
    pose = posture("open", dtype=torch.float64)[None].clone()
    pose[:, :6] = torch.tensor([x, 0.09, z, 0.0, np.pi / 2, 0.0])
    pose[:, 3:6] = torch.tensor([2.2, 0.0, 2.2])
    return pose


def test_the_window_is_a_part_of_the_whole_picture() -> None:
    hand, camera = MODEL.hand(dtype=torch.float64), assumed_camera(160, 120, dtype=torch.float64)
    painter = HandPainter(hand, camera)
    for x in (0.0, 0.25):  # the second at the edge
        painted = painter.paint(painter.surfaces(_pose(x)).select(0))
        behind = torch.tensor(PAPER, dtype=torch.uint8).expand(120, 160, 3)
        surface = posed_mesh(hand, hand(_pose(x)[0]))
        whole = shade(cast(surface, camera), skin=SKIN, background=behind, light=(-0.35, -0.6, -0.72), ambient=0.4)
        assert torch.equal(painted, whole)
        assert int((painted != behind).any(-1).sum()) > 300


def test_a_hand_out_of_sight_leaves_paper() -> None:
    hand, camera = MODEL.hand(dtype=torch.float64), assumed_camera(96, 64, dtype=torch.float64)
    painter = HandPainter(hand, camera, paper=(1, 2, 3))
    for pose in (_pose(3.0), _pose(0.0, -1.0)):
        painted = painter.paint(painter.surfaces(pose).select(0))
        assert bool((painted == torch.tensor((1, 2, 3), dtype=torch.uint8)).all())


def test_smoothing_averages_the_edges() -> None:
    hand, camera = MODEL.hand(dtype=torch.float64), assumed_camera(120, 120, dtype=torch.float64)
    surface = HandPainter(hand, camera).surfaces(_pose()).select(0)
    plain, smooth = (HandPainter(hand, camera, smoothing=side).paint(surface).double() for side in (1, 3))
    assert float((plain - smooth).abs().mean()) < 3
    assert len(smooth.reshape(-1, 3).unique(dim=0)) > 1.3 * len(plain.reshape(-1, 3).unique(dim=0))


def test_words_and_traces() -> None:
    picture = torch.full((240, 320, 3), 255, dtype=torch.uint8)
    write_word(picture, "HELLO", 1)
    dark = (picture < 90).all(-1).nonzero()
    faint = ((picture > 150) & (picture < 200)).all(-1).nonzero()
    assert len(dark) > 10  # letters are drawn a little thinner by OpenCV 4
    assert len(faint) > 60
    assert int(dark[:, 0].min()) > 180  # at the bottom
    assert int(faint[:, 1].min()) < int(dark[:, 1].min()) < int(dark[:, 1].max()) < int(faint[:, 1].max())
    long = torch.full((240, 320, 3), 255, dtype=torch.uint8)
    write_word(long, "A" * 200, 100)
    columns = (long < 255).any(-1).any(0).nonzero()[:, 0]
    assert 10 < int(columns.min()) < int(columns.max()) < 310
    corner = torch.full((128, 128, 3), 255, dtype=torch.uint8)
    write_sign(corner, "Q")
    assert bool((corner[:30, :30] < 255).any())
    assert bool((corner[40:] == 255).all())
    draw_trace(corner, torch.stack((torch.linspace(50, 100, 20), torch.full((20,), 90.0)), -1))
    assert bool((corner[90, 55:95] < 255).any(-1).all())
