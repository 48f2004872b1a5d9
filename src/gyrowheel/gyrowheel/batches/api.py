"""Diagnoses of many recordings as a table, a row for each; resumable, on all cores or a cluster."""

from __future__ import annotations

import functools
import hashlib
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrowheel.batches.workers import check_jobs, cores, finished
from gyrowheel.models.api import Model
from gyrowheel.show.result import Result
from gyrowheel.simulation.code_identity import code_identity
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.files import json_text, new_file, read_errors

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrowheel_analysis.diagnosis.estimates import Estimate, NuisanceEstimate

Row = dict[str, Any]

#: Columns that every row has, before those of coefficients and bench parameters.
COLUMNS = (
    "recording",
    "key",
    "version",
    "machine",
    "start",
    "duration",
    "windows",
    "verdict",
    "proven",
    "summary",
    "effects",
    "chi2_per_n_before",
    "chi2_per_n",
    "error",
    "seconds",
)
ENDINGS = (".parquet", ".csv")
_TEXTS = ("recording", "key", "version", "machine", "verdict", "summary", "effects", "error")
_ADDED = ("version", "proven")  # columns that earlier tables lack
_WRITTEN_EVERY = 2.0  # s; rows of a shorter time are written together
_METADATA = "metadata.yaml"
_STORAGES = (".mcap", ".db3")


