"""`torchhand benchmark` on registration: peers get the same problem, and figures say what was measured."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from torchhand.cli.benchmark import main
from torchhand.cli.benchmarks import iteration as benchmark_iteration
from torchhand.cli.benchmarks import registration as benchmark_registration
from torchhand.cli.benchmarks.iteration import TABLE, Iteration, pypose_step
from torchhand.cli.benchmarks.registration import SPACE, Case
from torchhand.evaluate import THREAD_VARIABLES
from torchhand.numerics.least_squares import normal_equations
from torchhand.view import outline_table

# torch's own, where forward derivatives are first asked for, and pypose's.
pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")


@pytest.fixture(autouse=True)
def _small_and_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in THREAD_VARIABLES:
        monkeypatch.setenv(name, "1")
    monkeypatch.setattr(benchmark_iteration, "HYPOTHESES", 3)
    monkeypatch.setattr(benchmark_iteration, "PEER_HYPOTHESES", 1)
    monkeypatch.setattr(benchmark_iteration, "TABLE", outline_table(2, 2, without=("palm_wrist",)))
    monkeypatch.setattr(benchmark_registration, "MANY", 4)
    monkeypatch.setattr(benchmark_registration, "SIZE_PX", (200, 150))


@pytest.fixture
def work() -> Iteration:
    return Iteration(3)


def _run(out: Path, name: str) -> dict[str, Any]:
    assert main(["--repeats", "1", "--out", str(out), "--only", name]) == 0
    [entry] = json.loads(out.read_text())["entries"]
    return entry


def test_the_closed_form_is_that_of_the_peer_s_residuals(work: Iteration) -> None:
    """Across the outlines exactly; what slides along them is left out and hardly changes a distance."""
    found = work.in_closed_form(work.start)
    residual, jacobian = work.by_forward_derivatives(work.start)
    torch.testing.assert_close(found.cost, 0.5 * residual.square().sum(-1), atol=0, rtol=1e-9)
    matrix, gradient = jacobian.mT @ jacobian, (residual[:, None] @ jacobian).squeeze(1)
    assert float((found.matrix - matrix).norm() / matrix.norm()) < 0.05
    assert float(torch.nn.functional.cosine_similarity(found.gradient, gradient).min()) > 0.99


def test_a_thousand_residuals() -> None:
    assert TABLE.size == pytest.approx(1000, abs=10)  # as imported, before these tests make it small


def test_plain_operations_give_the_same_residuals(work: Iteration) -> None:
    for free, channel in zip(work.start, work.channel, strict=True):
        torch.testing.assert_close(
            work.residual_plainly(free, channel), work.residual(free, channel), atol=1e-9, rtol=0
        )


def test_pypose_takes_the_step_that_ours_takes_with_the_same_derivatives(work: Iteration) -> None:
    library = pytest.importorskip("pypose")
    first = normal_equations(work.by_forward_derivatives(work.start), None)
    ours = work.run(work.by_forward_derivatives, first)
    taken = (ours != work.start).any(-1).nonzero()[:, 0].tolist()
    assert taken  # a refused step is tried again within a step of theirs
    for index in taken:
        theirs, step = pypose_step(library, work, index), ours[index] - work.start[index]
        assert float((theirs - ours[index]).norm()) < 1e-3 * float(step.norm())  # ours adds 1e-12 of the largest entry


def test_one_registration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(benchmark_registration, "SIZE_PX", (640, 480))
    entry = _run(tmp_path / "figures.json", "registration")
    details = entry["details"]
    assert (entry["unit"], entry["must"], entry["aim"]) == ("ms", 40.0, 15.0)
    assert entry["value"] == details["fit_ms"] > 0
    assert details["picture_ms"] > 0
    assert details["together_ms"] > 0
    assert details["residuals"] == pytest.approx(1000, abs=25)
    assert details["parameters"] == SPACE.size == 26
    assert details["error_after_mm"] < details["error_before_mm"]
    assert "maps and valleys take" in capsys.readouterr().out


def test_many_hypotheses(tmp_path: Path) -> None:
    entry = _run(tmp_path / "figures.json", "registration_many")
    details = entry["details"]
    assert (entry["unit"], entry["must"], entry["aim"]) == ("ms", 90.0, 30.0)
    assert details["hypotheses"] == 4
    assert details["most_iterations"] == 20 >= details["mean_iterations"] > 1
    assert details["minutes_per_10000"] == pytest.approx(entry["value"] / 6)
    assert 0 < details["median_contour_px"] < 1


def test_forward_derivatives_are_a_peer_that_is_always_there(tmp_path: Path) -> None:
    entry = _run(tmp_path / "figures.json", "lm_iteration_jacfwd")
    assert (entry["peer"], entry["must"]) == ("vmap(jacfwd)", 1.3)
    assert entry["ratio"] == pytest.approx(entry["peer_ms"] / entry["ours_ms"])


def test_ratios_to_pypose_are_per_hypothesis(tmp_path: Path) -> None:
    pytest.importorskip("pypose")
    entry = _run(tmp_path / "figures.json", "lm_iteration_pypose")
    assert (entry["peer"], entry["must"]) == ("pypose", 5.0)
    assert entry["ratio"] == pytest.approx(3 * entry["peer_ms"] / entry["ours_ms"])


def test_without_pypose_ours_is_measured_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pypose", None)
    entry = _run(tmp_path / "figures.json", "lm_iteration_pypose")
    assert [entry[key] for key in ("peer_ms", "ratio", "value", "meets")] == [None] * 4
    assert "pypose is not installed" in capsys.readouterr().out


def test_starts_are_off_by_what_is_said() -> None:
    case = Case.of(20, deg=5.0, mm=4.0)
    angles = torch.rad2deg((case.pose - case.truth)[:, 6:].abs())
    assert 3.0 < float(angles.max()) <= 10.0 + 1e-9  # tied angles move twice as far
    assert 3e-3 < float((case.pose - case.truth)[:, :3].abs().max()) <= 4e-3
    alike = torch.einsum("nij,ij->n", case.references, case.reference)
    turned = torch.rad2deg((0.5 * (alike - 1)).clamp(-1, 1).acos())
    assert 2.0 < float(turned.max()) < 5.0 * 3**0.5
