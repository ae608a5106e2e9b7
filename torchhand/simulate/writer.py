"""A simulated sequence as a folder: pictures, exact masks, camera and truth; whole or not there at all."""

import contextlib
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float

from torchhand.errors import InputError
from torchhand.files import save_cameras, video_writer
from torchhand.files.safe_write import explained_errors, write_text
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import DOFS, HandKinematics
from torchhand.simulate.motion import Motion
from torchhand.simulate.scene import RenderedFrame

FRAMES_NAME, MASKS_NAME, TRUTH_NAME = "frames", "masks", "truth.npz"
CAMERAS_NAME, VIDEO_NAME, ABOUT_NAME = "cameras.json", "video.mp4", "about.json"
KNOWN_NAMES = (FRAMES_NAME, MASKS_NAME, TRUTH_NAME, CAMERAS_NAME, VIDEO_NAME, ABOUT_NAME)
