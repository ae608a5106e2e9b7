#!/usr/bin/env bash
# From a fresh clone to a tracked hand: makes the environment, simulates a short video of a moving hand, tracks it.
# Arguments go to `torchhand demo`.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"
cd "$repository"
make_environment runtime

"$environment/bin/torchhand" demo --out demo_out --overwrite "$@"
cat <<'MESSAGE'

Done. In demo_out:
MESSAGE
find demo_out -type f | sort | sed 's/^/    /'
echo "Open overlay.mp4 first: the tracked contours over the video, and the hand from a second view beside it."
