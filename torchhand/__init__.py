"""torchhand: the open, anatomical, differentiable hand, and the trackers that fit it to video.

Import the parts by name, for example `from torchhand.hand import HandKinematics`. This file imports nothing, so that
the command line answers at once.
"""

__version__ = "0.1.0"

__all__ = ["__version__"]
