"""Files that libraries read: damaged ones are refused in one line, or read as their library reads them."""

from __future__ import annotations

import functools
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import asammdf
import h5py
import nptdms
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io
from pyarrow import feather
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from gyrowheel_core.errors import InputError
from gyrowheel_recording.tables import apart
from gyrowheel_recording.tables.formats import read_grid

from . import reference
from .damage import mutated
from .harness import Case, WrongAnswer
from .hostile import hostile
from .tables import columns


def formats(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Damage a file of one of the formats, or make a hostile one, and read its table."""
    whole = _whole(folder)
    for name, content in whole:
        if (outcome := _use(folder / name, content)) != "as the library":
            raise AssertionError(f"{name}: {outcome}")
    while True:
        if rng.random() < 0.2:
            name, data = hostile(rng, folder, whole)
        else:
            name, content = rng.choice(whole)
            data = mutated(content, rng)
        yield Case(name, data, functools.partial(_use, folder / name))


def _use(file: Path, data: bytes) -> str:
    file.write_bytes(data)
    grid = read_grid(file)
    try:
        other = apart.read(reference.read, file, None)
    except InputError:
        return "read, where the library refuses"
    if differs := reference.difference(grid, other, file):
        raise WrongAnswer(differs)
    return "as the library"


def _whole(folder: Path) -> list[tuple[str, bytes]]:
    """Return small files of every format as it is usually written, by name."""
    table = columns()
    time = table["t_ms"] * 1e-3
    within = {"run": {"signals": table, "names": np.array(["a", "b"], dtype=object)}}
    scipy.io.savemat(folder / "plain.mat", table)
    scipy.io.savemat(folder / "packed.mat", within, do_compression=True)
    scipy.io.savemat(folder / "old.mat", table, format="4")
    packings: list[tuple[str, dict[str, Any]]] = [
        ("plain.h5", {}),
        ("packed.h5", {"compression": "gzip", "chunks": (8,)}),
    ]
    for name, options in packings:
        with h5py.File(folder / name, "w") as file:
            for column, values in table.items():
                file.create_dataset(f"run/{column}", data=values, **options).attrs["unit"] = "V"
    with nptdms.TdmsWriter(folder / "run.tdms") as writer:
        waveform = {"wf_increment": 0.0005, "unit_string": "V"}
        writer.write_segment(
            [nptdms.ChannelObject("run", column, values, waveform) for column, values in table.items()]
        )
    for name, packed in (("plain.mf4", 0), ("packed.mf4", 2)):
        with asammdf.MDF(version="4.10") as measured:
            measured.append(
                [asammdf.Signal(values, time, name=column, unit="V") for column, values in table.items()]
            )
            measured.save(folder / name, overwrite=True, compression=packed)
    parquet: list[dict[str, Any]] = [{}, {"compression": "zstd"}, {"version": "1.0", "use_dictionary": False}]
    for number, packing in enumerate(parquet):
        pq.write_table(pa.table(table), folder / f"{number}.parquet", **packing)
    feather.write_feather(pa.table(table), str(folder / "lz4.feather"))
    feather.write_feather(pa.table(table), str(folder / "plain.feather"), compression="uncompressed")
    arrays: dict[str, Any] = dict(table)
    np.savez(folder / "plain.npz", **arrays)
    np.savez_compressed(folder / "packed.npz", **arrays)
    records = np.zeros(len(time), [(column, values.dtype) for column, values in table.items()])
    for column, values in table.items():
        records[column] = values
    np.save(folder / "records.npy", records)
    _bags(folder, table)
    return [(file.name, file.read_bytes()) for file in sorted(folder.iterdir())]


def _bags(folder: Path, table: dict[str, np.ndarray]) -> None:
    """Write small bags of ROS 1, packed in each way, and of ROS 2."""
    names = {"plain.bag": None, "bz2.bag": rosbag1.Writer.CompressionFormat.BZ2}
    names["lz4.bag"] = rosbag1.Writer.CompressionFormat.LZ4
    for name, packed in names.items():
        writer: Any = rosbag1.Writer(folder / name)
        if packed:
            writer.set_compression(packed)
        _write(writer, Stores.ROS1_NOETIC, table)
    for plugin in rosbag2.StoragePlugin:
        _write(rosbag2.Writer(folder / "bag", version=9, storage_plugin=plugin), Stores.ROS2_JAZZY, table)
        (file,) = (own for own in (folder / "bag").iterdir() if own.suffix != ".yaml")
        file.rename(folder / file.name)
        shutil.rmtree(folder / "bag")


def _write(writer: Any, kind: Stores, table: dict[str, np.ndarray]) -> None:
    store = get_typestore(kind)
    joints, header, when = (
        store.types[name]
        for name in ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    ros1 = kind == Stores.ROS1_NOETIC
    names, columns = list(table), np.column_stack(list(table.values()))
    with writer:
        connection = writer.add_connection("/joints", joints.__msgtype__, typestore=store)
        for k, row in enumerate(columns):
            stamp = when(100, 1000 * k)
            head = header(k, stamp, "") if ros1 else header(stamp, "")
            message = joints(head, names, row, np.zeros(0), np.zeros(0))
            packed = (store.serialize_ros1 if ros1 else store.serialize_cdr)(message, joints.__msgtype__)
            writer.write(connection, 10**18 + k, packed)
