"""The folder of a training: a new one, or one to go on in."""

from collections.abc import Mapping
from pathlib import Path

from torchhand.errors import InputError
from torchhand.files.disk import explained_errors
from torchhand.learn import MODEL_NAME


def check_training_folder(out: Path, *, resume: bool, overwrite: bool) -> None:
    """Make the folder of a new training; an older one in it must be replaced, or gone on with, on purpose."""
    if resume and overwrite:
        raise InputError("expected at most one of --resume and --overwrite, got both")
    if resume:
        return
    if (out / MODEL_NAME).exists() and not overwrite:
        raise InputError(
            f"{out}: holds {MODEL_NAME} of an earlier training; give another folder, or --resume to go on, or"
            " --overwrite to replace it"
        )
    with explained_errors(out):
        out.mkdir(parents=True, exist_ok=True)


def check_same(given: Mapping[str, object], record: object, out: Path) -> None:
    """Raise InputError where an option differs from what a training was begun with."""
    for name, value in given.items():
        if value != (own := getattr(record, name)):
            option = name.replace("_", "-")
            raise InputError(f"--{option}: expected {own}, as {out / MODEL_NAME} has it, got {value}")
