"""How a table of text is written: delimiter, decimal sign, lines before the names, units below them, comments."""

from __future__ import annotations

import gzip
import itertools
import re
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import zstandard

from gyrowheel_core.errors import InputError
from gyrowheel_core.limits import largest, require_room

#: How compressed files begin.
GZIP: Final = b"\x1f\x8b"
ZSTD: Final = b"\x28\xb5\x2f\xfd"
_PIECE: Final = 1 << 20
_LOOKED_AT: Final = 200  # lines
_DELIMITERS: Final = ("\t", ";", ",", "|", " ")
_COMMENTS: Final = ("#", "%", "//", ";", "!", '"#')
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?|nan|[-+]?inf|", re.IGNORECASE)
#: A date with a time, a time of day, or a number with its unit behind it: cells of rows, too.
_OTHER: Final = re.compile(
    r"(\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[T ,;]*)?\d{1,2}:\d\d(:\d\d([.,:]\d+)?)?Z?"
    r"|[-+]?\d+([.,]\d+)*([eE][-+]?\d+)?\s*[A-Za-zµμ°Ω%/]{1,6}"
    r"|[-+]?\d{1,3}([,.' ]\d{3})+[.,]\d*|[-+]?\d{1,3}([' ]\d{3})+"
)
#: What stands in cells in which there is no number; whatever else does is told.
EMPTY: Final = (
    "", "nan", "NaN", "NAN", "-nan", "-NaN", "NA", "N/A", "n/a", "#N/A", "#N/A N/A", "#NA", "#NV", "NULL", "null",
    "None", "none", "-", "--", "---", "1.#IND", "-1.#IND", "1.#QNAN", "-1.#QNAN",
)  # fmt: skip
_ENCODINGS: Final = (
    (b"\xef\xbb\xbf", "utf-8-sig"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)


@dataclass(frozen=True)
class TextForm:
    """How a table of text is written.

    Attributes
    ----------
    delimiter : str
        What stands between columns; a blank is any run of blanks.
    decimal : str
        Decimal sign.
    skip_lines : int
        Lines before that of the names.
    unit_lines : int
        Lines of units between the names and the numbers.
    comment : str
        With what lines begin that are no rows; empty where there are none.
    encoding : str
        Encoding of the text.
    names : tuple of str
        Names of the columns; numbers where the file has none.
    units : tuple of str
        Units in the line below the names; empty where there is none.
    named : bool
        Whether the file has a line of names.
    """

    delimiter: str = ","
    decimal: str = "."
    skip_lines: int = 0
    unit_lines: int = 0
    comment: str = ""
    encoding: str = "utf-8"
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    named: bool = True


def text_of(path: Path, *, most: int | None = None) -> bytes:
    """Return the bytes of a text, plain or compressed by gzip or zstd.

    Parameters
    ----------
    path : Path
        The file.
    most : int, optional
        How many bytes from the beginning are wanted; all, up to the limit of a file, if not given.

    Raises
    ------
    InputError
        If it is larger than what may be read, or its compression is damaged.
    OSError
        If it cannot be read.
    """
    with path.open("rb") as raw:
        head = raw.read(4)
        raw.seek(0)
        opener: Any = None
        if head.startswith(GZIP):
            opener = gzip.GzipFile(fileobj=raw)
        elif head.startswith(ZSTD):
            opener = zstandard.ZstdDecompressor().stream_reader(raw, read_across_frames=True)
        if opener is None:
            return raw.read() if most is None else raw.read(most)
        parts, size = [], 0
        limit = largest()
        try:
            while most is None or size < most:
                part = opener.read(_PIECE if most is None else min(_PIECE, most - size))
                if not part:
                    break
                parts.append(part)
                size += len(part)
                if size > limit:
                    require_room(size, f"{path}: unpacked, it")
        except (EOFError, OSError, zlib.error, zstandard.ZstdError) as error:
            raise InputError(f"{path}: its compression is damaged: {error}") from None
        return b"".join(parts)


def form_of(data: bytes, where: str, *, whole: bool = True) -> TextForm:
    """Look at the beginning of a text and return how its table is written.

    Parameters
    ----------
    data : bytes
        The beginning.
    where : str
        The file, for the error.
    whole : bool
        Whether this is all of the text; if not, its last line is not looked at.

    Raises
    ------
    InputError
        If no table of numbers is found in it.
    """
    encoding = next((name for mark, name in _ENCODINGS if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(encoding, errors="strict" if whole else "ignore")
    except UnicodeDecodeError:
        encoding = "latin-1"
        text = data.decode(encoding)
    if "\0" in text:
        raise InputError(f"{where}: is no text: it has a zero byte near its beginning")
    lines = text.splitlines()
    if not whole and len(lines) > 1:
        lines = lines[:-1]
    lines = lines[: 10 * _LOOKED_AT]
    best: tuple[int, int, TextForm] | None = None
    for delimiter, decimal in itertools.product(_DELIMITERS, (".", ",")):
        if delimiter == decimal:
            continue
        found = _tried(lines, delimiter, decimal, encoding)
        if found is not None and (best is None or found[:2] > best[:2]):
            best = found
    if best is None:
        raise InputError(
            f"{where}: no rows of numbers found near its beginning; allowed: a table, one row a sample"
        )
    return best[2]


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line."""
    parts = line.split() if delimiter == " " else line.split(delimiter)
    return [part.strip().strip('"').strip() for part in parts]


def _is_row(cells: Sequence[str], decimal: str) -> bool:
    filled = [cell for cell in cells if cell not in EMPTY]
    return len(filled) > 0.5 * len(cells) and _without_words(cells, decimal)


def _without_words(cells: Sequence[str], decimal: str) -> bool:
    """Whether all cells are numbers, times, or empty."""
    foreign = "," if decimal == "." else "."
    return all(
        (foreign not in cell and _NUMBER.fullmatch(cell.replace(decimal, ".")))
        or _OTHER.fullmatch(cell)
        or cell in EMPTY
        for cell in cells
    )


def _tried(
    lines: Sequence[str], delimiter: str, decimal: str, encoding: str
) -> tuple[int, int, TextForm] | None:
    """Return how many cells are numbers, how many columns there are, and the form, if lines are read this way."""
    rows = [cells_of(line, delimiter) for line in lines]
    numeric = [len(cells) > 1 and _is_row(cells, decimal) for cells in rows]
    if not any(numeric):
        return None
    widths = Counter(len(cells) for cells, own in zip(rows, numeric, strict=True) if own)
    width = widths.most_common(1)[0][0]
    good = [k for k, own in enumerate(numeric) if own and len(rows[k]) == width]
    first = good[0]
    comment = ""
    for k in range(first, min(len(lines), first + 10 * _LOOKED_AT)):
        mark = next((m for m in _COMMENTS if lines[k].lstrip().startswith(m)), "")
        if not numeric[k] and mark:
            comment = mark
            break
    above = [k for k in range(first) if lines[k].strip()]
    # the names stand in the nearest line above that has as many cells; a line of units may stand between them
    named = [
        k
        for k in above
        if (len(rows[k]) == width or len(_uncommented(rows[k], lines[k], delimiter)) == width)
        and not _without_words(rows[k], decimal)
    ]
    units: tuple[str, ...] = ()
    if not named:
        names = tuple(str(k + 1) for k in range(width))
        form = TextForm(delimiter, decimal, first, 0, comment, encoding, names, (), named=False)
        return len(good) * width, width, form
    at = named[-1]
    below = 0
    if len(named) > 1 and named[-2] == at - 1 and _looks_like_units(rows[at]):
        units, at, below = tuple(rows[at]), at - 1, first - at
    elif first - at > 1 and not all(_without_words(rows[k], decimal) for k in range(at + 1, first)):
        below = first - at - 1
    names = tuple(rows[at] if len(rows[at]) == width else _uncommented(rows[at], lines[at], delimiter))
    return len(good) * width, width, TextForm(delimiter, decimal, at, below, comment, encoding, names, units)


def _uncommented(cells: Sequence[str], line: str, delimiter: str) -> list[str]:
    """Return the cells of a line of names that stands behind a comment sign."""
    mark = next((m for m in _COMMENTS if m != delimiter and line.lstrip().startswith(m)), "")
    return cells_of(line.lstrip()[len(mark) :].strip(), delimiter) if mark else list(cells)


_UNIT: Final = re.compile(r"[\[(]?\s*([A-Za-zµμ°Ω%·/*^²³0-9.-]{0,12})\s*[\])]?")
_UNIT_WORDS: Final = frozenset(
    [
        "s",
        "ms",
        "us",
        "µs",
        "ns",
        "sec",
        "v",
        "mv",
        "a",
        "ma",
        "rad",
        "deg",
        "mrad",
        "°",
        "°c",
        "c",
        "k",
        "degc",
        "pa",
        "hpa",
        "kpa",
        "mbar",
        "bar",
        "rpm",
        "rad/s",
        "deg/s",
        "1/min",
        "u/min",
        "min-1",
        "hz",
        "-",
        "1",
        "turn",
        "rev",
        "turns",
        "counts",
        "count",
        "cnt",
        "volt",
        "volts",
        "amp",
        "ampere",
        "amps",
        "kelvin",
        "celsius",
        "degrees",
        "seconds",
        "nm",
        "mnm",
        "n·m",
        "w",
        "urad",
        "µrad",
        "arcmin",
        "arcsec",
        "tr/min",
        "r/min",
        "rps",
        "uv",
        "µv",
        "kv",
        "ua",
        "µa",
        "°/s",
        "mrad/s",
    ]
)


def _looks_like_units(cells: Sequence[str]) -> bool:
    """Whether a line holds units: most of its cells are known units or empty, and some are."""
    own = [match.group(1).lower() if (match := _UNIT.fullmatch(cell)) else None for cell in cells]
    known = [cell for cell in own if cell is not None and cell in _UNIT_WORDS]
    return len(known) > 0 and len(known) + sum(cell == "" for cell in own) >= 0.6 * len(cells)


def plain_rows(data: bytes, form: TextForm) -> bytes:
    """Return a text without the lines and blanks that a reader of comma-separated values does not know.

    Comments are taken out, runs of blanks become one, lines between names and numbers go, and so do lines that repeat
    the names; the line of names is the first one. What needs nothing of that comes back as it is, from its line of
    names on.
    """
    text = data.decode(form.encoding)
    lines = text.splitlines()
    head, rows = lines[form.skip_lines : form.skip_lines + 1], lines[form.skip_lines + 1 + form.unit_lines :]
    if not form.named:
        head, rows = [], lines[form.skip_lines :]
    if form.comment:
        rows = [line for line in rows if not line.lstrip().startswith(form.comment)]
    if head:
        rows = [line for line in rows if line != head[0]]
    if form.delimiter == " ":
        rows = [" ".join(line.split()) for line in rows]
    quoted = form.delimiter.join(
        f'"{name.replace(chr(34), "")}"' for name in (form.names or cells_of(head[0], form.delimiter))
    )
    return "\n".join([quoted, *(line for line in rows if line.strip())]).encode() + b"\n"
