"""The wheel, alone: built, installed into an empty environment, and run from a folder that knows no checkout."""

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
FOR_PEOPLE = {"mesh.png", "preview.png", "prior.png", "signs.png"}
"""Pictures of the model, which stay in the repository."""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built as `pip install` would build it, into a folder outside the repository."""
    folder = tmp_path_factory.mktemp("wheel")
    run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)], cwd=REPOSITORY)
    (built,) = folder.glob("torchhand-*.whl")
    return built


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with nothing but the wheel. Its dependencies are lent by the running environment.

    A plain path in a .pth file lends what lies in site-packages but obeys none of the .pth files there, so an editable
    installation of the checkout stays invisible.
    """
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False)
    python = folder / "bin" / "python"
    paths = run([str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]).strip()
    lent = dict.fromkeys(sysconfig.get_path(kind) for kind in ("purelib", "platlib"))
    (Path(paths) / "lent_dependencies.pth").write_text("\n".join(lent) + "\n")
    run([sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps", "--no-index", str(wheel)])
    return folder


def run(command: list[str], cwd: Path | None = None) -> str:
    """Run a command that must succeed, without what the test run itself has in its environment; returns its output."""
    inherited = {
        key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "TORCHHAND", "VIRTUAL"))
    }
    done = subprocess.run(command, cwd=cwd, env=inherited, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(command)} ended with {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def test_the_wheel_holds_models_and_configs(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        inside = set(archive.namelist())
    for folder in ("models", "configs"):
        files = [
            path for path in (REPOSITORY / folder).rglob("*") if path.is_file() and "__pycache__" not in path.parts
        ]
        assert files, f"{folder} is empty"
        names = {f"torchhand/{path.relative_to(REPOSITORY).as_posix()}" for path in files}
        assert {Path(name).name for name in names - inside} <= FOR_PEOPLE
    page = REPOSITORY / "torchhand" / "report" / "page"
    assert {f"torchhand/report/page/{path.name}" for path in page.iterdir()} <= inside
    assert "torchhand/cli/main.py" in inside
    assert any(name.endswith("licenses/LICENSE") for name in inside)
    assert not [name for name in inside if not name.startswith(("torchhand/", "torchhand-"))]


def test_the_wheel_is_small(wheel: Path) -> None:
    """Two thirds of it are the learned weights."""
    assert wheel.stat().st_size < 5e6


def test_models_and_configs_are_found_where_the_wheel_is_installed(environment: Path, tmp_path: Path) -> None:
    program = (
        "import torchhand\n"
        "from torchhand.files import configs_dir, models_dir\n"
        "print(torchhand.__file__, models_dir(), configs_dir(), sep='\\n')\n"
        "print(len(list(models_dir().rglob('*.urdf'))), len(list(configs_dir().glob('*.yaml'))))\n"
    )
    *places, counts = run([str(environment / "bin" / "python"), "-c", program], cwd=tmp_path).split("\n")[:4]
    for place in places:
        assert Path(place).is_relative_to(environment), f"{place} is not in the empty environment"
    urdfs, yamls = (int(count) for count in counts.split())
    assert urdfs == len(list((REPOSITORY / "models").rglob("*.urdf"))) > 0
    assert yamls == len(list((REPOSITORY / "configs").glob("*.yaml"))) > 0


def test_the_installed_command_tracks_a_hand(environment: Path, tmp_path: Path) -> None:
    run([str(environment / "bin" / "torchhand"), "demo", "--out", "demo_out", "--frames", "12"], cwd=tmp_path)
    found = {path.name for path in (tmp_path / "demo_out").rglob("*") if path.is_file() and path.stat().st_size > 0}
    for name in ("track.npz", "track.jsonl", "hand.json", "config.yaml", "overlay.mp4"):
        assert name in found
    assert [name for name in found if name.endswith((".png", ".jpg"))], "the demo leaves a picture to look at"


def test_everything_that_the_top_level_names_is_there(environment: Path) -> None:
    script = (
        "import sys, torchhand; assert 'torch' not in sys.modules;"
        "print(*(getattr(torchhand, name) for name in torchhand.__all__))"
    )
    python = environment / "bin" / "python"
    assert "Tracker" in run([str(python), "-c", script], cwd=environment)
    assert list(environment.rglob("torchhand/py.typed"))
