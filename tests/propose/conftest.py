"""A studio for every test here."""

import pytest

from tests.studio import Studio


@pytest.fixture(scope="session")
def studio() -> Studio:
    return Studio()
