"""How far a run is, where no terminal shows a bar."""

import pytest

from torchhand.runs import progress as progress_file
from torchhand.runs.progress import progress, untold_progress


def test_a_line_every_ten_seconds(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    now_s, said = 0.0, list[str]()
    monkeypatch.setattr(progress_file.time, "monotonic", lambda: now_s)
    with progress("wave", 100, said.append) as bar:
        for count in range(50):
            now_s = 0.5 * (count + 1)
            bar.update({"tracked": count + 1, "lost": 0})
    assert said == [
        "wave: 20 of 100 frames, 2.0 per second, 40 s left, 20 tracked",
        "wave: 40 of 100 frames, 2.0 per second, 30 s left, 40 tracked",
    ]
    assert capsys.readouterr().err == ""


def test_nobody_knows_how_many_frames_a_camera_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, said = 0.0, list[str]()
    monkeypatch.setattr(progress_file.time, "monotonic", lambda: now_s)
    with progress("webcam0", None, said.append) as bar:
        now_s = 12.0
        bar.update()
    assert said == ["webcam0: 1 frames, 0.1 per second"]


def test_what_nobody_reads_before_the_end_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, said = 0.0, list[str]()
    monkeypatch.setattr(progress_file.time, "monotonic", lambda: now_s)
    with untold_progress(), progress("wave", 100, said.append) as bar:
        now_s = 12.0
        bar.update()
    assert said == []
