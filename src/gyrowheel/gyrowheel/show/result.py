"""Base class of all results."""

from __future__ import annotations

import abc
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from rich.console import RenderableType


class Result(abc.ABC):
    """A result, as short text, as page in a notebook, as columns, as JSON, and as picture if it has one."""

    __slots__ = ()

    @abc.abstractmethod
    def __str__(self) -> str:
        """Return the result in a few lines."""

    def __repr__(self) -> str:
        """Return class and first line of the text."""
        return f"<{type(self).__name__}: {str(self).partition(chr(10))[0]}>"

    @abc.abstractmethod
    def _page(self) -> Iterable[RenderableType]:
        """Return the page that a notebook shows, part by part."""

    def _repr_html_(self) -> str:
        from gyrowheel.show.notebook import html

        return html(self._page())

    @abc.abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return the content of the JSON file that the command line writes with ``--json``; SI units."""

    @abc.abstractmethod
    def to_columns(self) -> Mapping[str, Any]:
        """Return the result as columns of equal length: {name: 1-D ndarray or list}; SI units."""

    def to_frame(self) -> pandas.DataFrame:
        """Return `to_columns` as a data frame.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        return data_frame(self.to_columns())

    def plot(self) -> Figure:
        """Return a picture as a matplotlib figure, to be shown in a notebook or written by ``savefig``.

        Raises
        ------
        InputError
            If the result has nothing to draw.
        """
        raise InputError(f"{type(self).__name__}: has no picture")

    def save(self, path: str | Path) -> None:
        """Write `to_dict` as a JSON file, atomically: a failure leaves the old file.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        from gyrowheel_core.files import json_text, write_text

        write_text(Path(path), json_text(self.to_dict()))


def data_frame(columns: Mapping[str, Any]) -> pandas.DataFrame:
    """Return columns as a data frame; InputError if pandas is not installed."""
    try:
        import pandas as pd
    except ImportError:
        raise InputError("to_frame: needs pandas, which is not installed: pip install pandas") from None
    return pd.DataFrame(dict(columns))
