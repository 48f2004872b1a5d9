"""What is under way on the desk: what it says, and how it is ended."""

from __future__ import annotations

import contextlib
import ctypes
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gyrowheel.workbench.session import Desk


@dataclass(frozen=True)
class Job:
    """What is under way: its title, its last line, the fraction that is done where that is known, and when it began."""

    title: str
    line: str = ""
    part: float | None = None
    began: float = field(default_factory=time.monotonic)


@dataclass(frozen=True)
class Trouble:
    """An error in a sentence, and the part of the page that caused it."""

    place: str
    sentence: str


class Ended(Exception):
    """The work was ended by the user."""


class Work:
    """The hand of what is under way on the desk; the desk takes nothing from it any more once it is ended.

    A calculation cannot be stopped in its middle: it goes on unseen to its next line, and stops there.
    """

    def __init__(self, desk: Desk, place: str) -> None:
        self._desk = desk
        self.place = place
        self.ended = False

    def say(self, line: str) -> None:
        """Show what is being done from now on; memory that the step before took is given back.

        Raises
        ------
        Ended
            If the user has ended it.
        """
        give_back_memory()
        self.change(lambda: self._desk.tell(line, None))

    def advancing(self, line: str) -> Callable[[float], None]:
        """Return what shows the fraction that is done of something, in steps of a hundredth."""
        shown = -1

        def advance(part: float) -> None:
            nonlocal shown
            if int(100 * part) != shown:
                shown = int(100 * part)
                self.change(lambda: self._desk.tell(line, part))

        return advance

    def change(self, what: Callable[[], None]) -> None:
        """Change something on the desk; raises `Ended` as `say` does."""
        with self._desk.lock:
            if self.ended:
                raise Ended
            what()
        self._desk.changed()


def give_back_memory() -> None:
    """Give freed memory back to the computer, where the C library can: it keeps what it took for the largest step."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
