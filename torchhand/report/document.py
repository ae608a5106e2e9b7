"""The page as a whole: the shipped template, filled with one result or two, in one file that needs no network."""

import base64
import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import date
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any, TextIO

import torchhand
from torchhand.files.disk import replacing
from torchhand.report.content import content_of
from torchhand.report.facts import (
    assumptions,
    citation,
    comparison,
    range_table,
    size_notes,
    summary,
    titles,
)
from torchhand.report.result import Result
from torchhand.report.video import small_video

_PAGE = files("torchhand.report") / "page"
_SCRIPTS = ("data.js", "hand.js", "scene.js", "charts.js", "player.js", "main.js")
_SLOT = "<!--slot "
_CHUNK = 3 * (1 << 16)  # bytes; whole groups of three, so that pieces of base64 join


def write_report(path: Path, results: Sequence[Result]) -> None:
    """Write the page of one result, or of two beside each other; or leave what was there and raise InputError.

    The video is that of the first result that has one; it is read and written piece by piece.
    """
    if not 1 <= len(results) <= 2:
        raise ValueError(f"results: expected one or two, got {len(results)}")
    overlay = next((result.overlay for result in results if result.overlay is not None), None)
    with contextlib.ExitStack() as stack:
        video, note = (None, "") if overlay is None else stack.enter_context(small_video(overlay, path))
        temporary = stack.enter_context(replacing(path))
        page = stack.enter_context(temporary.open("w", encoding="utf-8", newline="\n"))
        slots = _slots(results, note)
        for text, slot in _pieces():
            page.write(text)
            if slot == "video":
                _write_video(page, video)
            elif slot:
                page.write(slots[slot])


def _slots(results: Sequence[Result], video_note: str) -> Mapping[str, str]:
    """What stands in the template's places."""
    names = [result.name for result in results]
    letters = [""] if len(results) == 1 else ["A: ", "B: "]
    facts = []
    for letter, result in zip(letters, results, strict=True):
        notes = size_notes(result)
        if video_note and result is results[0]:
            notes.append(("Video", f"{video_note}."))
        head = f"<h3>{escape(letter + result.name)}</h3>" if letter else ""
        facts.append(f"{head}{assumptions(result, notes)}")
    lines = [f"<p>{escape(letter + summary(result))}</p>" for letter, result in zip(letters, results, strict=True)]
    return {
        "title": escape(" and ".join(names)),
        "sources": "".join(
            f"<p>{escape(letter)}<code>{escape(str(result.track.header.get('source', result.name)))}</code></p>"
            for letter, result in zip(letters, results, strict=True)
        ),
        "summary": "".join(lines) + comparison(results),
        "facts": "".join(facts),
        "ranges": range_table(results),
        "citation": citation(results),
        "made": escape(f"torchhand {torchhand.__version__}, {date.today().isoformat()}"),
        "style": (_PAGE / "report.css").read_text(encoding="utf-8"),
        "script": "".join((_PAGE / name).read_text(encoding="utf-8") for name in _SCRIPTS),
        "data": _as_script({"titles": titles(), "results": [content_of(result) for result in results]}),
    }


def _pieces() -> Iterator[tuple[str, str]]:
    """Pieces of the template, each with the name of the slot after it; none after the last."""
    first, *rest = (_PAGE / "report.html").read_text(encoding="utf-8").split(_SLOT)
    text = first
    for piece in rest:
        name, _, following = piece.partition("-->")
        yield text, name.strip()
        text = following
    yield text, ""


def _as_script(content: Any) -> str:
    """JSON that no browser takes for the end of a script."""
    return json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _write_video(page: TextIO, video: Path | None) -> None:
    if video is None:
        return
    with video.open("rb") as file:
        while piece := file.read(_CHUNK):
            page.write(base64.b64encode(piece).decode("ascii"))
