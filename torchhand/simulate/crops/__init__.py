"""Labelled crops of hands by the thousand: for training, streamed or in files."""

from torchhand.simulate.crops.crops import CropMaker, Crops
from torchhand.simulate.crops.forearms import FIRST_OF_FOREARM, FOREARM_LENGTH, LAST_OF_FOREARM, forearm_meshes
from torchhand.simulate.crops.settings import CropSettings
from torchhand.simulate.crops.shards import Shard, about, prepare_shards, write_shard
from torchhand.simulate.crops.stream import CropStream

__all__ = [
    "FIRST_OF_FOREARM",
    "FOREARM_LENGTH",
    "LAST_OF_FOREARM",
    "CropMaker",
    "CropSettings",
    "CropStream",
    "Crops",
    "Shard",
    "about",
    "forearm_meshes",
    "prepare_shards",
    "write_shard",
]
