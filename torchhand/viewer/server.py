"""The server of a page, for programs on this machine alone."""

import contextlib
import importlib
from collections.abc import Iterator
from typing import Any

from torchhand.errors import InputError

ViewerServer = Any
"""A viser.ViserServer, which need not be installed."""

HOST = "127.0.0.1"
_PORTS = range(1, 65536)


@contextlib.contextmanager
def opened_server(port: int, *, title: str) -> Iterator["ViewerServer"]:
    """A server at `port` of 127.0.0.1, or at the next free one, that ends with the block.

    Raises InputError where viser is not installed.
    """
    if port not in _PORTS:
        raise InputError(f"--port: expected {_PORTS[0]} to {_PORTS[-1]}, got {port}")
    try:
        rich, viser = importlib.import_module("rich"), importlib.import_module("viser")
    except ImportError as error:
        raise InputError(f"a page needs viser: pip install 'torchhand[view]' ({error})") from error
    console = rich.get_console()
    was_quiet, console.quiet = console.quiet, True  # it would print to standard output, which may be a stream
    try:
        server = viser.ViserServer(host=HOST, port=port, label=title, verbose=False)
        try:
            server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
            server.gui.main_panel.dock_right()
            yield server
        finally:
            server.stop()
    finally:
        console.quiet = was_quiet


def address_of(server: "ViewerServer") -> str:
    """What a browser opens."""
    return f"http://{HOST}:{server.get_port()}"
