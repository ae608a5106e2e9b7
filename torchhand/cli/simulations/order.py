"""What the user of `torchhand simulate` orders."""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import UseAppendAction, arg

from torchhand.cli.command import OnDevice
from torchhand.errors import InputError
from torchhand.simulate import SceneSettings
from torchhand.simulate.rigs import FOV_DEG, SIZE_PX

SMALLEST_PX, LARGEST_PX = 16, 8192
DEFAULT_FRAMES, DEFAULT_SIZE, DEFAULT_FOV_DEG = 100, "360x288", 48.0


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Render a seeded sequence of a hand before one or several cameras, with exact truth.

    DIR gets frames/, masks/ (exact, without the forearm), cameras.json, truth.npz, about.json, and video.mp4 if asked
    for; with --rig, view_K/ and masks_K/ for each camera in place of the first two. The same arguments give the same
    pictures.

    Example:
        torchhand simulate --out out/planar --motion planar --frames 100 --background dark --seed 1
        torchhand simulate --out out/rig --rig frame --pose flat --pose flat,index_mcp_fe=60 --frames 7
    """

    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for the sequence."""
    motion: Literal["planar", "planar_point", "abduction", "flexion", "free", "wave", "greet", "leave"] = "planar"
    """Motion of the hand."""
    recorded: Annotated[Path | None, arg(metavar="FILE")] = None
    """Recorded joint angles of a sensing glove to play instead, with a small planar motion on top."""
    recorded_start: float = 0.0
    """Time in the recording at which to start, seconds."""
    pose: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME[,DOF=DEG,...]")] = ()
    """A posture to show instead, such as point or flat,index_mcp_fe=10; repeat for a motion through several."""
    sampled: bool = False
    """Show unrelated postures, as hands take them, instead."""
    turn_deg: float = 40.0
    """How far sampled hands are turned away from the first camera at most, degrees."""
    frames: int | None = None
    """Number of pictures (of each camera); 100, or one for each --pose, if not given."""
    fps: float = 30.0
    """Frames per second."""
    pace: float = 1.0
    """Factor on the speed of the motion."""
    size: Annotated[str | None, arg(metavar="WxH")] = None
    """Size of the pictures, px; 360x288, or 640x480 of a rig, if not given."""
    fov_deg: float | None = None
    """Horizontal field of view, degrees; 48, or 63.2 of a rig, if not given."""
    camera: Annotated[Path | None, arg(metavar="FILE")] = None
    """Calibrated camera (cameras.json with one entry) instead of --size and --fov-deg."""
    rig: Annotated[str | None, arg(metavar="NAME|FILE")] = None
    """Cameras that look at the hand: a file or folder that holds them, or the 60 cm frame of four (frame; frame1 to
    frame8 for fewer or more), or a ring (ring8)."""
    view: Literal["back", "palm"] = "back"
    """Side of the hand that faces the camera at the start."""
    side: Literal["left", "right"] | None = None
    """Which hand; right, or that of --hand."""
    hand: Annotated[Path | None, arg(metavar="FILE")] = None
    """Shape of the hand (hand.json)."""
    random_hand: bool = False
    """Another person's hand for every seed."""
    surface: Literal["primitives", "mesh"] | None = None
    """Surface of the hand that is drawn: its 37 quadrics, or its skin; the quadrics, or the skin with a rig, if not
    given."""
    background: Literal["plain", "dark", "wall", "clutter", "blue", "room"] = "plain"
    """Background behind the hand."""
    skin: Literal["light", "medium", "brown", "dark"] = "light"
    """Colour of the skin."""
    forearm: bool = False
    """Show a bare forearm."""
    noise: float = 2.0
    """Standard deviation of the sensor's noise, grey levels of 255."""
    blur_px: float = 0.0
    """Standard deviation of the lens's blur, px."""
    shutter: float = 0.0
    """Motion blur: share of the time between two frames in which the shutter is open, 0 to 1."""
    mask_noise: float = 0.0
    """Standard deviation by which the masks' boundaries are off, px."""
    seed: int = 0
    """Seed of everything that is random."""
    pictures: Literal["jpg", "png"] = "jpg"
    """Format of the pictures."""
    video: bool = False
    """Write video.mp4 as well."""
    overwrite: bool = False
    """Replace an older sequence in DIR."""
    threads: int = 1
    """Threads of the renderer; small pictures are slower with more than one."""

    def __post_init__(self) -> None:
        if self.frames is not None and not 1 <= self.frames <= 100_000:
            raise ValueError(f"--frames: expected 1 to 100000, got {self.frames}")
        ranges = {"fps": (0.1, 1000), "pace": (0, 20), "fov_deg": (5, 150), "recorded_start": (0, 1e6)}
        ranges |= {"turn_deg": (0, 180), "mask_noise": (0, 20)}
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                option = "--" + name.replace("_", "-")
                raise ValueError(f"{option}: expected {low:g} to {high:g}, got {value}")
        if not -(2**63) <= self.seed < 2**63:
            raise ValueError(f"--seed: expected a number of 64 bits, got {self.seed}")
        if self.hand is not None and self.random_hand:
            raise ValueError("expected at most one of --hand and --random-hand, got both")
        if (self.recorded is not None) + bool(self.pose) + self.sampled > 1:
            raise ValueError("expected at most one of --recorded, --pose and --sampled, got several")
        for name in ("camera", "video") if self.rig is not None else ():
            if getattr(self, name):
                raise ValueError(f"expected at most one of --rig and --{name}, got both")

    def resolved(self) -> "Arguments":
        """The arguments with what depends on other options in place of None."""
        of_rig = self.rig is not None
        return replace(
            self,
            frames=self.frames or len(self.pose) or DEFAULT_FRAMES,
            size=self.size or ("{}x{}".format(*SIZE_PX) if of_rig else DEFAULT_SIZE),
            fov_deg=self.fov_deg or (FOV_DEG if of_rig else DEFAULT_FOV_DEG),
            surface=self.surface or ("mesh" if of_rig else "primitives"),
        )

    @property
    def size_px(self) -> tuple[int, int]:
        match = re.fullmatch(r"(\d{1,5})[xX](\d{1,5})", self.size or "")
        width, height = (int(match[1]), int(match[2])) if match else (0, 0)
        if not (SMALLEST_PX <= width <= LARGEST_PX and SMALLEST_PX <= height <= LARGEST_PX):
            raise InputError(
                f"--size: expected WIDTHxHEIGHT in px, each {SMALLEST_PX} to {LARGEST_PX}, like 360x288;"
                f" got {self.size!r}"
            )
        return width, height

    @property
    def scene(self) -> SceneSettings:
        return SceneSettings(
            surface=self.surface or "primitives",
            background=self.background,
            skin=self.skin,
            noise=self.noise,
            blur_px=self.blur_px,
            shutter=self.shutter,
            forearm=self.forearm,
        )
