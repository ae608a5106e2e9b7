"""`torchhand view`: how it ends."""

import contextlib
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from torchhand.cli.view import main

COMMANDS = Path(__file__).resolve().parents[2] / "docs" / "commands.md"


def test_ctrl_c_is_its_usual_end_as_the_page_of_commands_says(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("torchhand.cli.view.opened_server", lambda *_, **__: contextlib.nullcontext(SimpleNamespace()))
    monkeypatch.setattr("torchhand.cli.view.page_of", lambda *_: None)
    monkeypatch.setattr("torchhand.cli.view.address_of", lambda _: "http://127.0.0.1:8080")
    monkeypatch.setattr(threading.Event, "wait", interrupted)
    assert main([]) == 0
    assert capsys.readouterr() == ("open http://127.0.0.1:8080 in a browser; Ctrl-C ends it\n", "")
    assert "usual end of a live run and of `view`: 0 there" in COMMANDS.read_text(encoding="utf-8")
