"""Proposals measured: on single views of hands never seen in training, and on pictures as a tracker would use them."""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import sent_to
from torchhand.fit.proposals import ProposalRegistration
from torchhand.hand import HandKinematics, HandModel
from torchhand.learn.proposals.figures import ProposalFigures, proposal_figures
from torchhand.learn.proposals.observing import seen_hands
from torchhand.learn.proposals.pictures import PosedPicture
from torchhand.learn.proposals.rendering import RenderedHands
from torchhand.learn.proposals.training import generator_of, hypothesis_errors, keypoints_about_palm
from torchhand.propose import ProposalNetwork, propose_hands

_AT_ONCE = 128


@dataclass(frozen=True, kw_only=True)
class ViewFigures:
    """What single views of simulated hands give."""

    errors: ProposalFigures
    promised: float
    """Mean weight of the likeliest hypothesis."""
    kept: float
    """Share of the views where that one is the nearest to the truth: as large as `promised` if weights are honest."""


def measured_on_views(network: ProposalNetwork, hands: RenderedHands, model: HandModel, seed: int) -> ViewFigures:
    """Every hand in one random view."""
    device = network.heads.weight.device
    kinematics = model.kinematics(dtype=torch.float32).to(device)
    own, true, weight, is_nearest = [], [], [], []
    for number, rows in enumerate(torch.arange(len(hands)).split(_AT_ONCE)):
        seen = sent_to(seen_hands(hands.rows(rows), generator_of(seed, -number - 1)), device)
        with torch.no_grad():
            found = network(seen.channels)
        own.append(keypoints_about_palm(kinematics, found.rotation, found.joints))
        true.append(keypoints_about_palm(kinematics, seen.rotation, seen.joints))
        weight.append(found.log_weight.exp())
        is_nearest.append(hypothesis_errors(found, seen, kinematics).argmin(-1) == found.log_weight.argmax(-1))
    weights = torch.cat(weight)
    return ViewFigures(
        errors=proposal_figures(torch.cat(own).cpu(), weights.cpu(), torch.cat(true).cpu()),
        promised=float(weights.amax(-1).mean()),
        kept=float(torch.cat(is_nearest).float().mean()),
    )


def measured_on_pictures(
    network: ProposalNetwork, pictures: Iterable[PosedPicture], kinematics: HandKinematics
) -> tuple[ProposalFigures, ProposalFigures]:
    """Figures of the proposals, and of what registration on the silhouette makes of them; the usual proportions.

    kinematics: float64, of the side that the pictures show.
    """
    registration, shape = ProposalRegistration(kinematics=kinematics), kinematics.default_shape
    begun, weights, ended, costs, truth = [], [], [], [], []
    for picture in pictures:
        hands = propose_hands(network, (picture.silhouette,), kinematics, shape)
        start, weight = hands.pose[0], hands.weight[0]
        begun.append(_keypoints(kinematics, start.dofs, start.reference))
        weights.append(weight)
        truth.append(picture.keypoints)
        if not bool(weight.isfinite().all()):
            ended.append(begun[-1])
            costs.append(weight)
            continue
        found = registration(picture.silhouette, start, shape, weight=weight)
        ended.append(_keypoints(kinematics, found.pose.dofs, found.pose.reference))
        costs.append(found.cost)
    true = torch.stack(truth)
    return (
        proposal_figures(torch.stack(begun), torch.stack(weights), true),
        proposal_figures(torch.stack(ended), -torch.stack(costs), true),
    )


def _keypoints(kinematics: HandKinematics, dofs: Tensor, reference: Tensor) -> Float[Tensor, "k 21 3"]:
    return kinematics(dofs, root_reference=reference).keypoints
