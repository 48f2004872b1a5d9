"""Where verbs of several steps are shown."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from gyrowheel.cli.console import advancing, working

if TYPE_CHECKING:
    from rich.console import Console, RenderableType


class Terminal:
    """Shows step by step on a console what a verb does."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._number = 0

    def step(self, text: str) -> None:
        """Begin the next step."""
        from rich.text import Text

        self._number += 1
        self._console.print(
            Text.assemble("\n", (f" {self._number} ", "bold reverse"), (f" {text}\n", "bold"))
        )

    def show(self, parts: Iterable[RenderableType]) -> None:
        """Show something of the current step."""
        from gyrowheel.show.layout import show

        show(self._console, parts)

    def advancing(self, title: str) -> AbstractContextManager[Callable[[float], None]]:
        """Show how far something is."""
        return advancing(title)

    def working(self, title: str) -> AbstractContextManager[Callable[[str], None]]:
        """Show that something is being done."""
        return working(title)
