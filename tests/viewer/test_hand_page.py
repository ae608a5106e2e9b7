"""The controls of the page, driven as a browser does: each changes the hand that the scene shows."""

import json
import math
from typing import Any

import numpy as np
import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.hand import DOFS, posture
from torchhand.viewer import EditedHand, HandPage, ViewerServer


@pytest.fixture
def page(server: ViewerServer) -> HandPage:
    return HandPage(server, EditedHand(load_hand_model()))


def _shown(page: HandPage) -> np.ndarray:
    return np.asarray(page.scene.skin.vertices)


def _expected(pose: torch.Tensor, shape: torch.Tensor | None = None) -> np.ndarray:
    hand = load_hand_model().hand(dtype=torch.float64)
    return hand(pose, hand.shape if shape is None else shape).vertices.numpy()


def test_every_degree_of_freedom_and_every_proportion_has_its_slider(page: HandPage) -> None:
    space = load_hand_model().shape_space
    assert tuple(page.angles) == DOFS
    assert tuple(page.parameters) == space.names
    for dof in DOFS[6:]:
        low, high = (math.degrees(limit) for limit in page.hand.limits(dof))
        assert (page.angles[dof].min, page.angles[dof].max) == pytest.approx((low, high), abs=0.06)
    np.testing.assert_allclose(_shown(page), _expected(posture("open", dtype=torch.float64)), atol=1e-6)


def test_sliders_move_the_hand(page: HandPage) -> None:
    pose = posture("open", dtype=torch.float64)
    page.angles["index_pip_fe"].value = 70.0
    page.angles["root_ty"].value = 40.0
    pose[DOFS.index("index_pip_fe")], pose[1] = math.radians(70.0), 0.04
    np.testing.assert_allclose(_shown(page), _expected(pose), atol=1e-6)
    page.parameters["hand_length"].value = 0.2
    shape = load_hand_model().shape_space.default.double().clone()
    shape[0] = 0.2
    np.testing.assert_allclose(_shown(page), _expected(pose, shape), atol=1e-6)


def test_lists_and_buttons_fill_the_sliders_in(page: HandPage) -> None:
    page.posture.value = "fist"
    fist = posture("fist", dtype=torch.float64)
    assert page.angles["ring_pip_fe"].value == pytest.approx(math.degrees(fist[DOFS.index("ring_pip_fe")]), abs=0.06)
    np.testing.assert_allclose(_shown(page), _expected(fist), atol=1e-6)
    _press(page.draw)
    drawn = _shown(page)
    assert np.abs(drawn - _expected(fist)).max() > 0.01
    page.angles["middle_mcp_fe"].value = page.angles["middle_mcp_fe"].min
    page.angles["index_mcp_fe"].value = page.angles["index_mcp_fe"].max
    assert "impossible" in page.told.content
    _press(page.feasible)
    assert "impossible" not in page.told.content
    page.follows.value = True
    page.angles["little_pip_fe"].value = 60.0
    assert page.angles["little_dip_fe"].value == pytest.approx(40.0, abs=0.06)


def _press(button: Any) -> None:
    """As a click in the browser does."""
    for call in button._impl.update_cb:
        call(None)


def test_a_browser_gets_the_pose_as_a_file(page: HandPage) -> None:
    sent: list[tuple[str, bytes]] = []

    class Client:
        def send_file_download(self, name: str, content: bytes, *, save_immediately: bool = False) -> None:
            assert save_immediately
            sent.append((name, content))

    class Event:
        client = Client()

    page.posture.value = "victory"
    for _, button in page.exports.items():
        for call in button._impl.update_cb:
            call(Event())
    assert [name for name, _ in sent] == ["pose.json", "hand.obj"]
    assert json.loads(sent[0][1])["pose"]["middle_pip_fe"] == pytest.approx(float(page.hand.pose[22]))
