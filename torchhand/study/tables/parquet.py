"""Every start of a study as a Parquet table: a column for each number, for programs that read the columns they need."""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from importlib import import_module
from pathlib import Path

import numpy as np

from torchhand.errors import InputError
from torchhand.files.disk import opened_arrays, replacing
from torchhand.study.hypotheses import Hypotheses

_ROWS = (*(f.name for f in fields(Hypotheses)), "success")
_NAMES = {"pose": "dof_names", "perturbation": "free_names"}
"""Arrays with the names of the columns of others."""
_TOLD = ("config", "units", "convention", "header")
_GROUP = 2**16  # rows that a reader takes at once
_COMPLAINT = "is no study that can be read"


def write_parquet(source: Path, target: Path) -> int:
    """Write the starts of a study's hypotheses.npz as a Parquet file; how many there are.

    Columns are the arrays that have a row per start, `pose_NAME` and `perturbation_NAME` for each number of a pose
    (metres and radians); settings and units are the schema's metadata, under `torchhand.config` and so on. The same
    study gives the same bytes with the same pyarrow.

    Raises InputError where the study cannot be read, and without pyarrow (extra `study`).
    """
    try:
        arrow, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError as error:
        raise InputError(f"a Parquet table needs pyarrow: pip install 'torchhand[study]' ({error})") from error
    with opened_arrays(source, complaint=_COMPLAINT) as stored:
        missing = [name for name in (*_ROWS, *_NAMES.values(), *_TOLD) if name not in stored]
        if missing:
            raise InputError(f"{source}: {_COMPLAINT} (no array {missing[0]!r})")
        told = {f"torchhand.{name}": str(stored[name]) for name in _TOLD}
        try:
            table = arrow.table(dict(_columns(stored))).replace_schema_metadata(told)
        except ValueError as error:  # arrays that do not belong together
            raise InputError(f"{source}: {_COMPLAINT} ({error})") from error
    with replacing(target) as temporary:
        parquet.write_table(table, temporary, row_group_size=_GROUP, compression="zstd")
    return table.num_rows


def _columns(stored: Mapping[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    for name in _ROWS:
        values = stored[name]
        if name not in _NAMES:
            yield name, values
            continue
        for column, own in zip(stored[_NAMES[name]].tolist(), values.T, strict=True):
            yield f"{name}_{column}", np.ascontiguousarray(own)
