"""Readers in a separate process, with limits of memory and time.

A library that reads a format obeys what a file states of its size, and a damaged file may bring it down. The process is
a fork of the running one: a new interpreter would take 0.7 s of the processor to import what is already there (2 s for
MDF), a fork takes some hundredths. It hands the table over as plain arrays, never as objects that run code.
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import logging
import mmap
import os
import resource
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import LARGEST_VARIABLE, largest_unpacked
from gyrowheel_recording.tables.grid import Column, Grid

#: Reads some columns of a file, or all (see `formats.read_grid`).
Reader = Callable[[Path, Sequence[str] | None], Grid]
#: Memory [bytes] and time of the processor [s] that the smallest file may take, and what each byte of a file adds.
_ROOM, _ROOM_A_BYTE = 1.5e9, 32.0
#: What the threads and buffers of a library take at any rate [bytes].
_LIBRARY: Final = 1e8
_TIME, _TIME_A_BYTE = 12.0, 10e-6
_PATIENCE: Final = 10  # by the clock, in times of the processor: others may have it
_ALIGNED: Final = 64  # bytes
_FAILED: Final = 1


def read(reader: Reader, path: Path, names: Sequence[str] | None) -> Grid:
    """Return what a reader reads (see `formats.read_grid`).

    Raises
    ------
    InputError
        As the reader does, and if it takes more memory or time than it may, or does not survive the file.
    """
    size = _size(path)
    room = _room(size)
    seconds = int(_TIME + _TIME_A_BYTE * size)
    with open(os.memfd_create("gyrowheel-table"), "w+b") as table:  # in memory, without a name
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # other threads are not needed by what runs in the fork
            process = os.fork()
        if not process:
            _work(reader, path, names, table, room, seconds)
        try:
            _, status = os.waitpid(process, 0)
        except BaseException:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
            raise
        ended = os.waitstatus_to_exitcode(status)
        if ended in (-signal.SIGXCPU, -signal.SIGALRM):
            raise InputError(f"{path}: cannot be read: it takes more than {seconds} s: damaged")
        if ended:
            raise InputError(
                f"{path}: cannot be read: damaged, or it needs more memory than {room / 1e9:.3g} GB "
                f"({LARGEST_VARIABLE} allows more)"
            )
        return _received(table)


def _size(path: Path) -> int:
    """Return the size of a file or of the files of a folder [bytes]."""
    with contextlib.suppress(OSError):
        files = path.iterdir() if path.is_dir() else [path]
        return sum(file.stat().st_size for file in files)
    return 0


def _room(size: int) -> float:
    """Return the memory that a file of a size may take [bytes]: what the user states, if so, else what is usual."""
    most = float(largest_unpacked())
    return most if os.environ.get(LARGEST_VARIABLE) else min(most, _ROOM + _ROOM_A_BYTE * size)


def _work(
    reader: Reader,
    path: Path,
    names: Sequence[str] | None,
    table: BinaryIO,
    room: float,
    seconds: int,
) -> None:
    """Read, write the table or the error, and end: nothing that the running process has open is flushed."""
    status = _FAILED
    try:
        faulthandler.disable()
        for kind in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM, signal.SIGXCPU):
            signal.signal(kind, signal.SIG_DFL)
        nothing = os.open(os.devnull, os.O_RDWR)
        for own in (1, 2):  # libraries print and log what they think of a file
            os.dup2(nothing, own)
        sys.stdout = sys.stderr = os.fdopen(nothing, "w", encoding="utf-8")
        logging.disable()
        limit = int(_data_size() + _LIBRARY + room)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.alarm(_PATIENCE * seconds)
        try:
            _hand_over(reader(path, names), table)
        except MemoryError:
            raise
        except Exception as error:
            table.seek(0)
            table.truncate()
            wrong = isinstance(error, InputError)
            _write_head(table, {"error": str(error)} if wrong else {"defect": traceback.format_exc()})
        table.flush()
        status = 0
    finally:
        os._exit(status)


def _data_size() -> int:
    """Return the memory that this process has for its data [bytes], as the system counts it against its limit."""
    with open("/proc/self/status", encoding="ascii", errors="replace") as file:
        return next((1024 * int(line.split()[1]) for line in file if line.startswith("VmData:")), 0)


def _write_head(table: BinaryIO, head: dict[str, Any]) -> None:
    text = json.dumps(head).encode("ascii")
    table.write(len(text).to_bytes(8, "little") + text)


def _hand_over(grid: Grid, table: BinaryIO) -> None:
    """Write a table: a head of JSON, then the arrays of its columns."""
    about = []
    arrays = []
    for column in grid.columns.values():
        own: dict[str, Any] = {"name": column.name, "unit": column.unit, "clock": column.clock}
        if column.values.dtype.kind in "biufM":
            array = np.ascontiguousarray(column.values)
            arrays.append(array)
            own |= {"type": array.dtype.str, "rows": len(array)}
        else:
            own["texts"] = [str(value) for value in column.values]
        about.append(own)
    _write_head(table, {"name": grid.name, "remarks": grid.remarks, "columns": about})
    for array in arrays:
        table.write(b"\0" * (-table.tell() % _ALIGNED))
        table.write(array.view(np.uint8).data)


def _received(table: BinaryIO) -> Grid:
    """Return the table that was written; its arrays are those in the file, without a copy."""
    data = mmap.mmap(table.fileno(), 0, access=mmap.ACCESS_COPY)
    place = 8 + int.from_bytes(data[:8], "little")
    head = json.loads(data[8:place])
    if "error" in head:
        raise InputError(head["error"])
    if "defect" in head:
        raise RuntimeError(head["defect"])
    columns = {}
    for own in head["columns"]:
        if "texts" in own:
            values: Any = np.array(own["texts"], dtype=object)
        else:
            kind = np.dtype(own["type"])
            place += -place % _ALIGNED
            values = np.frombuffer(data, kind, own["rows"], place) if own["rows"] else np.zeros(0, kind)
            place += values.nbytes
        columns[own["name"]] = Column(own["name"], values, own["unit"], own["clock"])
    return Grid(head["name"], columns, tuple(head["remarks"]))
