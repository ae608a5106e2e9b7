"""The one exception that means: what the user gave is wrong."""


class InputError(Exception):
    """Bad input from outside (a file, a flag, a picture): one line that says what, what was expected, got and allowed.

    The commands print the line and leave with exit code 2; everything else is a defect and keeps its traceback.
    """
