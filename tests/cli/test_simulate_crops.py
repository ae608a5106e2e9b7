"""Labelled crops in WebDataset's form, by the command."""

import json
import os
import platform
import subprocess
import sys
import tarfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from torchhand.cli.simulate_crops import main


@pytest.mark.slow
def test_shards_are_the_same_bytes_with_any_number_of_workers(tmp_path: Path) -> None:
    options = ["--count", "16", "--shard", "8", "--side-px", "64", "--seed", "5"]
    for workers in ("1", "2"):
        assert main(["--out", str(tmp_path / workers), *options, "--workers", workers]) == 0
    names = sorted(path.name for path in (tmp_path / "1").iterdir())
    assert names == ["about.json", "crops-000000.tar", "crops-000001.tar"]
    for name in names:
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes(), name
    contents = {}
    with tarfile.open(tmp_path / "1" / "crops-000001.tar") as archive:
        for entry in archive:
            member = archive.extractfile(entry)
            assert member is not None
            contents[entry.name] = member.read()
    keys = sorted({name.partition(".")[0] for name in contents})
    assert len(keys) == 8
    for key in keys:
        labels = json.loads(contents[f"{key}.json"])
        image, mask = (
            cv2.imdecode(np.frombuffer(contents[f"{key}.{kind}"], np.uint8), cv2.IMREAD_UNCHANGED)
            for kind in ("jpg", "mask.png")
        )
        assert image is not None
        assert mask is not None
        assert image.shape == (64, 64, 3)
        assert set(np.unique(mask)) <= {0, 255}
        assert np.shape(labels["keypoints"]) == (21, 3)
        assert labels["side"] in ("left", "right")
    assert main(["--out", str(tmp_path / "1"), *options]) == 2
    assert main(["--out", str(tmp_path / "3"), "--count", "6"]) == 2


_TWICE = """
import resource, sys
from torchhand.cli.simulate_crops import main
for turn in range(2):
    begun = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    main(["--out", f"{sys.argv[1]}/{turn}", "--count", "256", "--workers", "1"])
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - begun)
"""


@pytest.mark.slow
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library keeps memory in its own way")
def test_memory_of_one_batch_serves_the_next(tmp_path: Path) -> None:
    """Of the pages that the pictures alone take, as floating-point numbers, few come anew."""
    env = os.environ | {"MALLOC_MMAP_THRESHOLD_": "131072"}
    arguments = [sys.executable, "-c", _TWICE, str(tmp_path)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True, env=env)
    pages = 256 * 128 * 128 * 3 * 4 // os.sysconf("SC_PAGESIZE")
    assert int(done.stdout.splitlines()[-1]) < 0.25 * pages
