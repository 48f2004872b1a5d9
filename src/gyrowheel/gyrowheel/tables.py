"""Recordings from tables of other programs, and tables from recordings."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gyrowheel.recording import Recording


def read_table(file: str | Path, column_map: str | Path, folder: str | Path | None = None) -> Recording:
    """Return the recording that a table holds: one row per sample.

    Parameters
    ----------
    file : str or Path
        A ``.csv`` or ``.parquet`` file, rows in the order of time.
    column_map : str or Path
        Map file: which column holds which reading, in which unit; docs/exchange.md describes it.
    folder : str or Path, optional
        New directory to keep the recording in; a temporary one that is removed with the recording if not given.

    Raises
    ------
    InputError
        If a file cannot be read, a column is missing, a value is missing or cannot be meant, the times are not
        uniform at the sample period of the bench, or the folder cannot be written.
    """
    if folder is not None:
        import_table(file, column_map, folder)
        return Recording.made(Path(folder))
    scratch = tempfile.TemporaryDirectory(prefix="gyrowheel-")
    place = Path(scratch.name) / Path(file).stem
    import_table(file, column_map, place)
    return Recording.made(place, scratch)


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
        What so many samples last [s].
    """

    bench: str
    samples: int
    seconds: float


def import_table(file: str | Path, column_map: str | Path, folder: str | Path) -> Imported:
    """Make a recording of a table, as `read_table` does, without reading it back; the folder is whole or not there."""
    from gyrowheel_analysis.exchange import ColumnMap
    from gyrowheel_analysis.exchange import import_table as write_recording
    from gyrowheel_core.files import new_directory, require_new

    require_new(Path(folder))
    loaded = ColumnMap.load(column_map)
    with new_directory(Path(folder)) as place:
        samples = write_recording(file, loaded, place)
    return Imported(loaded.bench.name, samples, (samples - 1) * loaded.bench.sample_period)


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
    from gyrowheel_analysis.exchange import export_recording

    check_suffix(file)
    given = recording if isinstance(recording, Recording) else Recording.open(recording)
    return export_recording(given.data, file, map_file=column_map, progress=progress)


def check_suffix(file: str | Path) -> None:
    """Refuse a table whose ending is not known."""
    from gyrowheel_analysis.exchange import check_suffix

    check_suffix(Path(file))
