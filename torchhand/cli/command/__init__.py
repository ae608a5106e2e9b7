"""What every command shares: reading its arguments, and turning the user's mistakes into one line and exit code 2."""

from torchhand.cli.command.arguments import (
    OnDevice,
    one_address,
    parse,
    print_help,
    threads,
    whole_record,
    workers_of,
)
from torchhand.cli.command.guard import DONE, STOPPED_BY_USER, WRONG_INPUT, command, reader_went_away
from torchhand.cli.command.records import arguments_of, has_settings

__all__ = [
    "DONE",
    "STOPPED_BY_USER",
    "WRONG_INPUT",
    "OnDevice",
    "arguments_of",
    "command",
    "has_settings",
    "one_address",
    "parse",
    "print_help",
    "reader_went_away",
    "threads",
    "whole_record",
    "workers_of",
]
