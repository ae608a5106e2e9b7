"""Track a hand through a video, a folder of pictures, a folder of videos, a webcam or a stream."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tqdm import tqdm
from tyro.conf import Positional, UseAppendAction, arg

from torchhand.cli.command import (
    DONE,
    STOPPED_BY_USER,
    WRONG_INPUT,
    OnDevice,
    command,
    one_address,
    parse,
    threads,
    workers_of,
)
from torchhand.cluster import Cluster, Copies, copies_for
from torchhand.devices import device_named
from torchhand.errors import DiskError, InputError
from torchhand.export import MAX_GAP_S, check_max_gap
from torchhand.files import check_output_folder, sequences_of
from torchhand.files.disk import expanded
from torchhand.files.pictures import MAX_MEGAPIXELS, pixel_limit
from torchhand.runs import (
    STANDARD_OUTPUT,
    Request,
    Video,
    check_streams,
    how_to_go_on,
    keypoints_of,
    known_hand,
    resume_option,
    settings_of,
    start_points_of,
    summary_of,
    track_sequence,
    track_videos,
    with_own_keypoints,
    without_hand,
)
from torchhand.track import TrackerSettings


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Track a hand through a video, a folder of pictures, a folder of videos, a webcam or a stream.

    DIR gets report.html, which opens in a browser, track.npz, track.jsonl with header.json, hand.json, config.yaml and
    overlay.mp4; of a folder of videos, one such folder per video. The hand is found by itself where it is open, or in
    the --posture given, and stands out by its colours; else give --start-points. A webcam is tracked until Ctrl-C,
    the newest picture each time. Streams (an address, or `-` for standard input) are read once, without a second pass.

    Examples:
        torchhand track wave.mp4 --out out/wave --config contour_planar --side left
        torchhand track 0 --out out/live --live --stream osc://127.0.0.1:9000
    """

    input: Annotated[Positional[str], arg(metavar="INPUT")]
    """Video file, folder of pictures, folder of videos, number of a webcam, address of a stream (http, rtsp, rtmp, udp,
    tcp, srt), or `-` for a video on standard input."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for the results."""
    config: Annotated[str, arg(metavar="NAME")] = "contour_full"
    """Method: contour_full (27 DOF), contour_planar, contour_planar_scale (motion in the picture plane), distance_full
    (26 DOF on distance maps), distance_abduction (planar motion and spreading of the fingers), or a YAML file."""
    camera: Annotated[Path | None, arg(metavar="FILE")] = None
    """Calibrated camera (cameras.json with one entry); without it a field of view is assumed."""
    hand: Annotated[Path | None, arg(metavar="FILE")] = None
    """Known shape of the hand (hand.json), which is then not fitted."""
    side: Literal["left", "right"] | None = None
    """Which hand. Without it, that of --hand; else the one that detected keypoints tell of; else right."""
    posture: Annotated[str | None, arg(metavar="NAME")] = None
    """Posture at the start: open, flat, point, fist, victory ..."""
    start_points: Annotated[str | None, arg(metavar="WX,WY,MX,MY")] = None
    """Wrist and middle fingertip in the first picture, px, where the hand is not found by itself."""
    keypoints: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="mediapipe|FILE")] = ()
    """Detected keypoints that are used beside the contours. mediapipe: MediaPipe runs along (pip install
    torchhand[mediapipe]), and what it finds is kept in DIR/keypoints.npz. FILE: those of an earlier run, or any file
    that fit_keypoints reads with points in the picture (and in space, such as MediaPipe's world landmarks); of a folder
    of videos, a folder with NAME.npz (or .npy, .json, a folder of OpenPose's) for each, or the --out of an earlier
    run with mediapipe."""
    hand_model: Annotated[Path | None, arg(metavar="FILE")] = None
    """hand_landmarker.task for a MediaPipe that carries no models of its own (newer than 0.10.21)."""
    background: Annotated[Path | None, arg(metavar="FILE")] = None
    """Picture of the scene without the hand, for --set silhouette.method=background."""
    causal: bool = False
    """Estimate every frame from this and earlier ones alone, as a webcam's. Else a recording is followed a second time,
    from its end to its beginning: that takes as long again."""
    live: bool = False
    """Track as if live: always the newest picture, others are dropped; a video plays at its own rate. A page on
    127.0.0.1 shows hand, picture and angles, starts anew and records (pip install torchhand[view])."""
    page: bool = True
    """With --live: serve the page."""
    port: int = 8080
    """Port of the page; the next free one where it is taken."""
    stream: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="WHERE")] = ()
    """Give every frame's estimate to other programs: jsonl (a line on standard output), udp://HOST:PORT (JSON),
    osc://HOST:PORT, ws://HOST:PORT (a WebSocket that is served; pip install torchhand[stream]), or FILE.thp (a pose
    stream that grows frame by frame); may be repeated."""
    max_gap_s: float = MAX_GAP_S
    """With --stream FILE.thp: a time without pictures that is longer becomes so many seconds of held poses, and a line
    tells it."""
    start: Annotated[int, arg(metavar="N")] = 0
    """First frame, counted from 0."""
    max_frames: Annotated[int | None, arg(metavar="N")] = None
    """Frames to track at most."""
    resume: bool = False
    """Go on with an interrupted run; a finished one has nothing left to do."""
    overwrite: bool = False
    """Replace an older result in DIR."""
    keep_checkpoint: bool = False
    """Keep checkpoint.pt when the run has ended, for --resume with a larger --max-frames."""
    overlay: bool = True
    """Draw overlay.mp4."""
    report: bool = True
    """Write report.html: one page with the video, the hand in 3D, every angle over time and tables."""
    changes: Annotated[UseAppendAction[tuple[str, ...]], arg(name="set", metavar="KEY=VALUE")] = ()
    """Change a single setting, such as noise.rotation=80; may be repeated. config.yaml of a result lists them all."""
    seed: int = 0
    """Seed of everything that is random (the contour tracker draws nothing at random)."""
    threads: int = 1
    """Threads of one tracker; its tensors are small, and more than one is slower."""
    workers: Annotated[int | None, arg(metavar="N")] = None
    """Videos of a folder that are tracked side by side, or parts of a long one's further passes, in copies of this
    program (on Linux): as many as there are cores if not given. The results are the same."""
    ray: Annotated[tuple[str, ...] | None, arg(metavar="[ADDRESS]")] = None
    """Track the videos of a folder side by side, in the processes of a Ray cluster (extra `cluster`): of the one at
    ADDRESS, such as auto or HOST:6379, where the paths must lead to the same files, or, without one, on all cores of
    this machine. The results are the same."""
    max_megapixels: float = MAX_MEGAPIXELS
    """Largest pictures that are read; what is larger by its header is refused before it is decoded."""

    def __post_init__(self) -> None:
        if not -(2**63) <= self.seed < 2**63:
            raise ValueError(f"--seed: expected a number of 64 bits, got {self.seed}")
        if len(self.keypoints) > 1:
            raise ValueError(f"--keypoints: expected one for the one camera, got {', '.join(self.keypoints)}")
        check_max_gap(self.max_gap_s, "--max-gap-s")
        one_address(self.ray)


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Track every sequence of the input."""
    arguments = parse(Arguments, argv, name="track", settings=_settings)
    request = _request(arguments)
    sequences = sequences_of(arguments.input)
    if (arguments.live or arguments.stream) and len(sequences) > 1:
        raise InputError(f"--live, --stream: expected one video, got a folder with {len(sequences)}")
    has_videos = expanded(arguments.input).is_dir() and Path(sequences[0][1]).is_file()
    videos = [
        Video(name=name, source=source, out_dir=arguments.out / name if has_videos else arguments.out)
        for name, source in sequences
    ]
    if has_videos:
        videos = with_own_keypoints(videos, request.keypoints)
    for video in videos:
        check_output_folder(video.out_dir, resume=request.resume, overwrite=request.overwrite)
    if arguments.ray is not None:
        if not has_videos:
            raise InputError(f"--ray: expected a folder of videos with it, got {arguments.input}")
        with Cluster(one_address(arguments.ray)) as cluster:
            return _track_side_by_side(cluster, arguments, request, videos)
    copies = copies_for(len(videos), request.workers, request.device)
    if copies is not None:
        _say(f"{len(videos)} videos, {copies.processes} at a time, each told of when done (--workers 1: frames too)")
        return _track_side_by_side(copies, arguments, request, videos)
    failed: list[str] = []
    said: set[str] = set()

    def say(line: str) -> None:
        """What holds for many videos is said once."""
        if line not in said:
            said.add(line)
            _say(line)

    with threads(arguments.threads), pixel_limit(arguments.max_megapixels):
        for video in videos:
            try:
                track, _ = track_sequence(video.source, video.out_dir, video.request_of(request), say)
            except KeyboardInterrupt:
                _say(how_to_go_on(video.out_dir, overwrite=request.overwrite))
                return STOPPED_BY_USER
            except (InputError, OSError) as error:
                if not has_videos or isinstance(error, DiskError):
                    raise
                _say(f"error: {error}")
                failed.append(video.name)
                continue
            told = summary_of(video.name, track, video.out_dir)
            print(told, file=sys.stderr if STANDARD_OUTPUT in request.streams else sys.stdout)
            line = without_hand(track)
            if line is not None:
                _say(f"{video.name}: {line}")
    return WRONG_INPUT if failed else DONE


def _track_side_by_side(
    workers: Cluster | Copies, arguments: Arguments, request: Request, videos: Sequence[Video]
) -> int:
    has_failed, said = False, set[str]()
    try:
        hidden = not sys.stderr.isatty()
        with tqdm(total=len(videos), desc="track", unit="video", disable=hidden, leave=False) as bar:
            for video, report in track_videos(workers, request, videos, arguments.max_megapixels):
                bar.update()
                for line in (line for line in report.said if line not in said):
                    said.add(line)
                    _say(f"{video.name}: {line.removeprefix(f'{video.name}: ')}")
                if report.error:
                    _say(f"error: {report.error}")
                    has_failed = True
                else:
                    print(report.summary)
    except KeyboardInterrupt:
        _say(f"stopped by Ctrl-C; the same command with {resume_option(arguments.overwrite)} goes on")
        return STOPPED_BY_USER
    return WRONG_INPUT if has_failed else DONE


def _settings(arguments: Arguments) -> TrackerSettings:
    settings = settings_of(arguments.config, arguments.changes, arguments.posture)
    if settings.method == "hull":
        raise InputError(
            f"--config: expected one for a single camera, got {arguments.config or 'one'} with method hull, which"
            " needs several (torchhand track_multiview)"
        )
    return settings


def _request(arguments: Arguments) -> Request:
    check_streams(arguments.stream, may_replace=arguments.overwrite)
    hand = None if arguments.hand is None else known_hand(arguments.hand)
    return Request(
        settings=_settings(arguments),
        config=arguments.config,
        side=arguments.side,
        hand=hand,
        camera=arguments.camera,
        **keypoints_of(arguments.keypoints, arguments.hand_model),
        start_points=None if arguments.start_points is None else start_points_of(arguments.start_points),
        background=arguments.background,
        is_causal=arguments.causal,
        is_live=arguments.live,
        page_port=arguments.port if arguments.live and arguments.page else None,
        streams=arguments.stream,
        max_gap_s=arguments.max_gap_s,
        start=arguments.start,
        max_frames=arguments.max_frames,
        resume=arguments.resume,
        overwrite=arguments.overwrite,
        keeps_checkpoint=arguments.keep_checkpoint,
        has_overlay=arguments.overlay,
        has_report=arguments.report,
        seed=arguments.seed,
        workers=workers_of(arguments.workers, arguments.threads),
        device=device_named(arguments.device),
    )


def _say(line: str) -> None:
    """One line on stderr, beside a progress bar that may run."""
    tqdm.write(f"torchhand track: {line}", file=sys.stderr)
