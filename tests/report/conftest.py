"""Results that are reported, made on the spot."""

from pathlib import Path

import pytest

from tests.report.made_result import write_result


@pytest.fixture(scope="session")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_result(tmp_path_factory.mktemp("results") / "wave")


@pytest.fixture(scope="session")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same recording, with an index finger that is bent by 2° more."""
    return write_result(tmp_path_factory.mktemp("results") / "again", shift_deg=2.0, has_video=False)
