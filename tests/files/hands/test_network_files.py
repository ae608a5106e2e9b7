"""network.npz: written and read again, what is refused, and the network that is shipped."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files.disk import models_dir
from torchhand.files.hands.hand_model import load_hand_model
from torchhand.files.hands.network_files import (
    load_presence_network,
    load_proposal_network,
    save_presence_network,
    save_proposal_network,
)
from torchhand.propose import CHANNELS, SIDE_PX, PresenceNetwork, ProposalNetwork

SHIPPED = models_dir() / "proposals"


def _network() -> ProposalNetwork:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return ProposalNetwork(load_hand_model().skeleton, hypotheses=3, width=4, hidden=8).eval()


def _changed(path: Path, **changes: Any) -> Path:
    """The file with some arrays replaced, or left out where the change is None."""
    with np.load(path) as stored:
        arrays = dict(stored) | changes
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    return path


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    save_proposal_network(tmp_path / "network.npz", _network(), {"why": "test"})
    return tmp_path / "network.npz"


def test_a_network_comes_back_to_16_bits(stored: Path, tmp_path: Path, generator: torch.Generator) -> None:
    views = torch.randn(4, CHANNELS, SIDE_PX, SIDE_PX, generator=generator)
    with torch.no_grad():
        own, found = _network()(views), load_proposal_network(stored)(views)
    for name in ("rotation", "joints", "place", "log_size", "spread", "log_weight"):
        torch.testing.assert_close(getattr(found, name), getattr(own, name), atol=5e-3, rtol=0)
    save_proposal_network(tmp_path / "again.npz", _network(), {"why": "test"})
    assert stored.read_bytes() == (tmp_path / "again.npz").read_bytes()


@pytest.mark.parametrize("load", [load_proposal_network, load_presence_network])
def test_a_network_is_for_callers_in_any_mode(load: Any) -> None:
    """Weights that are made for inference alone and sent to a GPU by another mode are refused there by layers that look
    for their versions; the change of the dtype is a sending that a processor has too."""
    with torch.inference_mode():
        network = load.__wrapped__()
    network.double()
    with torch.inference_mode():
        network(torch.zeros(1, CHANNELS, SIDE_PX, SIDE_PX, dtype=torch.float64))
    assert all(value._version >= 0 for value in (*network.parameters(), *network.buffers()))


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        ("header", None, "expected a proposal network"),
        ("header", np.array("{"), "expected a proposal network"),
        ("heads.bias", None, r"heads\.bias: expected floating-point numbers \(\d+,\), got nothing"),
        ("heads.bias", np.zeros(3), r"heads\.bias: expected floating-point numbers \(\d+,\), got float64 \(3,\)"),
    ],
)
def test_other_files_are_refused(stored: Path, name: str, value: Any, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        load_proposal_network(_changed(stored, **{name: value}))


def test_numbers_that_are_none_are_refused(stored: Path) -> None:
    with np.load(stored) as arrays:
        bias = arrays["heads.bias"].copy()
    bias[1] = np.nan
    with pytest.raises(InputError, match=r"heads\.bias: expected finite numbers"):
        load_proposal_network(_changed(stored, **{"heads.bias": bias}))


@pytest.mark.parametrize(
    ("key", "value"), [("side_px", 7), ("joints", ["thumb"]), ("sizes", {"width": 0}), ("sizes", 3)]
)
def test_networks_of_other_versions_are_refused(stored: Path, key: str, value: Any) -> None:
    with np.load(stored) as arrays:
        header = json.loads(str(arrays["header"])) | {key: value}
    with pytest.raises(InputError, match=rf"{stored.name}: {key}: "):
        load_proposal_network(_changed(stored, header=np.array(json.dumps(header))))


def test_a_presence_network_comes_back_and_is_taken_for_no_other(
    stored: Path, tmp_path: Path, generator: torch.Generator
) -> None:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = PresenceNetwork(width=2, hidden=4).eval()
    save_presence_network(tmp_path / "presence.npz", network, {"why": "test"})
    views = torch.randn(4, CHANNELS, SIDE_PX, SIDE_PX, generator=generator)
    with torch.no_grad():
        own, found = network(views), load_presence_network(tmp_path / "presence.npz")(views)
    torch.testing.assert_close(found, own, atol=5e-3, rtol=0)
    with pytest.raises(InputError, match="expected a proposal network"):
        load_proposal_network(tmp_path / "presence.npz")
    with pytest.raises(InputError, match="expected a presence network"):
        load_presence_network(stored)


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.npz: cannot be read"):
        load_proposal_network(tmp_path / "none.npz")


def test_the_shipped_networks_are_small_documented_and_were_trained_by_the_command() -> None:
    text = (SHIPPED / "README.md").read_text(encoding="utf-8")
    sizes = {}
    for name, option in (("network.npz", "--out"), ("presence.npz", "--presence")):
        with np.load(SHIPPED / name) as arrays:
            header = json.loads(str(arrays["header"]))
        settings = header["provenance"]["settings"]
        assert header["provenance"]["step"] == settings["steps"], "an unfinished training"
        assert f"torchhand learn_proposals {option}" in text
        sizes[name] = settings
    assert sum(file.stat().st_size for file in SHIPPED.glob("*.npz")) <= 8_000_000
    assert load_proposal_network().sizes["hypotheses"] == sizes["network.npz"]["hypotheses"]
    assert load_presence_network().sizes["width"] == sizes["presence.npz"]["width"]
