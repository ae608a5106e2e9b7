"""Play with a hand, or look at a result over time, on a page in the browser."""

import contextlib
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, cast

import torch
from tyro.conf import Positional, arg

from torchhand.cli.command import DONE, command, parse, threads
from torchhand.files import load_hand_model
from torchhand.files.disk import expanded
from torchhand.hand import Side
from torchhand.report import load_result
from torchhand.runs import known_hand
from torchhand.viewer import EditedHand, HandPage, ResultPage, ViewerServer, address_of, opened_server


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Play with a hand, or look at a result over time, on a page in the browser.

    The page of a hand has a slider for each of the 36 degrees of freedom, within its limits, and for each of the 52
    proportions; named postures, the signs of the manual alphabet, hands drawn from the prior; what limits, couplings
    and overlap say of it; and the pose as a file. That of a result has a slider over its frames. It is served to this
    machine alone, until Ctrl-C. Needs viser: pip install torchhand[view].

    Examples:
        torchhand view
        torchhand view out/clip/hand.json
        torchhand view out/clip
    """

    what: Annotated[Positional[Path | None], arg(metavar="HAND|RESULT")] = None
    """A hand's proportions (hand.json), or the result folder of track, track_multiview or fit_keypoints; the average
    hand if not given."""
    side: Literal["left", "right"] = "right"
    """Which hand, where the file does not tell."""
    port: int = 8080
    """Port of 127.0.0.1 that the page is served at; the next free one where it is taken."""
    seed: int = 0
    """Seed of the hands that are drawn from the prior."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Serve one page until Ctrl-C."""
    arguments = parse(Arguments, argv, name="view")
    with threads(1), opened_server(arguments.port, title="torchhand") as server:
        page = page_of(arguments, server)
        print(f"open {address_of(server)} in a browser; Ctrl-C ends it", flush=True)
        with contextlib.suppress(KeyboardInterrupt):
            if isinstance(page, ResultPage):
                page.run()
            threading.Event().wait()
    return DONE


def page_of(arguments: Arguments, server: ViewerServer) -> HandPage | ResultPage:
    """The page of what was asked for. Raises InputError where it cannot be read."""
    model = load_hand_model()
    if arguments.what is None:
        return HandPage(server, EditedHand(model, side=arguments.side, seed=arguments.seed))
    path = expanded(arguments.what)
    if path.suffix == ".json" and path.name != "header.json":
        hand = known_hand(path)
        shape = torch.tensor(list(hand.values.values()), dtype=torch.float64)
        return HandPage(server, EditedHand(model, side=cast(Side, hand.side), shape=shape, seed=arguments.seed))
    result = load_result(path)
    return ResultPage(server, result.track, result.model, side=result.side, shape=result.shape, fps=result.fps)
