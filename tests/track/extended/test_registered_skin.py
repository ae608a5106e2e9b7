"""Which skin the extended update registers."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.hand import HandPose
from torchhand.track import DEFAULTS, Tracker
from torchhand.track.extended import ExtendedUpdate, ExtendedUpdateSettings


def test_the_skin_that_is_registered_is_that_of_the_hand_given(studio: Any) -> None:
    """A model whose skin is a tenth larger about its middle has contours a tenth wider."""
    placed, model = studio.placed(size=0.7), load_hand_model()
    settings = replace(DEFAULTS["distance"], update=ExtendedUpdateSettings(surface="mesh"))
    assert model.mesh is not None
    middle = model.mesh.vertices.mean(0)
    larger = replace(model, mesh=replace(model.mesh, vertices=middle + 1.1 * (model.mesh.vertices - middle)))
    pose = HandPose(dofs=placed.pose, reference=placed.root_reference)
    widths = []
    for own, dtype in ((model, torch.float64), (larger, torch.float64), (model, torch.float32)):
        hand = own.hand(side=placed.kinematics.side, dtype=dtype)
        rule = Tracker(hand, placed.camera, settings, shape=placed.shape).parts.rule
        assert isinstance(rule, ExtendedUpdate)
        (contours,) = rule._for(placed.shape).contours
        seen = contours.visible(HandPose.stack([pose]), probe_distance_px=2.0)
        points = seen.points_px[0, (seen.outer | seen.inner)[0]]
        widths.append(float((points.amax(0) - points.amin(0)).norm()))
    assert widths[1] == pytest.approx(1.1 * widths[0], rel=0.01)
    assert widths[2] == pytest.approx(widths[0], rel=1e-5)
