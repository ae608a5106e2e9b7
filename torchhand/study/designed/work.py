"""A designed study at work: batch by batch into its folder, and its results."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import yaml

import torchhand
from torchhand.cluster import Cluster
from torchhand.files import CONFIG_ARRAY
from torchhand.files.disk import write_text
from torchhand.hand import DOFS, named_pose_space
from torchhand.study.designed.cell import CellRegistration, planned
from torchhand.study.designed.plot import draw_study, require_matplotlib
from torchhand.study.designed.study import Study, text_of
from torchhand.study.designed.table import CellRow, cell_rows, csv_text
from torchhand.study.hypotheses import (
    CSV_NAME,
    NPZ_NAME,
    PICTURE_NAME,
    Hypotheses,
    StudyFolder,
    run_batches,
    save_study,
)

UNITS = "metres, radians; *_deg degrees, *_mm mm, *_px px"


@dataclass(frozen=True, kw_only=True)
class DesignedResults:
    """What came of a study."""

    study: Study
    rows: list[CellRow]
    """A row for every cell."""
    hypotheses: Hypotheses
    """Every start, cell by cell, picture by picture, trial by trial."""
    seconds: float
    """Seconds per start; 0 where none was left to do."""


def run_study(
    study: Study,
    out: Path,
    *,
    workers: int | Cluster = 1,
    device: str = "cpu",
    resume: bool = False,
    overwrite: bool = False,
) -> DesignedResults:
    """Run a study, or go on with it, and write study.csv, study.png and hypotheses.npz into a folder.

    The same study gives the same files on one device, stopped and resumed or not, whatever the workers. device: of the
    registrations. Raises InputError where the
    folder cannot be used, holds another study than the one to resume, or matplotlib is missing.
    """
    require_matplotlib()
    folder = StudyFolder(out, _header(study, device), resume=resume, overwrite=overwrite)
    if folder.finished is not None:
        found = folder.finished
        return DesignedResults(study=study, rows=cell_rows(study, found), hypotheses=found, seconds=0.0)

    found, seconds = run_batches(planned(study), _Making(study=study, device=device), folder, workers, device)
    rows = cell_rows(study, found)
    further = {
        "cell": found.batch // study.pictures,
        "dof_names": DOFS,
        "free_names": named_pose_space(study.space).free_names,
        "success": found.is_success(study.success_deg),
        "units": UNITS,
        CONFIG_ARRAY: yaml.safe_dump(_written(study), sort_keys=False, allow_unicode=True),
    }
    with folder.finishing() as place:
        write_text(place / CSV_NAME, csv_text(study, rows))
        draw_study(study, rows, place / PICTURE_NAME)
        save_study(place / NPZ_NAME, folder.header, found, further)
    return DesignedResults(study=study, rows=rows, hypotheses=found, seconds=seconds)


@dataclass(frozen=True, kw_only=True)
class _Making:
    """Makes what registers batches; a worker of a cluster gets it."""

    study: Study
    device: str

    def __call__(self, threads: int = 1) -> CellRegistration:
        return CellRegistration(self.study, self.device)


def _header(study: Study, device: str) -> Mapping[str, Any]:
    """What must be equal in a study that is to be resumed."""
    versions = {"torchhand": torchhand.__version__, "torch": str(torch.__version__)}
    return {**versions, "kind": "designed", "device": device, "study": study.described()}


def _written(study: Study) -> dict[str, Any]:
    """The study as it was run, cell by cell."""
    described = study.described()
    cells = described.pop("cells")
    run = {"torchhand": torchhand.__version__, "torch": str(torch.__version__)}
    factors = {name: list(dict.fromkeys(text_of(cell.values[name]) for cell in study.cells)) for name in study.factors}
    return {**described, "factors": factors, "cells": cells, "run": run}
