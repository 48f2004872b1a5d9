"""How a table of text is written: delimiter, decimal sign, lines before the names, units below them, comments."""

from __future__ import annotations

import codecs
import contextlib
import csv
import functools
import gzip
import itertools
import re
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import zstandard

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import largest_unpacked, require_room

#: How compressed files begin.
GZIP: Final = b"\x1f\x8b"
ZSTD: Final = b"\x28\xb5\x2f\xfd"
_PIECE: Final = 1 << 20
_SEEN: Final = 1 << 18  # bytes by which the form of a text is detected
_LOOKED_AT: Final = 200  # lines
_NEARLY_ALL: Final = 0.9
_ALL_GIVEN: Final = 6  # fields of a form: nothing is to be seen
_MOST_BREAKS: Final = 500  # of lines, within one in quotes
_OPEN: Final = re.compile(r'(^|[,;\t| ])"[^"]*$')  # a cell in quotes that does not end in its line
_DELIMITERS: Final = ("\t", ";", ",", "|", " ")
_COMMENTS: Final = ("#", "%", "//", ";", "!", '"#')
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?|nan|[-+]?inf|", re.IGNORECASE)
#: A date with a time, a time of day, or a number with its unit behind it: cells of rows, too.
_OTHER: Final = re.compile(
    r"(\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[T ,;]*)?\d{1,2}:\d\d(:\d\d([.,:]\d+)?|[.,]\d+)?( ?[AP]M)?(Z|[-+]\d\d(:?\d\d)?)?"
    r"|[-+]?\d{1,3}([,.' ]\d{3})+[.,]\d*|[-+]?\d{1,3}([' ]\d{3})+"
)
_WITH_UNIT: Final = re.compile(r"[-+]?\d+([.,]\d+)*([eE][-+]?\d+)?\s*[A-Za-zµμ°Ω%/]{1,6}")
#: Cells that stand for "no number"; any other text is reported.
EMPTY: Final = (
    "", "nan", "NaN", "NAN", "-nan", "-NaN", "NA", "N/A", "n/a", "#N/A", "#N/A N/A", "#NA", "#NV", "NULL", "null",
    "None", "none", "-", "--", "---", "1.#IND", "-1.#IND", "1.#QNAN", "-1.#QNAN",
)  # fmt: skip
#: Characters that look like those of plain numbers: signs of minus, blanks without a break, an apostrophe.
LIKE_PLAIN: Final = {
    "\u2212": "-", "\u2013": "-", "\u2010": "-", "\u2011": "-", "\uff0d": "-", "\ufe63": "-", "\uff0b": "+",
    "\u00a0": " ", "\u2007": " ", "\u2009": " ", "\u202f": " ", "\u2019": "'", "\uff0e": ".", "\uff0c": ",",
}  # fmt: skip
_PLAIN: Final = str.maketrans(LIKE_PLAIN)
#: What separates names that have blanks in them, and the last name of a table whose rows may leave its cell out.
_APART: Final = re.compile(r"\s{2,}|\t")
_REMARKS: Final = ("", "comment", "comments", "remark", "remarks", "note", "notes", "kommentar", "bemerkung")
_NOTHING: Final = frozenset(EMPTY)
_ENCODINGS: Final = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))
_CHINESE: Final = re.compile(rb"([\xb0-\xf7][\xa1-\xfe])+")  # characters of GB 2312 in its two bytes each
_IN_A_WORD: Final = re.compile(rb"[a-z][\x80-\xff]+[a-z]")  # letters with accents, as of "Größe"
_PAIRS: Final = 64  # first bytes, which show whether each character has two of them


def unicode_of(data: bytes) -> str:
    """Return the encoding of a text by its first bytes; UTF-8 where these do not show another one."""
    for mark, name in _ENCODINGS:
        if data.startswith(mark):
            return name
    first, second = data[:_PAIRS:2], data[1:_PAIRS:2]
    if all(first) and 2 * second.count(0) > len(second):
        return "utf-16-le"
    return "utf-16-be" if all(second) and 2 * first.count(0) > len(first) else "utf-8"


@dataclass(frozen=True)
class TextForm:
    """How a table of text is written."""

    delimiter: str = ","  # what stands between columns; a blank is any run of blanks
    decimal: str = "."
    skip_lines: int = 0  # lines before that of the names
    unit_lines: int = 0  # lines of units between the names and the numbers
    comment: str = ""  # first characters of lines that are no rows; empty if there are no such lines
    encoding: str = "utf-8"
    names: tuple[str, ...] = ()  # names of the columns; numbers where the file has none
    units: tuple[str, ...] = ()  # units in the line below the names; empty where there is none
    named: bool = True  # whether the file has a line of names


