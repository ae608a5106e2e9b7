"""What the README and the pages under docs/ show must run and be there."""

import ast
import builtins
import importlib
import importlib.util
import math
import re
from pathlib import Path

import cv2
import pytest

import torchhand
from tests.studio import Studio
from torchhand.files import write_video
from torchhand.hand import posture

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = {
    path.relative_to(REPOSITORY).as_posix(): path.read_text(encoding="utf-8")
    for path in (REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md")))
}
README = PAGES["README.md"]
RAW = "https://raw.githubusercontent.com/torchhand/torchhand/main/"
ROOTS = (RAW, "https://github.com/torchhand/torchhand/tree/main/", "https://github.com/torchhand/torchhand/blob/main/")
SITE = "https://torchhand.github.io/torchhand/"


def _examples(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", PAGES[page], flags=re.DOTALL)


def _example(page: str, words: str) -> str:
    """The one that holds some words."""
    (found,) = [example for example in _examples(page) if words in example]
    return found


class _Webcam:
    """Two pictures of an open hand, then the end."""

    def __init__(self, number: int) -> None:
        self.number = number
        self._pictures = [Studio().placed().picture(seed=seed).numpy()[..., ::-1].copy() for seed in range(2)]

    def read(self) -> tuple:
        return (True, self._pictures.pop()) if self._pictures else (False, None)


def test_the_recording_example_fits_a_hand_and_tracks_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    image = Studio().placed(size=0.75, camera=Studio().camera(480, 360)).picture()
    cv2.imwrite("open_hand.jpg", image.numpy()[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
    with write_video(Path("video.mp4"), width=480, height=360) as video:
        for _ in range(2):
            video.write(image)
    names: dict = {}
    exec(compile(_example("README.md", "fit_hand"), "README.md", "exec"), names)
    assert names["shape"].shape == (52,)
    assert names["estimate"].status == "tracked"
    assert names["estimate"].time_s > 0
    assert capsys.readouterr().out.count("tracked tensor(") == 2


def test_the_webcam_example_tracks(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", _Webcam)
    names: dict = {}
    exec(compile(_example("README.md", "VideoCapture"), "README.md", "exec"), names)
    assert names["video"].number == 0
    assert names["estimate"].status == "tracked"
    assert capsys.readouterr().out.count("tracked tensor(") == 2


@pytest.mark.parametrize("page", ["README.md", "docs/library.md"])
def test_the_example_runs_and_its_gradients_are_those_of_the_pinch(page: str, capsys) -> None:
    names: dict = {}
    exec(compile(_example(page, "loss.backward()"), page, "exec"), names)
    gradient = names["pose"].grad
    assert gradient.isfinite().all()
    # The distance between two fingertips does not depend on where the hand is, but does on the thumb's joints.
    assert float(gradient[:3].abs().max()) < 1e-12
    assert float(gradient[6:9].abs().max()) > 1e-3
    if "shape" in names:
        assert float(names["shape"].grad.abs().max()) > 1e-3
        assert "thumb_cmc_fe" in capsys.readouterr().out
    else:
        assert names["poses"].shape == (64, 36)


@pytest.mark.parametrize("words", ["fit_hand", "VideoCapture"])
def test_the_library_page_repeats_what_the_readme_shows(words: str) -> None:
    assert _example("docs/library.md", words) == _example("README.md", words)


def test_every_python_block_is_run() -> None:
    """The blocks of README, library.md and mano.md here; those of examples.md are files, which test_examples runs."""
    counts = {page: len(_examples(page)) for page in ("README.md", "docs/library.md", "docs/mano.md")}
    assert counts == {"README.md": 3, "docs/library.md": 3, "docs/mano.md": 1}
    files = re.findall(r'--8<-- "docs/examples/\w+\.py"', PAGES["docs/examples.md"])
    assert len(_examples("docs/examples.md")) == len(files)


def _imports(page: str) -> list[str]:
    """The import statements in the Python of a page, which must be Python."""
    trees = [ast.parse(block) for block in _examples(page) if not block.startswith("--8<--")]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    return [ast.unparse(node) for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)]


@pytest.mark.parametrize("page", PAGES)
def test_what_its_python_imports_is_there(page: str) -> None:
    for statement in _imports(page):
        if re.match(r"(from|import) torchhand\b", statement):
            exec(compile(statement, page, "exec"), {})


def _unknown(page: str) -> set[str]:
    """Names in the Python of a page that neither its block nor one before it gives."""
    known, unknown = set(dir(builtins)), set()
    for block in _examples(page):
        if block.startswith("--8<--"):
            continue
        nodes = list(ast.walk(ast.parse(block)))
        names = [node for node in nodes if isinstance(node, ast.Name)]
        for node in nodes:
            if isinstance(node, ast.Import | ast.ImportFrom):
                known |= {(one.asname or one.name).partition(".")[0] for one in node.names}
            elif isinstance(node, ast.FunctionDef | ast.ClassDef):
                known.add(node.name)
            elif isinstance(node, ast.arg):
                known.add(node.arg)
        known |= {name.id for name in names if not isinstance(name.ctx, ast.Load)}
        unknown |= {name.id for name in names} - known
    return unknown


@pytest.mark.parametrize("page", PAGES)
def test_every_name_in_its_python_is_given_on_the_page(page: str) -> None:
    assert _unknown(page) == set()
    assert [block for block in re.findall(r"```\n(.*?)```", PAGES[page], flags=re.DOTALL) if "import " in block] == []


def test_the_examples_of_streams_write_and_read_three_poses(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for words in ("PoseStreamWriter", "PoseStreamReader"):
        exec(compile(_example("docs/exports.md", words), "docs/exports.md", "exec"), names)
    assert names["poses"].shape == (3, 36)
    assert not names["held"].any()
    assert float((names["poses"][-1] - posture("fist", dtype=names["poses"].dtype)).abs().max()) < math.radians(2.0)


def test_the_example_for_those_who_come_from_mano_runs(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict = {}
    exec(compile(_examples("docs/mano.md")[0], "docs/mano.md", "exec"), names)
    assert float(names["pose"].grad.abs().max()) > 1e-3
    assert "[8, 2010, 3]" in capsys.readouterr().out


@pytest.mark.parametrize("page", PAGES)
def test_functions_that_it_names_exist(page: str) -> None:
    for name in re.findall(r"`torchhand\.([\w.]+)`|^::: torchhand\.([\w.]+)$", PAGES[page], flags=re.MULTILINE):
        value: object = torchhand
        for place, part in enumerate(parts := "".join(name).split(".")):
            module = f"torchhand.{'.'.join(parts[: place + 1])}"
            can_be = place < len(parts) - 1 or len(parts) == 1
            is_package = can_be and importlib.util.find_spec(module) is not None
            value = importlib.import_module(module) if is_package else getattr(value, part)


def test_functions_are_named() -> None:
    assert len(re.findall(r"`torchhand\.[\w.]+`", PAGES["docs/library.md"])) > 8


@pytest.mark.parametrize("page", PAGES)
def test_pictures_and_pages_that_it_names_exist(page: str) -> None:
    missing = []
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", PAGES[page]):
        root = next((root for root in ROOTS if target.startswith(root)), None)
        if root is not None:
            path = REPOSITORY / target.removeprefix(root)
        elif target.startswith(SITE):
            path = REPOSITORY / "docs" / f"{target.removeprefix(SITE).strip('/') or 'index'}.md"
        elif target.startswith("https://"):
            continue
        else:
            path = (REPOSITORY / page).parent / target
        missing += [] if path.exists() else [target]
    assert missing == []


def test_the_readme_links_absolutely_and_fits_two_pages() -> None:
    """So that it reads the same on a package index as in the repository."""
    targets = re.findall(r"\]\(([^)]+)\)", README)
    assert targets
    assert [target for target in targets if not target.startswith("https://")] == []
    assert any(target.startswith(RAW) for target in targets)
    assert len(README.splitlines()) <= 160
