"""Write a result as one page that opens from disk (report.html), or two results beside each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from torchhand.cli.command import DONE, command, parse, threads
from torchhand.errors import InputError
from torchhand.files.disk import expanded
from torchhand.files.results import COMPARISON_NAME, REPORT_NAME
from torchhand.report import doubts, load_result, write_report


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Write a result as one page that opens from disk (report.html), or two results beside each other.

    The page holds the overlay video, the hand in 3D in step with it, every joint angle over time with its band and
    limits, the status of every frame, the range of motion, and what was assumed. It needs no network. Of two results of
    one recording it shows both hands, both curves, and how far they differ; the video is the first one's.

    Examples:
        torchhand report out/clip
        torchhand report out/clip out/clip_causal --out comparison.html
    """

    results: Annotated[Positional[tuple[Path, ...]], arg(metavar="RESULT")]
    """One result folder or two: of track, track_multiview or fit_keypoints."""
    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """File to write; report.html in the result's folder if not given, comparison.html in the first one's of two."""
    overwrite: bool = False
    """Replace the file of --out where it exists."""

    def __post_init__(self) -> None:
        if not 1 <= len(self.results) <= 2:
            raise ValueError(f"RESULT: expected one result folder or two, got {len(self.results)}")


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Write one page."""
    arguments = parse(Arguments, argv, name="report")
    out = _target(arguments)
    names = [expanded(path).resolve() for path in arguments.results]
    has_same_name = len({path.name for path in names}) < len(names)
    with threads(1):
        results = [
            load_result(path, name="/".join(path.parts[-2:]) if has_same_name and path.is_dir() else None)
            for path in names
        ]
        write_report(out, results)
    doubt = doubts(results)
    if doubt is not None:
        print(f"note: {doubt}")
    print(f"saved {out} ({out.stat().st_size / 1e6:.1f} MB); open it in a browser")
    return DONE


def _target(arguments: Arguments) -> Path:
    """The file to write; one that is not given is replaced, because all that it holds is in the result."""
    if arguments.out is None:
        first = expanded(arguments.results[0])
        folder = first if first.is_dir() else first.parent
        return folder / (REPORT_NAME if len(arguments.results) == 1 else COMPARISON_NAME)
    out = expanded(arguments.out)
    if out.is_dir():
        raise InputError(f"--out: expected a file, got the folder {out}")
    if out.exists() and not arguments.overwrite:
        raise InputError(f"{out}: exists already; give another name, or --overwrite")
    return out