def text_of(path: Path, *, most: int | None = None) -> bytes:
    """Return the bytes of a text, plain or compressed by gzip or zstd; up to `most` from its beginning, if given.

    Raises InputError if it is larger than what may be read, or its compression is damaged. Raises OSError if
    it cannot be read.
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
        limit = largest_unpacked()
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


def lines_of(text: str) -> list[str]:
    """Return the lines of a text; a name in quotes may have line breaks within it, which become blanks.

    Other signs than ends of lines separate none: a form feed, or what some code pages have in the place of an ellipsis.
    """
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if lines and not lines[-1]:
        lines.pop()
    if '"' not in text:
        return lines
    result: list[str] = []
    k = 0
    while k < len(lines):
        line, more = lines[k], 0
        if line.count('"') % 2 and _OPEN.search(line):
            while line.count('"') % 2 and more < _MOST_BREAKS and k + more + 1 < len(lines):
                more += 1
                line = f"{line} {lines[k + more]}"
        closed = more and not line.count('"') % 2
        result.append(line if closed else lines[k])
        k += 1 + (more if closed else 0)
    return result


def form_of(
    data: bytes, where: str, *, whole: bool = True, given: Mapping[str, Any] = MappingProxyType({})
) -> TextForm:
    """Return how the table at the beginning of a text is written.

    The last line is not used unless this is the `whole` text. `given` has fields that are known. Raises InputError if
    no table of numbers is found in it; it names `where`.
    """
    known = {key: given[key] for key in ("delimiter", "decimal", "encoding") if key in given}
    try:
        found = _form(data, whole, **known)
        if isinstance(found, str):
            if len(given) < _ALL_GIVEN:
                raise InputError(f"{where}: {found}")
            found = TextForm()
        form = replace(found, **given)
        if (form.skip_lines, form.unit_lines) != (found.skip_lines, found.unit_lines) or not form.names:
            return _head_of(data, form)
    except LookupError:
        raise InputError(
            f"{where}: the encoding '{given['encoding']}' is not known; allowed: such as utf-8"
        ) from None
    except UnicodeDecodeError as error:
        raise InputError(
            f"{where}: byte {error.start + 1} is no text in {given['encoding']}; csv.encoding names another encoding"
        ) from None
    return form


def one_byte_encoding(data: bytes) -> str:
    """Return the encoding of a text that is not Unicode: that of Windows where it has signs that Latin 1 lacks.

    Chinese where all signs beyond ASCII come in such pairs as GB 2312 has, and none between small letters.
    """
    runs = re.findall(rb"[\x80-\xff]+", data[:_SEEN])
    if (
        runs
        and not _IN_A_WORD.search(data[:_SEEN])
        and all(len(run) % 2 == 0 and _CHINESE.fullmatch(run) for run in runs)
    ):
        with contextlib.suppress(UnicodeDecodeError):
            data[:_SEEN].decode("gb18030")
            return "gb18030"
    try:
        return "cp1252" if any(sign > "\xff" for sign in data.decode("cp1252")) else "latin-1"
    except UnicodeDecodeError:
        return "latin-1"


@functools.lru_cache(maxsize=8)  # a table is looked at several times before it is read
def _form(
    data: bytes, whole: bool, delimiter: str = "", decimal: str = "", encoding: str = ""
) -> TextForm | str:
    """Return how a table is written, as far as it is not given, or why no table is found."""
    if encoding:
        text = codecs.getincrementaldecoder(encoding)().decode(data, whole)
    else:
        encoding = unicode_of(data)
        try:
            # a letter may be cut in two at the end
            text = codecs.getincrementaldecoder(encoding)().decode(data, whole)
        except UnicodeDecodeError:
            encoding = one_byte_encoding(data)
            text = data.decode(encoding)
    if "\0" in text:
        return "is no text: it has a zero byte near its beginning"
    lines = lines_of(text)
    if not whole and len(lines) > 1:
        lines = lines[:-1]
    lines = lines[: 10 * _LOOKED_AT]
    best: tuple[int, int, TextForm] | None = None
    for sign, point in itertools.product(
        [delimiter] if delimiter else _DELIMITERS, [decimal] if decimal else ".,"
    ):
        if (sign == point and '"' not in text) or (point == "," and "," not in text):
            continue
        if sign != " " and sign not in text:
            continue
        found = _tried(lines, sign, point, encoding)
        if found is not None and (best is None or found[:2] > best[:2]):
            best = found
    if best is None:
        return (
            "no rows of numbers found near its beginning; allowed: a table, one row a sample, most of its columns "
            "numbers"
        )
    return best[2]


def form_of_file(path: Path, given: Mapping[str, Any] = MappingProxyType({})) -> TextForm:
    """Look at the beginning of a file, plain or compressed, and return how its table is written (see `form_of`)."""
    data = text_of(path, most=_SEEN)
    return form_of(data, str(path), whole=len(data) < _SEEN, given=given)


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; a delimiter in quotes does not count."""
    if '"' in line:
        plain = " ".join(line.split()) if delimiter == " " else line
        with contextlib.suppress(csv.Error, StopIteration):
            return [
                cell.strip() for cell in next(csv.reader([plain], delimiter=delimiter, skipinitialspace=True))
            ]
    parts = line.split() if delimiter == " " else line.split(delimiter)
    return [part.strip().strip('"').strip() for part in parts]


