"""What a picture says for a hand that was registered in it, against another hand and against none.

The model of evidence.json decides, with the command that fitted it (`torchhand measure_status --photographs`), and how
often it is wrong on pictures that it was not fitted to.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.devices import kept, read_back
from torchhand.fit.contour import hand_length_px
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, HandPose
from torchhand.image import disc_kernel, erode, mean_skin_likeness
from torchhand.track.quality import LogisticModel
from torchhand.track.scene import Scene, seen_posture, seen_presence
from torchhand.track.single.registration import Registered
from torchhand.view import HandProjector

EVIDENCE = ("overlap", "edges", "presence", "direction", "sureness", "outline", "skin", "support")
"""Columns of the evidence for a registered hand; all are greater for a hand.

overlap, edges: log-odds of the intersection over union with the silhouette, and of the share of its contour that is
explained. presence: log odds of a hand, as one network sees it. direction: logarithm of how far the hypotheses of the
other network bear out the hand's direction. sureness: minus the logarithm of the error that this network expects.
outline: log-odds of the mean rank of the picture's edges under the drawn outline among those of all its pixels, 0 by
chance. skin: mean likeness of what the hand covers to human skin. support: how far the hands that were registered on
other silhouettes of the picture are the same, 0 to 1, mean of the three nearest.
"""

SILENCE = math.log(2 / 541) - math.log(884 / 892)
"""Log odds by which a hand is less likely where a detector finds none: MediaPipe is silent on 1 of 539 photographs of
hands (any_posture_stills, joints3d_stills, open_hand_stills), and on 883 of 890 pictures without one (`python
scripts/empty_pictures.py`); one is added to all four counts."""
_LEAST = 0.02  # shares are told apart from 0 and 1 so far
_SAME = 0.15  # hand lengths: distance of the keypoints of two hands at which they support one another to 1 / e
_SUPPORTING = 3  # hands on other silhouettes
_NEAR = np.ones((3, 3), np.uint8)  # pixels in which an edge is looked for
_TABLE = Path(__file__).with_name("evidence.json")


@dataclass(frozen=True, kw_only=True)
class HandOdds:
    """The logistic model of the evidence."""

    model: LogisticModel
    usual: Float[Tensor, "evidence"]
    """Median evidence of right hands. What is better counts as this, for it is no sign of another thing; as does what
    cannot be told."""
    reached: Mapping[float, float] = field(default_factory=dict[float, float])
    """Log odds that some shares of the fitted pictures without a hand reach, where they are known."""

    @property
    def most(self) -> float:
        """The most that any evidence gives."""
        return self(torch.full_like(self.usual, torch.inf))

    def __call__(self, evidence: Float[Tensor, "evidence"]) -> float:
        """Logarithm of the odds that a hand is the right one."""
        return self.model.bias + float(counted(evidence, self.usual) @ self.model.weights)


def counted(
    evidence: Float[Tensor, "*batch evidence"], usual: Float[Tensor, "evidence"]
) -> Float[Tensor, "*batch evidence"]:
    """Evidence as the model takes it: at most the usual one of right hands, and this where it cannot be told."""
    return torch.minimum(torch.where(evidence.isfinite(), evidence, usual), usual)


@kept(1)
def hand_odds() -> HandOdds:
    """The model of evidence.json."""
    table = json.loads(_TABLE.read_text(encoding="utf-8"))
    return HandOdds(
        model=LogisticModel.of_json(table, EVIDENCE),
        usual=torch.tensor([table["usual"][name] for name in EVIDENCE], dtype=torch.float64),
        reached={float(rate): told["log_odds"] for rate, told in table["fitted"].items()},
    )


def evidence_for(
    hand: HandPose,
    shape: Float[Tensor, "shape"],
    scene: Scene,
    camera: Camera,
    kinematics: HandKinematics,
    *,
    overlap: float,
    edges: float,
) -> Float[Tensor, "evidence"]:
    """In the order of EVIDENCE, support left open; NaN where the view or the camera cannot tell it.

    hand: (), in the camera's frame. scene: one view with its silhouette. overlap: with that, forearm cut at the wrist.
    edges: share of the hand's contour that is explained.
    """
    image, pose = scene.views[0].image, hand.normalized()
    told = dict.fromkeys(EVIDENCE, math.nan)
    told |= {"overlap": _log_odds(overlap), "edges": _log_odds(edges)}
    if camera.kind == "pinhole":
        presence = seen_presence(scene, camera, kinematics, pose, shape)
        seen = seen_posture(scene, camera, kinematics, pose, shape)
        if presence is not None and seen is not None:
            told["presence"] = presence
            told["direction"] = math.log(float(seen.direction_agreement(pose.rotation)) + _LEAST)
            told["sureness"] = -math.log(float(seen.spread))
    if image is not None:
        model = HandProjector(kinematics, camera, shape).silhouette(hand.dofs, hand.reference)
        told |= {"outline": _log_odds(outline_rank(image, model)), "skin": mean_skin_likeness(image, model)}
    return torch.tensor(list(told.values()), dtype=torch.float64)


def supported(
    evidence: Float[Tensor, "evidence"],
    hand: Registered,
    others: Sequence[Registered],
    camera: Camera,
    kinematics: HandKinematics,
) -> Float[Tensor, "evidence"]:
    """The evidence with the support of the hands on other silhouettes of the picture; open where there are none."""
    length_px = hand_length_px(camera, kinematics, hand.pose.dofs, hand.shape)
    own, *rest = (
        camera.project(HandProjector(kinematics, camera, one.shape).frames(one.pose.dofs, one.pose.reference).keypoints)
        for one in (hand, *others)
    )
    away = (float((own - one).norm(dim=-1).mean()) for one in rest)
    near = sorted((math.exp(-px / (_SAME * length_px)) for px in away), reverse=True)[:_SUPPORTING]
    result = evidence.clone()
    result[EVIDENCE.index("support")] = sum(near) / len(near) if near else math.nan
    return result


def outline_rank(image: UInt8[Tensor, "height width 3"], model: Bool[Tensor, "height width"]) -> float:
    """Mean rank, 0 to 1, of the picture's colour edges within a pixel of a silhouette's outline among those of all of
    its pixels: about one half where the outline is laid anywhere."""
    lab = cv2.cvtColor(cv2.GaussianBlur(image.cpu().contiguous().numpy(), (0, 0), 1.0), cv2.COLOR_RGB2LAB)
    across, down = (cv2.Sobel(lab, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    edges = cv2.dilate(np.sqrt((across**2 + down**2).sum(-1)), _NEAR)
    rank = edges.ravel().argsort(kind="stable").argsort(kind="stable").reshape(edges.shape) / max(1, edges.size - 1)
    rim = read_back(model & ~erode(model, disc_kernel(1)))
    rim[0] = rim[-1] = rim[:, 0] = rim[:, -1] = False  # the picture's end is no outline
    return float(rank[rim].mean()) if rim.any() else 0.5


def _log_odds(share: float) -> float:
    inside = min(max(share, _LEAST), 1 - _LEAST)
    return math.log(inside / (1 - inside))
