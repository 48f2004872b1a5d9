"""Errors that tell the user what is wrong with what they gave."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input by the user.

    The text is one line that names the file, the field, the value and what is allowed. The command line shows
    it without a traceback and exits with status 2.
    """
