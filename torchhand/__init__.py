"""torchhand: the open, anatomical, differentiable hand, and the trackers that fit it to video.

`Hand` makes the hand as a torch module; import everything else by name, for example
`from torchhand.hand import HandPrior`. This file loads nothing before it is used, so that the command line answers at
once.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

    import torchhand.hand

__version__ = "0.1.0"

__all__ = ["Hand", "__version__"]


def Hand(
    shape: "torch.Tensor | None" = None,
    *,
    side: "torchhand.hand.Side" = "right",
    model: str = "generic_hand",
    dtype: "torch.dtype | None" = None,
) -> "torchhand.hand.Hand":
    """The hand of a shipped model, or of a model folder given by path, as a torch module: `Hand(shape)(pose)`.

    shape: parameters of the model's shape space, (52,) or (*batch, 52) for the generic hand; a tensor, an nn.Parameter
        to learn, or None for the default proportions. side: "right" or "left". dtype: float32 if not given and not the
        shape's. See `torchhand.hand.Hand`.

    Raises InputError for an unknown model, ValueError for a shape that is not finite or outside its bounds.
    """
    from torchhand.files import load_hand_model

    return load_hand_model(model).hand(shape, side=side, dtype=dtype)
