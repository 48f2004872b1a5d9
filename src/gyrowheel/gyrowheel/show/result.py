"""Base classes of recordings, models and results, which show themselves."""

from __future__ import annotations

import abc
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from rich.console import RenderableType


class Shown(abc.ABC):
    """A recording, a model or a result: a page (printed, in a notebook, by the verb), columns, JSON and a picture."""

    __slots__ = ()

    @abc.abstractmethod
    def page(self) -> Iterable[RenderableType]:
        """Return the page that ``print``, a notebook and the verb show, part by part."""

    @abc.abstractmethod
    def headline(self) -> str:
        """Return the result in one line, as ``repr`` shows it."""

    def __str__(self) -> str:
        """Return the page as text, at the width of the terminal."""
        from gyrowheel.show.layout import plain_text, terminal_width

        return plain_text(self.page(), terminal_width())

    def __repr__(self) -> str:
        """Return class and headline."""
        return f"<{type(self).__name__}: {self.headline()}>"

    def _repr_html_(self) -> str:
        from gyrowheel.show.notebook import html

        return html(self.page())

    @abc.abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return the content of the JSON file that the command line writes with ``--json``; SI units."""

    @abc.abstractmethod
    def to_columns(self) -> Mapping[str, Any]:
        """Return columns of equal length: {name: 1-D ndarray or list}; SI units."""

    def to_frame(self) -> pandas.DataFrame:
        """Return `to_columns` as a data frame.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise InputError("to_frame: needs pandas, which is not installed: pip install pandas") from None
        return pd.DataFrame(dict(self.to_columns()))

    def plot(self) -> Figure:
        """Return a picture as a matplotlib figure, to be shown in a notebook or written by ``savefig``.

        Raises
        ------
        InputError
            If there is nothing to draw.
        """
        raise InputError(f"{type(self).__name__}: has no picture")


class Result(Shown):
    """A result of the packages below with a page: a subclass of it and of this class, which has the same fields.

    Its `page` and `plot` hand it to functions that know the facts alone.
    """

    __slots__ = ()

    @classmethod
    def of(cls, facts: Any, **more: Any) -> Self:
        """Return the result with the fields of `facts`, and further fields."""
        return cls(**{field.name: getattr(facts, field.name) for field in fields(facts)}, **more)

    def save(self, path: str | Path) -> None:
        """Write `to_dict` as a JSON file, atomically: a failure leaves the old file.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        from gyrowheel_core.files import json_text, write_text

        write_text(Path(path), json_text(self.to_dict()))


def columns_of(names: str, rows: Iterable[Iterable[Any]]) -> dict[str, list[Any]]:
    """Return rows as columns, by the names in a text separated by spaces."""
    table = [list(row) for row in rows]
    return {name: [row[k] for row in table] for k, name in enumerate(names.split())}
