"""What postures and proportions are likely."""

from torchhand.hand.prior.components import DigitAngles, PostureComponent, posture_component
from torchhand.hand.prior.mixture import PostureMixture
from torchhand.hand.prior.postures import COMPONENTS
from torchhand.hand.prior.prior import HandPrior, HandPriorSettings

__all__ = [
    "COMPONENTS",
    "DigitAngles",
    "HandPrior",
    "HandPriorSettings",
    "PostureComponent",
    "PostureMixture",
    "posture_component",
]
