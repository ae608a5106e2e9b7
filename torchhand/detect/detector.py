"""The keypoints of one hand in pictures that follow one another."""

from pathlib import Path

from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.detect.hands import chosen_hand, hand_keypoints
from torchhand.detect.landmarks import Landmarker
from torchhand.detect.mediapipe import MediaPipe
from torchhand.files import HandDetection
from torchhand.hand import Side
from torchhand.track import HandKeypoints


class HandDetector:
    """Detects one hand's keypoints, picture after picture: `View(image=image, keypoints=detector(image))`.

    It looks for one hand, and for two from the first picture on in which the only hand that it found is of the other
    side; two take twice as long. What it finds depends on the pictures before: a hand is looked for near where it was,
    which finds fists that a search of a single picture misses.
    """

    def __init__(
        self, *, side: Side = "right", hand_model: Path | None = None, landmarker: Landmarker | None = None
    ) -> None:
        """side: of the hand that is followed. hand_model: MediaPipe's hand_landmarker.task; wheels up to 0.10.21 have
        models of their own. landmarker: another program in MediaPipe's place.

        Raises InputError where MediaPipe is not installed or cannot read the model. Nothing is ever downloaded.
        """
        self.side: Side = side
        self._landmarker = MediaPipe(hand_model) if landmarker is None else landmarker
        self.name = self._landmarker.name
        """Program, version and model: the same name gives the same numbers."""
        self.other_hands = 0
        """Pictures in which all hands were of the other side."""
        self._hands = 1
        self._landmarks = self._landmarker.open(self._hands)
        self._last: Tensor | None = None

    def __call__(self, image: UInt8[Tensor, "height width 3"]) -> HandKeypoints | None:
        """What a tracker takes of the hand in the next picture (RGB), the one nearest to the last; None without one."""
        found = hand_keypoints(self.detect(image, self._last))
        self._last = self._last if found is None else found.points_px
        return found

    def detect(
        self, image: UInt8[Tensor, "height width 3"], followed_px: Float[Tensor, "21 2"] | None = None
    ) -> HandDetection | None:
        """The hand in the next picture that lies nearest to a followed one; without one, the detector's best."""
        hands = self._landmarks.detect(image)
        if hands and all(hand.label not in (self.side, None) for hand in hands) and self._hands == 1:
            self.close()
            self._hands = 2
            self._landmarks = self._landmarker.open(self._hands)
            hands = self._landmarks.detect(image)
        chosen = chosen_hand(hands, self.side, followed_px)
        self.other_hands += bool(hands) and chosen is None
        return chosen

    def close(self) -> None:
        """Let go of the program's memory."""
        self._landmarks.close()
