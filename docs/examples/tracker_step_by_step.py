"""Drive the tracker frame by frame: own pictures, own clock, a state that is a plain value.

The pictures here are simulated; any RGB tensor (height, width, 3) of bytes will do.
"""

from dataclasses import replace

import torch

from torchhand import Tracker, View, assumed_camera, load_hand_model, settings_of
from torchhand.simulate import SceneSettings, render_sequence, scripted_motion
from torchhand.track import TrackerState


def main(frames: int = 4) -> list[str]:
    """The status of every frame."""
    model = load_hand_model()
    camera = replace(assumed_camera(240, 192, horizontal_fov_deg=48.0), is_assumed=False)
    tracker = Tracker(model.hand(side="right"), camera, settings_of("contour_planar"))

    kinematics, generator = model.kinematics(dtype=torch.float64), torch.Generator().manual_seed(0)
    motion = scripted_motion("planar", frames, kinematics, camera, generator)
    state: TrackerState | None = None  # nothing is known of the hand before the first frame
    statuses = []
    for frame in render_sequence(kinematics, motion, camera, SceneSettings(supersampling=1), generator):
        state, estimate = tracker.step(state, [View(image=frame.image)], frame.index / motion.fps)
        statuses.append(estimate.status)
        if estimate.keypoints is not None and estimate.keypoints_cov is not None:
            tip_mm = [round(1e3 * float(x)) for x in estimate.keypoints[8]]
            std_mm = [round(1e3 * float(x)) for x in estimate.keypoints_cov[8].diagonal().sqrt()]
            print(f"{estimate.time_s:.2f} s  {estimate.status}  index fingertip at {tip_mm} mm ± {std_mm}")
    return statuses


if __name__ == "__main__":
    main()
