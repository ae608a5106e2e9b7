"""`python -m torchhand.cli NAME ...` is `torchhand NAME ...`."""

import sys

from torchhand.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
