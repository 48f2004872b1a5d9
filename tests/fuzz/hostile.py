"""Whole files of the formats that libraries read, made to take memory or time: sizes without an end, loops, bombs."""

from __future__ import annotations

import bz2
import contextlib
import io
import random
import sqlite3
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import nptdms
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

_ZEROS = 1 << 24
_PACKED = zlib.compress(bytes(_ZEROS), 9)


def hostile(rng: random.Random, folder: Path, whole: list[tuple[str, bytes]]) -> tuple[str, bytes]:
    """Return a file and its name: one of the makers below, or a whole file whose numbers lead elsewhere."""
    if rng.random() < 0.4:
        name, data = rng.choice(whole)
        return name, _relinked(data, rng)
    ending = rng.choice(list(_MAKERS))
    place = folder / f"hostile{ending}"
    place.unlink(missing_ok=True)
    rng.choice(_MAKERS[ending])(rng, place)
    return place.name, place.read_bytes()


def _relinked(data: bytes, rng: random.Random) -> bytes:
    """Return a file with one to three of its numbers in the place of others: loops, and counts of something else."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        size = rng.choice((2, 4, 8, 8, 8))
        a, b = (size * rng.randrange(max(len(data) // size, 1)) for _ in range(2))
        changed[a : a + size] = data[b : b + size]
    return bytes(changed)


def _large(rng: random.Random, most: float = 18.0) -> int:
    return int(10.0 ** rng.uniform(4.0, most))


# ---- HDF5


def _unwritten(rng: random.Random, place: Path) -> None:
    """Write data sets of any size that take no room in the file."""
    with h5py.File(place, "w") as file:
        for k in range(rng.choice((1, 3, 300))):
            shape = rng.choice(((_large(rng),), (_large(rng, 9.0), _large(rng, 9.0)), (_large(rng, 7.0), 2)))
            options = rng.choice(({}, {"chunks": tuple(min(n, 1000) for n in shape)}))
            file.create_dataset(f"d{k}", shape, rng.choice(("f8", "i1", ">u2", "S9", "(2,)f4")), **options)


def _zeros(rng: random.Random, place: Path) -> None:
    """Write chunks that unpack to a thousand times their size."""
    with h5py.File(place, "w") as file:
        for k in range(rng.choice((1, 4))):
            chunks = rng.choice((1, 8, 200))
            own = file.create_dataset(f"d{k}", (chunks * _ZEROS,), "u1", chunks=(_ZEROS,), compression="gzip")
            for chunk in range(chunks):
                own.id.write_direct_chunk((chunk * _ZEROS,), _PACKED)


def _links(rng: random.Random, place: Path) -> None:
    """Write groups that lead to themselves, to other files, or deep down."""
    with h5py.File(place, "w") as file:
        group: Any = file
        for k in range(rng.choice((3, 60, 500))):
            group = group.create_group(f"g{k % 3}")
        group["x"] = np.arange(5.0)
        group["loop"] = file["/"]
        group["soft"] = h5py.SoftLink("/g0/soft")
        group["out"] = h5py.ExternalLink(rng.choice(("/etc/passwd", str(place), "missing.h5")), "/x")
        layout = h5py.VirtualLayout((_large(rng, 12.0),), "f8")
        layout[:5] = h5py.VirtualSource(".", "x", (5,))
        file.create_virtual_dataset("v", layout)
        file.create_dataset("e", (100,), "f8", external=[("/etc/passwd", 0, 800)])


# ---- MATLAB


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def _variable(rng: random.Random, place: Path) -> None:
    """Write a variable of stated sizes that are not there, an opaque object, or cells within cells."""
    rows = rng.choice((_large(rng, 9.3), 1, 0))
    sizes = struct.pack("<2i", rows, rng.choice((1, 1000, -1, 2**31 - 1)))
    kind = rng.choice((1, 2, 3, 4, 5, 6, 12, 16, 17))
    head = _element(6, struct.pack("<II", kind | rng.choice((0, 0x800, 0x400)) << 0, _large(rng, 9.0)))
    cell = _element(14, head + _element(5, sizes) + _element(1, b"x") + _element(9, bytes(8 * 5)))
    if kind == 17:  # opaque: its name, and those of its system and class
        cell = _element(14, head + _element(1, b"x") + _element(1, b"MCOS") + _element(1, b"table") + cell)
    for _ in range(rng.choice((0, 0, 3, 1000))):
        outer = (
            _element(6, struct.pack("<II", 1, 0)) + _element(5, struct.pack("<2i", 1, 1)) + _element(1, b"x")
        )
        cell = _element(14, outer + cell)
    if rng.random() < 0.3:
        cell = (
            struct.pack("<II", 14, rng.choice((_ZEROS - 8, 2**32 - 1))) + cell + bytes(_ZEROS - 8 - len(cell))
        )
    if rng.random() < 0.6:
        packed = zlib.compress(cell)
        cell = struct.pack("<II", 15, len(packed)) + packed
    place.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x100) + b"IM" + cell)


def _old_variable(rng: random.Random, place: Path) -> None:
    """Write a variable of version 4 of any size."""
    sizes = _large(rng, 9.3), rng.choice((1, 2, _large(rng, 9.3)))
    place.write_bytes(
        struct.pack("<5i", rng.choice((0, 10, 52, 1, 2)), *sizes, rng.choice((0, 1)), 2) + b"x\0" + bytes(80)
    )


# ---- TDMS


def _stated(rng: random.Random, place: Path) -> None:
    """Write channels that state any number of values, in segments that are repeated."""
    out = io.BytesIO()
    with nptdms.TdmsWriter(out) as writer:
        channels = [
            nptdms.ChannelObject("g", f"c{k}", np.arange(7.0)) for k in range(rng.choice((1, 3, 300)))
        ]
        writer.write_segment(channels)
    data = out.getvalue()
    count = struct.pack("<Q", 7)
    data = data.replace(count, struct.pack("<Q", _large(rng)), rng.choice((1, -1)))
    place.write_bytes(data * rng.choice((1, 2, 200)))


# ---- Parquet


def _repeated(rng: random.Random, place: Path) -> None:
    """Write millions of rows in hardly any bytes: one value, one text, lists, records."""
    rows = rng.choice((10**4, 10**5, 10**6, 10**6, 10**7))
    kinds = [
        lambda: pa.array(np.zeros(rows)),
        lambda: pa.nulls(rows),
        lambda: pa.DictionaryArray.from_arrays(np.zeros(rows, np.int8), pa.array(["x" * rng.choice((1, 10**6))])),
        lambda: pa.array([[1.0] * 1000] * min(rows, 1000)),
        lambda: pa.StructArray.from_arrays([pa.array(np.zeros(rows))] * 50, [f"f{k}" for k in range(50)]),
        lambda: pa.array(np.zeros(rows, "i8")).cast(pa.timestamp("us")),
    ]  # fmt: skip
    values = rng.choice(kinds)()
    table = pa.table({f"c{k}": values for k in range(rng.choice((1, 1, 20)))})
    pq.write_table(table, place, compression=rng.choice(("zstd", "gzip", "none")))


# ---- bags


def _database(rng: random.Random, place: Path) -> None:
    """Write messages of any size, or a table that is a program."""
    with contextlib.closing(sqlite3.connect(place)) as file:
        file.execute(
            "create table topics(id integer primary key, name text, type text, serialization_format text)"
        )
        file.execute("insert into topics values (1, '/joints', 'sensor_msgs/msg/JointState', 'cdr')")
        rows = f"with recursive c(x) as (select 1 union all select x + 1 from c limit {_large(rng, 12.0)})"
        view = f"create view messages as {rows} select x as id, 1 as topic_id, x as timestamp, x'00' as data from c"
        table = (
            "create table messages(id integer primary key, topic_id integer, timestamp integer, data blob)"
        )
        if rng.random() < 0.3:
            file.execute(view)
        else:
            file.execute(table)
            many = rng.choice((1, 3, 1000))
            size = min(_large(rng, 7.5), 3 * 10**7 // many)
            filled = rng.choice((f"zeroblob({size})", "1", "'text'", "null", "x'00010000ffffffff'"))
            file.executemany(
                f"insert into messages values (?, 1, ?, {filled})", [(k, k) for k in range(many)]
            )
        file.commit()


def _record(fields: dict[str, bytes], data: bytes) -> bytes:
    head = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in fields.items())
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def _chunk(rng: random.Random, place: Path) -> None:
    """Write a chunk that unpacks to far more, or states another size, of a type with an odd definition."""
    inner = bytes(rng.choice((1000, _ZEROS)))
    definition = rng.choice(
        ("float64[1000000000] x", "Header header\n" * 10_000, "a/B b\n===\nMSG: a/B\na/B b", "x" * 10**6)
    )
    about = {"topic": b"/t", "type": b"a/B", "md5sum": b"*", "message_definition": definition.encode()}
    head = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in about.items())
    connection = _record({"op": b"\x07", "conn": struct.pack("<I", 0), "topic": b"/t"}, head)
    message = _record(
        {"op": b"\x02", "conn": struct.pack("<I", 0), "time": bytes(8)}, bytes(rng.choice((0, 800)))
    )
    inner = connection + message * rng.choice((1, 5000)) + rng.choice((b"", inner))
    size = rng.choice((len(inner), 2**32 - 1, 0))
    chunk = _record(
        {"op": b"\x05", "compression": b"bz2", "size": struct.pack("<I", size)}, bz2.compress(inner)
    )
    start = _record(
        {
            "op": b"\x03",
            "index_pos": bytes(8),
            "conn_count": struct.pack("<I", 1),
            "chunk_count": struct.pack("<I", 1),
        },
        bytes(4000),
    )
    place.write_bytes(b"#ROSBAG V2.0\n" + start + chunk * rng.choice((1, 8)))


_MAKERS: dict[str, tuple[Callable[[random.Random, Path], None], ...]] = {
    ".h5": (_unwritten, _zeros, _links),
    ".mat": (_variable, _variable, _old_variable),
    ".tdms": (_stated,),
    ".parquet": (_repeated,),
    ".db3": (_database,),
    ".bag": (_chunk,),
}
