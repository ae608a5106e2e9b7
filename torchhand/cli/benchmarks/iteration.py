"""Measures of `torchhand benchmark` on one iteration of Levenberg and Marquardt for many hands at once."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor, nn
from torch.func import jacfwd, vmap

from torchhand.cli.benchmarks.figures import Figure, Peer, against_peer, peer_module
from torchhand.cli.benchmarks.registration import SPACE, Case
from torchhand.fit import Stage
from torchhand.fit.contour import picture_contours
from torchhand.hand import HandFrames, HandPose
from torchhand.hand.kinematics import place_chain_plainly
from torchhand.image import channel_of
from torchhand.numerics import LevenbergMarquardtSettings, NormalEquations, levenberg_marquardt
from torchhand.view import outline_table
from torchhand.view.contours import PointToLineTerms
from torchhand.view.outlines import outline_points

HYPOTHESES, PEER_HYPOTHESES = 64, 2
TABLE = outline_table(22, 16, without=("palm_wrist",))
"""About a thousand points."""
ROUNDS = 9
"""Repeats unless --repeats says otherwise."""


class Iteration:
    """One iteration of Levenberg and Marquardt for hands whose outlines shall lie on a distance map, every point a
    residual; by the closed form and by derivatives of the same residuals."""

    def __init__(self, count: int) -> None:
        self.case = Case.of(count, deg=8.0, mm=6.0)
        self.case = replace(self.case, references=self.case.reference.expand(count, 3, 3).contiguous())
        self.contours, self.start = self.case.contours(TABLE), SPACE.free(self.case.pose)
        self.field = picture_contours(self.case.mask, (Stage(gross_m=0.00374),)).field(1)
        self.visible = self.contours.visible(self.case.starts, probe_distance_px=3.0)
        self.channel = channel_of(self.visible.normals, self.field.channels)
        self.settings = LevenbergMarquardtSettings(iterations=1, damping=1e-2, cost_tolerance=0.0, step_tolerance=0.0)

    def residual(self, free: Tensor, channel: Tensor) -> Tensor:
        """The residual of one hand."""
        points = self.case.projector.outline_px(SPACE.dof(free)[None], self.case.reference, TABLE)[0]
        return self.field.sample(points, channel)[0]

    def residual_plainly(self, free: Tensor, channel: Tensor) -> Tensor:
        """The residual in operations that every automatic derivative knows."""
        projector, constants = self.case.projector, self.case.projector.kinematics.chain.constants
        pose, reference = SPACE.dof(free)[:, None], self.case.reference[..., None]
        placed = place_chain_plainly(pose, reference, projector.kinematics.default_levers, constants)
        rotation, position, keypoints = (x.squeeze(-1) for x in placed)
        frames = HandFrames(rotation=rotation, position=position, keypoints=keypoints)
        points = outline_points(projector.primitives_cam(frames), TABLE)
        pixels = projector.camera.pixels_from_plane(projector.camera.plane_from_cam(points))
        return self.field.sample(pixels, channel)[0]

    def in_closed_form(self, free: Tensor) -> NormalEquations:
        """As registration computes it."""
        motion = self.contours.motion(HandPose.of(SPACE.dof(free), self.case.references), self.visible)
        distance, slope = self.field.sample_columns(motion.columns_px, self.channel)
        residual = distance[:, None]
        matrix, gradient = motion.equations(
            PointToLineTerms(direction=slope[:, None], curvature=torch.ones_like(residual), gradient=residual)
        )
        return NormalEquations(
            matrix=SPACE.basis.T @ matrix @ SPACE.basis,
            gradient=gradient @ SPACE.basis,
            cost=0.5 * distance.square().sum(-1),
        )

    def by_forward_derivatives(self, free: Tensor) -> tuple[Tensor, Tensor]:
        def twice(free: Tensor, channel: Tensor) -> tuple[Tensor, Tensor]:
            residual = self.residual(free, channel)
            return residual, residual

        jacobian, residual = vmap(jacfwd(twice, has_aux=True))(free, self.channel)
        return residual, jacobian

    def run(self, linearise: Callable[..., Any], first: NormalEquations) -> Tensor:
        """Propose a step, evaluate it with its derivatives, and accept or reject it."""
        with torch.inference_mode(linearise == self.in_closed_form):
            return levenberg_marquardt(linearise, self.start, settings=self.settings, first=first).values


def lm_iteration_jacfwd(name: str, repeats: int | None) -> Figure:
    """Against the same iteration with derivatives by vmap(jacfwd)."""
    work = Iteration(HYPOTHESES)
    first = work.in_closed_form(work.start)
    candidates: dict[str, Callable[[], object]] = {
        "ours": lambda: work.run(work.in_closed_form, first),
        "peer": lambda: work.run(work.by_forward_derivatives, first),
    }
    note = f"{HYPOTHESES} hypotheses, {SPACE.size} parameters, {TABLE.size} residuals; both with our solver"
    rounds = repeats or ROUNDS
    return against_peer(name, rounds, Peer("vmap(jacfwd)"), candidates, must=1.3, aim=2.0, note=note)


def lm_iteration_pypose(name: str, repeats: int | None) -> Figure:
    """Against a step of pypose's Levenberg-Marquardt on the same residuals, hypothesis by hypothesis.

    It has no problems of their own: a batch is one problem with all parameters, whose Jacobian would be dense, here
    64,000 x 1,664. A few hypotheses are measured, and ratios are per hypothesis.
    """
    work = Iteration(HYPOTHESES)
    first = work.in_closed_form(work.start)
    candidates: dict[str, Callable[[], object]] = {"ours": lambda: work.run(work.in_closed_form, first)}
    library = peer_module("pypose")
    if library is not None:
        candidates["peer"] = lambda: [pypose_step(library, work, index) for index in range(PEER_HYPOTHESES)]
    note = (
        f"{HYPOTHESES} hypotheses of ours, {PEER_HYPOTHESES} of the peer's one by one, per hypothesis; {SPACE.size}"
        f" parameters, {TABLE.size} residuals"
    )
    fraction = HYPOTHESES / PEER_HYPOTHESES
    rounds = repeats or ROUNDS
    return against_peer(name, rounds, Peer("pypose", fraction), candidates, must=5.0, aim=20.0, note=note)


class _Model(nn.Module):
    """One hypothesis's residuals as pypose takes them."""

    def __init__(self, work: Iteration, index: int) -> None:
        super().__init__()
        self.free, self._work, self._channel = nn.Parameter(work.start[index].clone()), work, work.channel[index]

    def forward(self, _: object) -> Tensor:
        return self._work.residual_plainly(self.free, self._channel)


def pypose_step(library: Any, work: Iteration, index: int) -> Tensor:
    """The free parameters after one step."""
    model = _Model(work, index)
    strategy = library.optim.strategy.Constant(damping=work.settings.damping)
    library.optim.LM(model, strategy=strategy).step(torch.zeros(()))
    return model.free.detach()
