"""`torchhand demo`: everything that it promises is there, and what it tracked is right."""

from pathlib import Path

import numpy as np
import pytest

from torchhand.cli.demo import main
from torchhand.evaluate import evaluate, load_truth
from torchhand.files import load_track, open_source, read_picture

FRAMES = 6


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo") / "out"
    assert main(["--out", str(folder), "--frames", str(FRAMES)]) == 0
    return folder


def test_the_demo_tracks_what_it_simulated(demo: Path) -> None:
    track = load_track(demo / "track")
    assert track.status.tolist() == ["tracked"] * FRAMES
    figures = evaluate(track, load_truth(demo / "simulated"))
    assert figures["position_2d_px"]["mean"] < 4.0
    assert figures["position_mm"]["aligned"]["mean"] < 5.0


def test_the_hand_is_skin_before_a_room(demo: Path) -> None:
    """Its outline is that of the mesh, and what is behind it has bright and dark areas and no colour of skin."""
    picture = read_picture(next((demo / "simulated" / "frames").iterdir())).double()
    mask = read_picture(next((demo / "simulated" / "masks").iterdir())).amax(-1) > 127
    behind = picture[: picture.shape[0] // 2][~mask[: picture.shape[0] // 2]]
    assert float(behind.mean(-1).std()) > 25.0
    assert float((behind[:, 0] - behind[:, 2]).quantile(0.99)) < 30.0
    assert float((picture[mask][:, 0] - picture[mask][:, 2]).median()) > 40.0


def test_the_demo_leaves_something_to_look_at(demo: Path) -> None:
    for name in ("report.html", "track.npz", "track.jsonl", "hand.json", "config.yaml", "overlay.mp4"):
        assert (demo / "track" / name).stat().st_size > 0
    with open_source(demo / "track" / "overlay.mp4") as video:
        assert len(list(video)) == FRAMES
        width, height = video.width, video.height
    picture = read_picture(demo / "picture.png").numpy()
    assert picture.shape[0] > 2 * height
    assert picture.shape[1] > 2 * width
    contour = np.array((40, 255, 60))
    quarters = [half for rows in np.array_split(picture, 2) for half in np.array_split(rows, 2, axis=1)]
    for quarter in quarters:  # a contour is drawn over the hand in each of four frames
        assert (np.abs(quarter.astype(int) - contour).max(-1) < 60).sum() > 100


def test_an_older_demo_is_only_replaced_when_asked(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (demo / "track" / "track.npz").read_bytes()
    assert main(["--out", str(demo), "--frames", "2"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert str(demo / "simulated") in printed.err
    assert "--overwrite" in printed.err
    assert (demo / "track" / "track.npz").read_bytes() == before


def test_replacing_and_saying_what_was_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--out", str(tmp_path / "out"), "--frames", "2"]
    assert main([*options, "--seed", "1"]) == 0
    one = load_track(tmp_path / "out" / "track")
    assert main([*options, "--seed", "2", "--overwrite"]) == 0
    other = load_track(tmp_path / "out" / "track")
    assert not np.allclose(one.pose[1], other.pose[1], rtol=0, atol=1e-12)
    printed = capsys.readouterr()
    assert "assumed" not in printed.err  # the camera is known
    assert "|" not in printed.err  # no progress bars where nobody watches
    assert "followed in 2 of 2 frames" in printed.out
    assert "% of the joints lie where the tracker is 95 % sure that they are" in printed.out
    assert f"open {tmp_path / 'out' / 'track' / 'report.html'} in a browser" in printed.out.splitlines()[-1]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--frames", "1"], "--frames: expected 2 to 10000, got 1"),
        (["--frames", "many"], "many"),
        (["--seed", str(2**70)], "--seed: expected a number of 64 bits"),
    ],
)
def test_options_that_cannot_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    assert main(["--out", str(tmp_path / "out"), *options]) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("torchhand demo: error: ")
    assert printed.err.count("\n") == 1
    assert words in printed.err
    assert not (tmp_path / "out").exists()
