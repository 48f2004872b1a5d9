"""Tables as a lab's own logger writes them, from a simulated recording, by no path of the project's export.

Every value goes through the text or the library of the format, in the lab's units, under the lab's names.
"""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

Columns = dict[str, np.ndarray]

#: Names and units of the lab, with what its values are of the SI ones: ``SI = value * factor + zero``.
LAB: dict[str, tuple[str, str, float, float]] = {
    "tilt_x": ("Tilt X", "deg", np.pi / 180.0, 0.0),
    "tilt_y": ("Tilt Y", "deg", np.pi / 180.0, 0.0),
    "spin_angle": ("Encoder", "counts", 2.0 * np.pi / 65536.0, 0.0),
    "spin_rate": ("Speed", "rpm", np.pi / 30.0, 0.0),
    "coil_voltage_x": ("Coil X", "mV", 1e-3, 0.0),
    "coil_voltage_y": ("Coil Y", "mV", 1e-3, 0.0),
    "motor_voltage": ("Motor voltage", "V", 1.0, 0.0),
    "motor_current": ("Motor current", "mA", 1e-3, 0.0),
    "coil_temperature": ("Coil temp", "degC", 1.0, 273.15),
    "air_temperature": ("Air temp", "degC", 1.0, 273.15),
    "air_pressure": ("Air pressure", "hPa", 100.0, 0.0),
}


def lab_columns(
    measurement: Any,
    *,
    every: int = 1,
    jitter: float = 0.0,
    gap: tuple[int, int] | None = None,
    without: Sequence[str] = (),
) -> tuple[Columns, dict[str, str]]:
    """Return the columns of a lab, and their units, by name.

    `every` takes that sample alone, `jitter` is that of the stamps [s], `gap` the rows that were lost.
    """
    rows = np.arange(0, len(measurement), every)
    if gap is not None:
        rows = np.delete(rows, slice(*gap))
    time = (measurement["stamp_ns"][rows] - measurement["stamp_ns"][0]) * 1e-9
    if jitter:
        time = time + np.random.default_rng(5).normal(0.0, jitter, len(time))
    columns, units = {"Time": time}, {"Time": "s"}
    for name, (own, unit, factor, zero) in LAB.items():
        if name in without:
            continue
        values = (measurement[name][rows] - zero) / factor
        if unit == "counts":
            values = np.mod(np.round(values), 65536.0)
        columns[own], units[own] = values, unit
    return columns, units


def write_text(
    file: Path,
    columns: Columns,
    units: dict[str, str],
    *,
    delimiter: str = ",",
    decimal: str = ".",
    units_row: bool = False,
    head: Sequence[str] = (),
) -> Path:
    """Write a text as a logger does: ten digits, times to the microsecond."""
    lines = [*head]
    if units_row:
        lines += [delimiter.join(columns), delimiter.join(units[name] for name in columns)]
    else:
        lines.append(delimiter.join(f"{name} [{units[name]}]" for name in columns))
    form = ["%.7f" if name == "Time" else "%.10g" for name in columns]
    table = np.column_stack(list(columns.values()))
    body = [delimiter.join(f % value for f, value in zip(form, row, strict=True)) for row in table.tolist()]
    text = "\n".join(lines + [line.replace(".", decimal) for line in body]) + "\n"
    if file.suffix == ".gz":
        file.write_bytes(gzip.compress(text.encode(), 1))
    else:
        file.write_text(text, encoding="utf-8")
    return file


def write_mat5(file: Path, columns: Columns, units: dict[str, str]) -> Path:
    from scipy.io import savemat

    savemat(
        file,
        {"log": {_plain(name, units): values for name, values in columns.items()}},
        long_field_names=True,
    )
    return file


def write_numpy(file: Path, columns: Columns, units: dict[str, str]) -> Path:
    """Write an archive of arrays (``.npz``), or one array of records (``.npy``)."""
    named: dict[str, Any] = {_plain(name, units): values for name, values in columns.items()}
    if file.suffix == ".npz":
        np.savez(file, **named)
    else:
        np.save(file, records(named))
    return file


