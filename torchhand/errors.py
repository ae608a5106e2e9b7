"""The one exception that means: what the user gave is wrong."""


class InputError(Exception):
    """Bad input from outside (a file, a flag, a picture): one line saying what, what was expected, what was got, what is allowed.

    The commands print the line and leave with exit code 2; everything else is a defect and keeps its traceback.
    """
