"""Recordings from tables of other programs, and tables from recordings."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrowheel.recordings.api import Recording
from gyrowheel.show.result import Result
from gyrowheel.show.sentences.setup import problem_and_map
from gyrowheel_core.errors import InputError, one_line

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel_recording.mapping.suggestion import Suggestion
    from gyrowheel_recording.tables import Grid
    from gyrowheel_sim.bench import Bench

_IN_MEMORY = "table"  # name of a table that is no file
_COLUMN = ("field", "column", "unit", "scale", "clock", "reason")  # of a suggested column


@dataclass(frozen=True, repr=False)
class TableMap(Result):
    """Outcome of `gyrowheel.suggest_map`: suggested meaning of the columns of a table, and open questions.

    Attributes
    ----------
    suggestion : gyrowheel_recording.mapping.suggestion.Suggestion
        The facts.
    """

    suggestion: Suggestion

    @property
    def content(self) -> dict[str, Any]:
        """A copy of the map, to be corrected and given to `gyrowheel.read_table`."""
        return copy.deepcopy(dict(self.suggestion.content))

    @property
    def questions(self) -> tuple[str, ...]:
        """Questions to answer before a diagnosis."""
        asked = [f"{own.what} {own.cure}" for own in self.suggestion.problems if own.asks]
        return (*asked, *(problem_and_map(wrong) for wrong in self.suggestion.setups))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Missing readings and what an import does about them."""
        found = self.suggestion
        problems = [f"{own.what} {own.cure}".strip() for own in found.problems if not own.asks]
        done = [f"{text}." for text in found.remarks if not text.startswith("not in the")]
        return tuple(dict.fromkeys([*problems, *done]))

    @property
    def settled(self) -> bool:
        """Whether no question is open."""
        return self.suggestion.settled

    def headline(self) -> str:
        """Return the table and the number of questions."""
        count = len(self.questions)
        asked = "no question" if not count else "one question" if count == 1 else f"{count} questions"
        return f"{self.suggestion.table}: {len(self.suggestion.proposals)} columns, {asked}"

    def page(self) -> Iterable[RenderableType]:
        """Return the columns with their ranges and reasons, then the questions and the remarks."""
        from gyrowheel.tables.page import suggestion_page

        return suggestion_page(self.suggestion, self.questions, self.remarks)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel import --suggest --json``."""
        d = self.suggestion
        return {
            "schema": 1,
            "table": d.table,
            "kind": d.kind,
            "settled": self.settled,
            "columns": [{name: getattr(own, name) for name in _COLUMN} for own in d.proposals],
            "questions": list(self.questions),
            "remarks": list(self.remarks),
            "unused": list(d.unused),
            "map": self.content,
        }

    def to_columns(self) -> Mapping[str, Any]:
        """Return a row for each recognised column."""
        return {name: [getattr(own, name) for own in self.suggestion.proposals] for name in _COLUMN}

    def plot(self) -> Figure:
        """Return a picture of the signals as the map reads them.

        Raises
        ------
        InputError
            If the table cannot be read by the map.
        """
        from gyrowheel.recordings.picture import recording_figure

        if self.suggestion.recording is None:
            raise InputError(f"{self.suggestion.table}: cannot be read by the suggested map; nothing to draw")
        return recording_figure(self.suggestion.recording, self.questions)

    def save(self, path: str | Path) -> None:
        """Write the map file, with a reason for every column and the questions on top.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        from gyrowheel_core.files import write_text

        write_text(Path(path), self.suggestion.map_text())


