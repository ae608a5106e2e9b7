"""The programs in docs/examples run, and do what they say; the pages build without a warning."""

import csv
import os
import re
import subprocess
import sys
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

from tests.studio import Studio
from torchhand.files import write_video

REPOSITORY = Path(__file__).resolve().parents[1]
EXAMPLES = REPOSITORY / "docs" / "examples"


def example(name: str) -> Any:
    spec = spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_example_is_told_of_and_run() -> None:
    names = {path.name for path in EXAMPLES.iterdir() if path.is_file()}
    pages = "".join(path.read_text(encoding="utf-8") for path in (REPOSITORY / "docs").glob("*.md"))
    tests = "".join(path.read_text(encoding="utf-8") for path in (REPOSITORY / "tests").rglob("*.py"))
    assert names
    assert {name for name in names if f"examples/{name}" not in pages} == set(), "in no page"
    assert {name for name in names if not re.search(rf"\b{re.escape(Path(name).stem)}\b", tests)} == set(), "in no test"


def test_a_network_learns_through_the_hand() -> None:
    losses = example("prior_in_training").main(steps=20, hands=64)
    assert losses[-1] < 0.6 * losses[0]


def test_a_video_becomes_a_table(tmp_path: Path) -> None:
    image = Studio().placed(size=0.75, camera=Studio().camera(480, 360)).picture()
    with write_video(tmp_path / "video.mp4", width=480, height=360) as video:
        for _ in range(2):
            video.write(image)
    assert example("track_a_video").main(tmp_path / "video.mp4", "right", tmp_path / "index.csv") == 2
    rows = list(csv.DictReader((tmp_path / "index.csv").read_text().splitlines()))
    assert [row["status"] for row in rows] == ["tracked", "tracked"]
    assert abs(float(rows[1]["index_pip_fe_deg"])) < 25  # the hand is open
    assert 0 < float(rows[1]["index_pip_fe_std_deg"]) < 30


@pytest.mark.parametrize("words", [(), ("wave.mp4",), ("wave.mp4", "both", "index.csv")])
def test_a_wrong_command_line_of_an_example_is_told_with_its_usage(words: tuple[str, ...]) -> None:
    command = [sys.executable, str(EXAMPLES / "track_a_video.py"), *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=REPOSITORY)
    assert done.returncode == 2
    assert done.stderr.startswith("usage: track_a_video.py [-h] video {left,right} out\n")
    assert "Traceback" not in done.stderr


def test_a_tracker_steps() -> None:
    assert example("tracker_step_by_step").main(frames=2) == ["tracked", "tracked"]


def test_hypotheses_come_nearer() -> None:
    before, after = example("many_hypotheses").main(starts=2)
    assert (after < 0.7 * before).all()


def test_a_motion_is_written_for_other_programs(tmp_path: Path) -> None:
    written = example("export_a_motion").main(tmp_path)
    assert [path.suffix for path in written] == [".glb", ".bvh", ".npz", ".urdf"]
    assert all(path.stat().st_size > 1000 for path in written)


@pytest.mark.slow
@pytest.mark.skipif(find_spec("mkdocstrings") is None, reason="pip install torchhand[docs]: no mkdocstrings here")
def test_the_pages_build_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "-f", ".mkdocs.yml", "--strict", "-d", str(tmp_path)]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=REPOSITORY, env=quiet, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "place_primitives" in (tmp_path / "papers" / "index.html").read_text(encoding="utf-8")