def _words(cells: Sequence[str], decimal: str) -> set[int]:
    """Return which cells are neither numbers, nor times, nor empty."""
    foreign = "," if decimal == "." else "."
    return {
        at
        for at, cell in enumerate(cell.translate(_PLAIN) for cell in cells)
        if not (
            (foreign not in cell and _NUMBER.fullmatch(cell.replace(decimal, ".")))
            or _OTHER.fullmatch(cell)
            or (foreign not in cell and _WITH_UNIT.fullmatch(cell))
            or cell in _NOTHING
        )
    }


@dataclass(frozen=True)
class _Lines:
    """Lines as cells: which cells of each are words, how many are numbers, and whether most are."""

    cells: list[list[str]]
    words: list[set[int]]
    numbers: list[int]
    numeric: list[bool]

    @classmethod
    def of(cls, lines: Sequence[str], delimiter: str, decimal: str) -> _Lines:
        rows = [cells_of(line, delimiter) for line in lines]
        words = [_words(cells, decimal) for cells in rows]
        numbers = [
            sum(cell not in _NOTHING for cell in cells) - len(own)
            for cells, own in zip(rows, words, strict=True)
        ]
        numeric = [
            len(cells) > 1 and count > 0.5 * len(cells) for cells, count in zip(rows, numbers, strict=True)
        ]
        return cls(rows, words, numbers, numeric)

    def rows(self) -> tuple[int, list[int]]:
        """Return the usual width of the rows of numbers, and their places."""
        widths = Counter(len(cells) for cells, own in zip(self.cells, self.numeric, strict=True) if own)
        if not widths:
            return 0, []
        width = widths.most_common(1)[0][0]
        likely = [k for k, own in enumerate(self.numeric) if own and len(self.cells[k]) == width]
        # a column of texts has a word in most rows; elsewhere a word is that of a name, or an odd cell
        often = Counter(at for k in likely for at in self.words[k])
        texts = {at for at, count in often.items() if 2 * count > len(likely)}
        return width, [k for k in likely if self.words[k] <= texts]


def _tried(
    lines: Sequence[str], delimiter: str, decimal: str, encoding: str
) -> tuple[int, int, TextForm] | None:
    """Return how many cells are numbers, how many columns there are, and the form, if lines are read this way."""
    table = _Lines.of(lines, delimiter, decimal)
    width, good = table.rows()
    if not good:
        return None
    first, numeric = good[0], table.numeric
    shape = _Shape(
        width, all(not table.cells[k][-1] for k in good), _counts_rows([table.cells[k][0] for k in good])
    )
    marked = (
        mark
        for k in range(first, min(len(lines), first + 10 * _LOOKED_AT))
        if not numeric[k] and (mark := _comment_mark(lines[k]))
    )
    comment = next(marked, "")
    # the names stand in the nearest line above that has as many cells; a line of units may stand between them
    worded = [
        k for k in range(first) if lines[k].strip() and _head(lines[k], delimiter, shape) and table.words[k]
    ]
    # names may be numbers but for one, and so may a row be that has an odd cell
    named = [k for k in worded if not numeric[k]] or worded
    size = sum(table.numbers[k] for k in good)
    if not named:
        names = tuple(str(k + 1) for k in range(width))
        form = TextForm(delimiter, decimal, first, 0, comment, encoding, names, (), named=False)
        return size, width, form
    at = named[-1]
    found = _head(lines[at], delimiter, shape)
    units: list[str] = []
    for above in reversed(named[:-1]):
        # below the names: their units, and what is the same for all of them, as how often they are written
        is_units = _looks_like_units(found)
        if not (is_units or 2 * len(set(found)) < len(found)) or not set(range(above, at)) <= set(worded):
            break
        units = found if is_units and not units else units
        at, found = above, _head(lines[above], delimiter, shape)
    if units:
        units = [*units, *[""] * len(found)][: len(found)]
    if at - 1 in named:
        found = _grouped(_head(lines[at - 1], delimiter, shape), found)
    # up to the last line of words; a row with an odd cell is a row
    below = max((k - at for k in range(at + 1, first) if table.words[k] and not numeric[k]), default=0)
    form = TextForm(delimiter, decimal, at, below, comment, encoding, tuple(found), tuple(units))
    return size, width, form


