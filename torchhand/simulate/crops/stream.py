"""Crops without end, for a torch DataLoader."""

from collections.abc import Iterator

import torch
from torch import Tensor
from torch.utils.data import IterableDataset, get_worker_info

from torchhand.devices import HOST
from torchhand.hand import HandModel
from torchhand.simulate.crops.crops import CropMaker
from torchhand.simulate.crops.settings import CropSettings


class CropStream(IterableDataset[dict[str, Tensor]]):
    """Batches of labelled crops without end, each a dict of the fields of `Crops`.

        loader = DataLoader(CropStream(load_hand_model(), batch=64), batch_size=None, num_workers=2)

    Every worker draws crops of its own. In one process the crops follow from `seed` and how often they were begun
    anew; those of workers also from the seed that the DataLoader gives these.
    """

    def __init__(
        self,
        model: HandModel,
        settings: CropSettings | None = None,
        *,
        batch: int = 64,
        seed: int = 0,
        device: torch.device = HOST,
    ) -> None:
        """batch: crops at a time, a multiple of the views. Raises ValueError for another number. device: that crops are
        made on; an accelerator is for `num_workers=0`, as workers cannot hand over what lies on it."""
        self.settings = settings or CropSettings()
        if batch < 1 or batch % self.settings.views:
            raise ValueError(f"batch: expected a multiple of the {self.settings.views} views, got {batch}")
        self._model, self._batch, self._seed, self._epoch = model, batch, seed, 0
        self._device = device

    def __iter__(self) -> Iterator[dict[str, Tensor]]:
        info = get_worker_info()
        worker, epoch = (0, self._epoch) if info is None else (info.id + 1, info.seed - info.id)
        self._epoch += 1
        generator = seeded(self._seed, worker, epoch)
        maker = CropMaker(self._model, self.settings, generator, self._device)
        for crops in maker.batches(self._batch // self.settings.views, generator):
            yield crops.tensors()


def seeded(*numbers: int) -> torch.Generator:
    """A generator for these numbers; generators of other numbers have nothing in common with it."""
    state = 0x9E3779B97F4A7C15
    for number in numbers:
        state = (state ^ (number + 0x632BE59BD9B4E019)) * 0xBF58476D1CE4E5B9 % 2**64
        state ^= state >> 29
    return torch.Generator().manual_seed(state % 2**63)
