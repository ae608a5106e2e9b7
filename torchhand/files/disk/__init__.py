"""Reading what a user may have broken and writing so that nothing is half written; where shipped files are."""

from torchhand.files.disk.array_file import opened_arrays
from torchhand.files.disk.json_checks import read_json, read_number, read_numbers, short, suggestion
from torchhand.files.disk.line_file import LineFile, read_lines
from torchhand.files.disk.locations import configs_dir, find_config, models_dir
from torchhand.files.disk.native_messages import quiet_opencv
from torchhand.files.disk.plain_files import check_name, check_plain_file, expanded, read_plain_file, read_text
from torchhand.files.disk.safe_write import explained_errors, replacing, temporary_path, write_text
from torchhand.files.disk.text_input import finite, read_lines_of, whole
from torchhand.files.disk.yaml_text import read_yaml

__all__ = [
    "LineFile",
    "check_name",
    "check_plain_file",
    "configs_dir",
    "expanded",
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
    "read_plain_file",
    "read_text",
    "read_yaml",
    "replacing",
    "short",
    "suggestion",
    "temporary_path",
    "whole",
    "write_text",
]
