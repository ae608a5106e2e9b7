"""`torchhand study export`: every start of a study as a Parquet table, columns read by themselves."""

import json
from pathlib import Path

import numpy as np
import pytest

from torchhand.cli.command import DONE, WRONG_INPUT
from torchhand.cli.study import main

parquet = pytest.importorskip("pyarrow.parquet", reason="tables need pyarrow (extra study)")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study") / "out"
    assert main(["--out", str(folder), "--starts", "10", "--levels", "2"]) == DONE
    return folder


def test_every_number_of_every_start(study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "starts.parquet"
    assert main(["export", str(study), "--to", str(target)]) == DONE
    assert f"10 starts; saved {target}" in capsys.readouterr().out
    table = parquet.read_table(target)
    with np.load(study / "hypotheses.npz") as stored:
        for name in ("frame", "level", "angle_deg", "misfit", "status", "success"):
            assert table[name].to_pylist() == stored[name].tolist()
        for name, names in (("pose", "dof_names"), ("perturbation", "free_names")):
            for column, values in zip(stored[names].tolist(), stored[name].T, strict=True):
                assert table[f"{name}_{column}"].to_pylist() == values.tolist()
        told = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}
        assert told["torchhand.config"] == str(stored["config"])
        assert json.loads(told["torchhand.header"]) == json.loads(str(stored["header"]))
    assert parquet.read_table(target, columns=["angle_deg"]).column_names == ["angle_deg"]  # without the others


def test_the_same_bytes_again(study: Path, tmp_path: Path) -> None:
    for name in ("one.parquet", "two.parquet"):
        assert main(["export", str(study / "hypotheses.npz"), "--to", str(tmp_path / name)]) == DONE
    assert (tmp_path / "one.parquet").read_bytes() == (tmp_path / "two.parquet").read_bytes()


def test_mistakes_are_one_line(study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    there = tmp_path / "there.parquet"
    there.write_bytes(b"mine")
    np.savez(tmp_path / "other.npz", frame=np.zeros(3))
    with np.load(study / "hypotheses.npz") as stored:
        arrays = dict(stored)
    np.savez(tmp_path / "shorter.npz", **(arrays | {"frame": arrays["frame"][:3]}))
    np.savez(tmp_path / "unnamed.npz", **(arrays | {"dof_names": arrays["dof_names"][:3]}))
    for words, message in (
        ([str(tmp_path / "shorter.npz"), "--to", str(tmp_path / "a.parquet")], "is no study that can be read ("),
        ([str(tmp_path / "unnamed.npz"), "--to", str(tmp_path / "a.parquet")], "is no study that can be read ("),
        ([str(study), "--to", str(tmp_path / "a.csv")], "--to: expected a name that ends in .parquet"),
        ([str(study), "--to", str(tmp_path / "no" / "a.parquet")], "--to: expected a file in an existing folder"),
        ([str(study), "--to", str(there)], "exists already; give another name, or --overwrite"),
        ([str(tmp_path / "other.npz"), "--to", str(tmp_path / "a.parquet")], "is no study that can be read (no array"),
        ([str(tmp_path / "none"), "--to", str(tmp_path / "a.parquet")], "none"),
    ):
        capsys.readouterr()
        assert main(["export", *words]) == WRONG_INPUT
        [line] = capsys.readouterr().err.splitlines()
        assert message in line
    assert there.read_bytes() == b"mine"
    assert not (tmp_path / "a.parquet").exists()
