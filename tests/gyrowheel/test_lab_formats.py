"""Files of other makers: what stands around the numbers, how numbers are packed, and columns of another clock."""

from __future__ import annotations

import gzip
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import gyrowheel as gw
from gyrowheel_recording.tables import Column, Grid, form_of_file, read_grid
from gyrowheel_recording.tables.text import form_of

from .test_wrong_tables import RATE, Lines, N, Table

START = np.datetime64("2026-11-12T10:00:00", "us")


def with_dates(zone: str) -> Callable[[Table], None]:
    """Return what writes the times of a table as dates in ISO 8601."""

    def write(table: Table) -> None:
        stamps = [
            START + np.timedelta64(round(1e6 * float(text)), "us") for text in table.columns["Time [s]"]
        ]
        table.columns = {"Time": [f"{stamp}{zone}" for stamp in stamps], **table.columns}
        del table.columns["Time [s]"]

    return write


def lines_of_dates(form: str, *, comma: bool = False) -> Callable[[Table], None]:
    """Return what writes the times of a table as other dates, for times of less than a minute."""

    def write(table: Table) -> None:
        stamps = [form.format(float(text)) for text in table.columns["Time [s]"]]
        if comma:
            stamps = [",".join(stamp.rsplit(".", 1)) for stamp in stamps]
        table.columns = {"Time": stamps, **table.columns}
        del table.columns["Time [s]"]

    return write


def lines(change: Callable[[Lines], Lines], delimiter: str = ";") -> Callable[[Table], None]:
    def write(table: Table) -> None:
        table.spoil, table.delimiter = change, delimiter

    return write


