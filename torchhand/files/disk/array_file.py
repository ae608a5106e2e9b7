"""Reading numpy's array files (.npy, .npz) that a user may have made, cut off or damaged."""

import contextlib
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from torchhand.errors import InputError
from torchhand.files.disk.plain_files import check_plain_file

_LONGEST = 120  # characters of a reason: numpy quotes broken bytes at length
_FREE_BYTES, _MAX_RATIO = 1 << 28, 100  # an array may be larger than the first only if it is not packed more than that


class StoredArrays(Mapping[str, np.ndarray]):
    """The arrays of a file by name, each read when it is asked for; what nobody asks for is never unpacked."""

    def __init__(self, arrays: Mapping[str, np.ndarray], members: Mapping[str, zipfile.ZipInfo]) -> None:
        self._arrays, self._members = arrays, members

    def __getitem__(self, name: str) -> np.ndarray:
        member = self._members.get(name)
        if member is not None and member.file_size > max(_FREE_BYTES, _MAX_RATIO * member.compress_size):
            raise ValueError(f"{name}: {member.file_size >> 20} MiB packed into {member.compress_size >> 10} KiB")
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def chosen(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Those of the arrays that the file has."""
        return {name: self[name] for name in names if name in self._arrays}

    def small(self, names: Iterable[str], most: int) -> dict[str, np.ndarray]:
        """Those of an archive's arrays that take at most so many bytes."""
        sizes = {name: self._members[name].file_size for name in names if name in self._members}
        return self.chosen(name for name, size in sizes.items() if size <= most)


@contextlib.contextmanager
def opened_arrays(path: Path, *, complaint: str) -> Iterator[StoredArrays]:
    """The arrays of an .npz by name; that of an .npy has the empty name.

    Nothing in the file is executed. Raises InputError with the complaint, such as "is no mesh that can be read", where
    the file, or an array that the block asks for, cannot be read.
    """
    check_plain_file(path)
    try:
        file = path.open("rb")  # here, because np.load leaves a broken file open
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    with file:
        try:
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                yield StoredArrays({"": loaded}, {})
            else:
                with loaded:
                    infos = [] if loaded.zip is None else loaded.zip.infolist()
                    yield StoredArrays(loaded, {info.filename.removesuffix(".npy"): info for info in infos})
        except InputError:
            raise
        except Exception as error:  # zip, its decompressors and numpy's header parser raise whatever they stumble over
            raise InputError(f"{path}: {complaint} ({_reason(error)})") from error


def _reason(error: Exception) -> str:
    text = str(error)
    if "allow_pickle" in text:  # numpy's advice, which nobody should follow
        return "it holds Python objects" if text.startswith("Object arrays") else "neither .npz nor .npy, or damaged"
    return (
        f"damaged: {_first_words(error)}"
        if isinstance(error, zipfile.BadZipFile)
        else f"{type(error).__name__}: {_first_words(error)}"
    )


def _first_words(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
