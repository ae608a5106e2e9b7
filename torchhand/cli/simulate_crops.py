"""Labelled crops of random hands by the thousand, as WebDataset shards: pictures, masks, keypoints and poses."""

import json
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated

import torch
from tqdm import tqdm
from tyro.conf import OmitArgPrefixes, arg

from torchhand.cli.command import DONE, OnDevice, command, parse
from torchhand.cluster import Copies, can_copy_process, keep_freed_memory
from torchhand.devices import device_named
from torchhand.errors import InputError
from torchhand.files.disk import explained_errors, write_text
from torchhand.simulate.crops import CropSettings, Shard, about, prepare_shards, write_shard

ABOUT_NAME = "about.json"
_MAX_WORKERS = 256


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Labelled crops of random hands by the thousand, as WebDataset shards: pictures, masks, keypoints and poses.

    People and postures of the prior, each before several cameras, with skin tones, light, backgrounds, forearms,
    sleeves, things in front, blur and noise. DIR gets crops-000000.tar and so on, plain tar files with KEY.jpg,
    KEY.mask.png and KEY.json for each crop, and about.json with names and units. The same arguments give the same
    bytes, with any number of workers, and on any device the same hands before the same things.
    `torchhand.simulate.CropStream` gives the same crops to a DataLoader.

    Example:
        torchhand simulate_crops --out out/crops --count 20000
    """

    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for the shards; new, or empty."""
    count: int = 10_000
    """Crops in all, a multiple of the views."""
    shard: int = 1000
    """Crops in a file, a multiple of the views."""
    seed: int = 0
    """Seed of everything that is random."""
    workers: int = 2
    """Processes, with one thread each."""
    settings: OmitArgPrefixes[CropSettings] = field(default_factory=CropSettings)

    def __post_init__(self) -> None:
        views = self.settings.views
        for name in ("count", "shard"):
            value = getattr(self, name)
            if value < 1 or value % views:
                raise ValueError(f"--{name}: expected a multiple of the {views} views, got {value}")
        if not 1 <= self.workers <= _MAX_WORKERS:
            raise ValueError(f"--workers: expected 1 to {_MAX_WORKERS}, got {self.workers}")
        if not 0 <= self.seed < 2**31:
            raise ValueError(f"--seed: expected 0 to {2**31 - 1}, got {self.seed}")


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Make the shards."""
    arguments = parse(Arguments, argv, name="simulate_crops")
    device = device_named(arguments.device)
    _check_folder(arguments.out)
    shards = [
        Shard(
            folder=arguments.out,
            index=index,
            crops=min(arguments.shard, arguments.count - first),
            seed=arguments.seed,
            settings=arguments.settings,
            device=device,
        )
        for index, first in enumerate(range(0, arguments.count, arguments.shard))
    ]
    facts = about(arguments.settings) | {"count": arguments.count, "seed": arguments.seed}
    write_text(arguments.out / ABOUT_NAME, json.dumps(facts, indent=2) + "\n")
    start = time.perf_counter()
    with tqdm(total=arguments.count, unit="crop", disable=not sys.stderr.isatty()) as bar:
        for shard in _written(shards, arguments.workers, device):
            bar.update(shard.crops)
    rate = arguments.count / (time.perf_counter() - start)
    print(f"saved {arguments.count} crops in {len(shards)} shards in {arguments.out}, {rate:.0f} a second")
    return DONE


def _check_folder(path: Path) -> None:
    with explained_errors(path):
        path.mkdir(parents=True, exist_ok=True)
        content = sorted(entry.name for entry in path.iterdir())
    if content:
        raise InputError(f"{path}: --out: expected a new folder or an empty one; it holds {content[0]}")


def _written(shards: list[Shard], workers: int, device: torch.device) -> Iterator[Shard]:
    """The shards as their files are done, in any order."""
    count = min(workers, len(shards))
    if count > 1 and can_copy_process(device):
        prepare_shards(shards[0])
        yield from (shard for shard, _ in Copies(count).done(lambda: write_shard, shards))
    elif count > 1:
        with ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=keep_freed_memory) as pool:
            for shard, _ in zip(shards, pool.map(write_shard, shards), strict=True):
                yield shard
    else:
        keep_freed_memory()
        for shard in shards:
            write_shard(shard)
            yield shard
