"""The file of a table of another program, text or Parquet, read by a map."""

from __future__ import annotations

import codecs
import contextlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.files import require_room
from gyrowheel_recording.mapping.map_file import TIMESTAMP, ColumnMap, CsvSettings
from gyrowheel_recording.tables import EMPTY, TextForm, form_of_file, text_of
from gyrowheel_recording.tables.readers.text_table import dates_of, numbers_of
from gyrowheel_recording.tables.text import GZIP, ZSTD, needs_no_change, plain_rows

_TEXT_TO_MEMORY: Final = 2.0  # a short number takes more bytes in memory than in a text
_BYTES_A_VALUE: Final = 16  # as it is read, and as it is converted
_HEAD: Final = 1 << 16  # bytes by which a text is known


class TableFile:
    """A text or a Parquet file, of which a map names columns.

    The map may also state how a text is written; otherwise its form is detected. `remarks` are about what was left
    out.
    """

    def __init__(self, path: Path, column_map: ColumnMap, *, is_text: bool) -> None:
        self.path = path
        self.remarks: list[str] = []
        self.is_text = is_text
        self._map = column_map
        self.settings = self._text_settings() if is_text else CsvSettings()

    def place(self, row: int) -> str:
        """Return the name of a row for messages."""
        s = self.settings
        # the header is line 1 where nothing is skipped
        return f"line {row + 2 + s.skip_lines + s.unit_lines}" if self.is_text else f"row {row + 1}"

    def read(self) -> Any:
        """Return the columns that the map names, unconverted, as a table of arrow.

        Raises InputError if the file cannot be read, a column is not there, or one of numbers holds something
        else.
        """
        names = self._map.names
        try:
            return self._read_csv(names) if self.is_text else self._read_parquet(names)
        except FileNotFoundError:
            raise InputError(f"{self.path}: no such file") from None
        except OSError as error:
            # arrow raises OSError for faults inside a file, too
            raise InputError(f"{self.path}: cannot be read: {error.strerror or one_line(error)}") from None
        except (pa.ArrowException, UnicodeDecodeError) as error:
            raise InputError(f"{self.path}: cannot be read: {one_line(error)}") from None

    def _read_parquet(self, names: Sequence[str]) -> Any:
        with self.path.open("rb") as opened, pq.ParquetFile(opened) as file:
            self.check_columns(file.schema_arrow.names, names)
            # what the file claims of its size may be small: a column of one repeated value has hardly any bytes
            rows = file.metadata.num_rows
            require_room(_BYTES_A_VALUE * rows * len(names), f"{self.path}: its table of {rows} rows")
            return file.read(columns=list(names))

    def _check_text(self) -> str:
        """Return the beginning of the file; refuse one that is no text: the parser would quote what it cannot read."""
        encoding = self.settings.encoding
        head = text_of(self.path, most=_HEAD)
        try:
            # a character may be cut in two at the end
            text = codecs.getincrementaldecoder(encoding)().decode(head)
        except UnicodeDecodeError as error:
            raise InputError(
                f"{self.path}: byte {error.start + 1} is no text in {encoding}; {self._map.origin}: csv.encoding names "
                "another encoding"
            ) from None
        except LookupError:
            return ""  # reported where the file is read
        if "\0" in text:
            raise InputError(f"{self.path}: is no text: it has a zero byte near its beginning")
        return text

    def _read_csv(self, names: Sequence[str]) -> Any:
        settings = self.settings
        beginning = self._check_text()
        with self.path.open("rb") as file:
            packed = file.read(4).startswith((GZIP, ZSTD))
        plain = not (packed or settings.unit_lines or settings.comment or settings.delimiter == " ")
        plain = plain and needs_no_change(beginning, self._form())
        data = b"" if plain else text_of(self.path)
        require_room(_TEXT_TO_MEMORY * (self.path.stat().st_size if plain else len(data)), f"{self.path}: it")
        encoding, skipped = (settings.encoding, settings.skip_lines) if plain else ("utf-8", 0)
        if not plain:
            try:
                data = plain_rows(data, self._form())
            except LookupError:
                self._unknown_encoding()
        self._opened = (lambda: self.path.open("rb")) if plain else (lambda: io.BytesIO(data))
        read = pc.ReadOptions(skip_rows=skipped, encoding=encoding)
        parse = pc.ParseOptions(delimiter=settings.delimiter)
        try:
            # opened here and below: arrow refuses names of files that are not text
            with (
                self._opened() as opened,
                pc.open_csv(opened, read_options=read, parse_options=parse) as stream,
            ):
                self.check_columns(stream.schema.names, names)
        except pa.ArrowInvalid:
            self._name_the_row(read)
            raise
        except LookupError:
            self._unknown_encoding()
        dates = self._map.time.column if self._map.time.unit == TIMESTAMP else ""

        def options(kind: Any, zone: str | None) -> Any:
            types = dict.fromkeys(names, kind)
            if dates and kind != pa.string():
                types[dates] = pa.timestamp("ns", zone)
            return pc.ConvertOptions(
                include_columns=list(names),
                column_types=types,
                decimal_point=settings.decimal,
                null_values=[*EMPTY, *settings.missing],
                strings_can_be_null=True,
            )

        def table(kind: Any, zone: str | None = None) -> Any:
            with self._opened() as opened:
                return pc.read_csv(
                    opened, read_options=read, parse_options=parse, convert_options=options(kind, zone)
                )

        try:
            return table(pa.float64())
        except pa.ArrowInvalid:
            if dates:
                with contextlib.suppress(pa.ArrowInvalid):
                    return table(pa.float64(), "UTC")  # dates with a zone
            self._name_the_row(read)
            if plain and self._without_repeated_names():
                read = pc.ReadOptions()
                with contextlib.suppress(pa.ArrowInvalid):
                    return table(pa.float64())
            return self._by_cells(table(pa.string()), dates)

    def _form(self) -> TextForm:
        return TextForm(**self.settings.model_dump(exclude={"missing"}))

    def _without_repeated_names(self) -> bool:
        """Read the text without lines that repeat the names; return whether there are any."""
        data, form = text_of(self.path), self._form()
        lines = data.decode(form.encoding).splitlines()
        repeated = lines.count(lines[form.skip_lines]) - 1
        if repeated:
            body = plain_rows(data, form)
            self._opened = lambda: io.BytesIO(body)
            self.remarks.append(f"{repeated} lines that repeat the names are left out")
        return bool(repeated)

    def _unknown_encoding(self) -> NoReturn:
        raise InputError(
            f"{self._map.origin}: csv.encoding: '{self.settings.encoding}' is not known; allowed: such as utf-8"
        ) from None

    def _name_the_row(self, read: Any) -> None:
        """Raise for the first row that has too few columns or too many."""
        wrong: list[Any] = []

        def note(row: Any) -> str:
            wrong.append(row)
            return "skip"

        # rows are counted by one thread alone
        one = pc.ReadOptions(skip_rows=read.skip_rows, encoding=read.encoding, use_threads=False)
        parse = pc.ParseOptions(delimiter=self.settings.delimiter, invalid_row_handler=note)
        with contextlib.suppress(pa.ArrowInvalid), self._opened() as opened:
            pc.read_csv(opened, read_options=one, parse_options=parse)
        if wrong and wrong[0].number is not None:
            row = wrong[0]
            raise InputError(
                f"{self.path}: line {row.number}: {row.actual_columns} columns; "
                f"allowed: {row.expected_columns}, as in the line of names"
            )

    def _by_cells(self, table: Any, dates: str) -> Any:
        """Return a table of texts as numbers, and the column `dates` as dates: arrow reads neither a sign + nor 1D3.

        Raises InputError: for texts that are no numbers: the first one of each column.
        """
        found: list[str] = []
        columns: dict[str, Any] = {}
        for name in table.column_names:
            column = table.column(name)
            if name == dates:
                columns[name] = self._dates(name, column)
                continue
            numbers, odd = numbers_of(column, self.settings.decimal)
            if odd:
                first = min(odd, key=lambda own: own.row)
                found.append(f"column '{name}', {self.place(first.row)}: '{first.text}' is not allowed")
            nothing = np.asarray(column.is_null().to_numpy(zero_copy_only=False))
            columns[name] = pa.array(numbers, mask=nothing)
        if found:
            raise InputError(
                f"{self.path}: {'; '.join(found)}; allowed: a number, or a word that `csv: {{missing: [...]}}` in the "
                "map takes for none"
            ) from None
        return pa.table(columns)

    def _dates(self, name: str, column: Any) -> Any:
        """Return texts as dates with times."""
        if (dates := dates_of(column)) is not None:
            return dates
        text = next((str(own) for own in column.to_pylist() if own), "")
        raise InputError(
            f"{self.path}: column '{name}': dates such as '{text[:40]}' cannot be read; allowed: dates with times, as "
            "2026-05-04T10:00:00.0005 or 4.5.2026 10:00:00.0005, all with a zone behind them or none"
        )

    def check_columns(self, there: Sequence[str], needed: Sequence[str]) -> None:
        """Refuse a file in which a column that the map names is not there once."""
        for name in needed:
            count = list(there).count(name)
            if count == 0:
                raise InputError(
                    f"{self.path}: no column '{name}', which {self._map.origin} names; there are: {', '.join(there)}"
                )
            if count > 1:
                raise InputError(f"{self.path}: {count} columns are called '{name}'; allowed: one")

    def _text_settings(self) -> CsvSettings:
        """Return how a text is written: as stated by the map, or as detected."""
        if self._map.csv is not None:
            return self._map.csv
        try:
            form = form_of_file(self.path)
        except InputError:  # reported where it is read
            return CsvSettings()
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror or one_line(error)}") from None
        if not form.named:
            raise InputError(f"{self.path}: has no line of names; allowed: a table whose columns have names")
        return CsvSettings(
            delimiter=form.delimiter,
            decimal=form.decimal,
            skip_lines=form.skip_lines,
            unit_lines=form.unit_lines,
            comment=form.comment,
            encoding=form.encoding,
        )
