"""Measures of `torchhand benchmark` on registration: one hand as a tracker registers it, and thousands of starts."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import partial

import cv2
import torch
from torch import Tensor

from torchhand.cli.benchmarks.figures import Figure
from torchhand.devices import HOST, at_once_on, finished, sent_to
from torchhand.evaluate import time_interleaved
from torchhand.files import load_hand_model
from torchhand.fit import (
    ConstraintPrior,
    GaussianPrior,
    PosturePrior,
    PostureResiduals,
    Problem,
    Schedule,
    Solutions,
    free_bounds,
    solve,
)
from torchhand.fit.contour import (
    SEARCH,
    TRACKING,
    ContourObservation,
    ContourSettings,
    PictureContours,
    picture_contours,
)
from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.hand import HandPose, PoseConstraints, named_pose_space
from torchhand.simulate import SceneSettings, render_sequence, scripted_motion
from torchhand.view import HandProjector, OutlineTable, PrimitiveContours, outline_table

SIZE_PX, FOV_DEG, FRAME = (640, 480), 48.0, 12
SPACE = named_pose_space("dof26")
TABLE = outline_table(16, 12, without=("palm_wrist",))
"""With the picture's 256 points about a thousand residuals."""
ONE_MUST_MS, ONE_AIM_MS = 40.0, 15.0
MANY, MANY_MUST_MS, MANY_AIM_MS = 128, 90.0, 30.0
"""Starts at once on a processor; 90 ms for each of 10,000 are 15 minutes."""
ROUNDS, MANY_ROUNDS = 15, 3
"""Repeats unless --repeats says otherwise."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A hand before a camera, its picture, and starts around it."""

    projector: HandProjector
    image: Tensor
    mask: Tensor
    truth: Tensor
    reference: Tensor
    pose: Tensor
    references: Tensor

    @classmethod
    def of(cls, count: int, *, deg: float, mm: float) -> "Case":
        """Starts whose every angle, place and direction are off by up to so much."""
        kinematics = load_hand_model().kinematics(dtype=torch.float64)
        camera = replace(assumed_camera(*SIZE_PX, horizontal_fov_deg=FOV_DEG), is_assumed=False)
        generator = torch.Generator().manual_seed(0)
        motion = scripted_motion("free", FRAME + 1, kinematics, camera, generator)
        truth = SPACE.free(motion.poses[FRAME])
        motion = replace(motion, poses=SPACE.dof(truth)[None])
        frame = next(iter(render_sequence(kinematics, motion, camera, SceneSettings(), generator)))

        def off(*size: int) -> Tensor:
            return 2 * torch.rand(*size, generator=generator, dtype=torch.float64) - 1

        free = truth + torch.cat(
            (1e-3 * mm * off(count, 3), torch.zeros(count, 3), math.radians(deg) * off(count, SPACE.size - 6)), -1
        )
        free = free.clamp(*free_bounds(SPACE, kinematics.skeleton))
        turned = rotation_from_vector(math.radians(deg) * off(count, 3)) @ motion.root_reference
        return cls(
            projector=HandProjector(kinematics, camera),
            image=frame.image,
            mask=frame.mask,
            truth=SPACE.dof(truth),
            reference=motion.root_reference,
            pose=SPACE.dof(free),
            references=turned,
        )

    def on(self, device: torch.device) -> "Case":
        """The same case on a device; itself where it is there."""
        own, projector = {f.name: getattr(self, f.name) for f in fields(self)}, self.projector
        kinematics, camera = projector.kinematics.on(device), sent_to(projector.camera, device)
        moved = {name: value.to(device) for name, value in own.items() if isinstance(value, Tensor)}
        return (
            self if kinematics is projector.kinematics else Case(projector=HandProjector(kinematics, camera), **moved)
        )

    def contours(self, table: OutlineTable) -> PrimitiveContours:
        return PrimitiveContours(self.projector, table)

    @property
    def starts(self) -> HandPose:
        return HandPose.of(self.pose, self.references)

    def errors_mm(self, pose: HandPose) -> Tensor:
        """Mean over the keypoints."""
        kinematics, truth = self.projector.kinematics, self.projector.frames(self.truth, self.reference).keypoints
        found = kinematics(pose.dofs, root_reference=pose.reference).keypoints
        return 1e3 * (found - truth).norm(dim=-1).mean(-1)


