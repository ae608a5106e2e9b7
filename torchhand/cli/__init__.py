"""The commands: one file each, run as `torchhand NAME` or as `python scripts/NAME.py`."""