@dataclass(frozen=True, repr=False)
class Batch(Result):
    """Outcome of `gyrowheel.batch`.

    Attributes
    ----------
    rows : tuple of dict
        A row a recording: see `COLUMNS`; then ``EFFECT.COEFFICIENT`` and ``EFFECT.COEFFICIENT.error`` of every effect
        that was found, and the same of every fitted bench parameter [SI]; as ``.data``, ``.data_error`` and
        ``.data_scatter`` what the recording alone says of it, without its prior, and how that would scatter between
        recordings of the same machine. ``proven`` is whether the recording is consistent with what was found, None
        where it does not decide. ``error`` is the reason why a recording could not be diagnosed, or empty;
        ``key`` identifies recording and model, ``version`` the code and libraries that diagnosed it.
    kept : int
        Number of rows that the file had already.
    outdated : int
        Number of rows that it had of another version; their recordings are diagnosed again.
    interrupted : bool
        Whether Ctrl-C ended the batch before all recordings were diagnosed.
    """

    rows: tuple[Row, ...]
    kept: int = 0
    outdated: int = 0
    interrupted: bool = False

    def headline(self) -> str:
        """Return the numbers of recordings and of failures."""
        failures = sum(bool(row["error"]) for row in self.rows)
        return f"{len(self.rows)} recordings diagnosed" + (f", {failures} of them failed" if failures else "")

    def page(self) -> Iterable[RenderableType]:
        """Return the verdicts, the effects that were found, and the failures."""
        from gyrowheel.batches.page import batch_page

        return batch_page(self.rows)

    def to_dict(self) -> dict[str, Any]:
        """Return the rows as JSON; SI units."""
        return {"schema": 1, "rows": list(self.rows), "interrupted": self.interrupted}

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the rows as columns; SI units."""
        return columns_of(self.rows)


def batch(
    folders: str | Path | Iterable[str | Path],
    model: Model,
    output: str | Path | None = None,
    *,
    jobs: int | None = None,
    dask: str | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> Batch:
    """Diagnose every recording below some folders, each alone; a row of a table for each.

    Parameters
    ----------
    folders : str, Path or iterable of these
        Folders that are searched, or recordings.
    model : Model
        The model.
    output : str or Path, optional
        Table that is written as the diagnoses end, ``.parquet`` or ``.csv``. Recordings that it has already, unchanged
        and by the same version with the same model, are not diagnosed again.
    jobs : int, optional
        Recordings at a time; one per core if not given.
    dask : str, optional
        Address of a Dask scheduler whose workers do the work; they must see the recordings under the same paths.
    progress : callable, optional
        Called after each recording with the numbers of finished ones and of all, and the recording's path.

    Returns
    -------
    Batch
        All rows, also after Ctrl-C.

    Raises
    ------
    InputError
        If a folder does not exist or has no recording, or the table cannot be read or written.
    """
    jobs = cores() if jobs is None else jobs
    check_jobs(jobs)
    table = None if output is None else Path(output)
    if table is not None and table.suffix not in ENDINGS:
        raise InputError(f"{table}: must end in {' or '.join(ENDINGS)}")
    paths = recordings_below([folders] if isinstance(folders, str | Path) else list(folders))
    content = hashlib.sha256(json_text(model.to_dict()).encode()).hexdigest()
    keys = {path: _key(path, content) for path in paths}
    known = {row["key"]: row for row in ([] if table is None else read_rows(table))}
    version = _version()
    there = {path: known[key] for path, key in keys.items() if key in known}
    done = {path: row for path, row in there.items() if row["version"] == version}
    given = {_written(str(path)) for path in paths}
    others = [row for row in known.values() if row["recording"] not in given]
    kept, interrupted, written = len(done), False, time.monotonic()

    def rows() -> list[Row]:
        return [*others, *(done[path] for path in paths if path in done)]

    call = functools.partial(diagnosed, model.details)
    try:
        left = [(str(path), keys[path]) for path in paths if path not in done]
        with finished(call, left, jobs=jobs, dask=dask) as results:
            for row in results:
                done[Path(row["recording"])] = row | {"version": version}
                if table is not None and time.monotonic() - written > _WRITTEN_EVERY:
                    write_rows(table, rows())
                    written = time.monotonic()
                if progress is not None:
                    progress(len(done), len(paths), row["recording"])
    except KeyboardInterrupt:
        if not done:
            raise
        interrupted = True
    finally:
        if table is not None and len(done) > kept:
            write_rows(table, rows())
    return Batch(tuple(rows()), kept, len(there) - kept, interrupted)


def recordings_below(folders: Sequence[str | Path]) -> list[Path]:
    """Return every recording below some folders, in the order of their paths; a recording itself counts as well."""
    found: dict[Path, None] = {}
    for folder in map(Path, folders):
        if not folder.exists():
            raise InputError(f"{folder}: no such folder")
        if folder.is_file():
            own = [folder]
        else:
            own = sorted({file.parent for file in folder.rglob(_METADATA)})
            within = set(own)
            own += sorted(
                file
                for file in folder.rglob("*")
                if file.suffix in _STORAGES and file.parent not in within and file.is_file()
            )
        if not own:
            raise InputError(f"{folder}: no recording in it; allowed: folders with {_METADATA}, .mcap, .db3")
        found |= dict.fromkeys(own)
    return list(found)


def _key(path: Path, model: str) -> str:
    """Return a digest of the model and of names, sizes and times of the files of a recording."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    digest = hashlib.sha256(model.encode())
    for file in files:
        state = file.stat()
        digest.update(os.fsencode(file.name) + f" {state.st_size} {state.st_mtime_ns}\n".encode())
    return digest.hexdigest()[:16]


def _version() -> str:
    """Return the version of the project, and a digest of everything that a diagnosis depends on."""
    identity = code_identity()
    return (
        f"{identity['gyrowheel'].split()[0]} {hashlib.sha256(json_text(identity).encode()).hexdigest()[:12]}"
    )


