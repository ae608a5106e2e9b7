"""Spell a text in the manual alphabet: a video, or the moving hand in any export format."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import torch
from tyro.conf import OmitArgPrefixes, Positional, arg

from torchhand.cli.command import DONE, command, parse, threads
from torchhand.draw.spelling import paint_spelling
from torchhand.errors import InputError
from torchhand.export import FORMATS, ExportOptions, FormatName, MotionClip, format_of
from torchhand.files import load_hand, load_hand_model
from torchhand.files.disk import expanded
from torchhand.hand import HandModel, Side
from torchhand.signs import SpellingSettings, check_text, load_signs, sign_joints, spell

VIDEO = ".mp4"
_DISTANCE = 0.5  # metres of the hand before the camera, in exports
_MAX_SIDE = 4096


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Spell a text in the manual alphabet of American Sign Language: letters A to Z and digits 0 to 9.

    The ending of --to says what is written: .mp4, or a format of `torchhand export` such as .glb, .bvh, .bap, .thp.
    Spaces are pauses; J and Z are traced.

    Example:
        torchhand animate "HELLO" --to hello.mp4
    """

    text: Annotated[Positional[str], arg(metavar="TEXT")]
    """Text to spell."""
    to: Annotated[Path, arg(metavar="FILE")]
    """File to write."""
    format: FormatName | None = None
    """Export format, where the ending leaves it open."""
    hand: Annotated[Path | None, arg(metavar="FILE")] = None
    """Hand of these proportions, a hand.json of `torchhand fit_hand`; the average hand without it."""
    side: Literal["left", "right"] | None = None
    """Which hand; that of --hand, else the right one."""
    fps: float = 25.0
    """Frames per second."""
    seconds: float = 1.0
    """Time from one sign to the next; ways around collisions and traced letters take longer."""
    size: str = "640x480"
    """Size of the video, WIDTHxHEIGHT in px."""
    options: OmitArgPrefixes[ExportOptions] = ExportOptions()  # noqa: RUF009 - frozen
    """Options that only some export formats ask."""
    overwrite: bool = False
    """Replace a file that exists."""

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        words = self.size.lower().split("x")
        if len(words) == 2 and all(word.isascii() and word.isdecimal() for word in words):
            width, height = map(int, words)
            if all(64 <= side <= _MAX_SIDE for side in (width, height)):
                return width, height
        raise InputError(f"--size: expected WIDTHxHEIGHT, each 64 to {_MAX_SIDE} px, got {self.size!r}")


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Spell, then draw or export."""
    arguments = parse(Arguments, argv, name="animate")
    text, size = check_text(arguments.text), arguments.size_px
    try:
        settings = SpellingSettings(fps=arguments.fps, seconds_per_sign=arguments.seconds)
    except ValueError as error:
        raise InputError(f"--{str(error).replace('seconds_per_sign', 'seconds')}") from error
    target = expanded(arguments.to)
    kind = None if _is_video(arguments, target) else format_of(target, arguments.format)
    if target.is_dir():
        raise InputError(f"--to: expected a file, got the folder {target}")
    if not target.absolute().parent.is_dir():
        raise InputError(f"--to: expected a file in an existing folder, got {target}")
    model = load_hand_model()
    side, shape = _hand_of(arguments, model)
    with threads(1):
        joints = sign_joints(model, "".join(dict.fromkeys(text.replace(" ", ""))), load_signs(), shape)
        spelling = spell(text, model, joints, side=side, shape=shape, settings=settings)
        poses = spelling.poses.clone()
        poses[:, 2] += _DISTANCE
        clip = MotionClip(
            model=model,
            side=side,
            shape=model.shape_space.default.double() if shape is None else shape,
            poses=poses,
            fps=settings.fps,
            name=text,
            up="-y",
        )
        for file in [target] if kind is None else kind.files(clip, target):
            if file.exists() and not arguments.overwrite:
                raise InputError(f"{file}: exists already; give another name, or --overwrite")
        begin = time.perf_counter()
        if kind is None:
            notes = []
            paint_spelling(target, spelling, clip, size)
            spent = time.perf_counter() - begin
            notes.append(f"drawn in {spent:.1f} s, {len(poses) / settings.fps / spent:.1f} times as fast as it plays")
        else:
            notes = kind.write(clip, target, arguments.options)
    deepest = 1e3 * max(0.0, float(spelling.overlap.max()))
    print(
        f"{text}: {side} hand, {len(poses)} frames at {settings.fps:g} per second, parts overlap by {deepest:.2f} mm at"
        f" most; saved {target}"
    )
    for note in notes:
        print(f"note: {note}")
    return DONE


def _is_video(arguments: Arguments, target: Path) -> bool:
    if target.suffix.lower() != VIDEO:
        known = [suffix for entry in FORMATS for suffix in entry.suffixes]
        if not target.name.lower().endswith(tuple(known)):
            allowed = ", ".join(entry.suffixes[0] for entry in FORMATS)
            raise InputError(
                f"{target}: expected a file name with a known ending ({VIDEO}, {allowed}), got {target.suffix!r}"
            )
        return False
    if arguments.format is not None:
        raise InputError(f"--format: expected none for {VIDEO}, got {arguments.format}")
    return True


def _hand_of(arguments: Arguments, model: HandModel) -> tuple[Side, torch.Tensor | None]:
    if arguments.hand is None:
        return arguments.side or "right", None
    space = model.shape_space
    fitted = load_hand(expanded(arguments.hand), space.names)
    shape = torch.tensor([fitted.values[name] for name in space.names], dtype=torch.float64)
    try:
        space.check(shape)
    except ValueError as error:
        raise InputError(f"{arguments.hand}: {error}") from error
    own: Side = "left" if fitted.side == "left" else "right"
    return arguments.side or own, shape