def with_state(table: Table) -> None:
    table.columns["State"] = ["HOLD" if k < N // 2 else "RAMP" for k in range(N)]


def odd_first_cell(table: Table) -> None:
    table.columns["Coil X [V]"][0] = "OVR"


def signed(table: Table) -> None:
    """As instruments write numbers: with a sign always, and with an exponent."""
    for name in list(table.columns)[1:]:
        table.columns[name] = [f"{float(text):+.8E}" for text in table.columns[name]]


def quoted(table: Table) -> None:
    """As spreadsheets write a number that holds the delimiter, and a name that does."""
    table.delimiter = ","
    name = "Speed, rotor [rpm]"
    speed = table.columns.pop("Speed [rpm]")
    table.columns[f'"{name}"'] = [f'"{float(text):,.3f}"' for text in speed]


def labview(own: Lines) -> Lines:
    """As LabVIEW writes measurements: its head, names with one for comments, rows without it but the first."""
    head = ["LabVIEW Measurement\t", "Separator\tTab", "***End_of_Header***\t", "\t", "Channels\t11\t"]
    names, first, *rest = (line.replace(";", "\t") for line in own)
    names = names.replace("Time [s]", "X_Value")
    return [*head, "***End_of_Header***" + "\t" * 11, f"{names}\tComment", f"{first}\tbegin", *rest]


def with_unit_in_cells(table: Table) -> None:
    table.columns = {
        name.partition(" [")[0]: [f"{text} {name.partition(' [')[2][:-1]}" for text in own]
        for name, own in table.columns.items()
    }
    table.columns["Motor current"][7] = "OVR"


def with_commas_in_quotes(table: Table) -> None:
    table.delimiter = ","
    table.columns = {
        name: [f'"{text}"'.replace(".", ",") for text in own] for name, own in table.columns.items()
    }


def campbell(own: Lines) -> Lines:
    names, units = heads(own[0])
    often = ";".join(f'"{text}"' for text in ["", *["Smp"] * 11])
    return ["TOA5;rig;CR6", names, units, often, *own[1:]]


def beckhoff(own: Lines) -> Lines:
    names, units = heads(own[0])
    return [names, "SampleTime[ms]" + ";1" * 11, units, "", *own[1:]]


def grouped(own: Lines) -> Lines:
    """As catman and pandas write: axes and quantities in one line, what they are of above, once for each group."""
    groups = "Bench;Tilt;;Shaft;;Coil;;Motor;;Temperature;;Air"
    names = "Time;X;Y;Angle;Speed;X;Y;Voltage;Current;Coil;Air;Pressure"
    return [groups, names, heads(own[0])[1], *own[1:]]


def grouped_apart(own: Lines) -> Lines:
    """With columns that only separate the groups."""
    cells = (line.split(";") for line in grouped(own))
    return [";".join([*line[:3], "", *line[3:5], "", *line[5:]]) for line in cells]


def heads(names: str) -> tuple[str, str]:
    """Return a line of names, and one of units."""
    parts = [name[:-1].split(" [") for name in names.split(";")]
    return ";".join(name for name, _ in parts), ";".join(unit for _, unit in parts)


#: How a right table may be written, with what is asked of it: nothing, or words of the question.
WRITTEN: dict[str, tuple[Callable[[Table], None], str]] = {
    "dates": (with_dates(""), ""),
    "dates in UTC": (with_dates("Z"), ""),
    "dates with a zone": (with_dates("+02:00"), ""),
    "dates of Germany": (lines_of_dates("12.11.2026 10:00:{:09.6f}", comma=True), ""),
    "dates of Japan": (lines_of_dates("2026/11/12 10:00:{:09.6f}"), ""),
    "a column of words": (with_state, ""),
    "a word in the first row": (odd_first_cell, ""),
    "signs and exponents": (signed, ""),
    "blanks behind delimiters": (lines(lambda own: [line.replace(";", ", ") for line in own]), ""),
    "a delimiter at the end of rows": (lines(lambda own: [own[0], *(f"{line};" for line in own[1:])]), ""),
    "names behind a comment sign": (lines(lambda own: [f"# {own[0]}", *own[1:]]), ""),
    "columns of blanks": (
        lines(lambda own: ["  ".join(line.split(";")) for line in own]),
        "",
    ),
    "LabVIEW": (lines(labview), ""),
    "a unit in every cell": (with_unit_in_cells, ""),
    "decimal commas in quotes": (with_commas_in_quotes, ""),
    "rows of delimiters alone": (lines(lambda own: [*own[:500], ";" * 11, *own[500:], ";" * 11]), ""),
    "names, units and how often, as Campbell writes": (lines(campbell), ""),
    "names, rates and units, as Beckhoff writes": (lines(beckhoff), ""),
    "names in groups": (lines(grouped), ""),
    "names in groups with columns between them": (lines(grouped_apart), ""),
    "a degree written as an ordinal": (lines(lambda own: [own[0].replace("degC", "ºC"), *own[1:]]), ""),
    "numbers and names in quotes": (quoted, "have signs between the thousands"),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_tables_are_read_in_every_dialect(tmp_path: Path, name: str) -> None:
    change, asked = WRITTEN[name]
    table, plain = Table(), Table()
    change(table)
    file = table.write(tmp_path)
    found = gw.suggest_map(file)
    if asked:
        assert asked in "\n".join(found.questions)
        return
    assert found.settled, found.questions
    rows = gw.read_table(file, found).data.measurement
    assert len(rows) == N
    assert np.abs(np.diff(rows["stamp_ns"]) - 1e6).max() < 1000
    assert np.degrees(rows["tilt_x"]) == pytest.approx(plain.numbers("Tilt X [deg]"), rel=1e-6)
    assert rows["air_pressure"] == pytest.approx(100.0 * plain.numbers("Air pressure [hPa]"), rel=1e-6)


def test_ambiguous_dates_are_refused_with_the_allowed_ones(tmp_path: Path) -> None:
    table = Table()
    table.columns["Time [s]"] = [
        f"12/11/2026 10:00:{float(text):09.6f}" for text in table.columns["Time [s]"]
    ]
    file = table.write(tmp_path)
    given = gw.suggest_map(file).content
    given["time"] = {"column": "Time [s]", "unit": "timestamp"}
    with pytest.raises(
        gw.InputError, match=r"dates such as '12/11/2026.*allowed: dates with times, as 2026-05-04T"
    ):
        gw.read_table(file, given)


def test_numbers_of_numpy_with_names_and_units_behind_comment_signs() -> None:
    form = form_of(b"# t x y\n# s deg rpm\n0.0 1.0 2.0\n0.1 1.5 2.5\n", "t.txt")
    assert (form.names, form.units, form.delimiter) == (("t", "x", "y"), ("s", "deg", "rpm"), " ")


@pytest.mark.parametrize("shift", [0, 1])
def test_the_head_of_a_compressed_text_may_end_within_a_character(tmp_path: Path, shift: int) -> None:
    """What is looked at ends within a long run of letters of two bytes, by one of the two shifts within one of them."""
    text = f"{'a' * shift}t;b;ü\n" + f"1;1;{'µ' * 200}\n" * 1000
    file = tmp_path / "t.csv.gz"
    file.write_bytes(gzip.compress(text.encode()))
    form = form_of_file(file)
    assert (form.names[2], form.encoding) == ("ü", "utf-8")


@pytest.mark.parametrize(
    ("head", "encoding"),
    [
        ("时间,倾角X,转速", "gb2312"),
        ("Zeit,Größe,Drehzahl", "latin-1"),  # two letters in a row beyond ASCII, as a Chinese one has
        ("temps,créée,vitesse", "latin-1"),
        ("时间,Größe,°C", "utf-16-le"),
    ],
)
def test_a_head_is_read_in_the_encoding_of_its_letters(tmp_path: Path, head: str, encoding: str) -> None:
    file = tmp_path / "rig.csv"
    rows = [f"{0.001 * k:.3f},{k % 7},{k % 5}" for k in range(200)]
    file.write_bytes("\n".join([head, *rows]).encode(encoding))
    assert list(read_grid(file).columns) == head.split(",")


@pytest.mark.parametrize("late", [False, True], ids=["in the names", "far below"])
def test_a_long_text_in_latin_1_is_read(tmp_path: Path, late: bool) -> None:
    """Longer than what is looked at: its letters are those of latin-1, wherever the first one stands."""
    head = "t;b;Text" if late else "t;Luft [°C];Text"
    rows = [
        f"{k};{20 + k % 7};läuft" if not late or k > 40_000 else f"{k};{k % 7};gut" for k in range(45_000)
    ]
    file = tmp_path / "t.csv"
    file.write_text("\n".join([head, *rows]) + "\n", encoding="latin-1")
    assert file.stat().st_size > 1 << 18
    found = read_grid(file).columns
    assert list(found) == head.split(";")
    assert len(found["t"].values) == 45_000


def columns() -> dict[str, np.ndarray]:
    """Return the columns of a right table as numbers."""
    own = Table()
    return {name: own.numbers(name) for name in own.columns}


def test_packed_numbers_of_netcdf_are_unpacked(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "t.nc", "w") as file:
        data = file.create_dataset("x", data=np.array([-32768, -100, 0, 250], dtype=">i2"))
        data.attrs["scale_factor"], data.attrs["add_offset"], data.attrs["_FillValue"] = (
            0.01,
            2.0,
            np.int16(-32768),
        )
        data.attrs["units"] = "deg"
        file["time"] = np.arange(4.0)
        file["time"].attrs["units"] = "seconds since 2026-11-12 10:00:00"
    grid = read_grid(tmp_path / "t.nc")
    assert grid.columns["x"].values == pytest.approx([math.nan, 1.0, 2.0, 4.5], nan_ok=True)
    assert (grid.columns["x"].unit, grid.columns["time"].unit) == ("deg", "seconds")


def test_big_endian_numbers_are_read() -> None:
    grid = Grid.of("t", [Column("a", np.arange(3, dtype=kind)) for kind in (">i4", ">u2", ">f4", ">i8")])
    from gyrowheel_recording.mapping.table import _as_arrow

    for column in grid.columns.values():
        assert _as_arrow(column).to_pylist() == [0, 1, 2]


def test_cells_and_structures_of_matlab(tmp_path: Path) -> None:
    from scipy.io import savemat

    cells = np.empty(2, dtype=object)
    cells[0], cells[1] = np.arange(5.0), np.arange(5.0) ** 2
    single = np.empty(5, dtype=object)
    single[:] = [float(k) for k in range(5)]
    rows = np.array([(0.1 * k, 2.0 * k) for k in range(5)], dtype=[("t", object), ("x", object)])
    savemat(tmp_path / "t.mat", {"parts": cells, "each": single, "log": rows})
    found = read_grid(tmp_path / "t.mat").columns
    assert found["parts.2"].values.tolist() == [0.0, 1.0, 4.0, 9.0, 16.0]
    assert found["each"].values.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert found["log.t"].values == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])


