#!/usr/bin/env bash
# From a fresh clone to a tracked hand: makes the environment, simulates a short video of a moving hand, tracks it.
# Arguments go to `torchhand demo`.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"
cd "$repository"
make_environment runtime

"$environment/bin/torchhand" demo --out demo_out --overwrite "$@"
cat <<'MESSAGE'

Done. Look at
    demo_out/track/overlay.mp4   the tracked contours over the video, beside them the hand from a second view
    demo_out/picture.png         four of its frames
    demo_out/track/track.npz     poses, keypoints and covariances, frame by frame
MESSAGE
