"""Reading numpy's array files (.npy, .npz) that a user may have made, cut off or damaged."""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from torchhand.errors import InputError

_LONGEST = 120  # characters of a reason: numpy quotes broken bytes at length


@contextlib.contextmanager
def opened_arrays(path: Path, *, complaint: str) -> Iterator[Mapping[str, np.ndarray]]:
    """The arrays of an .npz by name, read as they are asked for; that of an .npy has the empty name.

    Nothing in the file is executed. Raises InputError with the complaint, such as "is no mesh that can be read", where
    the file, or an array that the block asks for, cannot be read.
    """
    try:
        file = path.open("rb")  # here, because np.load leaves a broken file open
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    with file:
        try:
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                yield {"": loaded}
            else:
                with loaded:
                    yield loaded
        except InputError:
            raise
        except Exception as error:  # zip, its decompressors and numpy's header parser raise whatever they stumble over
            raise InputError(f"{path}: {complaint} ({type(error).__name__}: {_first_words(error)})") from error


def _first_words(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