def test_matlab_objects_are_reported_with_a_conversion(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "t.mat", "w", userblock_size=512) as file:
        node = file.create_dataset("T", data=np.array([[3707764736, 2, 1, 1, 1, 1]], dtype=np.uint32))
        node.attrs["MATLAB_class"] = np.bytes_("timetable")
    with (tmp_path / "t.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    with pytest.raises(gw.InputError, match=r"T is an object of MATLAB, a timetable, .*table2struct"):
        gw.suggest_map(tmp_path / "t.mat")


def test_invalid_samples_of_mdf_are_missing(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")

    time, values = np.arange(5.0), np.arange(5.0)
    invalid = np.array([False, False, True, False, False])
    with asammdf.MDF(version="4.10") as out:
        out.append([asammdf.Signal(values, time, name="x", unit="V", invalidation_bits=invalid)])
        out.save(tmp_path / "t.mf4", overwrite=True)
    found = read_grid(tmp_path / "t.mf4").columns["x"].values
    assert found == pytest.approx([0.0, 1.0, math.nan, 3.0, 4.0], nan_ok=True)


def test_joint_columns_are_named_by_joint(tmp_path: Path) -> None:
    """Two publishers share a topic, each with joints of its own in an order of its own; stamps are in the messages."""
    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    joints, header, when = (
        store.types[name]
        for name in ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    none = np.zeros(0)
    with rosbag2.Writer(tmp_path / "bag", version=9) as out:
        connection = out.add_connection("/joint_states", joints.__msgtype__, typestore=store)
        for k in range(6):
            names = [["tilt_x", "rotor"], ["rotor", "tilt_x"], ["tilt_y"]][k % 3]
            values = {"tilt_x": 0.01 * k, "tilt_y": 0.02 * k, "rotor": float(k)}
            own = np.array([values[name] for name in names])
            message = joints(header(when(100, k * 1000), ""), names, own, none, none)
            out.write(connection, 10**18 + k, store.serialize_cdr(message, joints.__msgtype__))
    found = read_grid(tmp_path / "bag").columns
    nan = math.nan
    assert found["/joint_states.position.rotor"].values == pytest.approx([0, 1, nan, 3, 4, nan], nan_ok=True)
    assert found["/joint_states.position.tilt_x"].values == pytest.approx(
        [0, 0.01, nan, 0.03, 0.04, nan], nan_ok=True
    )
    assert found["/joint_states.position.tilt_y"].values == pytest.approx(
        [nan, nan, 0.04, nan, nan, 0.1], nan_ok=True
    )
    assert found["/joint_states.stamp"].values == pytest.approx(1e-6 * np.arange(6), abs=1e-12)


def by_two_clocks(
    shift: float, *, missing: Any = None, gap: slice | None = None
) -> tuple[Any, dict[str, Any]]:
    """Return a table, and its map, whose angle and current are by another logger, later by `shift` samples."""
    own = columns()
    time = own["Time [s]"]
    there = time + shift / RATE
    turned = np.mod(250.0 * there, 2.0 * math.pi)
    current = 0.1 + 0.05 * there
    if missing is not None:
        current[500:520] = missing
    keep, by_other = np.ones(N, dtype=bool), ("Encoder [deg]", "Motor current [A]")
    if gap is not None:
        keep[gap] = False
    grid = Grid.of(
        "two",
        [
            *(Column(name, values) for name, values in own.items() if name not in by_other),
            Column("drive/t", there[keep]),
            Column("drive/angle", np.degrees(turned)[keep]),
            Column("drive/current", current[keep]),
        ],
    )
    content = gw.suggest_map(pa.table(own)).content
    content["columns"]["spin_angle"] = {"column": "drive/angle", "unit": "deg", "clock": "drive/t"}
    content["columns"]["motor_current"] = {"column": "drive/current", "unit": "A", "clock": "drive/t"}
    if missing is not None:
        content["columns"]["motor_current"]["missing"] = missing
    return grid, content


def imported(folder: Path, grid: Any, content: dict[str, Any]) -> tuple[Any, tuple[str, ...]]:
    from gyrowheel_recording.bags import Recording
    from gyrowheel_recording.mapping import ColumnMap, import_table

    (folder / "run").mkdir()
    made = import_table("two", ColumnMap.from_mapping(content, "the map"), folder / "run", grid=grid)
    return Recording.open(folder / "run"), made.remarks


@pytest.mark.parametrize("shift", [0.1, 0.5, 0.9])
def test_an_angle_of_another_clock_is_interpolated_along_its_turns(tmp_path: Path, shift: float) -> None:
    recording, _ = imported(tmp_path, *by_two_clocks(shift))
    rows = recording.measurement
    assert N - 2 <= len(rows) < N
    off = rows["spin_angle"] - 250.0e-9 * rows["stamp_ns"]
    off = np.remainder(off - off[0] + math.pi, 2.0 * math.pi) - math.pi
    assert np.abs(off).max() < 1e-6
    assert np.isfinite(rows["motor_current"]).all()


def test_gap_of_another_clock_is_not_interpolated(tmp_path: Path) -> None:
    recording, remarks = imported(tmp_path, *by_two_clocks(0.5, gap=slice(800, 1000)))
    rows = recording.measurement
    for name in ("spin_angle", "motor_current"):
        assert 195 <= int(np.isnan(rows[name]).sum()) <= 205, name
    assert np.isfinite(rows["tilt_x"]).all()
    assert any("rows lie in gaps of the clock 'drive/t'" in remark for remark in remarks)


def test_sentinel_on_another_clock_is_not_interpolated(tmp_path: Path) -> None:
    recording, _ = imported(tmp_path, *by_two_clocks(0.5, missing=0.0))
    current = recording.measurement["motor_current"]
    assert 15 <= int(np.isnan(current).sum()) <= 25
    assert np.nanmin(current) >= 0.1


def test_an_undersampled_angle_is_left_out(tmp_path: Path) -> None:
    grid, content = by_two_clocks(0.5)
    thin = [
        Column(own.name, own.values[::40]) if own.name.startswith("drive/") else own
        for own in grid.columns.values()
    ]
    recording, remarks = imported(tmp_path, Grid.of("two", thin), content)
    assert np.isnan(recording.measurement["spin_angle"]).all()
    assert any("spin_angle is left out" in remark and "25 samples a second" in remark for remark in remarks)


@pytest.mark.parametrize("kind", ["uint16", "uint32", "int16"])
def test_small_whole_numbers_as_times_do_not_overflow(kind: str) -> None:
    """A counter of milliseconds that starts again goes back; one from below zero on does not."""
    begin = -1000 if kind == "int16" else 65536 - 1000 if kind == "uint16" else 2**32 - 1000
    ticks = (begin + np.arange(N)).astype(kind)
    own = columns()
    del own["Time [s]"]
    table = pa.table({"t": pa.array(ticks), **own})
    content = gw.suggest_map(pa.table(columns())).content
    content["time"] = {"column": "t", "unit": "ms"}
    if kind == "int16":
        assert len(gw.read_table(table, content).data.measurement) == N
    else:
        with pytest.raises(gw.InputError, match="before the row before"):
            gw.read_table(table, content)


def test_a_table_with_a_row_for_every_value_is_reported(tmp_path: Path) -> None:
    table = Table()
    names = list(table.columns)[1:]
    rows = [
        f"{time};{name};{table.columns[name][k]}"
        for k, time in enumerate(table.columns["Time [s]"])
        for name in names
    ]
    file = tmp_path / "long.csv"
    file.write_text("\n".join(["time;signal;value", *rows]) + "\n")
    first, *_ = gw.suggest_map(file).questions
    assert "a row for every value, and 'signal' names what it is" in first
    assert "pivot(index=TIME, columns='signal', values='value')" in first


def test_times_of_a_thermometer_are_no_temperature(tmp_path: Path) -> None:
    """An HDF5 file with one group per signal, each with its own time vector."""
    import h5py

    table = Table()
    with h5py.File(tmp_path / "groups.h5", "w") as file:
        for name in table.columns:
            if name != "Time [s]":
                step = 100 if name.startswith("Coil temp") else 1
                group = file.create_group(name.partition(" [")[0].replace("Coil temp", "tc"))
                group["t"], group["data"] = (table.numbers(own)[::step] for own in ("Time [s]", name))
    found = gw.suggest_map(tmp_path / "groups.h5")
    assert not any("tc/t'" in question for question in found.questions)
    assert "tc/data" in {own["column"] for own in found.content["columns"].values()}
    assert "tc/t" not in {own["column"] for own in found.content["columns"].values()}


def test_objects_in_an_archive_of_numpy_are_left_out(tmp_path: Path) -> None:
    own: dict[str, Any] = columns()
    np.savez_compressed(tmp_path / "lab.npz", **own, about=np.array([{"bench": 3}, None], dtype=object))
    found = gw.suggest_map(tmp_path / "lab.npz")
    assert found.settled, found.questions
    assert any("about is left out: its cells are objects of Python" in remark for remark in found.remarks)
    np.save(tmp_path / "bare.npy", np.column_stack(list(own.values())))
    with pytest.raises(gw.InputError, match=r"whose columns have no names; save it as \.npz"):
        gw.suggest_map(tmp_path / "bare.npy")


def test_tables_of_pandas_that_are_indexed_by_their_times() -> None:
    pd = pytest.importorskip("pandas")
    own = columns()
    time = own.pop("Time [s]")
    stamps = pd.to_datetime(START) + pd.to_timedelta(np.round(1e9 * time), unit="ns")
    frame = pd.DataFrame(own, index=pd.DatetimeIndex(stamps))
    found = gw.suggest_map(frame)
    assert found.settled, found.questions
    assert len(gw.read_table(frame, found).data.measurement) == N
    twice = pd.concat([frame, frame["Speed [rpm]"]], axis=1)
    with pytest.raises(gw.InputError, match="cannot be read"):
        gw.suggest_map(twice)


def test_tables_of_other_libraries_are_read_by_their_arrow_stream() -> None:
    class Other:
        def __init__(self, table: Any) -> None:
            self._table = table
            self.columns = table.column_names

        def to_numpy(self) -> Any:
            raise AssertionError

        def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
            return self._table.__arrow_c_stream__(requested_schema)

    assert gw.suggest_map(Other(pa.table(columns()))).settled
