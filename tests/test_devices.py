"""Devices by name, and what is asked of them: a processor all the time, an accelerator seldom."""

import numpy as np
import pytest
import torch

from torchhand import devices
from torchhand.devices import TURNS, asks_after, constant_tensor, device_named, may_hold, read_back, rows_where
from torchhand.errors import InputError
from torchhand.track import HandKeypoints, View

CPU, META = torch.device("cpu"), torch.device("meta")


def test_a_processor_is_always_asked_and_an_accelerator_after_some_turns() -> None:
    assert all(asks_after(turn, CPU) for turn in range(3 * TURNS))
    assert [turn for turn in range(3 * TURNS) if asks_after(turn, META)] == [TURNS - 1, 2 * TURNS - 1, 3 * TURNS - 1]


def test_flags_of_an_accelerator_may_be_set_without_being_read() -> None:
    for flags in (torch.zeros(3, dtype=torch.bool), torch.tensor((False, True))):
        assert may_hold(flags) == bool(flags.any())
        assert may_hold(flags.to(META))


def test_rows_by_flags_that_were_read_back() -> None:
    flags = read_back(torch.tensor((True, False, True)))
    np.testing.assert_array_equal(flags, (True, False, True))
    assert rows_where(flags, CPU).tolist() == [0, 2]


def test_constants_are_sent_once() -> None:
    one = constant_tensor((1.0, 2.0), torch.float64, CPU)
    assert one is constant_tensor((1.0, 2.0), torch.float64, CPU)
    assert torch.equal(one, torch.tensor((1.0, 2.0), dtype=torch.float64))
    assert constant_tensor((1.0, 2.0), torch.float64, META).is_meta
    with torch.inference_mode():
        kept = constant_tensor((3, 4), torch.long, CPU)
    assert not kept.is_inference()


def test_devices_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    assert device_named("cpu") == CPU
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for name in ("cuda", "cuda:1", "meta", "gpu", "", "cpu:x", "mps"):
        with pytest.raises(InputError, match=rf"^--device: expected cpu on this machine, got '{name}'$"):
            device_named(name)


def test_an_accelerator_works_on_more_at_once() -> None:
    assert devices.at_once_on(CPU, 128) == 128
    assert devices.at_once_on(META, 128) == 128 * devices.MORE


@pytest.mark.gpu
def test_a_gpu_by_name() -> None:
    assert device_named("cuda").type == "cuda"
    with pytest.raises(InputError, match="expected cpu or cuda on this machine, got 'cuda:99'"):
        device_named("cuda:99")


@pytest.mark.gpu
def test_a_gpu_is_no_host() -> None:
    assert not devices.is_host(torch.device("cuda"))


def test_records_in_records_are_sent_and_others_stay() -> None:
    view = View(keypoints=HandKeypoints(points_px=torch.zeros(21, 2)))
    assert devices.sent_to((view, "name"), torch.device("cpu"))[0] is view
    sent = devices.sent_to((view, "name"), torch.device("meta"))
    assert sent[0].keypoints is not None
    assert sent[0].keypoints.points_px.device.type == "meta"
    assert sent[1] == "name"


def test_work_of_the_processor_gives_its_result_to_the_device(device: torch.device) -> None:
    seen = []

    @devices.on_host
    def doubled(values: torch.Tensor, *, by: torch.Tensor) -> list[torch.Tensor]:
        seen.extend((values.device.type, by.device.type))
        return [torch.from_numpy(values.numpy() * by.numpy())]

    [found] = doubled(torch.ones(3, device=device), by=torch.full((3,), 2.0, device=device))
    assert seen == ["cpu", "cpu"]
    assert found.device.type == device.type
    assert found.tolist() == [2.0, 2.0, 2.0]