def records(columns: dict[str, Any]) -> np.ndarray:
    """Return columns as one array of records."""
    found = np.empty(len(next(iter(columns.values()))), [(name, own.dtype) for name, own in columns.items()])
    for name, own in columns.items():
        found[name] = own
    return found


def write_feather(file: Path, columns: Columns, units: dict[str, str]) -> Path:
    import pyarrow as pa
    from pyarrow.feather import write_feather

    fields = [pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in columns]
    write_feather(pa.table(list(columns.values()), schema=pa.schema(fields)), str(file))
    return file


def write_hdf5(file: Path, columns: Columns, units: dict[str, str], *, matlab: bool = False) -> Path:
    """Write an HDF5 file, or one as MATLAB 7.3 does: behind a head of 512 bytes, vectors as rows."""
    import h5py

    with h5py.File(file, "w", userblock_size=512 if matlab else 0) as out:
        for name, values in columns.items():
            if matlab:
                data = out.create_dataset(f"log/{_plain(name, units)}", data=values[None, :])
                data.attrs["MATLAB_class"] = np.bytes_("double")
            else:
                data = out.create_dataset(f"daq/{name}", data=values)
                data.attrs["unit"] = units[name]
    if matlab:
        with file.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return file


def write_tdms(file: Path, columns: Columns, units: dict[str, str]) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(str(file)) as out:
        out.write_segment(
            [
                ChannelObject("daq", name, values, properties={"unit_string": units[name]})
                for name, values in columns.items()
            ]
        )
    return file


def write_mdf(file: Path, columns: Columns, units: dict[str, str]) -> Path:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as out:
        out.append(
            [
                Signal(values, columns["Time"], unit=units[name], name=name)
                for name, values in columns.items()
                if name != "Time"
            ]
        )
        out.save(file, overwrite=True)
    return file


def write_bag(folder: Path, measurement: Any, *, ros1: bool = False) -> Path:
    """Write a bag as another team's driver does: three standard messages, each on its own topic."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    vector = store.types["geometry_msgs/msg/Vector3Stamped"]
    three = store.types["geometry_msgs/msg/Vector3"]
    header, when = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    topics = {
        "/wheel/tilt": ("tilt_x", "tilt_y", "air_temperature"),
        "/wheel/spin": ("spin_angle", "spin_rate", "coil_temperature"),
        "/wheel/coil_volts": ("coil_voltage_x", "coil_voltage_y", "air_pressure"),
        "/wheel/motor": ("motor_voltage", "motor_current", "air_pressure"),
    }
    writer: Any = rosbag1.Writer(folder) if ros1 else rosbag2.Writer(folder, version=9)
    with writer as out:
        for topic, names in topics.items():
            connection = out.add_connection(topic, vector.__msgtype__, typestore=store)
            for k, row in enumerate(np.column_stack([measurement[name] for name in names]).tolist()):
                stamp = 1_700_000_000_000_000_000 + int(measurement["stamp_ns"][k])
                time = when(stamp // 1_000_000_000, stamp % 1_000_000_000)
                head = header(k, time, "w") if ros1 else header(time, "w")
                message = vector(head, three(*row))
                packed = (store.serialize_ros1 if ros1 else store.serialize_cdr)(message, vector.__msgtype__)
                out.write(connection, stamp, packed)
    return folder


def lab_table(file: Path, samples: Any) -> Path:
    """Write a table of samples, in which one unit is not what it says."""
    columns, units = lab_columns(samples, every=2)
    units["Tilt Y"] = "rad"  # it is in degrees
    head = ",".join(f"{name} [{units[name]}]" for name in columns)
    np.savetxt(file, np.stack(list(columns.values()), axis=1), "%.9g", ",", header=head, comments="")
    return file


def _plain(name: str, units: dict[str, str]) -> str:
    """Return a name as MATLAB allows it, the unit behind it."""
    return f"{name.lower().replace(' ', '_')}_{units[name]}"