def diagnosed(model: Any, item: tuple[str, str], scratch: str | None = None) -> Row:
    """Return the row of one recording, given as its path and key; a failure is part of the row.

    MemoryError and OSError are raised: they concern the computer, and the batch can be called again.
    """
    from gyrowheel import Recording, diagnose

    path, key = item
    row: Row = dict.fromkeys(COLUMNS)
    row |= {"recording": path, "key": key, "error": ""}
    began = time.monotonic()
    try:
        recording = Recording.open(path)
        row |= {
            "machine": recording.data.machine,
            "start": recording.data.start_ns * 1e-9,
            "duration": recording.duration,
        }
        found = diagnose(recording, Model.of(model))
    except (MemoryError, OSError):
        raise
    except InputError as error:
        row |= {"verdict": "failed", "error": str(error)}
    except Exception as error:  # one recording must not end the others
        row |= {"verdict": "failed", "error": f"internal error: {type(error).__name__}: {one_line(error)}"}
    else:
        row |= {
            "windows": found.windows,
            "verdict": found.verdict,
            "proven": None if found.proof is None else found.proof.proven,
            "summary": found.headline(),
            "effects": ", ".join(finding.name for finding in found.effects),
        }
        if found.error is not None:
            before, after = found.error.before, found.error.after
            row |= {"chi2_per_n_before": before.chi2_per_n, "chi2_per_n": after.chi2_per_n}
        for finding in found.effects:
            for name, estimate in finding.coefficients.items():
                row |= _estimate(f"{finding.name}.{name}", estimate, has_prior=estimate.prior is not None)
        for name, own in found.nuisance.items():
            row |= _estimate(name, own, has_prior=True)
    return row | {"seconds": time.monotonic() - began}


def _estimate(name: str, own: Estimate | NuisanceEstimate, *, has_prior: bool) -> Row:
    """Return the columns of an estimate; those of the data alone where they determine it."""
    row: Row = {name: own.value, f"{name}.error": own.standard_error}
    data = own.data if has_prior else (own.value, own.standard_error)
    if data is not None:
        row |= {f"{name}.data": data[0], f"{name}.data_error": data[1], f"{name}.data_scatter": own.scatter}
    return row


def columns_of(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """Return rows as columns; a row without a column has None there."""
    names = dict.fromkeys(COLUMNS)
    for row in rows:
        names |= dict.fromkeys(row)
    return {name: [row.get(name) for row in rows] for name in names}


def read_rows(table: Path) -> list[Row]:
    """Return the rows of a table that `write_rows` wrote; none if there is no such file."""
    if not table.exists():
        return []
    import pyarrow
    import pyarrow.csv
    import pyarrow.parquet

    texts = pyarrow.csv.ConvertOptions(
        column_types=dict.fromkeys(_TEXTS, pyarrow.string()),
        strings_can_be_null=True,
        quoted_strings_can_be_null=False,
    )
    with read_errors(table), table.open("rb") as opened:  # opened here: arrow refuses names that are no text
        try:
            if table.suffix == ".parquet":
                found = pyarrow.parquet.read_table(opened)
            else:
                found = pyarrow.csv.read_csv(opened, convert_options=texts)
        except pyarrow.ArrowInvalid as error:
            raise InputError(f"{table}: not a table of a batch ({one_line(error)})") from None
    if missing := [name for name in COLUMNS if name not in (*found.column_names, *_ADDED)]:
        raise InputError(f"{table}: not a table of a batch: it has no column {missing[0]}")
    rows = [{n: v for n, v in row.items() if v is not None or n in COLUMNS} for row in found.to_pylist()]
    return [dict.fromkeys(_ADDED) | row | {"error": row["error"] or ""} for row in rows]


def write_rows(table: Path, rows: Sequence[Row]) -> None:
    """Write rows as a table, atomically."""
    import pyarrow
    import pyarrow.csv
    import pyarrow.parquet

    columns = columns_of(rows)
    content = pyarrow.table({name: [_written(value) for value in own] for name, own in columns.items()})
    with new_file(table) as place, place.open("wb") as opened:
        if table.suffix == ".parquet":
            pyarrow.parquet.write_table(content, opened)
        else:
            pyarrow.csv.write_csv(content, opened)


def _written(value: Any) -> Any:
    """Return a value as a table has it: bytes of a path that are no text as escapes."""
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value
