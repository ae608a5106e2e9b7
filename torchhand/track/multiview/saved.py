"""What the tracker of several cameras knows, as plain tensors and numbers on disk (torch.save, weights_only)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import torch

from torchhand.image import SkinModel
from torchhand.numerics import Gaussian
from torchhand.track import TrackerState
from torchhand.track.multiview.fitting import Anchor
from torchhand.track.multiview.silhouettes import LearnedSkin
from torchhand.track.multiview.tracker import MultiViewMemory


@dataclass(frozen=True, kw_only=True)
class Knowledge:
    """Everything with which a run goes on."""

    state: TrackerState | None
    memory: MultiViewMemory
    skins: Sequence[LearnedSkin | None]
    anchors: Mapping[int, Anchor]
    metres: float = 1.0
    """Of the rig's unit, where the hand told it."""


def saved(knowledge: Knowledge) -> dict[str, Any]:
    """From which `restored` goes on exactly."""
    memory, state = knowledge.memory, knowledge.state
    content: dict[str, Any] = {f.name: getattr(memory, f.name) for f in fields(MultiViewMemory)}
    content["metres"] = knowledge.metres
    content["skins"] = [
        None
        if skin is None
        else {
            "log_ratio": skin.model.log_ratio,
            "dark": (skin.model.dark_log_ratio, skin.model.dark_value),
            "separability": skin.separability,
        }
        for skin in knowledge.skins
    ]
    content["anchors"] = {moment: (a.pose, a.root_reference) for moment, a in knowledge.anchors.items()}
    if state is not None:
        content["mean"], content["covariance"] = state.belief.mean, state.belief.covariance
        content["base"], content["reference"] = state.base, state.reference
        content["start_reference"], content["failures"] = state.start_reference, state.failures
    return {name: value.clone() if isinstance(value, torch.Tensor) else value for name, value in content.items()}


def restored(content: Mapping[str, Any]) -> Knowledge:
    """The inverse of `saved`. Raises KeyError for a dictionary that lacks something."""
    skins = [
        None
        if skin is None
        else LearnedSkin(
            model=SkinModel(
                log_ratio=skin["log_ratio"], dark_log_ratio=float(skin["dark"][0]), dark_value=int(skin["dark"][1])
            ),
            separability=skin["separability"],
        )
        for skin in content["skins"]
    ]
    state = None
    if "mean" in content:
        state = TrackerState(
            belief=Gaussian(content["mean"], content["covariance"]),
            base=content["base"],
            reference=content["reference"],
            start_reference=content["start_reference"],
            failures=content["failures"],
        )
    return Knowledge(
        state=state,
        memory=MultiViewMemory(**{f.name: content[f.name] for f in fields(MultiViewMemory)}),
        skins=skins,
        anchors={
            moment: Anchor(pose=pose, root_reference=reference)
            for moment, (pose, reference) in content["anchors"].items()
        },
        metres=content["metres"],
    )
