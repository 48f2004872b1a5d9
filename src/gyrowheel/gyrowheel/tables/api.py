"""Recordings from tables of other programs, and tables from recordings."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrowheel.recordings.api import Recording
from gyrowheel_core.errors import InputError, one_line

if TYPE_CHECKING:
    from gyrowheel.tables.table_map import TableMap
    from gyrowheel_recording.tables import Grid
    from gyrowheel_sim.bench import Bench

_IN_MEMORY = "table"  # name of a table that is no file


def suggest_map(table: Any, *, bench: str | Path = "gyrowheel") -> TableMap:
    """Look at a table and suggest a map for it: which column holds which reading, in which unit, and why.

    Names, units and ranges are looked at; then the laws of the wheel are asked whether the columns can be what they
    are called. All that is doubtful is told at once.

    Parameters
    ----------
    table : path, pandas.DataFrame, pyarrow.Table or list of those
        CSV or other text, Parquet, MATLAB, HDF5, TDMS, MDF, a bag of ROS 1 or ROS 2, or a table in memory. Of
        several, say of two loggers, columns are called ``file/column``; how far their clocks are apart is found and put
        into the map.
    bench : str or Path
        The bench that it was measured on.

    Raises
    ------
    InputError
        If it cannot be read at all.
    """
    from gyrowheel.tables.table_map import TableMap
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
    """Return the recording that a table holds: one row per sample.

    Parameters
    ----------
    table : path, pandas.DataFrame, pyarrow.Table or list of those
        CSV or other text, Parquet, MATLAB, HDF5, TDMS, MDF, a bag, or a table in memory; rows in the order of time. Of
        several the columns are called ``file/column``.
    column_map : TableMap, mapping or path, optional
        Which column holds which reading, in which unit: what `suggest_map` returns, its content as a mapping, or a map
        file (docs/exchange.md). What `suggest_map` finds if not given, where that leaves no question.
    folder : str or Path, optional
        New directory to keep the recording in; a temporary one that is removed with the recording if not given.
    bench : str or Path
        The bench that it was measured on, where no map says it.

    Raises
    ------
    InputError
        If a file cannot be read, a column is missing, a value is missing or cannot be meant, the times are those of no
        clock, the folder cannot be written, or no map is given and one cannot be told without a question.
    """
    given = column_map
    if given is None:
        given = suggest_map(table, bench=bench)
        if not given.settled:
            asked = " ".join(f"({k}) {text}" for k, text in enumerate(given.questions, 1))
            raise InputError(
                f"{given.details.table}: {len(given.questions)} questions about its columns: {asked} Answer by "
                "a map: `gyrowheel import --suggest` writes one to correct, gw.suggest_map returns one"
            )
    if folder is not None:
        import_table(table, given, folder)
        return Recording.made(Path(folder))
    scratch = tempfile.TemporaryDirectory(prefix="gyrowheel-")
    place = Path(scratch.name) / _name(table)
    import_table(table, given, place)
    return Recording.made(place, scratch)


def read_bag(
    bag: str | Path,
    column_map: TableMap | Mapping[str, Any] | str | Path | None = None,
    folder: str | Path | None = None,
    *,
    bench: str | Path = "gyrowheel",
) -> Recording:
    """Return the recording that a bag of ROS 1 or ROS 2 with other messages than the bench's holds.

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
    """Whether the index of a table of pandas is a column of it: it has a name, or holds times or measured values."""
    named = any(name is not None for name in getattr(index, "names", ()))
    return named or getattr(getattr(index, "dtype", None), "kind", "-") in "Mmf"


def _joined(tables: Sequence[Any]) -> Grid:
    """Return tables of several loggers as one: each a folder of columns, named like its file, with its own times."""
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
    return Grid.of(_file(tables), columns, remarks)


def _name(table: Any) -> str:
    """Return what a table is called: the name of its file without endings, of several those of all."""
    if isinstance(table, list | tuple):
        return "_".join(dict.fromkeys(map(_name, table)))
    return Path(table).name.partition(".")[0] if isinstance(table, str | Path) else _IN_MEMORY


def _file(table: Any) -> str:
    """Return how errors and pages name a table."""
    if isinstance(table, list | tuple):
        return " and ".join(map(_file, table))
    return str(table) if isinstance(table, str | Path) else _IN_MEMORY


@dataclass(frozen=True)
class Imported:
    """What a table held.

    Attributes
    ----------
    bench : str
        Name of the bench.
    samples : int
        Number of samples.
    seconds : float
        Time from the first to the last [s].
    rate : float
        Samples in a second.
    remarks : tuple of str
        What was done to make a recording of it, and what it lacks.
    questions : tuple of str
        What the laws of the wheel say against the map, each with its cure; empty unless it was asked for.
    """

    bench: str
    samples: int
    seconds: float
    rate: float
    remarks: tuple[str, ...]
    questions: tuple[str, ...] = ()


def import_table(
    table: Any,
    column_map: TableMap | Mapping[str, Any] | str | Path,
    folder: str | Path,
    *,
    question: bool = False,
) -> Imported:
    """Make a recording of a table, as `read_table` does, without reading it back; the folder is whole or not there.

    With `question`, the laws of the wheel are asked whether its columns can be what the map calls them.
    """
    from gyrowheel.tables.table_map import TableMap
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
    """Return what the laws of the wheel say against an imported recording, each with what to change in the map."""
    from gyrowheel.show.sentences.setup import problem_and_map
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

    Beside the readings stand the command that answers the sample and the setpoint in force.

    Parameters
    ----------
    recording : Recording or path
        The recording.
    file : str or Path
        The ``.csv`` or ``.parquet`` file; it is whole or as it was before.
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
    """Refuse a table whose ending is not known."""
    from gyrowheel_recording.mapping import check_suffix

    check_suffix(Path(file))
