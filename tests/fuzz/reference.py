"""Tables as the libraries of their formats return them by their plainest call, to compare what was read with."""

from __future__ import annotations

import contextlib
import sqlite3
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import asammdf
import h5py
import mcap.reader
import nptdms
import numpy as np
import pyarrow.parquet as pq
import scipy.io
from pyarrow import feather
from rosbags import rosbag1
from rosbags.typesys import Stores, get_typestore

from gyrowheel_recording.tables.grid import Column, Grid, split
from gyrowheel_recording.tables.readers import library_errors

_BAGS = (".bag", ".mcap", ".db3")


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Return the columns of numbers of a file, for `apart.read`."""
    with library_errors(path):
        found = _READERS[path.suffix](path)
        joint = "/" if path.suffix == ".h5" else "."
        return Grid.of(
            str(path), [own for name, values in found for own in _split(name, np.asarray(values), joint)]
        )


def _split(name: str, values: Any, joint: str) -> list[Column]:
    """Return an array as columns; a vector as it is, whatever it has."""
    values = np.squeeze(values)
    return (
        [Column(name, values)]
        if values.ndim < 2 and not values.dtype.names
        else split(name, values, joint=joint)
    )


def difference(grid: Grid, other: Grid, path: Path) -> str:
    """Return how a table differs from that of the library; empty where every column is as the library has it.

    Messages of bags are there in another order, and those that are there twice are read once.
    """
    for name, column in grid.columns.items():
        if not column.numeric or name == column.clock:
            continue
        if name not in other.columns:
            return f"{path.name}: the library has no column {name!r}"
        values, wanted = column.values, other.columns[name].values
        if path.suffix in _BAGS:
            surplus = Counter(map(repr, map(float, values))) - Counter(map(repr, map(float, wanted)))
            if surplus - Counter({"nan": len(values)}):
                return f"{path.name}: {name!r} has values that are in no message"
        elif not _equal(values, wanted):
            return f"{path.name}: {name!r} has other values than the library reads"
    return ""


def _equal(values: Any, wanted: Any) -> bool:
    if wanted.dtype.kind in "OM":
        return values.dtype.kind in "OM" or all(text in ("", "None", "nan") for text in wanted)
    return np.array_equal(values, wanted, equal_nan="f" in (values.dtype.kind, wanted.dtype.kind))


def _matlab(path: Path) -> Iterator[tuple[str, Any]]:
    def numbers(name: str, value: Any) -> Iterator[tuple[str, Any]]:
        if value.dtype.names:
            for own in value.dtype.names:
                yield from numbers(f"{name}.{own}", value[own].flat[0]) if value.size else ()
        else:
            yield name, value

    for name, value in scipy.io.loadmat(path, appendmat=False).items():
        if isinstance(value, np.ndarray):
            yield from numbers(name, value)


def _hdf5(path: Path) -> Iterator[tuple[str, Any]]:
    found = []

    def take(name: str, node: Any) -> None:
        with contextlib.suppress(Exception):  # a damaged data set, where others are whole
            if isinstance(node, h5py.Dataset):
                found.append((name, node[()]))

    with h5py.File(path, "r") as file:
        file.visititems(take)
    yield from found


def _tdms(path: Path) -> Iterator[tuple[str, Any]]:
    for group in nptdms.TdmsFile.read(path).groups():
        for channel in group.channels():
            yield f"{group.name}/{channel.name}", channel[:]


def _mdf(path: Path) -> Iterator[tuple[str, Any]]:
    with asammdf.MDF(path) as file:
        for g, group in enumerate(file.groups):
            for k, channel in enumerate(group.channels):
                yield channel.name, file.get(group=g, index=k, ignore_invalidation_bits=True).samples


def _parquet(path: Path) -> Iterator[tuple[str, Any]]:
    table = pq.read_table(path).flatten().to_pandas()
    yield from ((str(name), table[name].to_numpy()) for name in table)


def _feather(path: Path) -> Iterator[tuple[str, Any]]:
    table = feather.read_table(str(path), memory_map=False).flatten().to_pandas()
    yield from ((str(name), table[name].to_numpy()) for name in table)


def _archive(path: Path) -> Iterator[tuple[str, Any]]:
    with np.load(path) as file:
        yield from file.items()


def _records(path: Path) -> Iterator[tuple[str, Any]]:
    array = np.load(path)
    yield from ((name, array[name]) for name in array.dtype.names)


def _joints(messages: Iterator[Any]) -> Iterator[tuple[str, Any]]:
    found: dict[str, list[float]] = {}
    for own in messages:
        for field in ("position", "velocity", "effort"):
            values = getattr(own, field)
            for k, value in enumerate(values):
                for label in {str(k), own.name[k] if k < len(own.name) else str(k)}:
                    found.setdefault(f"/joints.{field}.{label}", []).append(value)
    yield from ((name, np.array(values)) for name, values in found.items())


def _bag(path: Path) -> Iterator[tuple[str, Any]]:
    store = get_typestore(Stores.ROS1_NOETIC)
    with rosbag1.Reader(path) as file:
        yield from _joints(store.deserialize_ros1(data, own.msgtype) for own, _, data in file.messages())


def _mcap(path: Path) -> Iterator[tuple[str, Any]]:
    store = get_typestore(Stores.ROS2_JAZZY)
    with path.open("rb") as file:
        messages = mcap.reader.make_reader(file).iter_messages()
        yield from _joints(
            store.deserialize_cdr(own.data, schema.name) for schema, _, own in messages if schema
        )


def _database(path: Path) -> Iterator[tuple[str, Any]]:
    store = get_typestore(Stores.ROS2_JAZZY)
    with contextlib.closing(sqlite3.connect(path)) as file:
        rows = file.execute("select data from messages").fetchall()
    yield from _joints(store.deserialize_cdr(data, "sensor_msgs/msg/JointState") for (data,) in rows)


_READERS = {
    ".mat": _matlab,
    ".h5": _hdf5,
    ".tdms": _tdms,
    ".mf4": _mdf,
    ".parquet": _parquet,
    ".feather": _feather,
    ".npz": _archive,
    ".npy": _records,
    ".bag": _bag,
    ".mcap": _mcap,
    ".db3": _database,
}
