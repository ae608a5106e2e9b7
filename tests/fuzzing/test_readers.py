"""Damaged files of every kind: each ends in a result or in one line, in 10 s and 1 GB, and touches nothing else."""

import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from tests.fuzzing.guard import guarded
from tests.fuzzing.readers import READERS, good_files
from torchhand.errors import InputError

CASES, SLOW_CASES = 5, 120
"""Of each reader, in the default suite and in the slow one."""

seeded = {
    "derandomize": True,
    "database": None,
    "deadline": None,
    "phases": (Phase.explicit, Phase.generate, Phase.shrink),
    "suppress_health_check": list(HealthCheck),
}


def check(name: str, data: bytes, folder: Path) -> None:
    """Read one damaged file beside good ones."""
    reader = READERS[name]
    shutil.rmtree(folder, ignore_errors=True)
    for file, content in (good_files(reader) | {reader.file: data}).items():
        path = folder / "in" / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    (folder / "beside.txt").write_text("beside")
    with guarded(folder / "in"):
        try:
            reader.read(folder / "in")
        except InputError as error:
            message = str(error)
            assert message.strip()
            assert len(message.splitlines()) == 1, message
            assert len(message) < 2000
    assert {path.name for path in folder.iterdir()} == {"in", "beside.txt"}


@pytest.mark.parametrize("name", READERS)
def test_good_files_are_read(name: str, tmp_path: Path) -> None:
    reader = READERS[name]
    for file, content in good_files(reader).items():
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_bytes(content)
    reader.read(tmp_path)


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_end_in_a_result_or_one_line(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("case")

    @settings(max_examples=CASES, **seeded)
    @given(READERS[name].damaged())
    def case(data: bytes) -> None:
        check(name, data, folder)

    case()


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_many_damaged_files_end_in_a_result_or_one_line(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("case")

    @settings(max_examples=SLOW_CASES, **seeded)
    @given(READERS[name].damaged())
    def case(data: bytes) -> None:
        check(name, data, folder)

    case()
