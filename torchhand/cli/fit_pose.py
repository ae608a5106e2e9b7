"""Fit the hand to single pictures: any posture, every picture by itself, with detected keypoints or without."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tqdm import tqdm
from tyro.conf import Positional, arg

from torchhand.cli.command import DONE, STOPPED_BY_USER, OnDevice, command, parse, threads, workers_of
from torchhand.devices import device_named
from torchhand.files import Track
from torchhand.files.pictures import MAX_MEGAPIXELS, pixel_limit
from torchhand.files.results import POSES_NAME
from torchhand.runs import keypoints_of, known_hand
from torchhand.runs.pictures import PicturesRequest, fit_pictures
from torchhand.track.single import SinglePoseSettings


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Fit the hand to single pictures: any posture, every picture by itself, with detected keypoints or without.

    DIR gets poses.npz (the fields of track.npz, and for every picture its name, side, proportions and intrinsics),
    poses.jsonl, and overlays/, a picture of each. Pictures that show no hand are refused, each with the reason.
    NAME_mask.png beside a picture NAME is its silhouette, which --masks uses.

    Example:
        torchhand fit_pose photographs/ --out out/poses --keypoints photographs/mediapipe.npz
    """

    input: Annotated[Positional[Path], arg(metavar="PICTURE|FOLDER")]
    """Picture, or folder of pictures of any sizes."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for the results."""
    keypoints: Annotated[str | None, arg(metavar="mediapipe|FILE")] = None
    """Detected keypoints. mediapipe: MediaPipe looks at every picture (pip install torchhand[mediapipe]). FILE: what a
    detector found in these pictures, in a file that fit_keypoints reads, with points in the picture (and in space, such
    as MediaPipe's world landmarks); rows belong to pictures by name where the file has names (`image`), else by
    order."""
    hand_model: Annotated[Path | None, arg(metavar="FILE")] = None
    """hand_landmarker.task for a MediaPipe that carries no models of its own (newer than 0.10.21)."""
    hand: Annotated[Path | None, arg(metavar="FILE")] = None
    """Known shape of the hand (hand.json); else every picture's proportions are fitted."""
    side: Literal["left", "right"] | None = None
    """Which hand; that of --hand, that which the detector names, or right."""
    camera: Annotated[Path | None, arg(metavar="FILE")] = None
    """Calibrated camera (cameras.json with one entry), or an npz with intrinsics K (pictures, 3, 3) and the names
    (`image`); without it a field of view is assumed."""
    masks: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Silhouettes of hand and forearm, bright inside: NAME_mask.png or NAME.png for each picture NAME."""
    resume: bool = False
    """Go on with an interrupted run."""
    overwrite: bool = False
    """Replace an older result in DIR."""
    overlays: bool = True
    """Draw overlays/."""
    threads: int = 1
    """Threads of the fit; its tensors are small, and more than one is slower."""
    workers: Annotated[int | None, arg(metavar="N")] = None
    """Pictures of a folder that are fitted side by side, in copies of this program (on Linux): as many as there are
    cores if not given. The results are the same."""
    max_megapixels: float = MAX_MEGAPIXELS
    """Largest pictures that are read; what is larger by its header is refused before it is decoded."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Fit all pictures."""
    arguments = parse(Arguments, argv, name="fit_pose")
    hand = None if arguments.hand is None else known_hand(arguments.hand)
    of_hand = None if hand is None else "left" if hand.side == "left" else "right"
    request = PicturesRequest(
        source=arguments.input,
        settings=SinglePoseSettings(),
        side=arguments.side or of_hand,
        hand=hand,
        camera=arguments.camera,
        **keypoints_of([] if arguments.keypoints is None else [arguments.keypoints], arguments.hand_model),
        masks=arguments.masks,
        resume=arguments.resume,
        overwrite=arguments.overwrite,
        has_overlays=arguments.overlays,
        device=device_named(arguments.device),
    )
    with threads(arguments.threads), pixel_limit(arguments.max_megapixels):
        try:
            workers = workers_of(arguments.workers, arguments.threads)
            poses = fit_pictures(request, arguments.out, _say, workers=workers)
        except KeyboardInterrupt:
            _say(f"stopped by Ctrl-C; what is done stands in {arguments.out}: go on with --resume")
            return STOPPED_BY_USER
    print(_summary(poses))
    print(f"saved {arguments.out / POSES_NAME}")
    return DONE


def _summary(poses: Track) -> str:
    found = poses.status == "tracked"
    pictures, hands = len(poses), int(found.sum())
    text = f"{pictures} picture{'s' * (pictures != 1)}: {hands} hand{'s' * (hands != 1)}, {pictures - hands} refused"
    if found.any():
        overlap = sorted(poses.measures["overlap"][found])[hands // 2]
        text += f"; median overlap with the picture's silhouette {overlap:.2f}"
    return text


def _say(line: str) -> None:
    """One line on stderr, beside a progress bar that may run."""
    tqdm.write(f"torchhand fit_pose: {line}", file=sys.stderr)