def suggest_map(table: Any, *, bench: str | Path = "gyrowheel") -> TableMap:
    """Suggest a map for a table: the reading and the unit of every column, with reasons.

    The suggestion follows from names, units and ranges, and is checked by the laws of the wheel. All doubts are
    reported at once.

    Parameters
    ----------
    table : path, pandas.DataFrame, pyarrow.Table or list of those
        CSV or other text, Parquet, Feather, MATLAB, HDF5, NumPy, TDMS, MDF, a bag of ROS 1 or ROS 2, or a table in
        memory. Of several, say of two loggers, columns are called ``file/column``; the offset of their clocks is found
        and put into the map.
    bench : str or Path
        The bench that it was measured on.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    from gyrowheel_recording.mapping.suggestion.suggest import suggest
    from gyrowheel_sim.bench import Bench

    grid = _in_memory(table)
    own = "" if str(bench) == "gyrowheel" else str(bench)
    return TableMap(suggest(_file(table), Bench.load(bench), bench_name=own, grid=grid))


def read_table(
    table: Any,
    column_map: TableMap | Mapping[str, Any] | str | Path | None = None,
    folder: str | Path | None = None,
    *,
    bench: str | Path = "gyrowheel",
) -> Recording:
    """Return a table as a recording: one row per sample.

    Parameters
    ----------
    table : path, pandas.DataFrame, pyarrow.Table or list of those
        CSV or other text, Parquet, Feather, MATLAB, HDF5, NumPy, TDMS, MDF, a bag, or a table in memory; rows in the
        order of time. Of several the columns are called ``file/column``.
    column_map : TableMap, mapping or path, optional
        Reading and unit of every column: the result of `suggest_map`, its content as a mapping, or a map file
        (docs/exchange.md). By default that of `suggest_map`, if it has no question.
    folder : str or Path, optional
        New directory to keep the recording in; a temporary one that is removed with the recording if not given.
    bench : str or Path
        The bench that it was measured on, if no map names it.

    Raises
    ------
    InputError
        If a file cannot be read, a column or a value is missing, a value or the times are impossible, the folder cannot
        be written, or no map is given and the suggested one has questions.
    """
    given = column_map
    if given is None:
        given = suggest_map(table, bench=bench)
        if not given.settled:
            asked = " ".join(f"({k}) {text}" for k, text in enumerate(given.questions, 1))
            raise InputError(
                f"{given.suggestion.table}: {len(given.questions)} questions about its columns: {asked} Answer by "
                "a map: `gyrowheel import --suggest` writes one to correct, gw.suggest_map returns one"
            )
    return Recording.written(folder, _name(table), lambda place: import_table(table, given, place))


def read_bag(
    bag: str | Path,
    column_map: TableMap | Mapping[str, Any] | str | Path | None = None,
    folder: str | Path | None = None,
    *,
    bench: str | Path = "gyrowheel",
) -> Recording:
    """Return a bag of ROS 1 or ROS 2 whose messages are not those of the bench as a recording.

    Columns are named by topic and field: ``/imu/data.angular_velocity.x``; those of a topic share its stamps. All else
    is as for `read_table`.

    Raises
    ------
    InputError
        As `read_table` does.
    """
    return read_table(bag, column_map, folder, bench=bench)


def _in_memory(table: Any) -> Grid | None:
    """Return a table of pandas or arrow, or several tables as one; None for a path."""
    if isinstance(table, str | Path):
        return None
    if isinstance(table, list | tuple):
        return _joined(table)
    import pyarrow as pa

    from gyrowheel_recording.tables.readers.arrow import of_table

    if isinstance(table, pa.Table):
        return of_table(table, _IN_MEMORY)
    try:
        if all(hasattr(table, own) for own in ("index", "columns", "to_numpy")):
            return of_table(pa.Table.from_pandas(table, preserve_index=_is_column(table.index)), _IN_MEMORY)
        if hasattr(table, "__arrow_c_stream__"):  # polars and others
            return of_table(pa.table(table), _IN_MEMORY)
    except InputError:
        raise
    except (pa.ArrowException, ValueError, TypeError) as error:
        raise InputError(f"{_IN_MEMORY}: cannot be read: {one_line(error)}") from None
    raise InputError(
        f"table: {type(table).__name__} is not allowed; allowed: a path, a table of pandas, pyarrow or polars, or a "
        "list of them"
    )


def _is_column(index: Any) -> bool:
    """Whether the index of a pandas table is a column: it has a name, or consists of times or measured values."""
    named = any(name is not None for name in getattr(index, "names", ()))
    return named or getattr(getattr(index, "dtype", None), "kind", "-") in "Mmf"


def _joined(tables: Sequence[Any]) -> Grid:
    """Return tables of several loggers as one, columns called ``file/column``, each file with its own times."""
    from gyrowheel_recording.tables import Grid, read_grid

    if not tables:
        raise InputError("table: an empty list; allowed: one table or more")
    columns, remarks, names = [], [], list[str]()
    for table in tables:
        grid = _in_memory(table) or read_grid(Path(table))
        own = _name(table)
        names.append(own if own not in names else f"{own}{len(names) + 1}")
        for column in grid.columns.values():
            clock = f"{names[-1]}/{column.clock}" if column.clock else ""
            columns.append(replace(column, name=f"{names[-1]}/{column.name}", clock=clock))
        remarks += [f"{names[-1]}: {remark}" for remark in grid.remarks]
    return replace(Grid.of(_file(tables), columns, remarks), files=tuple(names))


def _name(table: Any) -> str:
    """Return the name of a table: that of its file without endings, of several those of all."""
    if isinstance(table, list | tuple):
        return "_".join(dict.fromkeys(map(_name, table)))
    return Path(table).name.partition(".")[0] if isinstance(table, str | Path) else _IN_MEMORY


def _file(table: Any) -> str:
    """Return the path of a table for errors and pages."""
    if isinstance(table, list | tuple):
        return " and ".join(map(_file, table))
    return str(table) if isinstance(table, str | Path) else _IN_MEMORY


@dataclass(frozen=True)
class Imported:
    """Outcome of an import."""

    bench: str  # its name
    samples: int
    seconds: float  # time from the first to the last sample
    rate: float  # samples in a second
    remarks: tuple[str, ...]  # conversions and missing readings
    #: Contradictions of the map to the laws of the wheel, each with its fix; empty unless asked for.
    questions: tuple[str, ...] = ()


def import_table(
    table: Any,
    column_map: TableMap | Mapping[str, Any] | str | Path,
    folder: str | Path,
    *,
    question: bool = False,
) -> Imported:
    """Write a table as a recording, as `read_table` does, without reading it back; the folder is complete or absent.

    With `question`, the map is checked by the laws of the wheel.
    """
    from gyrowheel_core.files import new_directory, require_new
    from gyrowheel_recording.mapping import ColumnMap
    from gyrowheel_recording.mapping import import_table as write_recording

    require_new(Path(folder))
    if isinstance(column_map, TableMap):
        loaded = ColumnMap.from_mapping(column_map.content, "the suggested map")
    elif isinstance(column_map, Mapping):
        loaded = ColumnMap.from_mapping(dict(column_map), "the map")
    else:
        loaded = ColumnMap.load(column_map)
    grid = _in_memory(table)
    with new_directory(Path(folder)) as place:
        made = write_recording(_file(table), loaded, place, grid=grid)
    asked = _questions(Path(folder), loaded.bench) if question else ()
    return Imported(loaded.bench.name, made.samples, made.seconds, made.rate, made.remarks, asked)


def _questions(folder: Path, bench: Bench) -> tuple[str, ...]:
    """Return the contradictions of an imported recording to the laws of the wheel, each with a change of the map."""
    from gyrowheel_recording.mapping.suggestion.checks import broken_laws
    from gyrowheel_recording.mislabelled.find import wrong_setups

    recording = Recording.open(folder).data
    found = [problem_and_map(own) for own in wrong_setups([recording], bench)]
    return tuple(found or [f"{own.what} {own.cure}" for own in broken_laws(recording, bench)])


def write_table(
    recording: Recording | str | Path,
    file: str | Path,
    *,
    column_map: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[str]:
    """Write a recording as a table: one row per sample, SI units.

    The readings are followed by the command that answers the sample and by the setpoint in force.

    Parameters
    ----------
    recording : Recording or path
        The recording.
    file : str or Path
        The ``.csv`` or ``.parquet`` file, written atomically.
    column_map : str or Path, optional
        Map file to write, with which `read_table` reads the table back.
    progress : callable, optional
        Called with the fraction done, 0 .. 1.

    Returns
    -------
    list of str
        Names of the columns.

    Raises
    ------
    InputError
        If the recording cannot be read, the ending of `file` is not known, or a file cannot be written.
    """
    from gyrowheel_recording.mapping import export_recording

    check_suffix(file)
    given = recording if isinstance(recording, Recording) else Recording.open(recording)
    return export_recording(given.data, file, map_file=column_map, progress=progress)


def check_suffix(file: str | Path) -> None:
    """Raise InputError if the ending of a table is not known."""
    from gyrowheel_recording.mapping import check_suffix

    check_suffix(Path(file))
