"""Formats of tables: their signatures and readers."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from gyrowheel_core.errors import InputError
from gyrowheel_recording.tables import apart
from gyrowheel_recording.tables.grid import Grid
from gyrowheel_recording.tables.readers import arrays, arrow, bag, hdf5, lvm, matlab, mdf, tdms
from gyrowheel_recording.tables.readers import text_table as texts
from gyrowheel_recording.tables.text import text_of, unicode_of

_HEAD: Final = 1 << 16  # bytes by which a file is known
_HDF5: Final = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class Format:
    """A format of tables."""

    name: str  # short name, such as ``text`` or ``parquet``
    title: str  # what it is called
    endings: tuple[str, ...]  # usual endings, by which a file is known that does not show what it is
    begins: Callable[[bytes], bool]  # whether a file that begins with some bytes is of it
    read: apart.Reader  # reads some columns of a file, or all; see `read_grid`
    library: str = ""  # what reads it, in a separate process (see `apart`); empty where this project does


def _never(head: bytes) -> bool:
    return False


_FORMATS: Final = (
    Format(
        "parquet",
        "Parquet",
        (".parquet", ".pq"),
        lambda h: h.startswith(b"PAR1"),
        arrow.read,
        "pyarrow.parquet",
    ),
    Format(
        "mat",
        "MATLAB, up to version 7",
        (".mat",),
        lambda h: h.startswith(b"MATLAB 5.0"),
        matlab.read,
        "scipy.io",
    ),
    Format(
        "hdf5",
        "HDF5, MATLAB version 7.3",
        (".h5", ".hdf5", ".hdf"),
        lambda h: h.startswith(_HDF5) or h[512:520] == _HDF5,
        hdf5.read,
        "h5py",
    ),
    Format("numpy", "NumPy", (".npz", ".npy"), arrays.begins, arrays.read, "numpy"),
    Format(
        "feather",
        "Feather",
        (".feather", ".arrow"),
        lambda h: h.startswith(b"ARROW1"),
        arrow.read_feather,
        "pyarrow.ipc",
    ),
    Format("tdms", "TDMS", (".tdms",), lambda h: h.startswith(b"TDSm"), tdms.read, "nptdms"),
    Format(
        "mdf",
        "MDF",
        (".mf4", ".mdf", ".dat"),
        lambda h: h.startswith((b"MDF     ", b"UnFinMF ")),
        mdf.read,
        "asammdf",
    ),
    Format("lvm", "text of LabVIEW", (".lvm",), lambda h: h.startswith(lvm.MAGIC), lvm.read),
    Format(
        "bag",
        "bag of ROS 1 or ROS 2",
        (".bag", ".mcap", ".db3"),
        lambda h: h.startswith((b"#ROSBAG V", b"\x89MCAP", b"SQLite format 3\0")),
        bag.read,
        "rosbags",
    ),
    Format(
        "text",
        "text, comma-separated or other",
        (".csv", ".txt", ".tsv", ".dat", ".asc", ".log"),
        _never,
        texts.read,
    ),
)
_BY_NAME: Final = {own.name: own for own in _FORMATS}
#: What can be read, for messages.
READABLE: Final = (
    "text as CSV (plain, .gz, .zst), Parquet, Feather, MATLAB .mat, HDF5, NumPy .npz, TDMS, MDF4 .mf4, bags of ROS 2 "
    "and ROS 1"
)
#: What is sometimes taken for a table, and what to do with it.
_OTHERS: Final = (
    (b"PK\x03\x04", "a zip archive or a spreadsheet; save its sheet as CSV"),
    (b"\xd0\xcf\x11\xe0", "a spreadsheet; save its sheet as CSV"),
    (b"FEA1", "a Feather file of version 1; save it as Parquet"),
    (b"CDF\x01", "a netCDF 3 file; `nccopy -k nc4` makes netCDF 4 of it"),
    (b"CDF\x02", "a netCDF 3 file; `nccopy -k nc4` makes netCDF 4 of it"),
    (
        b"\x93NUMPY",
        "an array of NumPy, whose columns have no names; save it as .npz, an array for every reading",
    ),
    (b"{", "JSON; save it as CSV or Parquet, a column for every reading"),
    (b"[{", "JSON; save it as CSV or Parquet, a column for every reading"),
    (b"%PDF", "a PDF"),
    (b"\x89PNG", "a picture"),
)


def format_of(path: Path) -> Format:
    """Return the format of a file, by what it begins with, then by its ending.

    Raises InputError if there is no such file, or it is of none; the message lists what can be read.
    """
    try:
        if path.is_dir():
            if (path / "metadata.yaml").is_file():
                return _BY_NAME["bag"]
            raise InputError(f"{path}: cannot be read: it is not a file, and no bag (no metadata.yaml)")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: cannot be read: it is not a file")
        with path.open("rb") as file:
            raw = file.read(_HEAD)
        for form in _FORMATS:
            if form.begins(raw):
                return form
        for mark, what in _OTHERS:
            if raw.startswith(mark):
                raise InputError(f"{path}: is {what}; allowed: {READABLE}")
        head = text_of(path, most=_HEAD)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not head:
        raise InputError(f"{path}: cannot be read: it is empty")
    ending = path.suffix.lower()
    if path.suffix == ".mat":  # version 4 begins with numbers
        return _BY_NAME["mat"]
    if b"\0" not in head or unicode_of(head) != "utf-8":
        return _BY_NAME["text"]
    if ending == ".csv":
        raise InputError(f"{path}: is no text: it has a zero byte near its beginning; allowed: {READABLE}")
    named = next((f.title for f in _FORMATS if ending in f.endings), "")
    what = f"does not begin as {named} does" if named else "is of no known format"
    raise InputError(f"{path}: {what}; allowed: {READABLE}")


def read_grid(path: Path, names: Sequence[str] | None = None) -> Grid:
    """Read a table of any format: a file, or the directory of a bag; the columns `names` with their clocks, or all.

    Raises
    ------
    InputError
        If it cannot be read, or is larger than what may be read.
    """
    form = format_of(path)
    if not form.library:
        return form.read(path, names)
    with contextlib.suppress(ImportError):  # once, for all processes; the reader reports one that is missing
        importlib.import_module(form.library)
    return apart.read(form.read, path, names)
