"""Cutting a piece out of a picture by its colours and the picture's edges together."""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

_ROUNDS = 3  # of learning colours and cutting
_CORE = 0.12  # depth in a piece, over the square root of its area, from which on it is believed
_SEED = 0  # of the first colours


def graph_cut(
    image: UInt8[Tensor, "height width 3"],
    likely: Bool[Tensor, "height width"],
    *,
    inside: Bool[Tensor, "height width"],
    outside: Bool[Tensor, "height width"],
) -> Bool[Tensor, "height width"]:
    """The part of a picture whose colours are those of the inside and whose outline runs along edges.

    GrabCut (Rother et al. 2004): mixtures of Gaussians of both sides' colours are learned and the cut of least cost is
    taken in turn, from what is `likely`; `inside` and `outside` stay as they are. Nothing is cut where one side is
    empty: `likely` is returned. The same picture gives the same cut.
    """
    labels = np.where(likely.numpy(), cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[outside.numpy()], labels[inside.numpy()] = cv2.GC_BGD, cv2.GC_FGD
    is_front = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
    if not is_front.any() or is_front.all():
        return likely.clone()
    cv2.setRNGSeed(_SEED)
    back, front = np.zeros((1, 65)), np.zeros((1, 65))
    pixels = cv2.cvtColor(image.cpu().contiguous().numpy(), cv2.COLOR_RGB2BGR)
    cv2.grabCut(pixels, labels, None, back, front, _ROUNDS, cv2.GC_INIT_WITH_MASK)  # type: ignore[call-overload]
    return torch.from_numpy((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))


def cut_along_edges(
    image: UInt8[Tensor, "height width 3"], piece: Bool[Tensor, "height width"]
) -> Bool[Tensor, "height width"]:
    """A piece as its colours and the picture's edges have it: its thick parts are believed, the rest is not."""
    depth = cv2.distanceTransform(piece.numpy().astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_3)
    core = torch.from_numpy(depth > _CORE * float(piece.sum()) ** 0.5)
    return graph_cut(image, piece, inside=core, outside=torch.zeros_like(piece))
