"""What every test of a command starts from."""

import math

import pytest


@pytest.fixture(autouse=True)
def no_lines_of_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """One comes every ten seconds: on a busy machine among the lines that a test counts."""
    monkeypatch.setattr("torchhand.runs.progress._EVERY_S", math.inf)
