"""The protocol of update rules: how a prediction and a scene become an estimate."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from torchhand.hand import HandPose
from torchhand.track.belief import FollowedHand
from torchhand.track.scene.candidate import Candidate
from torchhand.track.scene.views import Scene


@runtime_checkable
class UpdateRule(Protocol):
    """Estimates a hand from one scene; a value without state of its own.

    All candidates of one rule are evaluated in the same way, so that they can be compared.
    """

    @property
    def overconfidence(self) -> float:
        """Variance of its estimates' errors over the variance that they come with: a filter takes neighbouring
        measurements for independent, which have the errors of the model's surface in common."""
        ...

    def follow(
        self, hand: FollowedHand, predicted: FollowedHand, scene: Scene, shape: Float[Tensor, "shape"]
    ) -> Candidate | None:
        """The hand of the frame before, carried on to this scene; None where nothing can be compared.

        predicted: the same hand at the scene's time.
        """
        ...

    def begin(
        self,
        pose: HandPose,
        covariance: Float[Tensor, "free free"] | None,
        scene: Scene,
        shape: Float[Tensor, "shape"],
    ) -> Candidate | None:
        """A hand that was found at a pose; covariance: of the free parameters, where it is known."""
        ...
