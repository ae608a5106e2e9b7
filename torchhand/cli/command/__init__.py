"""What every command shares: reading its arguments, and turning the user's mistakes into one line and exit code 2."""

from torchhand.cli.command.arguments import parse, threads
from torchhand.cli.command.guard import DONE, STOPPED_BY_USER, WRONG_INPUT, command

__all__ = ["DONE", "STOPPED_BY_USER", "WRONG_INPUT", "command", "parse", "threads"]
