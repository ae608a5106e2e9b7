"""The same command as `torchhand simulate_crops`; runs from the checkout, installed or not."""

import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    from torchhand.cli.simulate_crops import main

    sys.exit(main())
