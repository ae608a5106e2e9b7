"""ONNX export of kinematics and skinning, run by onnxruntime, for any number of poses.

Exporters cannot trace the tests' own type checks: these tests run in a call of their own with JAXTYPING_DISABLE=1.
"""

import os
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from torchhand.files import load_hand_model
from torchhand.hand import Hand, HandState

pytestmark = [
    pytest.mark.skipif(
        not os.environ.get("JAXTYPING_DISABLE"), reason="needs JAXTYPING_DISABLE=1: exporters cannot trace type checks"
    ),
    pytest.mark.filterwarnings("ignore::FutureWarning"),  # torch's own, on the way
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:# The axis name.* will not be used:UserWarning"),
]
TOLERANCE = 1e-5


class _Tensors(nn.Module):
    """Exported graphs give tensors, no records."""

    def __init__(self, hand: Hand) -> None:
        super().__init__()
        self.hand = hand

    def forward(self, pose: Tensor, shape: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        state = self.hand(pose, shape)
        return state.vertices, state.keypoints, state.frames.rotation, state.frames.position


@pytest.mark.parametrize("has_shapes", [False, True])
def test_onnx_gives_the_same(has_shapes: bool, tmp_path: Path, generator: torch.Generator) -> None:
    for name in ("onnx", "onnxscript"):
        pytest.importorskip(name)
    onnxruntime = pytest.importorskip("onnxruntime")
    module = _Tensors(load_hand_model().hand()).eval()
    default = module.hand.shape

    def inputs(count: int) -> tuple[Tensor, Tensor]:
        pose = 0.5 * torch.randn(count, 36, generator=generator)
        people = 1 + 0.03 * torch.randn(count, len(default), generator=generator)
        return pose, default * people if has_shapes else default

    batch = torch.export.Dim("batch", min=2, max=1 << 20)
    sizes = ({0: batch}, {0: batch} if has_shapes else None)
    program = torch.onnx.export(module, inputs(4), dynamo=True, dynamic_shapes=sizes, verbose=False)
    assert program is not None
    program.save(tmp_path / "hand.onnx")
    session = onnxruntime.InferenceSession(str(tmp_path / "hand.onnx"), providers=["CPUExecutionProvider"])
    names = [entry.name for entry in session.get_inputs()]
    for count in (4, 7):
        given = inputs(count)
        if count == 7:
            given[0][0] = 0  # the rotation vector's singular point
        found = session.run(None, dict(zip(names, (x.numpy() for x in given), strict=True)))
        for array, expected in zip(found, module(*given), strict=True):
            torch.testing.assert_close(torch.from_numpy(array), expected, atol=TOLERANCE, rtol=0)


def test_a_hand_is_exported_with_its_record(generator: torch.Generator) -> None:
    """No wrapper that gives tensors; the faces are those of the program, not of its tracing."""
    hand = load_hand_model().hand().eval()
    pose = 0.5 * torch.randn(3, 36, generator=generator)
    found = torch.export.export(hand, (pose,)).module()(pose)
    assert isinstance(found, HandState)
    assert torch.equal(found.faces, hand.faces)
    torch.testing.assert_close(found.vertices, hand(pose).vertices, atol=1e-6, rtol=0)
