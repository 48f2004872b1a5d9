"""Libraries read foreign formats in a process of their own: within limits, and whatever becomes of it."""

from __future__ import annotations

import os
import signal
import struct
import threading
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import LARGEST_VARIABLE
from gyrowheel_recording.tables import apart, read_grid
from gyrowheel_recording.tables.grid import Column, Grid

Names = Sequence[str] | None


def of_every_type(path: Path, names: Names) -> Grid:
    kinds = ("<f8", ">f4", "<f2", "<i8", ">i2", "u1", "?", "<M8[ns]")
    columns = [Column(f"c{k}", np.array([0, 1, 1]).astype(kind), "V", "c0") for k, kind in enumerate(kinds)]
    columns.append(Column("none", np.zeros(0)))
    columns.append(Column("strided", np.arange(12.0).reshape(3, 4)[:, 1]))
    columns.append(Column("texts \udcff", np.array(["a\n", "ü", ""], dtype=object)))
    return Grid.of(str(path), columns, ["a remark"])


def test_a_table_comes_over_as_it_was(tmp_path: Path) -> None:
    own, found = of_every_type(tmp_path, None), apart.read(of_every_type, tmp_path, None)
    assert (found.name, found.remarks, list(found.columns)) == (own.name, own.remarks, list(own.columns))
    for name, column in own.columns.items():
        other = found.columns[name]
        assert (other.name, other.unit, other.clock) == (name, column.unit, column.clock)
        assert other.values.dtype == column.values.dtype
        assert np.array_equal(other.values, column.values)
    found.columns["c0"].values[0] = 5.0  # nothing keeps it from being worked on


def greedy(path: Path, names: Names) -> Grid:
    return Grid.of(str(path), [Column("x", np.ones(10**9))])


def endless(path: Path, names: Names) -> Grid:
    while True:
        pass


def waiting(path: Path, names: Names) -> Grid:
    os.read(os.pipe()[0], 1)
    return greedy(path, names)


def broken(path: Path, names: Names) -> Grid:
    os.kill(os.getpid(), signal.SIGSEGV)
    return greedy(path, names)


@pytest.mark.parametrize(
    ("reader", "said"),
    [
        (greedy, f"damaged, or it needs more memory than 1.5 GB ({LARGEST_VARIABLE} allows more)"),
        (endless, "it takes more than 1 s: damaged"),
        (waiting, "it takes more than 1 s: damaged"),
        (broken, f"damaged, or it needs more memory than 1.5 GB ({LARGEST_VARIABLE} allows more)"),
    ],
)
def test_whatever_a_library_does_ends_in_one_error(
    reader: apart.Reader, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "_TIME", 1.0)
    monkeypatch.setattr(apart, "_PATIENCE", 1)
    with pytest.raises(InputError) as error:
        apart.read(reader, tmp_path / "t.x", None)
    assert str(error.value) == f"{tmp_path / 't.x'}: cannot be read: {said}"


def test_the_user_may_allow_more_memory_or_less(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LARGEST_VARIABLE, "0.2")
    with pytest.raises(InputError, match=r"more memory than 0\.2 GB"):
        apart.read(lambda path, names: Grid.of("x", [Column("x", np.ones(10**8))]), tmp_path, None)


def defective(path: Path, names: Names) -> Grid:
    raise KeyError("of our own")


def test_a_defect_of_a_reader_stays_one(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="KeyError: 'of our own'"):
        apart.read(defective, tmp_path, None)


def test_tables_are_read_while_other_threads_work(tmp_path: Path) -> None:
    file = tmp_path / "t.parquet"
    pq.write_table(pa.table({f"c{k}": np.arange(1000.0) + k for k in range(20)}), file)
    ended = threading.Event()

    def work() -> None:
        while not ended.is_set():
            pq.read_table(file)
            np.ones((200, 200)) @ np.ones((200, 200))

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(5):
            assert read_grid(file).columns["c19"].values[-1] == 1018.0
    finally:
        ended.set()
        for thread in threads:
            thread.join()


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def array(kind: int, data: bytes) -> bytes:
    flags, sizes = struct.pack("<II", kind, 0), struct.pack("<2i", 1, 1)
    return element(14, element(6, flags) + element(5, sizes) + element(1, b"x") + data)


@pytest.mark.parametrize("packed", [False, True])
def test_arrays_within_arrays_without_an_end(packed: bool, tmp_path: Path) -> None:
    """SciPy goes down until the program ends."""
    cell = array(6, element(9, struct.pack("<d", 1.0)))
    for _ in range(6000):
        cell = array(1, cell)
    if packed:
        small = zlib.compress(cell)
        cell = struct.pack("<II", 15, len(small)) + small
    file = tmp_path / "t.mat"
    file.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x100) + b"IM" + cell)
    with pytest.raises(InputError, match=r"t\.mat: (cannot be read: |has no columns of numbers)"):
        read_grid(file)


def test_a_unit_that_is_none(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "t.h5", "w") as out:
        out["x"] = np.arange(3.0)
        out["x"].attrs["unit"] = "V" * 60_000
    grid = read_grid(tmp_path / "t.h5")
    assert grid.columns["x"].unit == ""
    assert grid.remarks == ("x: a unit of 60000 characters: not used",)
