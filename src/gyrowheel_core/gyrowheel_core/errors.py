"""Errors for bad input of the user."""

from __future__ import annotations

import difflib
import re
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
    """Return a text with characters that cannot be printed replaced by escapes.

    Messages quote files from anywhere, and a terminal would obey escape sequences in them.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


#: Characters that a terminal obeys, those that are not seen or turn the direction of reading, and bytes of names that
#: are no text; no line breaks.
_HIDDEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u2064\u2066-\u206f\ufeff\ufff9-\ufffb\ud800-\udfff]"
)


def visible(text: str) -> str:
    """Return a text with characters that act or hide replaced by escapes: names of users are data in every medium."""
    return _HIDDEN.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def one_line(error: BaseException) -> str:
    """Return the message of an error in one line; the name of its class if the message is empty."""
    return " ".join(str(error).split()) or type(error).__name__


def nearest(name: str, known: Iterable[str], what: str = "allowed") -> str:
    """Return a hint after an unknown name: the known name that it resembles, else all of them."""
    names = list(known)
    near = difflib.get_close_matches(name[:60], names, n=1)
    return f"did you mean {near[0]}?" if near else f"{what}: {', '.join(names) or 'none'}"


def with_article(noun: str) -> str:
    """Return a noun with its article: a campaign, an investigation."""
    return f"an {noun}" if noun[:1] in "aeiou" else f"a {noun}"
