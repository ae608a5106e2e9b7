"""Register many starts on one picture in one batch, and ask which are right.

A picture of a hand is simulated, its silhouette is the observation, and poses that are off by up to 12 degrees in every
joint are the starts. `torchhand study` does the same by the thousand, with tables.
"""

from dataclasses import replace

import torch

from torchhand import assumed_camera, load_hand_model
from torchhand.fit import ConstraintPrior, PosturePrior, PostureResiduals, Problem, solve
from torchhand.fit.contour import SEARCH, ContourObservation, ContourSettings, picture_contours
from torchhand.hand import HandPose, PoseConstraints, named_pose_space
from torchhand.simulate import SceneSettings, render_sequence, scripted_motion
from torchhand.view import HandProjector, PrimitiveContours, outline_table


def main(starts: int = 6, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean error of the joint angles of every start and of every result, degrees."""
    model, generator = load_hand_model(), torch.Generator().manual_seed(seed)
    kinematics = model.kinematics(dtype=torch.float64)
    camera = replace(assumed_camera(240, 192, horizontal_fov_deg=48.0), is_assumed=False)
    motion = scripted_motion("abduction", 20, kinematics, camera, generator)
    still = replace(motion, poses=motion.poses[-1:])
    frame = next(render_sequence(kinematics, still, camera, SceneSettings(supersampling=1), generator))

    space = named_pose_space("dof26")
    true = HandPose(dofs=still.poses[0], reference=still.root_reference).normalized()
    off = torch.deg2rad(24 * torch.rand(starts, 36, generator=generator, dtype=torch.float64) - 12)
    off[:, :6] *= 0.05  # metres, and a turn
    begun = HandPose(dofs=true.dofs + off * space.basis.any(-1), reference=true.reference.expand(starts, 3, 3))

    settings = ContourSettings()
    projector = HandProjector(kinematics, camera)
    contours = PrimitiveContours(projector, outline_table(10, 12, without=("palm_wrist",)))
    picture = picture_contours(frame.mask, SEARCH, settings, image=frame.image)
    problem = Problem(
        space=space.about(true.dofs),
        skeleton=model.skeleton,
        shape=kinematics.default_shape,
        observations=(ContourObservation(picture=picture, contours=contours, settings=settings),),
        priors=(
            ConstraintPrior(constraints=PoseConstraints(model.skeleton), has_ties=False),
            PosturePrior(postures=PostureResiduals.of(model.prior().postures)),
        ),
    )
    found = solve(problem, begun, SEARCH)

    def error_deg(pose: HandPose) -> torch.Tensor:
        return torch.rad2deg((pose.dofs[:, 6:] - true.dofs[6:]).abs().mean(-1))

    before, after = error_deg(begun), error_deg(found.pose)
    for number in found.cost.argsort().tolist():
        print(
            f"start {number}: {before[number]:.1f}° off, now {after[number]:.1f}°, cost {found.cost[number]:.1f} nats"
        )
    return before, after


if __name__ == "__main__":
    main()
