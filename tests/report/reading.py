"""What a page holds, read back as its script does."""

import base64
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np

_MISSING = {"i1": -(2**7), "i2": -(2**15), "i4": -(2**31), "u1": 2**8 - 1}


def unpacked(content: dict[str, Any]) -> np.ndarray:
    """The values of a packed array."""
    stored = np.frombuffer(zlib.decompress(base64.b64decode(content["data"])), f"<{content['kind']}")
    whole = stored.reshape(-1, content["shape"][0]).cumsum(axis=1, dtype=stored.dtype).T
    values = content["start"] + content["step"] * whole.astype(np.float64)
    values[whole == _MISSING[content["kind"]]] = np.nan
    return values.reshape(content["shape"])


def data_of(page: Path) -> dict[str, Any]:
    """What the page's script draws."""
    return json.loads(_script(page, "data"))


def video_of(page: Path) -> bytes:
    """The embedded video; empty where there is none."""
    return base64.b64decode(_script(page, "video-data"))


def words_of(page: Path) -> str:
    """The text of a page as a reader sees it, without its script and its numbers."""
    text = re.sub(r"<(script|style).*?</\1>", " ", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]*>", " ", text).split())


def _script(page: Path, name: str) -> str:
    found = re.search(rf'<script [^>]*id="{name}">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None, name
    return found.group(1)
