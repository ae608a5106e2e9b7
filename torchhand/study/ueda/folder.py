"""The folder of a study of many small parts: each saved when it is done, so that a stopped study can go on."""

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from torchhand.errors import InputError
from torchhand.files import check_output_folder
from torchhand.files.disk import explained_errors, read_json, short, write_text
from torchhand.files.results import UNFINISHED_NAME, finish_replacement, replace_result

PARTS_NAME = "parts.json"
HEADER_NAME = "header.json"
_PART = "part_{}.json"


class PartsFolder:
    """Parts grow in the sub-folder `unfinished`; `finishing` moves the results into place as one step.

    Until then an older result stays. What is saved is JSON.
    """

    def __init__(
        self, out_dir: Path, header: Mapping[str, Any], *, resume: bool = False, overwrite: bool = False
    ) -> None:
        """header: what must be equal in a study that is to be resumed.

        Raises InputError where the folder cannot be used, or holds another study than the one to resume.
        """
        check_output_folder(out_dir, resume=resume, overwrite=overwrite)
        self.out_dir, self.folder = out_dir, out_dir / UNFINISHED_NAME
        self._place = self.folder / "results"
        finish_replacement(self.out_dir, self._place)
        self.header = json.loads(json.dumps(dict(header)))
        self.parts: dict[str, Any] = {}
        if resume:
            self.parts = self._earlier()
        else:
            self._clear()
        with explained_errors(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
        write_text(self.folder / HEADER_NAME, json.dumps(self.header, indent=1) + "\n")

    def save(self, name: str, part: Any) -> None:
        """Keep one part for good."""
        self.parts[name] = part
        write_text(self.folder / _PART.format(name), json.dumps(part) + "\n")

    @contextlib.contextmanager
    def finishing(self, names: Sequence[str]) -> Iterator[Path]:
        """A folder for the results, moved into place when the block ends well.

        names: of all results that a study can have; those of an older study that the new one lacks are removed.
        """
        with explained_errors(self._place):
            self._place.mkdir(exist_ok=True)
        yield self._place
        content = {"header": self.header, "parts": self.parts}
        write_text(self._place / PARTS_NAME, json.dumps(content, indent=1) + "\n")
        kept = [name for name in (*names, PARTS_NAME) if (self._place / name).exists()]
        replace_result(self.out_dir, self._place, kept, dropped=[name for name in names if name not in kept])
        self._clear()

    def _earlier(self) -> dict[str, Any]:
        """Parts of the study to resume."""
        begun, done = self.folder / HEADER_NAME, self.out_dir / PARTS_NAME
        if begun.exists():
            self._check_same(begun, read_json(begun))
            paths = sorted(self.folder.glob(_PART.format("*")))
            prefix = len(_PART.format("")) - len(".json")
            return {path.stem[prefix:]: read_json(path) for path in paths}
        if done.exists():
            content = read_json(done)
            if not isinstance(content, dict) or not isinstance(content.get("parts"), dict):
                raise InputError(f"{done}: cannot be resumed: expected the parts of a study, got {short(content)}")
            self._check_same(done, content.get("header"))
            return content["parts"]
        names = sorted(path.name for path in self.out_dir.iterdir()) if self.out_dir.is_dir() else []
        foreign = [name for name in names if name != UNFINISHED_NAME]
        if foreign:
            raise InputError(f"{self.out_dir}: cannot be resumed: expected a study, found {foreign[0]}")
        return {}

    def _check_same(self, where: Path, before: Any) -> None:
        before = before if isinstance(before, dict) else {}
        for name in [*self.header, *before]:
            if before.get(name) != self.header.get(name):
                raise InputError(
                    f"{where}: cannot be resumed: {name} was {short(before.get(name))}, is now"
                    f" {short(self.header.get(name))}; give the same options as before, or --overwrite"
                )

    def _clear(self) -> None:
        with explained_errors(self.folder):
            for path in [self.folder / HEADER_NAME, *self.folder.glob(_PART.format("*")), *self._place.glob("*")]:
                path.unlink(missing_ok=True)
            for folder in (self._place, self.folder):
                with contextlib.suppress(OSError):
                    folder.rmdir()  # stays where someone else has put a file there
