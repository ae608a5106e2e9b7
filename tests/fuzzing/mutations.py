"""Hypothesis strategies that damage good files: bytes, numbers in texts, values in JSON, arrays in archives."""

import copy
import io
import json
import re
from typing import Any

import numpy as np
from hypothesis import strategies as st

_TOKENS = (
    *(b"", b"\0" * 7, b"\xff\xfe", b"\r\n\r\n", b"[" * 3000, b"{" * 3000, b"(" * 300, b"nan", b"-inf", b"1e999", b"-1"),
    *(
        b"99999999999999999999999",
        b"9" * 5000,
        b"../../../x",
        b"/dev/zero",
        b"\xe2\x80\xae",
        b"%n%s",
        b"null",
        b"&a *a",
    ),
    *(b"!!python/object/apply:os.system [true]", b"<!ENTITY a 'b'>", b"<a>", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff"),
)
_NUMBERS = (
    "0",
    "-1",
    "1e308",
    "-1e308",
    "1e-320",
    "nan",
    "inf",
    "2147483648",
    "1" + 30 * "0",
    "1e",
    "0x10",
    "1_0",
    "٣",
)
_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1e308, -1e308, 10**30, 2**63, 5e-324, float("nan"), float("inf")),
    *("", "nan", "1", "\0", "x" * 3000, "\ud800", [], {}, [[]], [None], [[[[]]]], {"": {}}, [1, 2, 3], ["a"]),
)
_DTYPES = ("<f4", "<f8", ">f8", "<i8", "<u1", "?", "<U4", "S3", "<c16", "<f2", "<M8[s]", "V4")
_FILLS = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 0.0, -1.0, 2.0**40)

_fraction = st.floats(0, 1, allow_nan=False)


@st.composite
def damaged_bytes(draw: st.DrawFn, data: bytes) -> bytes:
    """One to four edits: bits flipped, cut off, spliced, deleted, tokens put in."""
    for _ in range(draw(st.integers(1, 4))):
        size = len(data)
        at, length = int(draw(_fraction) * size), draw(st.integers(1, 64))
        kind = draw(st.sampled_from(("flip", "flip", "cut", "delete", "splice", "token", "repeat", "swap")))
        if kind == "flip" and size:
            at = min(at, size - 1)
            data = data[:at] + bytes([data[at] ^ (1 << draw(st.integers(0, 7)))]) + data[at + 1 :]
        elif kind == "cut":
            data = data[:at]
        elif kind == "delete":
            data = data[:at] + data[at + length :]
        elif kind == "splice":
            source = int(draw(_fraction) * size)
            data = data[:at] + data[source : source + length] + data[at:]
        elif kind == "token":
            data = data[:at] + draw(st.sampled_from(_TOKENS)) + data[at + draw(st.sampled_from((0, 1, 4))) :]
        elif kind == "repeat":
            data = data[:at] + data[at : at + length] * draw(st.integers(2, 40)) + data[at:]
        elif kind == "swap":
            data = data[at:] + data[:at]
    return data


@st.composite
def damaged_text(draw: st.DrawFn, data: bytes) -> bytes:
    """Some numbers of a text replaced by others, or its words and lines moved."""
    text = data.decode("utf-8", "replace")
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(("number", "number", "line", "word")))
        pieces = {"number": re.finditer(r"-?\d[\d.e+-]*", text), "line": re.finditer(r".+", text)}
        found = [match.span() for match in pieces.get(kind, re.finditer(r"[A-Za-z_]+", text))]
        if not found:
            continue
        start, end = found[int(draw(_fraction) * (len(found) - 1))]
        other = found[int(draw(_fraction) * (len(found) - 1))]
        new = draw(st.sampled_from(_NUMBERS)) if kind == "number" else text[slice(*other)]
        text = text[:start] + new + text[end:]
    return text.encode("utf-8", "surrogatepass")