def _grouped(groups: Sequence[str], names: list[str]) -> list[str]:
    """Return names with those of the groups in the line above, where only these make equal names differ.

    The name of a group may stand above its first column alone.
    """
    joint, group = [], ""
    for above, name in zip(groups, names, strict=False):
        group = above or group
        joint.append(f"{group} {name}".strip() if name else "")
    named = [name for name in names if name]  # columns that only separate others have none
    repeat = len(set(named)) < len(named) == len(set(joint) - {""})
    return joint if repeat and len(joint) == len(names) else names


def _comment_mark(line: str, *, without: str = "") -> str:
    """Return the comment sign that a line begins with; empty if it begins with none."""
    return next((m for m in _COMMENTS if m != without and line.lstrip().startswith(m)), "")


@dataclass(frozen=True)
class _Shape:
    """The cells of most rows: their number, whether the last is always empty, and whether the first counts the rows."""

    width: int
    open_end: bool = False
    counted: bool = False

    @classmethod
    def of(cls, rows: Sequence[str], delimiter: str) -> _Shape:
        seen = [cells_of(line, delimiter) for line in rows[:_LOOKED_AT]]
        if not seen:
            return cls(0)
        width = Counter(map(len, seen)).most_common(1)[0][0]
        usual = [cells for cells in seen if len(cells) == width]
        return cls(width, all(not cells[-1] for cells in usual), _counts_rows([cells[0] for cells in usual]))


def _counts_rows(cells: Sequence[str]) -> bool:
    """Whether cells are the numbers of rows, as R writes them before each row, without a name above them."""
    if len(cells) < 2 or cells[0] not in ("0", "1") or not all(cell.isdecimal() for cell in cells):
        return False
    steps = [int(later) - int(cell) for cell, later in itertools.pairwise(cells)]
    return min(steps) > 0 and steps.count(1) >= _NEARLY_ALL * len(
        steps
    )  # rows with odd cells are not looked at


def _head(line: str, delimiter: str, shape: _Shape) -> list[str]:
    """Return the names in a line above rows of so many cells; nothing where it has another number of them.

    It may stand behind a comment sign, and its names be apart by several blanks. The last name may be that of
    remarks, which rows leave out; where every row ends with a delimiter, the last column may lack a name, and where
    every row begins with its number, the first one.
    """
    width = shape.width
    cells = cells_of(line, delimiter)
    bare = _uncommented(cells, line, delimiter)
    apart = [part.strip() for part in _APART.split(line.strip())] if delimiter == " " else []
    for own in (cells, bare, apart):
        if len(own) == width:
            return own
        if len(own) == width - 1 and shape.counted and not shape.open_end:
            return ["", *own]
    if delimiter == " ":  # nothing can stand between two blanks
        return []
    for own in (cells, bare):
        if len(own) == width + 1 and own[-1].lower() in _REMARKS:
            return own
        if len(own) == width - 1 and shape.open_end:
            return [*own, ""]
    return []


def _uncommented(cells: Sequence[str], line: str, delimiter: str) -> list[str]:
    """Return the cells of a line of names that stands behind a comment sign."""
    mark = _comment_mark(line, without=delimiter)
    return cells_of(line.lstrip()[len(mark) :].strip(), delimiter) if mark else list(cells)


