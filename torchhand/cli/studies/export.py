"""The starts of a finished study as a table that other programs read."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from torchhand.cli.command import DONE, parse
from torchhand.errors import InputError
from torchhand.files.disk import expanded
from torchhand.study.hypotheses import NPZ_NAME
from torchhand.study.tables import write_parquet

EXPORT = "export"
"""The word after `torchhand study` that asks for a study in another format."""

_ENDING = ".parquet"


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Write the starts of a finished study, of any kind that has hypotheses.npz, as one Parquet table.

    A row per start, a column per number; settings and units are in the metadata. Programs such as polars, DuckDB and
    pandas read of it only the columns and rows that are asked for.

    Example:
        torchhand study export out/study --to starts.parquet
    """

    result: Annotated[Positional[Path], arg(metavar="IN")]
    """Folder of `torchhand study` or `torchhand study design`, or its hypotheses.npz."""
    to: Annotated[Path, arg(metavar="FILE")]
    """File to write, *.parquet."""
    overwrite: bool = False
    """Replace a file that exists."""


def study_export(argv: Sequence[str]) -> int:
    """Write the table. Raises InputError as commands do."""
    arguments = parse(Arguments, argv, name=f"study {EXPORT}")
    source, target = expanded(arguments.result), expanded(arguments.to)
    if target.suffix.lower() != _ENDING:
        raise InputError(f"--to: expected a name that ends in {_ENDING}, got {target}")
    if not target.absolute().parent.is_dir() or target.is_dir():
        raise InputError(f"--to: expected a file in an existing folder, got {target}")
    if target.exists() and not arguments.overwrite:
        raise InputError(f"{target}: exists already; give another name, or --overwrite")
    count = write_parquet(source / NPZ_NAME if source.is_dir() else source, target)
    print(f"{count} starts; saved {target}")
    return DONE
