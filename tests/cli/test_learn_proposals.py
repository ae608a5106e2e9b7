"""`torchhand learn_proposals`: a tiny training from the command line, the shipped network measured, what is refused."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from tests.studio import StagedHand
from torchhand.cli import learn_proposals
from torchhand.cli.learn_proposals import main
from torchhand.files import load_hand_model, load_presence_network, load_proposal_network, save_cameras
from torchhand.geometry import assumed_camera
from torchhand.hand import posture
from torchhand.learn.presence import PresenceTraining
from torchhand.learn.proposals import ProposalTraining
from torchhand.simulate import facing


@pytest.fixture(autouse=True)
def few_views() -> Iterator[None]:
    """What the command line does not offer: fewer hands to measure on and a smaller network."""
    small = ProposalTraining(held_out=6, width=2, batch=4, hypotheses=3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learn_proposals, "ProposalTraining", lambda: small)
        patch.setattr(learn_proposals, "PresenceTraining", lambda: PresenceTraining(held_out=6, width=2, batch=4))
        yield


def _sequence(folder: Path) -> Path:
    """Two frames of a fist and of an open hand, with masks."""
    model = load_hand_model()
    camera = assumed_camera(160, 120)
    points = []
    for name in ("frames", "masks"):
        (folder / name).mkdir(parents=True)
    for number, name in enumerate(("fist", "open")):
        pose = posture(name, dtype=torch.float64)
        pose[:3] = torch.tensor([0.0, 0.03, 0.5])
        hand = StagedHand(
            kinematics=model.kinematics(dtype=torch.float64),
            camera=camera,
            shape=model.shape_space.default,
            pose=pose,
            root_reference=facing("back"),
        )
        points.append(hand.projector.frames(hand.pose, hand.root_reference).keypoints.numpy())
        mask = 255 * hand.mask.numpy().astype(np.uint8)
        cv2.imwrite(str(folder / "masks" / f"{number}.png"), mask)
        cv2.imwrite(str(folder / "frames" / f"{number}.png"), cv2.merge((mask, mask, mask)) // 2)
    np.savez(folder / "truth.npz", keypoints3d=np.stack(points))
    save_cameras([camera], folder / "cameras.json")
    return folder


def test_a_training_leaves_a_network_that_can_be_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "network.npz"
    assert main(["--out", str(out), "--steps", "3", "--hands", "8"]) == 0
    assert load_proposal_network(out).sizes == {"hypotheses": 3, "width": 2, "hidden": 384}
    told = capsys.readouterr().out
    assert "step 3: loss" in told
    assert "held-out simulated hands, one view" in told
    again = tmp_path / "again.npz"
    assert main(["--out", str(again), "--steps", "3", "--hands", "8"]) == 0
    assert again.read_bytes() == out.read_bytes()


def test_a_training_leaves_a_network_of_presence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "presence.npz"
    assert main(["--presence", str(out), "--steps", "3", "--hands", "8"]) == 0
    assert load_presence_network(out).sizes == {"width": 2, "hidden": 96}
    told = capsys.readouterr().out
    assert "step 3: loss" in told
    assert "% of held-out hands" in told


def test_the_shipped_network_is_measured_on_a_sequence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--evaluate", str(_sequence(tmp_path / "hands"))]) == 0
    head, names, proposed, registered = capsys.readouterr().out.splitlines()
    assert "best of 8" in head
    assert "placed_mm" in names
    assert proposed.split()[:3] == ["hands,", "proposed", "2"]
    assert registered.split()[:3] == ["hands,", "registered", "2"]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ([], "expected --out or --presence FILE to train, or --evaluate FOLDER to measure"),
        (["--out", "a.npz", "--network", "b.npz"], "expected at most one of --out and --network"),
        (["--out", "a.npz", "--steps", "0"], "--steps: expected 1 to"),
        (["--evaluate", "nowhere"], "nowhere: expected a folder with truth.npz"),
        (["--evaluate", ".", "--every", "0"], "--every: expected 1 or more, got 0"),
    ],
)
def test_mistakes_are_told_in_a_line(
    arguments: list[str],
    complaint: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    told = capsys.readouterr().err.strip()
    assert complaint in told
    assert "\n" not in told
