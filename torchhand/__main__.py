"""`python -m torchhand NAME ...` is `torchhand NAME ...`."""

import runpy

runpy.run_module("torchhand.cli", run_name="__main__")
