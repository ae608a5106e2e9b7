"""Where streams go: none of them ever makes the tracker wait for its reader."""

import contextlib
import json
import logging
import socket
import threading
from collections.abc import Iterator, Sequence
from typing import Any, Protocol, runtime_checkable
from urllib.parse import urlsplit

from torchhand.errors import InputError
from torchhand.runs.streams.message import osc_bundle
from torchhand.runs.streams.pose_file import SUFFIX, check_pose_file, is_pose_file

STANDARD_OUTPUT = "jsonl"
_KINDS = ("udp", "osc", "ws")
_SILENT = logging.Logger("torchhand.websockets", logging.CRITICAL + 1)  # who goes away, or asks for a page, is no news
_EXPECTED = f"{STANDARD_OUTPUT}, udp://HOST:PORT, osc://HOST:PORT, ws://HOST:PORT or FILE{SUFFIX}"


@runtime_checkable
class Sender(Protocol):
    """One stream."""

    def send(self, message: dict[str, Any]) -> None:
        """Give one message away."""
        ...

    def close(self) -> None: ...


def check_streams(texts: Sequence[str], *, may_replace: bool = False) -> None:
    """Raise InputError for what is no stream, for one that is named twice, and for a file that cannot be made or, but
    for may_replace, is there already."""
    for place, text in enumerate(texts):
        if is_pose_file(text):
            check_pose_file(text, may_replace=may_replace)
        else:
            _address(text)
        if text in texts[:place]:
            raise InputError(f"--stream: expected each stream once, got {text} again")


@contextlib.contextmanager
def opened_streams(texts: Sequence[str]) -> Iterator[list[Sender]]:
    """Senders, which end with the block, of all but files. Raises InputError for those that cannot be had."""
    with contextlib.ExitStack() as stack:
        senders: list[Sender] = []
        for text in (text for text in texts if not is_pose_file(text)):
            sender = _opened(text)
            stack.callback(sender.close)
            senders.append(sender)
        yield senders


def _opened(text: str) -> Sender:
    address = _address(text)
    if address is None:
        return _Lines()
    kind, host, port = address
    if kind == "ws":
        return _WebSockets(host, port)
    return _Datagrams(host, port, is_osc=kind == "osc")


def _address(text: str) -> tuple[str, str, int] | None:
    """Kind, host and port; None for standard output. Raises InputError for anything else."""
    if text == STANDARD_OUTPUT:
        return None
    with contextlib.suppress(ValueError):  # of a port that is none
        parts = urlsplit(text)
        is_plain = not (parts.query or parts.fragment or parts.username) and parts.path in ("", "/")
        if parts.scheme in _KINDS and parts.hostname and parts.port and is_plain:
            return parts.scheme, parts.hostname, parts.port
    raise InputError(f"--stream: expected {_EXPECTED}, got {text!r}")


def as_line(message: dict[str, Any]) -> str:
    """A message as strict JSON on one line."""
    return json.dumps(message, allow_nan=False, separators=(",", ":"))


class _Lines:
    """A line per frame on standard output."""

    def send(self, message: dict[str, Any]) -> None:
        print(as_line(message), flush=True)

    def close(self) -> None:
        pass


class _Datagrams:
    """A datagram per frame, whether anybody listens or not: JSON, or an OSC bundle."""

    def __init__(self, host: str, port: int, *, is_osc: bool) -> None:
        self._encode = osc_bundle if is_osc else lambda message: as_line(message).encode()
        try:
            family, kind, _, _, self._place = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        except OSError as error:
            raise InputError(f"--stream: {host}: no such host ({error.strerror or error})") from error
        self._socket = socket.socket(family, kind)
        self._socket.setblocking(False)

    def send(self, message: dict[str, Any]) -> None:
        with contextlib.suppress(OSError):  # nobody listens, or the network is busy: the next frame is newer
            self._socket.sendto(self._encode(message), self._place)

    def close(self) -> None:
        self._socket.close()


class _WebSockets:
    """A server: everybody who connects gets the newest frame as text, and misses those that he is too slow for."""

    def __init__(self, host: str, port: int) -> None:
        try:
            from websockets.sync.server import ServerConnection, serve
        except ImportError as error:
            raise InputError(f"--stream ws: needs websockets: pip install 'torchhand[stream]' ({error})") from error
        self._changed, self._newest, self._number, self._is_over = threading.Condition(), "", 0, False

        def attend(connection: ServerConnection) -> None:
            seen = self._number
            while (newest := self._after(seen)) is not None:
                text, seen = newest
                connection.send(text)

        try:
            self._server = serve(attend, host, port, logger=_SILENT)
        except OSError as error:
            raise InputError(f"--stream: {host}:{port}: cannot be listened at ({error.strerror or error})") from error
        self._thread = threading.Thread(target=self._server.serve_forever, name="websockets", daemon=True)
        self._thread.start()

    def _after(self, seen: int) -> tuple[str, int] | None:
        """The newest message and its number, once it is another than the one seen; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._number > seen or self._is_over)
            return None if self._is_over else (self._newest, self._number)

    def send(self, message: dict[str, Any]) -> None:
        with self._changed:
            self._newest, self._number = as_line(message), self._number + 1
            self._changed.notify_all()

    def close(self) -> None:
        with self._changed:
            self._is_over = True
            self._changed.notify_all()
        self._server.shutdown()
        self._thread.join()
