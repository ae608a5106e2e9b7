#!/usr/bin/env bash
# From a fresh clone to a tracked hand: makes the environment, simulates a short video of a hand in a room, tracks it.
# Arguments go to `torchhand demo`.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"
cd "$repository"
make_environment runtime

"$environment/bin/torchhand" demo --out demo_out --overwrite "$@"
cat <<'MESSAGE'

Done. Open in a browser
    demo_out/track/report.html   the video with the tracked hand, the hand in 3D, every joint angle over time
Beside it
    demo_out/picture.png         four frames: the contours over the picture, beside them the hand from a second view
    demo_out/track/track.npz     poses, keypoints and covariances, frame by frame
MESSAGE
