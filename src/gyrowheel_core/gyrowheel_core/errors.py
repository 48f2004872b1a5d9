"""Errors that tell the user what is wrong with what they gave."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Bad input by the user.

    The text is one line that names the file, the field, the value and what is allowed. The command line shows
    it without a traceback and exits with status 2.

    Parameters
    ----------
    text : str
        What is wrong; see `printable`.
    """

    def __init__(self, text: str) -> None:
        super().__init__(printable(text))


def printable(text: str) -> str:
    """Return a text with escapes in the place of characters that cannot be printed.

    Messages quote files that anybody may have written, and a terminal would obey what they hold.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def one_line(error: BaseException) -> str:
    """Return what an error says, in one line; the name of its class where it says nothing."""
    return " ".join(str(error).split()) or type(error).__name__


def nearest(name: str, known: Iterable[str], what: str = "allowed") -> str:
    """Return what a message says after an unknown name: the known one that it resembles, else all of them."""
    names = list(known)
    near = difflib.get_close_matches(name[:60], names, n=1)
    return f"did you mean {near[0]}?" if near else f"{what}: {', '.join(names) or 'none'}"


def with_article(noun: str) -> str:
    """Return a noun with its article: a campaign, an investigation."""
    return f"an {noun}" if noun[:1] in "aeiou" else f"a {noun}"
