"""Estimates for other programs while they are made: JSON on standard output, by UDP or WebSocket, and OSC."""

from torchhand.runs.streams.message import message_of
from torchhand.runs.streams.senders import STANDARD_OUTPUT, Sender, check_streams, opened_streams

__all__ = ["STANDARD_OUTPUT", "Sender", "check_streams", "message_of", "opened_streams"]
