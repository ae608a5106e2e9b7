"""Train the network that proposes hands in any posture for a silhouette, on simulated hands alone; measure it."""

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import torch
from tqdm import tqdm
from tyro.conf import arg

import torchhand
from torchhand.cli.command import DONE, STOPPED_BY_USER, OnDevice, command, parse, threads
from torchhand.devices import device_named
from torchhand.errors import InputError
from torchhand.files import (
    load_hand_model,
    load_proposal_network,
    save_presence_network,
    save_proposal_network,
)
from torchhand.files.disk import explained_errors
from torchhand.learn.presence import (
    PresenceTraining,
    new_presence_network,
    presence_figures,
    thing_pool,
    train_presence,
)
from torchhand.learn.proposals import (
    ProposalFigures,
    ProposalTraining,
    figures_table,
    hand_pool,
    measured_on_pictures,
    measured_on_views,
    new_network,
    posed_pictures,
    train_proposals,
)
from torchhand.propose import ProposalNetwork

Training = TypeVar("Training", ProposalTraining, PresenceTraining)

REPORTS = 30  # along the training
_VIEWS = 7  # seed of the views of held-out hands


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Train the network that proposes hands in any posture for a silhouette, on simulated hands alone; measure it.

    Hands of the prior, of the signs and of mixtures of them are rendered from all sides, with forearms, ragged masks,
    random lights and picture edges; the network learns several weighted hypotheses for each view. FILE gets it, and is
    written anew at every report. Without --out the network of --network is only measured. --presence trains another
    network, which tells hands from heads, limbs, furniture, lumps, boxes and spots. The same arguments give the same
    networks on the same machine.

    Example:
        torchhand learn_proposals --out network.npz --evaluate data/synthetic/free
    """

    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """File for the network, .npz."""
    presence: Annotated[Path | None, arg(metavar="FILE")] = None
    """File for the network that tells hands from other things, .npz."""
    network: Annotated[Path | None, arg(metavar="FILE")] = None
    """Network to measure, without --out; the shipped one if not given."""
    evaluate: Annotated[tuple[Path, ...], arg(metavar="FOLDER")] = ()
    """Folders of pictures with true keypoints: sequences with cameras.json and frames/, or stills with truth.npz and
    images/."""
    side: Literal["left", "right"] = "right"
    """Which hand these pictures show."""
    every: int = 1
    """Take every so many of their pictures."""
    steps: int | None = None
    """Steps of training; as many as took the shipped network if not given."""
    hands: int | None = None
    """Simulated hands to train on."""
    seed: int | None = None
    """Seed of everything that is random; 0 if not given."""
    threads: int = 1
    """Threads of the training."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Train where a file is given, then measure."""
    arguments = parse(Arguments, argv, name="learn_proposals")
    device_named(arguments.device)  # a mistake is told before the work
    if arguments.every < 1:
        raise InputError(f"--every: expected 1 or more, got {arguments.every}")
    pictures = [(folder, posed_pictures(folder, every=arguments.every)) for folder in arguments.evaluate]
    model = load_hand_model()
    with threads(arguments.threads):
        if arguments.out is not None:
            if arguments.network is not None:
                raise InputError("expected at most one of --out and --network, got both")
            try:
                network = _trained(arguments, arguments.out)
            except KeyboardInterrupt:
                print(f"torchhand learn_proposals: stopped by Ctrl-C; {arguments.out} has the last report's network")
                return STOPPED_BY_USER
        else:
            network = load_proposal_network(arguments.network)
            if not pictures and arguments.presence is None:
                raise InputError("expected --out or --presence FILE to train, or --evaluate FOLDER to measure")
        if arguments.presence is not None:
            _presence(arguments, arguments.presence)
        kinematics = model.kinematics(arguments.side, dtype=torch.float64)
        rows: list[tuple[str, ProposalFigures]] = []
        for folder, some in pictures:
            shown = tqdm(some, desc=folder.name, unit="picture", leave=False, disable=not sys.stderr.isatty())
            proposed, registered = measured_on_pictures(network, iter(shown), kinematics)
            rows += [(f"{folder.name}, proposed", proposed), (f"{folder.name}, registered", registered)]
    if rows:
        print(f"errors of the likeliest / of the best of {network.sizes['hypotheses']}, means")
        print(figures_table(rows))
    return DONE


