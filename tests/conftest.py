"""What all tests share: one thread, the place of the development data, and a seeded generator."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from tests import checked_calls
from tests.pretend_device import WHY_NOT, pretended

checked_calls.install()
# Convolutions of a GPU round their numbers to 10 bits unless they are told otherwise before the first of them. Tests
# compare them with those of the processor.
os.environ.setdefault("NVIDIA_TF32_OVERRIDE", "0")
REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """torch computes with one thread: several only wait for each other over small tensors on a busy machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def pytest_runtest_setup() -> None:
    """Shapes are checked in the first calls of every test."""
    checked_calls.begin_test()


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The development data: where TORCHHAND_DATA points, or ../shared/data; the test is skipped where it is missing."""
    folder = Path(os.environ.get("TORCHHAND_DATA") or REPOSITORY.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"needs the development data, which is not at {folder} (set TORCHHAND_DATA)")
    return folder


@pytest.fixture(params=["pretended", pytest.param("cuda", marks=pytest.mark.gpu)])
def device(request: pytest.FixtureRequest) -> Iterator[torch.device]:
    """An accelerator: one that is only pretended, on any machine, and a real one where the marker `gpu` asks for it."""
    if request.param == "pretended":
        if WHY_NOT is not None:
            pytest.skip(WHY_NOT)
        with pretended() as found:
            yield found
    elif torch.cuda.is_available():
        yield torch.device("cuda")
    else:
        pytest.skip("needs a CUDA device")


@pytest.fixture
def generator() -> torch.Generator:
    """A CPU random generator that starts the same for every test."""
    return torch.Generator().manual_seed(0)