def _registration(case: Case, schedule: Schedule) -> Callable[[PictureContours], Solutions]:
    """Registration with all that a tracker's registration has: constraints, prior and what is expected."""
    device, starts = case.pose.device, case.starts
    contours, model = case.contours(sent_to(TABLE, device)), load_hand_model().to(device=device)
    space = SPACE.to(device=device)
    std = torch.full((SPACE.size,), math.radians(9.0), dtype=torch.float64, device=device)
    std[:3], std[3:6] = 0.03, 0.3
    priors = (
        ConstraintPrior(constraints=PoseConstraints(model.skeleton), has_ties=False),
        PosturePrior(postures=PostureResiduals.of(model.prior().postures)),
        GaussianPrior.of_std(starts, std, space),
    )

    def fit(picture: PictureContours) -> Solutions:
        observation = ContourObservation(picture=picture, contours=contours, settings=ContourSettings())
        problem = Problem(
            space=space,
            skeleton=model.skeleton,
            shape=contours.shape,
            observations=(observation,),
            priors=priors,
        )
        return solve(problem, starts, schedule, at_once=MANY)

    return fit


@contextmanager
def _picture_threads() -> Iterator[None]:
    """OpenCV computes with as many threads as torch does."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(torch.get_num_threads())
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def one_registration(name: str, repeats: int | None, device: torch.device = HOST) -> Figure:
    """One hypothesis from a prediction a few degrees off; the picture's maps and valleys are measured by themselves."""
    case = Case.of(1, deg=4.0, mm=3.0).on(device)
    fit, repeats = _registration(case, TRACKING), repeats or ROUNDS
    extract = partial(picture_contours, case.mask, TRACKING, image=case.image)
    with _picture_threads():
        contours = extract()
        calls = {"fit": lambda: fit(contours), "picture": extract, "together": lambda: fit(extract())}
        times = time_interleaved({part: finished(call, device) for part, call in calls.items()}, repeats, warm_up=3)
    found = fit(contours)
    errors = [float(case.errors_mm(hands)) for hands in (case.starts, found.pose)]
    details = {f"{part}_ms": timing.median for part, timing in times.items()} | {
        "fit_fastest_ms": times["fit"].fastest,
        "residuals": TABLE.size + len(contours.boundary.points_px),
        "parameters": SPACE.size,
        "iterations": int(found.iterations),
        "error_before_mm": errors[0],
        "error_after_mm": errors[1],
    }
    note = f"the picture's maps and valleys take {times['picture'].median:.1f} ms, both together"
    return Figure(
        name=name,
        value=times["fit"].median,
        unit="ms",
        must=ONE_MUST_MS,
        aim=ONE_AIM_MS,
        ours_ms=times["fit"].median,
        repeats=repeats,
        note=f"{note} {times['together'].median:.1f} ms; error {errors[0]:.1f} mm before, {errors[1]:.1f} mm after",
        details=details,
    )


def many_hypotheses(name: str, repeats: int | None, device: torch.device = HOST) -> Figure:
    """Milliseconds per start of a batch, from coarse to fine, at most twenty iterations each."""
    count = at_once_on(device, MANY)
    case = Case.of(count, deg=15.0, mm=10.0).on(device)
    fit, repeats = _registration(case, SEARCH), repeats or MANY_ROUNDS
    contours = picture_contours(case.mask, SEARCH, image=case.image)
    ours = finished(lambda: fit(contours), device)
    [timing] = time_interleaved({"ours": ours}, repeats, warm_up=1).values()
    found = fit(contours)
    each = timing.median / count
    details = {
        "hypotheses": count,
        "most_iterations": sum(stage.rounds * stage.iterations for stage in SEARCH),
        "mean_iterations": float(found.iterations.double().mean()),
        "minutes_per_10000": each * 10_000 / 60_000,
        "median_contour_px": float(found.explained_by("contour").distance.median()),
    }
    return Figure(
        name=name,
        value=each,
        unit="ms",
        must=MANY_MUST_MS,
        aim=MANY_AIM_MS,
        ours_ms=each,
        repeats=repeats,
        note=f"per hypothesis of {count}; {details['minutes_per_10000']:.1f} minutes for 10,000; contours are"
        f" {details['median_contour_px']:.2f} px off at the end (median)",
        details=details,
    )
