"""Reading what a user may have broken and writing so that nothing is half written; where shipped files are."""

from torchhand.files.disk.array_file import opened_arrays
from torchhand.files.disk.json_checks import read_json, read_number, read_numbers, short, suggestion
from torchhand.files.disk.line_file import LineFile, read_lines
from torchhand.files.disk.locations import configs_dir, find_config, models_dir
from torchhand.files.disk.native_messages import captured_messages, quiet_opencv
from torchhand.files.disk.safe_write import explained_errors, replacing, temporary_path, write_text
from torchhand.files.disk.text_input import finite, read_lines_of, whole

__all__ = [
    "LineFile",
    "captured_messages",
    "configs_dir",
    "explained_errors",
    "find_config",
    "finite",
    "models_dir",
    "opened_arrays",
    "quiet_opencv",
    "read_json",
    "read_lines",
    "read_lines_of",
    "read_number",
    "read_numbers",
    "replacing",
    "short",
    "suggestion",
    "temporary_path",
    "whole",
    "write_text",
]
