"""Streams as their readers get them; none ever waits for a reader."""

import json
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.runs.streams.test_message import read_osc, record
from torchhand.errors import InputError
from torchhand.runs.streams.message import message_of
from torchhand.runs.streams.senders import check_streams, opened_streams

EXAMPLE = Path(__file__).resolve().parents[3] / "docs" / "examples" / "receive_hands.py"
MESSAGE = message_of(record(), side="right")


@pytest.fixture
def receiver() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        own.settimeout(30)
        yield own


def test_datagrams_hold_json_or_osc(receiver: socket.socket) -> None:
    place = f"127.0.0.1:{receiver.getsockname()[1]}"
    with opened_streams([f"udp://{place}", f"osc://{place}/"]) as streams:
        for stream in streams:
            stream.send(MESSAGE)
        assert json.loads(receiver.recv(65535)) == MESSAGE
        assert dict(read_osc(receiver.recv(65535)))["/torchhand/frame"][0] == MESSAGE["frame"]


def test_nobody_need_listen(receiver: socket.socket) -> None:
    port = receiver.getsockname()[1]
    receiver.close()
    with opened_streams([f"udp://127.0.0.1:{port}"]) as [stream]:
        for _ in range(20):
            stream.send(MESSAGE)


def test_lines_on_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    with opened_streams(["jsonl"]) as [stream]:
        stream.send(MESSAGE)
        stream.send(MESSAGE)
    assert [json.loads(line) for line in capsys.readouterr().out.splitlines()] == [MESSAGE, MESSAGE]


def test_a_websocket_gives_the_newest_to_everybody_who_connects() -> None:
    client = pytest.importorskip("websockets.sync.client", reason="needs websockets (pip install torchhand[stream])")
    with socket.create_server(("127.0.0.1", 0)) as free:
        place = f"127.0.0.1:{free.getsockname()[1]}"
    with opened_streams([f"ws://{place}"]) as [stream]:
        stream.send(MESSAGE)  # before anybody is there
        with client.connect(f"ws://{place}") as one, client.connect(f"ws://{place}") as other:
            is_over = threading.Event()

            def send() -> None:
                number = 0
                while not is_over.wait(0.01):
                    number += 1
                    stream.send(MESSAGE | {"frame": number})

            thread = threading.Thread(target=send)
            thread.start()
            try:
                for reader in (one, other):
                    frames = [json.loads(reader.recv(timeout=30))["frame"] for _ in range(3)]
                    assert frames == sorted(set(frames))
            finally:
                is_over.set()
                thread.join()
        with (
            pytest.raises(InputError, match=rf"--stream: {place}: cannot be listened at \("),
            opened_streams([f"ws://{place}"]),
        ):
            pass


@pytest.mark.parametrize(
    "text", ["json", "udp://127.0.0.1", "udp://:9000", "tcp://127.0.0.1:1", "ws://a:99999", "osc://a:1/b", "ws://a:b"]
)
def test_what_is_no_stream(text: str) -> None:
    with pytest.raises(InputError, match=rf"--stream: expected jsonl, udp://HOST:PORT, .*, got '{re.escape(text)}'"):
        check_streams([text])
    with pytest.raises(InputError, match="expected each stream once, got jsonl again"):
        check_streams(["jsonl", "jsonl"])


def test_the_example_receives_hands() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, str(EXAMPLE), str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, encoding="utf-8") as example:
        assert example.stdout is not None
        assert "waiting" in example.stdout.readline()
        with opened_streams([f"udp://127.0.0.1:{port}"]) as [stream]:
            stream.send(MESSAGE)
        line = example.stdout.readline()
        example.kill()
    assert line.startswith("7 tracked index PIP ")
    assert "wrist at" in line
