"""Columns of a text that are not numbers throughout: which of their cells are, and what stands in the others."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from gyrowheel_recording.tables.text import EMPTY

#: What a cell may be beside a number: one with the other decimal sign, with signs between thousands, with its unit
#: behind it, a time of day or a date, or any other text.
Kind = Literal["decimal", "thousands", "unit", "clock", "text"]
_EXPONENT: Final = r"([eEdD][-+]?\d+)?"
_MOST: Final = 8  # different texts that are told


@dataclass(frozen=True)
class Odd:
    """Cells of a column that are not numbers as the others are.

    Attributes
    ----------
    kind : Kind
        What they are.
    text : str
        What stands there; of numbers, the first.
    count, row : int
        How many there are, and the row of the first, from 0 on.
    """

    kind: Kind
    text: str
    count: int
    row: int


#: Around a number; other characters that show as nothing are no part of it.
_BLANKS: Final = " \t\r\n\u00a0\u2009\u202f"


def numbers_of(values: Any, decimal: str) -> tuple[NDArray[np.float64], tuple[Odd, ...]]:
    """Return a column of texts as numbers, NaN where a cell is none, and what stands in the odd cells.

    Numbers that are written in another way than the rest are read, and told.

    Parameters
    ----------
    values : pyarrow.ChunkedArray
        Texts; null where a cell is empty.
    decimal : str
        The decimal sign.
    """
    texts = pc.utf8_trim(values.cast(pa.string()), characters=_BLANKS).combine_chunks()
    result = np.full(len(texts), np.nan)
    empty = pc.or_(texts.is_null(), pc.is_in(texts, pa.array(list(EMPTY))))
    left = ~np.asarray(empty.to_numpy(zero_copy_only=False))
    odd: list[Odd] = []
    for kind, pattern, change in _readings(decimal):
        found = left & np.asarray(
            pc.fill_null(pc.match_substring_regex(texts, pattern), False).to_numpy(zero_copy_only=False)
        )
        rows = np.flatnonzero(found)
        if not len(rows):
            continue
        left &= ~found
        if kind != "clock":
            own = texts.take(pa.array(rows))
            for old, new in change:
                own = pc.replace_substring_regex(own, old, new)
            result[rows] = _floats(own)
        if kind:
            odd.append(Odd(kind, str(texts[int(rows[0])]), len(rows), int(rows[0])))
    rest = np.flatnonzero(left)
    words: dict[str, list[int]] = {}
    for row in rest.tolist():
        words.setdefault(str(texts[row]), []).append(row)
    for text, rows_of_it in sorted(words.items(), key=lambda item: -len(item[1]))[:_MOST]:
        odd.append(Odd("text", text, len(rows_of_it), rows_of_it[0]))
    return result, tuple(odd)


#: How dates that leave no doubt which number is the month become those of ISO 8601: day.month.year, and year/month/day.
_TO_ISO: Final = (
    (r"^(\d)\.", r"0\1."),
    (r"^(\d\d)\.(\d)\.", r"\1.0\2."),
    (r"^(\d\d)\.(\d\d)\.(\d{4})[ T,;]+", r"\3-\2-\1T"),
    (r"^(\d{4})[/.](\d\d)[/.](\d\d)[ T,;]+", r"\1-\2-\3T"),
    (r",(\d+)", r".\1"),
)


def dates_of(values: Any) -> Any:
    """Return a column of texts as dates with times, or None if one of them is none.

    Parameters
    ----------
    values : pyarrow.ChunkedArray
        Texts; null where a cell is empty. Dates as in ISO 8601, all with a zone behind them or none, or as in
        `_TO_ISO`. Of 05/04/2026 nobody knows the month: such are none.
    """
    for _ in range(2):
        for zone in (None, "UTC"):
            with contextlib.suppress(pa.ArrowException):
                return values.cast(pa.timestamp("ns", zone))
        for old, new in _TO_ISO:
            values = pc.replace_substring_regex(values, old, new)
    return None


def _floats(texts: Any) -> NDArray[np.float64]:
    """Return texts of plain numbers as such; one beyond all numbers is infinite."""
    try:
        return np.asarray(texts.cast(pa.float64()).to_numpy(zero_copy_only=False))
    except pa.ArrowInvalid:
        return np.array([float(text) for text in texts.to_pylist()])


def _readings(decimal: str) -> list[tuple[Any, str, list[tuple[str, str]]]]:
    """Return the ways to read a cell, the plain one first: its kind, its pattern, and what makes it a plain number."""
    other = "," if decimal == "." else "."
    own, foreign = (rf"[-+]?(\d+[{sign}]?\d*|[{sign}]\d+){_EXPONENT}" for sign in (decimal, other))
    exponent, plus = ("[dD]", "e"), (r"^\+", "")  # neither is known to arrow
    return [
        ("", f"^{own}$", [(rf"[{decimal}]", "."), exponent, plus]),
        (
            "thousands",
            rf"^[-+]?(\d{{1,3}}([{other}' ]\d{{3}})+[{decimal}]\d*|\d{{1,3}}([' ]\d{{3}})+)$",
            [(rf"[{other}' ]", ""), (rf"[{decimal}]", "."), plus],
        ),
        ("decimal", f"^{foreign}$", [(rf"[{other}]", "."), exponent, plus]),
        (
            "unit",
            rf"^{own}\s*[A-Za-zµμ°Ω%/]+$",
            [(r"\s*[A-Za-zµμ°Ω%/]+$", ""), (rf"[{decimal}]", "."), exponent, plus],
        ),
        (
            "clock",
            r"^(\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[ T,;]*)?\d{1,2}:\d{2}(:\d{2}([.,:]\d+)?)?(Z|[-+]\d{2}(:?\d{2})?)?$",
            [],
        ),
    ]