@st.composite
def damaged_json(draw: st.DrawFn, data: bytes) -> bytes:
    """Values of a JSON text, or of one of its lines, swapped for others, taken away, renamed or doubled."""
    lines = data.decode().splitlines() if data.count(b"\n") and data.startswith(b'{"') else [data.decode()]
    try:
        contents = [json.loads(line) for line in lines]
    except ValueError:  # one value over several lines
        lines = [data.decode()]
        contents = [json.loads(lines[0])]
    row = int(draw(_fraction) * (len(contents) - 1))
    content = copy.deepcopy(contents[row])
    for _ in range(draw(st.integers(1, 3))):
        content = _changed(draw, content)
    lines[row] = json.dumps(content)
    return "\n".join(lines).encode() + b"\n"


def _changed(draw: st.DrawFn, content: Any) -> Any:
    """One value at a random depth changed."""
    if not isinstance(content, list | dict) or not content or draw(st.integers(0, 9)) == 0:
        return copy.deepcopy(draw(st.sampled_from(_VALUES)))
    keys = list(content) if isinstance(content, dict) else list(range(len(content)))
    key = keys[int(draw(_fraction) * (len(keys) - 1))]
    kind = draw(st.sampled_from(("deeper", "deeper", "deeper", "delete", "double", "rename")))
    if kind == "delete":
        del content[key]
    elif kind == "double" and isinstance(content, list):
        content.extend(copy.deepcopy(content[: 1 + key]))
    elif kind == "rename" and isinstance(content, dict):
        content[str(key)[:-1] + draw(st.sampled_from(("", "x", "\0")))] = content.pop(key)
    else:
        content[key] = _changed(draw, content[key])
    return content


@st.composite
def damaged_arrays(draw: st.DrawFn, data: bytes) -> bytes:
    """Arrays of an .npz or .npy of other types, shapes and values, taken away or renamed."""
    loaded = np.load(io.BytesIO(data), allow_pickle=False)
    arrays = {"": loaded} if isinstance(loaded, np.ndarray) else dict(loaded)
    for _ in range(draw(st.integers(1, 2))):
        name = draw(st.sampled_from(sorted(arrays)))
        kind = draw(st.sampled_from(("type", "shape", "values", "delete", "rename", "text")))
        if kind == "delete" and len(arrays) > 1:
            del arrays[name]
        elif kind == "rename":
            arrays[name + "x"] = arrays.pop(name)
        else:
            arrays[name] = _other_array(draw, kind, arrays[name])
    packed = io.BytesIO()
    if isinstance(loaded, np.ndarray):
        np.save(packed, next(iter(arrays.values())), allow_pickle=False)
    else:
        np.savez(packed, **arrays)  # pyright: ignore[reportArgumentType] - the stub lacks keyword arrays
    return packed.getvalue()


def _other_array(draw: st.DrawFn, kind: str, array: np.ndarray) -> np.ndarray:
    if kind == "type":
        new = np.zeros(array.shape, draw(st.sampled_from(_DTYPES)))
        if new.dtype.kind in "fiub" and array.dtype.kind in "fiub":
            with np.errstate(all="ignore"):
                new[...] = array.astype(new.dtype)
        return new
    if kind == "shape":
        shapes = (
            array.ravel(),
            array[None],
            array[..., None],
            array.T,
            array.ravel()[:1].reshape(()) if array.size else array,
        )
        cut = (array[:-1], array[:0], array[..., :-1], np.concatenate((array, array))) if array.ndim else ()
        return draw(st.sampled_from((*shapes, *cut)))
    if kind == "values" and array.dtype.kind in "fiu" and array.size:
        new = array.copy().reshape(-1)
        rows = slice(None) if draw(st.booleans()) else int(draw(_fraction) * (new.size - 1))
        with np.errstate(all="ignore"):
            new[rows] = np.float64(draw(st.sampled_from(_FILLS))).astype(new.dtype)
        return new.reshape(array.shape)
    return np.array(draw(st.sampled_from(("", "x", "[1]", '{"a": 1}', "9" * 400))))
