"""A server of pages, where viser is installed."""

from collections.abc import Iterator

import pytest

from torchhand.viewer import ViewerServer, opened_server


@pytest.fixture
def server() -> Iterator[ViewerServer]:
    pytest.importorskip("viser", reason="needs viser (pip install torchhand[view])")
    with opened_server(8750, title="test") as server:
        yield server
