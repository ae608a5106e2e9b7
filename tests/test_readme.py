"""What the README shows must run and be there."""

import importlib
import re
from pathlib import Path

import cv2
import pytest

from tests.studio import Studio
from torchhand.files import write_video

REPOSITORY = Path(__file__).resolve().parents[1]
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")


def _examples() -> list[str]:
    return re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


class _Webcam:
    """Two pictures of an open hand, then the end."""

    def __init__(self, number: int) -> None:
        self.number = number
        self._pictures = [Studio().placed().picture(seed=seed).numpy()[..., ::-1].copy() for seed in range(2)]

    def read(self) -> tuple:
        return (True, self._pictures.pop()) if self._pictures else (False, None)


def test_the_first_example_fits_a_hand_and_tracks_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    image = Studio().placed(size=0.75, camera=Studio().camera(480, 360)).picture()
    cv2.imwrite("open_hand.jpg", image.numpy()[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
    with write_video(Path("video.mp4"), width=480, height=360) as video:
        for _ in range(2):
            video.write(image)
    names: dict = {}
    exec(compile(_examples()[0], "README.md", "exec"), names)
    assert names["shape"].shape == (52,)
    assert names["estimate"].status == "tracked"
    assert names["estimate"].time_s > 0
    assert capsys.readouterr().out.count("tracked tensor(") == 2


def test_the_webcam_example_tracks(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", _Webcam)
    names: dict = {}
    exec(compile(_examples()[2], "README.md", "exec"), names)
    assert names["video"].number == 0
    assert names["estimate"].status == "tracked"
    assert capsys.readouterr().out.count("tracked tensor(") == 2


def test_the_example_runs_and_its_gradients_are_those_of_the_pinch(capsys) -> None:
    example = _examples()[1]
    names: dict = {}
    exec(compile(example, "README.md", "exec"), names)
    gradient = names["pose"].grad
    assert gradient.isfinite().all()
    # The distance between two fingertips does not depend on where the hand is, but does on the thumb's joints.
    assert float(gradient[:3].abs().max()) < 1e-12
    assert float(gradient[6:9].abs().max()) > 1e-3
    assert float(names["shape"].grad.abs().max()) > 1e-3
    assert "thumb_cmc_fe" in capsys.readouterr().out


def test_functions_that_it_names_exist() -> None:
    names = re.findall(r"`torchhand\.([\w.]+)`", README)
    assert names
    for name in names:
        door, *rest = name.split(".")
        value: object = importlib.import_module(f"torchhand.{door}")
        for part in rest:
            value = getattr(value, part)


def test_pictures_and_pages_that_it_names_exist() -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", README)
    assert targets
    assert [target for target in targets if not (REPOSITORY / target).exists()] == []
