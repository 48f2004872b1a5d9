"""Errors that tell the user what is wrong with what they gave."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input by the user.

    The text is one line that names the file, the field, the value and what is allowed. The command line shows
    it without a traceback and exits with status 2.
    """


def one_line(error: BaseException) -> str:
    """Return what an error says, in one line; the name of its class where it says nothing."""
    return " ".join(str(error).split()) or type(error).__name__
