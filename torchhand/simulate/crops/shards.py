"""Crops in WebDataset's form: plain tar files whose members belong together by their names."""

import io
import json
import tarfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import torch

from torchhand.devices import HOST, sent_to
from torchhand.files import load_hand_model
from torchhand.files.disk import explained_errors, replacing
from torchhand.hand import DOFS
from torchhand.numerics import single_threaded
from torchhand.simulate.crops.crops import CropMaker, Crops
from torchhand.simulate.crops.settings import CropSettings
from torchhand.simulate.crops.stream import seeded

_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 92)
_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)
_AT_ONCE = 128  # crops


@dataclass(frozen=True, kw_only=True)
class Shard:
    """One file of a data set; its bytes depend on this record alone, and for another device
    than the processor on what that computes."""

    folder: Path
    index: int
    crops: int
    """Number of crops, a multiple of the views."""
    seed: int
    settings: CropSettings
    device: torch.device = HOST
    """That crops are made on."""

    @property
    def path(self) -> Path:
        return self.folder / f"crops-{self.index:06d}.tar"


def write_shard(shard: Shard) -> Path:
    """Make the crops of a shard and write them; one of torch's threads. For each crop KEY the file has

    KEY.jpg  the picture.
    KEY.mask.png  255 where the hand is seen.
    KEY.json  keypoints (21, 3) metres and keypoints_px (21, 2), intrinsics (3, 3), pose (36,), shape (52,), side, hand:
        crops of one hand at one time, by several cameras, share its number.
    """
    with (
        single_threaded(),
        explained_errors(shard.path),
        replacing(shard.path) as part,
        tarfile.open(part, "w", format=tarfile.USTAR_FORMAT) as archive,
    ):
        batches, done = _batches(shard, max(1, _AT_ONCE // shard.settings.views)), 0
        while done < shard.crops:
            crops = sent_to(next(batches).rows(slice(shard.crops - done)), HOST)
            for name, content in _members(crops, shard, done):
                entry = tarfile.TarInfo(name)
                entry.size = len(content)
                archive.addfile(entry, io.BytesIO(content))
            done += len(crops)
    return shard.path


def prepare_shards(shard: Shard) -> None:
    """Make what all shards of a data set share before any is written, for this process and later copies of it."""
    with single_threaded():
        next(_batches(shard, 1))


def _batches(shard: Shard, people: int) -> Iterator[Crops]:
    maker = _maker(shard.settings, shard.seed, shard.device)
    return maker.batches(people, seeded(shard.seed, shard.index))


@lru_cache(maxsize=1)
def _maker(settings: CropSettings, seed: int, device: torch.device) -> CropMaker:
    """The same for all shards of a data set."""
    return CropMaker(load_hand_model(), settings, seeded(seed), device)


def about(settings: CropSettings) -> dict[str, object]:
    """What holds for all crops of a data set."""
    return {
        "dof_names": list(DOFS),
        "shape_names": list(load_hand_model().shape_space.names),
        "units": "metres, radians, px; OpenCV cameras, the centre of the first pixel is (0, 0)",
        "settings": asdict(settings),
    }


def _members(crops: Crops, shard: Shard, first: int) -> Iterator[tuple[str, bytes]]:
    numbers = [
        np.round(field.numpy().astype(np.float64), 6).tolist()
        for field in (crops.keypoints, crops.keypoints_px, crops.intrinsics, crops.pose, crops.shape)
    ]
    images, masks = crops.image.numpy(), crops.mask.numpy().astype(np.uint8) * 255
    sides, people = crops.is_left.tolist(), crops.person.tolist()
    for index in range(len(crops)):
        key = f"{shard.index:06d}{first + index:06d}"
        names = ("keypoints", "keypoints_px", "intrinsics", "pose", "shape")
        labels = {name: values[index] for name, values in zip(names, numbers, strict=True)}
        labels["side"] = "left" if sides[index] else "right"
        labels["hand"] = f"{shard.index:06d}{first // shard.settings.views + people[index]:06d}"
        bgr = cv2.cvtColor(images[index], cv2.COLOR_RGB2BGR)
        yield f"{key}.jpg", cv2.imencode(".jpg", bgr, _JPEG)[1].tobytes()
        yield f"{key}.mask.png", cv2.imencode(".png", masks[index], _PNG)[1].tobytes()
        yield f"{key}.json", json.dumps(labels, separators=(",", ":")).encode()
