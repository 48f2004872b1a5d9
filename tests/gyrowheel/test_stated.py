"""What a file states is used or refused by name: starts, axes, units, names and rates, written by other libraries."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pytest
import zstandard
from asammdf import MDF, Signal
from nptdms import ChannelObject, TdmsWriter
from pyarrow import parquet
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.io import savemat

import gyrowheel as gw
from gyrowheel_core.errors import InputError
from gyrowheel_recording.tables import read_grid

from .test_wrong_tables import Table

N, RATE = 400, 1000.0
BEGIN = 1_784_000_000_000_000_000  # ns


def columns() -> dict[str, np.ndarray]:
    table = Table()
    return {name: table.numbers(name)[:N] for name in table.columns}


def split(name: str) -> tuple[str, str]:
    label, unit = name[:-1].split(" [")
    return label, unit


# --- TDMS ---


def tdms(file: Path, parts: list[dict[str, Any]]) -> Path:
    for k, waveform in enumerate(parts):
        with TdmsWriter(str(file), mode="a" if k else "w") as writer:
            own = {"wf_increment": 1.0 / RATE, "unit_string": "V", **waveform}
            writer.write_segment([ChannelObject("daq", "u", np.arange(N) + 1.0 * k, properties=own)])
    return file


START = np.datetime64("2026-11-12T10:00:00", "us")


def test_parts_of_a_waveform_begin_when_each_states(tmp_path: Path) -> None:
    later = START + np.timedelta64(9, "s")
    grid = read_grid(tdms(tmp_path / "u.tdms", [{"wf_start_time": START}, {"wf_start_time": later}]))
    times = grid.columns["daq/time"].values
    assert times[[0, N - 1, N]] == pytest.approx([0.0, (N - 1) / RATE, 9.0])


@pytest.mark.parametrize("late", [0, 400_000])  # stated again, or where the last part ended [us]
def test_parts_that_go_on_are_one(tmp_path: Path, late: int) -> None:
    parts = [{"wf_start_time": START}, {"wf_start_time": START + np.timedelta64(late, "us")}]
    grid = read_grid(tdms(tmp_path / "u.tdms", parts if late else [parts[0], {}]))
    assert np.diff(grid.columns["daq/time"].values) == pytest.approx(np.full(2 * N - 1, 1.0 / RATE))


def test_a_spectrum_in_tdms_is_left_out_by_name(tmp_path: Path) -> None:
    file = tdms(tmp_path / "u.tdms", [{"wf_start_time": START}])
    with TdmsWriter(str(file), mode="a") as writer:
        own = {"wf_increment": 2.5, "wf_xunit_string": "Hz"}
        writer.write_segment([ChannelObject("daq", "power", np.arange(50.0), properties=own)])
    assert "daq/power is over Hz, not over time: left out" in read_grid(file).remarks


def test_a_scale_in_tdms_is_applied(tmp_path: Path) -> None:
    scale = {
        "NI_Scaling_Status": "unscaled",
        "NI_Number_Of_Scales": 1,
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": 2.0,
        "NI_Scale[0]_Linear_Y_Intercept": 1.0,
        "NI_Scale[0]_Linear_Input_Source": 0xFFFFFFFF,
    }
    column = read_grid(tdms(tmp_path / "u.tdms", [scale])).columns["daq/u"]
    assert column.values == pytest.approx(1.0 + 2.0 * np.arange(N))
    assert column.unit == "V"


def test_a_tdms_file_that_breaks_off_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    file = tdms(tmp_path / "u.tdms", [{}, {}])
    file.write_bytes(file.read_bytes()[:-80])
    grid = read_grid(file)
    assert N <= len(grid.columns["daq/u"].values) < 2 * N
    assert "the file breaks off: its last segment is read as far as it goes" in grid.remarks


# --- MDF ---


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_units_conversions_and_rates_of_mdf(tmp_path: Path, version: str) -> None:
    time = np.arange(N) / RATE
    with MDF(version=version) as mdf:
        counts = np.arange(N, dtype=np.int16)
        mdf.append([Signal(counts, time, name="u", unit="V", conversion={"a": 0.5, "b": -1.0})])
        mdf.append([Signal(np.full(N // 10, 21.0), time[::10], name="t_air", unit="degC")])
        file = Path(mdf.save(tmp_path / ("u.mf4" if version > "4" else "u.mdf")))
    columns = read_grid(file).columns
    assert columns["u"].values == pytest.approx(0.5 * np.arange(N) - 1.0)
    assert (columns["u"].unit, columns["t_air"].unit) == ("V", "degC")
    assert columns[columns["t_air"].clock].values == pytest.approx(time[::10])


def test_values_over_an_angle_in_mdf_are_left_out_by_name(tmp_path: Path) -> None:
    time = np.arange(N) / RATE
    with MDF(version="4.10") as mdf:
        mdf.append([Signal(np.sin(time), time, name="u", unit="V")])
        mdf.append([Signal(np.cos(time), 360.0 * time, name="pressure by angle", unit="bar")])
        mdf.groups[1].channels[0].sync_type = 2
        mdf.save(tmp_path / "u.mf4")
    grid = read_grid(tmp_path / "u.mf4")
    assert list(grid.columns) == ["time 1", "u"]
    assert any("pressure by angle: over an angle, not over time" in text for text in grid.remarks)


# --- HDF5 and MATLAB 7.3 ---


def matrix(file: Path, attributes: dict[str, Any]) -> Path:
    table = columns()
    with h5py.File(file, "w") as out:
        data = out.create_dataset("acq/ai", data=np.array(list(table.values())[1:]))
        for key, value in attributes.items():
            data.attrs[key] = value
    return file


def test_names_units_and_rate_of_a_matrix(tmp_path: Path) -> None:
    names, units = zip(*map(split, list(columns())[1:]), strict=True)
    for key in ("sample_rate", "fs"):
        file = matrix(tmp_path / f"{key}.h5", {"channel_names": names, "units": units, key: RATE})
        found = gw.suggest_map(file)
        assert found.settled, found.questions
        assert found.content["time"] == {"column": "acq/ai/time", "unit": "s"}
        assert found.content["columns"]["tilt_x"] == {"column": "acq/ai/Tilt X", "unit": "deg"}
        assert len(gw.read_table(file, found)) == N


def test_names_and_units_of_a_matrix_in_one_text_or_in_data_sets_beside_it(tmp_path: Path) -> None:
    names, units = zip(*map(split, list(columns())[1:]), strict=True)
    one = matrix(tmp_path / "one.h5", {"columns": ",".join(names), "units": ", ".join(units), "fs_hz": RATE})
    two = matrix(tmp_path / "two.h5", {"fs": RATE})
    with h5py.File(two, "a") as out:
        out["acq/channel_names"], out["acq/units"] = (np.array(own, dtype="S") for own in (names, units))
    for file in (one, two):
        found = gw.suggest_map(file)
        assert found.settled, found.questions
        assert found.content["columns"]["tilt_x"] == {"column": "acq/ai/Tilt X", "unit": "deg"}


def test_vectors_of_a_group_have_the_rate_of_the_group_and_slow_ones_are_held_at_the_end(
    tmp_path: Path,
) -> None:
    file = tmp_path / "groups.h5"
    with h5py.File(file, "w") as out:
        for name, values in list(columns().items())[1:]:
            label, unit = split(name)
            every = 10 if unit in ("degC", "hPa") else 1
            group = out.require_group("slow" if every > 1 else "fast")
            group.attrs["sample_rate"] = RATE / every
            group[label] = values[::every]
            group[label].attrs["units"] = unit
    found = gw.suggest_map(file)
    assert found.settled, found.questions
    assert found.content["columns"]["air_pressure"]["clock"] == "slow/time"
    assert len(gw.read_table(file, found)) == N


def test_one_data_set_that_cannot_be_read_is_left_out_by_name(tmp_path: Path) -> None:
    file = tmp_path / "external.h5"
    with h5py.File(file, "w") as out:
        for name, values in columns().items():
            out[name] = values
        out.create_dataset("raw", (N,), "f8", external=[("raw.bin", 0, h5py.h5f.UNLIMITED)])
    found = gw.suggest_map(file)
    assert found.settled, found.questions
    assert any(text.startswith("raw: its numbers are in another file") for text in found.remarks)
    assert len(gw.read_table(file, found)) == N
    with pytest.raises(InputError, match="raw: its numbers are in another file"):
        read_grid(file, ["raw"])


def test_units_that_are_not_one_for_each_column_are_not_taken(tmp_path: Path) -> None:
    grid = read_grid(matrix(tmp_path / "u.h5", {"units": ("deg", "V", "A")}))
    assert {own.unit for own in grid.columns.values()} == {""}
    assert grid.remarks == ("acq/ai: 3 units are stated for 11 columns: not used",)
    one = read_grid(matrix(tmp_path / "one.h5", {"units": "mV"}))
    assert {own.unit for own in one.columns.values()} == {"mV"}


def test_a_frame_of_pandas_has_its_own_names(tmp_path: Path) -> None:
    table = columns()
    time = table.pop("Time [s]")
    with h5py.File(tmp_path / "frame.h5", "w") as out:
        group = out.create_group("df")
        group.attrs["pandas_type"] = np.bytes_("frame")
        group.create_dataset("axis1", data=time)
        group.create_dataset("block0_items", data=np.array([name.encode() for name in table]))
        group.create_dataset("block0_values", data=np.column_stack(list(table.values())))
    found = gw.suggest_map(tmp_path / "frame.h5")
    assert found.settled, found.questions
    assert found.content["columns"]["coil_voltage_x"]["column"] == "df/Coil X [V]"
    assert len(gw.read_table(tmp_path / "frame.h5", found)) == N


def test_matrices_of_matlab_stand_as_it_shows_them(tmp_path: Path) -> None:
    shown = np.arange(36.0).reshape(6, 6)  # a row a sample
    with h5py.File(tmp_path / "m.mat", "w", userblock_size=512) as out:
        for name, values in (("square", shown.T), ("none", np.array([0, 1], dtype=np.uint64))):
            data = out.create_dataset(name, data=values)
            data.attrs["MATLAB_class"] = np.bytes_("double")
            if name == "none":
                data.attrs["MATLAB_empty"] = np.uint8(1)
    with (tmp_path / "m.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + bytes([0, 2]) + b"IM")
    grid = read_grid(tmp_path / "m.mat")
    assert list(grid.columns) == [f"square.{k}" for k in range(1, 7)]
    assert grid.columns["square.1"].values.tolist() == shown[:, 0].tolist()


def test_signals_of_simulink_have_their_labels(tmp_path: Path) -> None:
    table = columns()
    time = table.pop("Time [s]")
    matrix_of_all = np.column_stack(list(table.values()))
    single = np.array(
        list(zip(table.values(), table, strict=True)), dtype=[("values", object), ("label", object)]
    )
    for k, signals in enumerate(
        ({"values": matrix_of_all, "label": np.array(list(table), dtype=object)}, single)
    ):
        file = tmp_path / f"scope{k}.mat"
        savemat(file, {"Scope": {"time": time, "signals": signals}})
        found = gw.suggest_map(file)
        assert found.settled, found.questions
        assert found.content["columns"]["tilt_x"] == {"column": "Scope.Tilt X [deg]", "unit": "deg"}
        assert len(gw.read_table(file, found)) == N


# --- numbers for none ---


def test_channels_of_dspace_have_their_names_and_units(tmp_path: Path) -> None:
    named = [(*split(name), values) for name, values in columns().items()]
    channels = np.array(
        [(label, values, unit) for label, unit, values in named[1:]],
        dtype=[("Name", object), ("Data", object), ("Unit", object)],
    )
    savemat(
        tmp_path / "d.mat", {"rec": {"X": {"Name": "time", "Data": named[0][2], "Unit": "s"}, "Y": channels}}
    )
    found = gw.suggest_map(tmp_path / "d.mat")
    assert found.settled, found.questions
    assert found.content["columns"]["tilt_x"] == {"column": "rec.Y.Tilt X", "unit": "deg"}
    assert len(gw.read_table(tmp_path / "d.mat", found)) == N


def test_numbers_by_which_instruments_mean_none_are_not_measured(tmp_path: Path) -> None:
    table = Table()
    for row, text in ((7, "9.91E+37"), (8, "+9.9E37"), (9, "-9.90000E+37")):
        table.columns["Motor current [A]"][row] = text
    file = table.write(tmp_path)
    found = gw.suggest_map(file)
    assert found.settled, found.questions
    assert "Motor current [A]: 3 values of 9.91E+37 or so, by which instruments mean none." in found.remarks
    rows = gw.read_table(file, found).data.measurement
    assert np.flatnonzero(np.isnan(rows["motor_current"])).tolist() == [7, 8, 9]


# --- Parquet ---


def test_times_of_day_and_numbers_in_texts_in_parquet(tmp_path: Path) -> None:
    table = {name: pa.array(values) for name, values in columns().items()}
    seconds = np.round(1e6 * (columns()["Time [s]"] + 36000.0)).astype(np.int64)
    del table["Time [s]"]
    table["Time"] = pa.array(seconds).cast(pa.time64("us"))
    table["Speed [rpm]"] = table["Speed [rpm]"].cast(pa.string())
    parquet.write_table(pa.table(table), tmp_path / "t.parquet")
    found = gw.suggest_map(tmp_path / "t.parquet")
    assert found.settled, found.questions
    rows = gw.read_table(tmp_path / "t.parquet", found).data.measurement
    assert rows["spin_rate"] == pytest.approx(np.pi / 30.0 * columns()["Speed [rpm]"])


def test_categories_durations_zones_and_units_in_parquet(tmp_path: Path) -> None:
    nanoseconds = pa.array(np.arange(N) * 1_000_000)
    table = {
        "t": nanoseconds.cast(pa.duration("ns")),
        "date": nanoseconds.cast(pa.timestamp("ns", "+02:00")),
        "u": pa.array(np.arange(N) % 3.0).dictionary_encode(),
    }
    fields = [pa.field(name, own.type, metadata={"unit": "mV"}) for name, own in table.items()]
    parquet.write_table(pa.table(list(table.values()), schema=pa.schema(fields)), tmp_path / "c.parquet")
    columns = read_grid(tmp_path / "c.parquet").columns
    assert columns["t"].values == pytest.approx(np.arange(N) / RATE)
    assert (columns["t"].unit, columns["u"].unit) == ("s", "mV")
    assert columns["date"].dated
    assert columns["u"].values.tolist() == (np.arange(N) % 3.0).tolist()


def test_a_text_packed_by_zstandard_is_read(tmp_path: Path) -> None:
    file = Table().write(tmp_path)
    packed = file.with_suffix(".csv.zst")
    packed.write_bytes(zstandard.compress(file.read_bytes()))
    assert read_grid(packed).columns["Tilt X [deg]"].values[:N] == pytest.approx(columns()["Tilt X [deg]"])


def test_records_and_dates_out_of_range_in_parquet(tmp_path: Path) -> None:
    table = {name: pa.array(values) for name, values in columns().items()}
    own = {name: table.pop(name) for name in ("Tilt X [deg]", "Tilt Y [deg]")}
    table["tilt"] = pa.StructArray.from_arrays(list(own.values()), ["X [deg]", "Y [deg]"])
    never = pa.array([2**62] + [0] * (N - 1), pa.timestamp("us"))
    table["valid"] = pa.StructArray.from_arrays([never], ["end"])
    parquet.write_table(pa.table(table), tmp_path / "r.parquet")
    found = gw.suggest_map(tmp_path / "r.parquet")
    assert found.settled, found.questions
    assert found.content["columns"]["tilt_x"]["column"] == "tilt.X [deg]"
    assert len(gw.read_table(tmp_path / "r.parquet", found)) == N


# --- text of LabVIEW ---


def lvm(file: Path, x_columns: str, *, separator: str = "\t", segments: int = 1) -> Path:
    table = columns()
    time = table.pop("Time [s]")
    names, units = zip(*map(split, table), strict=True)
    apart = separator * (2 if x_columns == "Multi" else 1)
    word = "Tab" if separator == "\t" else "Comma"
    lines = ["LabVIEW Measurement", f"Separator{separator}{word}", f"X_Columns{separator}{x_columns}"]
    lines += [f"Multi_Headings{separator}{'Yes' if segments > 1 else 'No'}", "***End_of_Header***", ""]
    rows = [[f"{value:.9g}" for value in row] for row in zip(*table.values(), strict=True)]
    for k in range(segments):
        for key, values in (
            ("Channels", [str(len(names))]),
            ("Samples", [str(N)] * len(names)),
            ("Date", ["2026/11/12"] * len(names)),
            ("Time", [f"10:00:{7 * k:02d}.5"] * len(names)),
            ("Y_Unit_Label", units),
            ("X0", ["0.0E+0"] * len(names)),
            ("Delta_X", ["0.001"] * len(names)),
        ):
            lines.append(f"{key}{separator}{apart.join(values)}")
        lines.append("***End_of_Header***")
        head = (
            [f"X_Value{separator}{name}" for name in names] if x_columns == "Multi" else ["X_Value", *names]
        )
        lines.append(separator.join([*head, "Comment"]))
        for t, row in zip(time, rows, strict=True):
            first = "" if x_columns == "No" else f"{t:.4f}"
            cells = [f"{first}{separator}{cell}" for cell in row] if x_columns == "Multi" else [first, *row]
            lines.append(separator.join(cells))
        lines.append("")
    file.write_text("\r\n".join(lines) + "\r\n", encoding="utf-8")
    return file


@pytest.mark.parametrize("x_columns", ["No", "One", "Multi"])
@pytest.mark.parametrize("separator", ["\t", ","])
def test_text_of_labview_is_read_as_its_head_states(tmp_path: Path, x_columns: str, separator: str) -> None:
    file = lvm(tmp_path / "u.lvm", x_columns, separator=separator)
    found = gw.suggest_map(file)
    assert found.settled, found.questions
    assert found.content["columns"]["spin_rate"] == {"column": "Speed", "unit": "rpm"}
    rows = gw.read_table(file, found).data.measurement
    assert np.diff(rows["stamp_ns"]).tolist() == [1_000_000] * (N - 1)
    assert np.degrees(rows["tilt_x"]) == pytest.approx(columns()["Tilt X [deg]"], rel=1e-6)


def test_a_spectrum_in_a_text_of_labview_is_left_out_by_name(tmp_path: Path) -> None:
    file = lvm(tmp_path / "u.lvm", "One")
    text = file.read_text(encoding="utf-8")
    kinds = "\t".join(["X_Dimension", "Frequency", *["Time"] * 10])
    file.write_text(text.replace("X0\t", f"{kinds}\r\nX0\t", 1), encoding="utf-8")
    grid = read_grid(file)
    assert "Tilt X is over Frequency, not over time: left out" in grid.remarks
    assert "Tilt Y" in grid.columns


def test_segments_of_labview_begin_when_each_states(tmp_path: Path) -> None:
    grid = read_grid(lvm(tmp_path / "u.lvm", "One", segments=2))
    assert grid.columns["X_Value"].values[[0, N]] == pytest.approx([0.0, 7.0])


# --- bags ---

STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg("string[] interface_names\nfloat64[] values\n", "lab_msgs/msg/Values"))
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nstring[] joint_names\nlab_msgs/Values[] interface_values\n",
        "lab_msgs/msg/Joints",
    )
)


def message(kind: str, /, **own: Any) -> Any:
    return STORE.types[kind](**own)


def header(stamp: int, frame: str = "wheel") -> Any:
    time = message("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
    return message("std_msgs/msg/Header", stamp=time, frame_id=frame)


def vector(stamp: int, x: float, frame: str = "wheel") -> Any:
    own = message("geometry_msgs/msg/Vector3", x=x, y=2.0 * x, z=0.5)
    return message("geometry_msgs/msg/Vector3Stamped", header=header(stamp, frame), vector=own)


def numbers(values: np.ndarray) -> Any:
    layout = message("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    return message("std_msgs/msg/Float64MultiArray", layout=layout, data=values)


def bag(
    folder: Path,
    put: Callable[[Callable[[str, int, Any], None]], None],
    storage: StoragePlugin = StoragePlugin.MCAP,
) -> Path:
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        topics: dict[str, Any] = {}

        def write(topic: str, logged: int, what: Any, behind: bytes = b"") -> None:
            kind = what.__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(topics[topic], logged, bytes(STORE.serialize_cdr(what, kind)) + behind)

        put(write)
    return folder


def test_a_topic_that_cannot_be_decoded_is_left_out_by_name(tmp_path: Path) -> None:
    def put(write: Any) -> None:
        for k in range(20):
            write("/volts", BEGIN + k, vector(BEGIN + k, k))
            write("/foreign", BEGIN + k, vector(BEGIN + k, k), bytes(8))

    grid = read_grid(bag(tmp_path / "b", put))
    assert "/volts.vector.x" in grid.columns
    assert any(text.startswith("/foreign: message 0 cannot be decoded") for text in grid.remarks)


def test_messages_that_are_there_twice_are_taken_once(tmp_path: Path) -> None:
    def put(write: Any) -> None:
        for k in range(40):
            for _ in range(1 + (k % 10 == 0)):
                write("/volts", BEGIN + k, vector(BEGIN + k, k))

    grid = read_grid(bag(tmp_path / "b", put))
    assert grid.columns["/volts.vector.x"].values.tolist() == list(range(40))
    assert grid.remarks == ("/volts: 4 messages are there twice: taken once",)


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_frames_of_one_topic_are_columns_of_their_own(tmp_path: Path, storage: StoragePlugin) -> None:
    def put(write: Any) -> None:
        for k in range(40):
            write("/imu", BEGIN + k, vector(BEGIN + k, k, "left" if k % 2 else "right"))

    place = bag(tmp_path / "b", put, storage)
    grid = read_grid(place)
    assert grid.columns["/imu@left.vector.x"].values.tolist() == list(range(1, 40, 2))
    assert read_grid(place, ["/imu@right.vector.x"]).columns["/imu@right.vector.x"].values[1] == 2.0
    with pytest.raises(InputError, match="its messages are of 2 frames; allowed: /imu@right, /imu@left"):
        read_grid(place, ["/imu.vector.x"])


def test_lists_of_messages_and_long_arrays_are_columns(tmp_path: Path) -> None:
    def put(write: Any) -> None:
        for k in range(20):
            values = [
                message(
                    "lab_msgs/msg/Values",
                    interface_names=["position", "effort"],
                    values=np.array([k, 2.0 * k]),
                )
                for _ in range(2)
            ]
            own = message(
                "lab_msgs/msg/Joints",
                header=header(BEGIN + k),
                joint_names=["x", "y"],
                interface_values=values,
            )
            write("/joints", BEGIN + k, own)
            write("/daq", BEGIN + k, numbers(np.arange(40.0)))
            write("/cloud", BEGIN + k, numbers(np.arange(1000.0)))

    grid = read_grid(bag(tmp_path / "b", put))
    assert grid.columns["/joints.y.effort"].values[3] == 6.0
    assert grid.columns["/daq.data.39"].values[0] == 39.0
    assert "/cloud.data is left out: 1000 elements; allowed: up to 256" in grid.remarks


def test_stamps_of_a_controller_are_moved_to_the_time_of_logging(tmp_path: Path) -> None:
    boot = 12_000_000_000

    def put(write: Any) -> None:
        for k in range(20):
            write("/tilt", BEGIN + 1000 * k, vector(boot + 1000 * k, k))
            write("/u", BEGIN + 1000 * k + 500, numbers(np.array([1.0, 2.0])))

    grid = read_grid(bag(tmp_path / "b", put))
    assert grid.columns["/u.stamp"].values - grid.columns["/tilt.stamp"].values == pytest.approx(
        np.full(20, 5e-7)
    )
    assert any(text.startswith("/tilt: its stamps are") for text in grid.remarks)


def test_messages_before_there_was_a_clock_are_left_out(tmp_path: Path) -> None:
    def put(write: Any) -> None:
        for k in range(20):
            write("/tilt", BEGIN + 1000 * k, vector(0 if k < 3 else BEGIN + 1000 * k, k))

    grid = read_grid(bag(tmp_path / "b", put))
    assert grid.columns["/tilt.vector.x"].values.tolist() == list(range(3, 20))
    assert any("3 messages have the stamp 0" in text for text in grid.remarks)


def test_topics_with_equal_stamps_share_a_clock(tmp_path: Path) -> None:
    def put(write: Any) -> None:
        for k in range(20):
            for topic in ("/a", "/b"):
                write(topic, BEGIN + 1000 * k, vector(BEGIN + 1000 * k, k))

    grid = read_grid(bag(tmp_path / "b", put))
    assert {own.clock for own in grid.columns.values()} == {"/a.stamp"}