_UNIT: Final = re.compile(r"[\[(]?\s*([A-Za-zµμ°Ω%·/*^²³0-9.-]{0,12})\s*[\])]?")
# fmt: off
_UNIT_WORDS: Final = frozenset([
    "s", "ms", "us", "µs", "ns", "sec", "seconds", "v", "mv", "uv", "µv", "kv", "volt", "volts", "a", "ma", "ua",
    "µa", "amp", "amps", "ampere", "rad", "mrad", "urad", "µrad", "deg", "°", "degrees", "arcmin", "arcsec", "°c",
    "c", "k", "degc", "kelvin", "celsius", "pa", "hpa", "kpa", "mbar", "bar", "rpm", "rps", "rad/s", "mrad/s",
    "deg/s", "°/s", "1/min", "u/min", "min-1", "tr/min", "r/min", "hz", "-", "1", "turn", "turns", "rev", "counts",
    "count", "cnt", "nm", "mnm", "n·m", "w",
])
# fmt: on


def _looks_like_units(cells: Sequence[str]) -> bool:
    """Whether a line holds units: most of its cells are known units or empty, and some are."""
    own = [match.group(1).lower() if (match := _UNIT.fullmatch(cell)) else None for cell in cells]
    known = [cell for cell in own if cell is not None and cell in _UNIT_WORDS]
    return len(known) > 0 and len(known) + sum(cell == "" for cell in own) >= 0.6 * len(cells)


def needs_no_change(beginning: str, form: TextForm) -> bool:
    """Whether a reader of comma-separated values sees the rows of a text as `plain_rows` does, by its beginning."""
    if not form.named or form.comment or form.delimiter == " ":
        return False
    lines = beginning.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    head = lines[: form.skip_lines + 1 + form.unit_lines]
    return (
        not any(line.count('"') % 2 for line in head)
        and len(form.names)
        == _Shape.of([line for line in lines[len(head) : -1] if line.strip()], form.delimiter).width
    )


def has_empty_rows(data: bytes, form: TextForm) -> bool:
    """Whether a text has lines of delimiters alone."""
    sign = form.delimiter.encode()
    found = re.finditer(rb'(?:^|[\r\n])([ "' + re.escape(sign) + rb"]+)(?=[\r\n]|$)", data)
    return any(sign in own[1] for own in found)


def plain_rows(data: bytes, form: TextForm) -> tuple[bytes, list[int], int]:
    """Return the rows of a text without what a reader of comma-separated values does not know, and their lines.

    Comments are taken out, runs of blanks become one, and lines that repeat the names go; the last result is how many
    did. Rows that leave the last cell out get an empty one. The lines are numbers from 1 on.
    """
    lines = lines_of(data.decode(form.encoding))
    begin = form.skip_lines + (1 + form.unit_lines if form.named else 0)
    nothing = f'{form.delimiter}" \t'  # spreadsheets end a sheet by rows of delimiters alone
    numbered = [(k, line) for k, line in enumerate(lines[begin:], begin + 1) if line.strip(nothing)]
    if form.comment:
        numbered = [own for own in numbered if not own[1].lstrip().startswith(form.comment)]
    every = len(numbered)
    if form.named:
        head = lines[form.skip_lines] if form.skip_lines < len(lines) else ""
        numbered = [own for own in numbered if own[1] != head]
    repeated = every - len(numbered)
    rows = [line for _, line in numbered]
    if form.delimiter == " ":
        rows = [" ".join(line.split()) for line in rows]
    width, names = _Shape.of(rows, form.delimiter).width, form.names
    if len(names) == width + 1 and form.delimiter != " " and names[-1].lower() in _REMARKS:
        rows = [
            line + form.delimiter if len(cells_of(line, form.delimiter)) == width else line for line in rows
        ]
    return "\n".join(rows).encode() + b"\n", [k for k, _ in numbered], repeated


def _head_of(data: bytes, form: TextForm) -> TextForm:
    """Return a form as it is stated with the names that stand at the beginning of a text written so."""
    lines = lines_of(codecs.getincrementaldecoder(form.encoding)().decode(data))
    begin = form.skip_lines + 1 + form.unit_lines
    rows = [line for line in lines[begin:] if line.strip()]
    if form.comment:
        rows = [line for line in rows if not line.lstrip().startswith(form.comment)]
    line = lines[form.skip_lines] if form.skip_lines < len(lines) else ""
    shape = _Shape.of(rows[:-1] or rows, form.delimiter)
    names = _head(line, form.delimiter, shape) or cells_of(line, form.delimiter)
    return replace(form, names=tuple(names), units=(), named=True)
