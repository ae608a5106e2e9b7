"""Estimates for other programs while they are made: JSON on standard output, by UDP or WebSocket, OSC, pose streams."""

from torchhand.runs.streams.message import message_of
from torchhand.runs.streams.pose_file import PoseRate, opened_pose_files
from torchhand.runs.streams.senders import STANDARD_OUTPUT, Sender, check_streams, opened_streams

__all__ = [
    "STANDARD_OUTPUT",
    "PoseRate",
    "Sender",
    "check_streams",
    "message_of",
    "opened_pose_files",
    "opened_streams",
]