def _trained(arguments: Arguments, out: Path) -> ProposalNetwork:
    """Render, train and measure on held-out hands."""
    settings, model = _settings(arguments, ProposalTraining()), load_hand_model()
    _make_folder(out)
    hidden = not sys.stderr.isatty()
    with tqdm(total=settings.hands + settings.held_out, desc="rendering", unit="hand", disable=hidden) as bar:
        generators = (torch.Generator().manual_seed(settings.seed + number) for number in range(2))
        counts = (settings.hands, settings.held_out)
        hands, held_out = (hand_pool(model, *one, bar.update) for one in zip(counts, generators, strict=True))
    network = new_network(settings, model).to(device_named(arguments.device))
    provenance = {"torchhand": torchhand.__version__, "command": "learn_proposals", "settings": asdict(settings)}
    with tqdm(total=settings.steps, desc="learning", unit="step", disable=hidden) as bar:
        for reached in train_proposals(network, hands, settings, model, report_every=max(1, settings.steps // REPORTS)):
            figures = measured_on_views(network, held_out, model, _VIEWS)
            save_proposal_network(out, network, {**provenance, "step": reached.step})
            bar.update(reached.step - bar.n)
            print(
                f"step {reached.step}: loss {reached.loss:.2f}, keypoints {figures.errors.top['aligned_mm']:.1f} mm"
                f" (best {figures.errors.best['aligned_mm']:.1f}), palm {figures.errors.top['rotation_deg']:.0f}°"
                f" (best {figures.errors.best['rotation_deg']:.0f}°), likeliest right in {figures.kept:.0%}, promised"
                f" {figures.promised:.0%}",
                flush=True,
            )
    print(figures_table([("held-out simulated hands, one view", figures.errors)]))
    print(f"saved {out}")
    return load_proposal_network(out)


def _presence(arguments: Arguments, out: Path) -> None:
    """Render hands and things, train on most of them and measure on the rest."""
    settings, model = _settings(arguments, PresenceTraining()), load_hand_model()
    _make_folder(out)
    hidden, count = not sys.stderr.isatty(), settings.hands + settings.held_out
    with tqdm(total=2 * count, desc="rendering", unit="picture", disable=hidden) as bar:
        generators = [torch.Generator().manual_seed(settings.seed + number) for number in (2, 3)]
        hands = hand_pool(model, count, generators[0], bar.update)
        things = thing_pool(count, generators[1], bar.update)
    network, own = new_presence_network(settings).to(device_named(arguments.device)), slice(0, settings.hands)
    provenance = {"torchhand": torchhand.__version__, "command": "learn_proposals", "settings": asdict(settings)}
    with tqdm(total=settings.steps, desc="learning", unit="step", disable=hidden) as bar:
        reports = train_presence(
            network, hands.rows(own), things.rows(own), settings, report_every=max(1, settings.steps // REPORTS)
        )
        for step, loss in reports:
            save_presence_network(out, network, {**provenance, "step": step})
            bar.update(step - bar.n)
            print(f"step {step}: loss {loss:.3f}", flush=True)
    rest, generator = slice(settings.hands, None), torch.Generator().manual_seed(_VIEWS)
    told = presence_figures(network, hands.rows(rest), things.rows(rest), generator)
    for threshold, (hands_missed, things_taken) in told.items():
        print(f"above {threshold:g}: {1 - hands_missed:.1%} of held-out hands, {things_taken:.1%} of held-out things")
    print(f"saved {out}")


def _make_folder(out: Path) -> None:
    with explained_errors(out):
        out.parent.mkdir(parents=True, exist_ok=True)


def _settings(arguments: Arguments, settings: Training) -> Training:
    names = ("steps", "hands", "seed")
    given = {name: value for name in names if (value := getattr(arguments, name)) is not None}
    try:
        return replace(settings, **given)
    except ValueError as error:
        raise InputError(f"--{error}") from error
