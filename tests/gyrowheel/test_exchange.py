"""Import and export of tables: what comes back is what went out, and what cannot be meant is refused with its place."""

from __future__ import annotations

import copy
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording, RecordingWriter
from gyrowheel_recording.mapping import ColumnMap, export_recording, import_table
from gyrowheel_sim.bench import Bench

from .conftest import Wheel
from .helpers import Shell, write

N = 40
PERIOD = 0.0005
RATE = 200.0


def columns() -> dict[str, Any]:
    """Return the columns of a table as another program would write it: degrees, rpm, millivolts, Celsius."""
    t = PERIOD * np.arange(N)
    angle = 0.3 + RATE * t
    return {
        "t_ms": np.round(1e3 * t, 6),
        "TiltX [deg]": np.linspace(0.0, 1.0, N),
        "TiltY [deg]": np.linspace(0.5, -0.5, N),
        "Encoder [counts]": np.round(angle / (2.0 * math.pi) * 65536),
        "Speed [rpm]": np.full(N, RATE * 30.0 / math.pi),
        "Coil X [mV]": np.linspace(-20.0, 20.0, N),
        "Coil Y [mV]": np.linspace(5.0, 6.0, N),
        "Motor [V]": np.full(N, 6.0),
        "Motor [A]": np.full(N, 0.1),
        "Coil [degC]": np.full(N, 25.0),
        "Air [hPa]": np.full(N, 1013.25),
    }


def column_map() -> dict[str, Any]:
    return {
        "schema": 1,
        "time": {"column": "t_ms", "unit": "ms"},
        "columns": {
            "tilt_x": {"column": "TiltX [deg]", "unit": "deg"},
            "tilt_y": {"column": "TiltY [deg]", "unit": "deg", "scale": -1, "offset": 0.25},
            "spin_angle": {"column": "Encoder [counts]", "unit": "turn", "scale": 1 / 65536},
            "spin_rate": {"column": "Speed [rpm]", "unit": "rpm"},
            "coil_voltage_x": {"column": "Coil X [mV]", "unit": "mV"},
            "coil_voltage_y": {"column": "Coil Y [mV]", "unit": "mV"},
            "motor_voltage": {"column": "Motor [V]", "unit": "V"},
            "motor_current": {"column": "Motor [A]", "unit": "A"},
            "coil_temperature": {"column": "Coil [degC]", "unit": "degC"},
            "air_temperature": {"value": 21.5, "unit": "degC"},
            "air_pressure": {"column": "Air [hPa]", "unit": "hPa"},
        },
        "environment": [{"time_s": 0, "rig": "inverted", "yaw_deg": 90}],
    }


class Case:
    """A table and its map on the disk, to be changed and imported."""

    def __init__(self, folder: Path, gyrowheel: Shell) -> None:
        self.folder = folder
        self.gyrowheel = gyrowheel
        self.columns = columns()
        self.map = column_map()

    def run(self, suffix: str = ".csv") -> Any:
        table = self.folder / f"table{suffix}"
        content = pa.table({name: pa.array(values) for name, values in self.columns.items()})
        (pc.write_csv if suffix == ".csv" else pq.write_table)(content, table)
        write(self.folder / "map.yaml", yaml.safe_dump(self.map, sort_keys=False))
        return self.gyrowheel("import", table, "--map", self.folder / "map.yaml", "-o", self.folder / "run")

    def refused(self, *words: str, suffix: str = ".csv") -> None:
        result = self.run(suffix)
        assert result.code == 2, result.out
        line = result.err.strip().rpartition("\n")[2]
        for word in words:
            assert word in line
        assert "Traceback" not in result.err
        assert not (self.folder / "run").exists()
        assert {path.name for path in self.folder.iterdir()} == {f"table{suffix}", "map.yaml"}


@pytest.fixture
def case(tmp_path: Path, gyrowheel: Shell) -> Case:
    return Case(tmp_path, gyrowheel)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_units_scales_and_offsets_become_si(case: Case, suffix: str) -> None:
    result = case.run(suffix)
    assert result.code == 0, result.err
    assert f"{N} samples, 0.02 s" in result.out
    recording = Recording.open(case.folder / "run")
    rows, deg = recording.measurement, math.pi / 180.0
    assert recording.integrity().complete
    assert rows["stamp_ns"].tolist() == [500_000 * k for k in range(N)]
    assert rows["tilt_x"] == pytest.approx(np.linspace(0.0, 1.0, N) * deg)
    assert rows["tilt_y"] == pytest.approx((np.linspace(-0.5, 0.5, N) + 0.25) * deg)
    assert rows["spin_angle"] == pytest.approx((0.3 + RATE * PERIOD * np.arange(N)) % (2 * math.pi), abs=1e-4)
    assert rows["spin_rate"] == pytest.approx(np.full(N, RATE))
    assert rows["coil_voltage_x"] == pytest.approx(np.linspace(-0.02, 0.02, N))
    assert rows["coil_temperature"] == pytest.approx(np.full(N, 298.15))
    assert rows["air_temperature"] == pytest.approx(np.full(N, 294.65))
    assert rows["air_pressure"] == pytest.approx(np.full(N, 101325.0))
    assert [(event.rig, event.yaw) for event in recording.environment] == [("inverted", math.pi / 2)]
    assert recording.bench_text == Bench.load().describe()


def test_time_may_be_dates_and_large_numbers(case: Case) -> None:
    stamps = np.datetime64("2026-05-04T10:00:00", "ns") + 500_000 * np.arange(N)
    case.columns["t_ms"] = stamps.astype("int64")
    case.map["time"]["unit"] = "ns"
    assert case.run(".parquet").code == 0
    for suffix in (".parquet", ".csv"):
        case.columns["t_ms"] = stamps
        case.map["time"]["unit"] = "timestamp"
        case.folder /= f"dates{suffix}"
        case.folder.mkdir()
        result = case.run(suffix)
        assert result.code == 0, result.err
        rows = Recording.open(case.folder / "run").measurement
        assert rows["stamp_ns"].tolist() == [500_000 * k for k in range(N)]


def test_missing_samples_are_found_by_their_numbers(case: Case) -> None:
    kept = np.delete(np.arange(N), [10, 11, 30])
    case.columns = {name: values[kept] for name, values in case.columns.items()} | {"n": kept + 7}
    for numbered in (True, False):  # or by their times
        if numbered:
            case.map["sequence"] = {"column": "n"}
        else:
            del case.map["sequence"]
            shutil.rmtree(case.folder / "run")
        said = case.run()
        assert said.code == 0, said.err
        assert "3 samples missing in 2 gaps" in said.out
        recording = Recording.open(case.folder / "run")
        assert recording.measurement["sequence"].tolist() == kept.tolist()
        assert recording.measurement["stamp_ns"].tolist() == [500_000 * k for k in kept]
        assert recording.integrity().gaps == ((10, 2), (30, 1))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_missing_readings_stay_missing_where_the_map_keeps_them(case: Case, suffix: str) -> None:
    for name, row, value in (
        ("Motor [A]", 6, None),
        ("Encoder [counts]", 9, math.nan),
        ("Coil [degC]", 3, math.inf),
    ):
        _set(name, row, value)(case)
    case.refused("number in every row", suffix=suffix)
    case.map["missing"] = "keep"
    assert case.run(suffix).code == 0
    samples = Recording.open(case.folder / "run").measurement
    missing = {"motor_current": [6], "spin_angle": [9], "coil_temperature": [3]}
    for name in case.map["columns"]:
        assert np.flatnonzero(~np.isfinite(samples[name])).tolist() == missing.get(name, []), name


def test_only_readings_may_be_missing(case: Case) -> None:
    case.map["missing"] = "keep"
    _set("t_ms", 6, None)(case)
    case.refused("column 't_ms', line 8", "missing")


def test_other_values_are_checked_where_some_are_missing(case: Case) -> None:
    case.map["missing"] = "keep"
    _set("Motor [A]", 6, None)(case)
    _set("Motor [A]", 7, 1e4)(case)
    case.refused("column 'Motor [A]', line 9: 10000 A; allowed: -100 .. 100 A")


def _set(name: str, row: int, value: Any) -> Callable[[Case], None]:
    def change(case: Case) -> None:
        values = list(case.columns[name])
        values[row] = value
        case.columns[name] = values

    return change


def _put(path: str, value: Any) -> Callable[[Case], None]:
    def change(case: Case) -> None:
        *folders, last = path.split(".")
        place = case.map
        for name in folders:
            place = place[name]
        if value is None:
            del place[last]
        else:
            place[last] = value

    return change


def _scale(name: str, factor: float) -> Callable[[Case], None]:
    def change(case: Case) -> None:
        case.columns[name] = case.columns[name] * factor

    return change


def _same_time(case: Case) -> None:
    case.columns["t_ms"][5] = case.columns["t_ms"][4]


def _back(case: Case) -> None:
    case.columns["t_ms"][5:] -= 0.75


BAD = {
    "missing value": (_set("Motor [A]", 6, None), ("column 'Motor [A]', line 8", "missing")),
    "not a number": (_set("Motor [A]", 6, math.nan), ("column 'Motor [A]', line 8", "a number in every row")),
    "infinite": (_set("Motor [V]", 0, math.inf), ("column 'Motor [V]', line 2", "finite")),
    "time repeats": (_same_time, ("column 't_ms', line 7", "the same time as the row before")),
    "time goes back": (_back, ("column 't_ms', line 7", "0.25 ms before the row before")),
    "time in seconds": (_put("time.unit", "s"), ("a row every 500 ms", "50 ms", "is the unit right?")),
    "time in microseconds": (_put("time.unit", "us"), ("a row every 0.0005 ms", "is the unit right?")),
    "wrong quantity": (_put("columns.tilt_x.unit", "V"), ("columns.tilt_x.unit: 'V'", "such as rad")),
    "no unit at all": (_put("columns.tilt_x.unit", "furlongg"), ("columns.tilt_x.unit", "such as rad")),
    "unit missing": (_put("columns.tilt_x.unit", None), ("columns.tilt_x.unit: missing", "such as rad")),
    "ambiguous": (_put("columns.spin_rate.unit", "Hz"), ("columns.spin_rate.unit: 'Hz'", "rpm")),
    "degrees for radians": (
        _put("columns.tilt_x.unit", "rad"),
        ("column 'TiltX [deg]', line 10", "allowed: -0.2 .. 0.2 rad", "are unit and scale right?"),
    ),
    "a speed that is not that of the angle": (
        _scale("Speed [rpm]", 0.5),
        ("the spin angle turns by", "columns.spin_rate"),
    ),
    "Celsius for kelvin": (
        _put("columns.coil_temperature.unit", "K"),
        ("column 'Coil [degC]', line 2: 25 K; allowed: 150 .. 600 K",),
    ),
    "constant out of range": (
        _put("columns.air_temperature.value", 2150.0),
        ("columns.air_temperature.value: 2150 degC", "150 .. 400 K"),
    ),
    "constant tilt": (
        _put("columns.tilt_x", {"value": 0.0, "unit": "rad"}),
        ("columns.tilt_x.value: a constant is not allowed here",),
    ),
    "no such column": (
        _put("columns.tilt_x.column", "Tilt"),
        ("no column 'Tilt'", "there are: t_ms, TiltX [deg]"),
    ),
    "reading missing": (_put("columns.tilt_x", None), ("columns.tilt_x: missing",)),
    "unknown field": (_put("columns.tilt_z", {"column": "t_ms"}), ("columns.tilt_z: no such field",)),
    "typing error": (_put("colums", {}), ("colums: no such field; did you mean columns?",)),
    "schema": (_put("schema", 2), ("schema: 2", "allowed: 1")),
    "bench": (_put("bench", "gyrowhel"), ("bench 'gyrowhel'", "did you mean gyrowheel?")),
    "scale": (_put("columns.tilt_x.scale", 0), ("columns.tilt_x.scale: 0 is out of range",)),
    "scale no number": (_put("columns.tilt_x.scale", "1e"), ("columns.tilt_x.scale: '1e'",)),
    "rig": (
        _put("environment", [{"rig": "sideways"}]),
        ("environment.0.rig: 'sideways'", "allowed: upright"),
    ),
    "not a mapping": (_put("columns.tilt_x", "TiltX"), ("columns.tilt_x: 'TiltX' is not a mapping",)),
    "missing": (_put("missing", "skip"), ("missing: 'skip'", "allowed: refuse, keep")),
    "both": (_put("columns.tilt_x.value", 1.0), ("columns.tilt_x: either column or value",)),
}


@pytest.mark.parametrize("name", BAD)
def test_invalid_values_are_refused_with_their_place(case: Case, name: str) -> None:
    change, words = BAD[name]
    change(case)
    case.refused(*words)


def test_text_among_the_numbers_is_named(case: Case) -> None:
    case.columns["Motor [V]"] = [*(str(v) for v in case.columns["Motor [V]"][:-1]), "off"]
    case.refused("column 'Motor [V]', line 41: 'off'", "allowed: a number")


def test_the_last_line_of_a_logger_that_was_switched_off_is_left_out(case: Case) -> None:
    case.run()
    table = case.folder / "table.csv"
    table.write_bytes(table.read_bytes().rstrip().rpartition(b",")[0])
    result = case.gyrowheel("import", table, "--map", case.folder / "map.yaml", "-o", case.folder / "other")
    assert result.code == 0
    assert f"{N - 1} samples" in result.out
    assert "the last line breaks off: it is left out" in result.out


@pytest.mark.parametrize("skipped", [0, 2])
def test_a_row_of_another_length_is_named_by_its_line(case: Case, skipped: int) -> None:
    case.map["csv"] = {"skip_lines": skipped}
    case.run()
    lines = (case.folder / "table.csv").read_text(encoding="utf-8").splitlines()
    lines[7] = lines[7].rpartition(",")[0]
    table = write(case.folder / "short.csv", "\n".join(["made by me"] * skipped + lines) + "\n")
    place = case.folder / "other"
    result = case.gyrowheel("import", table, "--map", case.folder / "map.yaml", "-o", place)
    assert result.code == 2
    assert f"{table}: line {8 + skipped}: 10 columns; allowed: 11" in result.err
    assert not place.exists()


def test_the_machine_of_a_map_has_a_name_that_can_be_printed(case: Case) -> None:
    case.map["environment"] = [{"machine": "wheel\n7"}]
    case.refused("map.yaml", "environment.0.machine", "'wheel\\n7' is no name; allowed: printable characters")


def test_two_quantities_do_not_share_a_column(case: Case) -> None:
    case.map["columns"]["tilt_y"] = case.map["columns"]["tilt_x"]
    case.refused("columns.tilt_y.column", "'TiltX [deg]'", "tilt_x")


def test_one_thermometer_may_stand_for_coils_and_air(case: Case) -> None:
    case.map["columns"]["air_temperature"] = case.map["columns"]["coil_temperature"]
    assert case.run().code == 0


def test_text_in_parquet_is_named(case: Case) -> None:
    case.columns["Motor [V]"] = ["six"] * N
    case.refused("column 'Motor [V]': holds string; allowed: numbers", suffix=".parquet")


def test_csv_with_decimal_commas_and_another_encoding(case: Case) -> None:
    lines = ["Prüfstand 3", "zweite Zeile", ";".join(case.columns)]
    lines += [
        ";".join(repr(float(v)).replace(".", ",") for v in row)
        for row in zip(*case.columns.values(), strict=True)
    ]
    table = case.folder / "table.csv"
    table.write_text("\n".join(lines), encoding="latin-1")
    case.map["csv"] = {"delimiter": ";", "decimal": ",", "skip_lines": 2, "encoding": "latin-1"}
    mapped = write(case.folder / "map.yaml", yaml.safe_dump(case.map))
    case.gyrowheel.good("import", table, "--map", mapped, "-o", case.folder / "run")
    assert Recording.open(case.folder / "run").measurement["motor_voltage"].tolist() == [6.0] * N
    case.map["csv"]["delimiter"] = ","
    write(mapped, yaml.safe_dump(case.map))
    result = case.gyrowheel("import", table, "--map", mapped, "-o", case.folder / "other")
    assert (result.code, "csv.decimal" in result.err) == (2, True)


@pytest.mark.parametrize(
    ("damage", "suffix"),
    [(own, suffix) for suffix in (".csv", ".parquet") for own in ("absent", "empty", "folder", "ending")]
    + [("cut", ".parquet")],
)
def test_files_that_are_not_tables_are_refused(case: Case, damage: str, suffix: str) -> None:
    table = case.folder / f"table{suffix}"
    assert case.run(suffix).code == 0
    mapped = case.folder / "map.yaml"
    if damage == "absent":
        table.unlink()
    elif damage == "empty":
        table.write_bytes(b"")
    elif damage == "cut":
        table.write_bytes(table.read_bytes()[: table.stat().st_size // 2])
    elif damage == "folder":
        table.unlink()
        table.mkdir()
    else:
        table = case.folder / "table.xlsx"
        table.write_bytes(b"PK\x03\x04" + bytes(100))
    result = case.gyrowheel("import", table, "--map", mapped, "-o", case.folder / "other")
    assert result.code == 2
    assert str(table) in result.err
    assert "Traceback" not in result.err
    assert not (case.folder / "other").exists()


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_export_and_import_return_the_same_recording(
    wheel: Wheel, tmp_path: Path, gyrowheel: Shell, suffix: str
) -> None:
    table, mapped, back = tmp_path / f"table{suffix}", tmp_path / "map.yaml", tmp_path / "back"
    said = gyrowheel.good("export", wheel.recording, "-o", table, "--map", mapped, "--json", "-").json
    gyrowheel.good("import", table, "--map", mapped, "-o", back)
    before, after = Recording.open(wheel.recording), Recording.open(back)
    assert said["rows"] == len(before.measurement)
    for name in ("measurement", "command", "setpoint"):
        assert np.array_equal(getattr(before, name), getattr(after, name)), name
    assert after.environment == before.environment
    assert after.bench_text == before.bench_text
    if suffix == ".csv":
        return
    # and what is said of it is the same
    results = [
        gyrowheel.good("compare", path, "--model", wheel.model, "--json", "-").json
        for path in (wheel.recording, back)
    ]
    assert results[1]["error"] == results[0]["error"]
    assert results[1]["channels"] == results[0]["channels"]


def test_parquet_has_units_and_bench(wheel: Wheel, tmp_path: Path) -> None:
    recording = Recording.open(wheel.recording)
    export_recording(recording, tmp_path / "table.parquet")
    schema = pq.read_schema(tmp_path / "table.parquet")
    units = {name: schema.field(name).metadata[b"unit"].decode() for name in schema.names}
    assert (units["tilt_x"], units["spin_rate"], units["sequence"]) == ("rad", "rad/s", "1")
    assert yaml.safe_load(schema.metadata[b"gyrowheel"])["bench"] == recording.bench_text
    assert {path.name for path in tmp_path.iterdir()} == {"table.parquet"}


def test_failed_export_leaves_the_old_file(wheel: Wheel, tmp_path: Path, gyrowheel: Shell) -> None:
    result = gyrowheel("export", wheel.recording, "-o", tmp_path / "table.txt")
    assert (result.code, "allowed: .csv, .parquet" in result.err) == (2, True)
    (tmp_path / "file").write_text("kept")
    result = gyrowheel("export", wheel.recording, "-o", tmp_path / "file" / "table.csv")
    assert result.code == 2
    assert "cannot be written" in result.err
    assert (tmp_path / "file").read_text() == "kept"


def test_rows_without_command_or_setpoint_come_back_without(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    stamps = 500_000 * np.arange(N, dtype=np.int64)
    samples, commands = wire.MEASUREMENT.array(N), wire.COMMAND.array(5)
    wire.MEASUREMENT.set_stamps(samples, stamps)
    samples["sequence"] = np.arange(N)
    samples["spin_angle"] = RATE * PERIOD * np.arange(N)
    samples["spin_rate"] = RATE
    samples["coil_temperature"] = samples["air_temperature"] = 300.0
    wire.COMMAND.set_stamps(commands, stamps[3:8])
    commands["measurement_sequence"] = np.arange(3, 8)
    commands["motor_voltage"] = rng.normal(size=5)
    with RecordingWriter(tmp_path / "run") as writer:
        writer.write_columns([(topics.MEASUREMENT, stamps, samples), (topics.COMMAND, stamps[3:8], commands)])
    before = Recording.open(tmp_path / "run")
    for suffix in (".csv", ".parquet"):
        table, mapped = tmp_path / f"table{suffix}", tmp_path / f"map{suffix}.yaml"
        export_recording(before, table, map_file=mapped)
        import_table(table, ColumnMap.load(mapped), tmp_path / f"back{suffix}")
        after = Recording.open(tmp_path / f"back{suffix}")
        assert np.array_equal(after.command, before.command)
        assert np.array_equal(after.measurement, before.measurement)
        assert len(after.setpoint) == 0


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_missing_readings_survive_export_and_import(wheel: Wheel, tmp_path: Path, suffix: str) -> None:
    whole = Recording.open(wheel.recording)
    samples = whole.measurement[:500].copy()
    samples["tilt_x"][7] = samples["coil_temperature"][11:400] = math.nan
    export_recording(
        replace(whole, measurement=samples), tmp_path / f"t{suffix}", map_file=tmp_path / "map.yaml"
    )
    import_table(tmp_path / f"t{suffix}", ColumnMap.load(tmp_path / "map.yaml"), tmp_path / "back")
    back = Recording.open(tmp_path / "back").measurement
    for name in samples.dtype.names or ():
        equal_nan = samples[name].dtype.kind == "f"
        assert np.array_equal(back[name], samples[name], equal_nan=equal_nan), name


_JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_map_is_read_or_refused_by_its_name(data: st.DataObject) -> None:
    """Whatever stands at one place of a map: it is read, or one InputError names the map."""
    content = copy.deepcopy(column_map()) | {"csv": {"delimiter": ";"}}
    place: Any = content
    while isinstance(place, dict | list) and place:
        keys = sorted(place) if isinstance(place, dict) else list(range(len(place)))
        key = data.draw(st.sampled_from(keys))
        if data.draw(st.booleans()):
            place[key] = data.draw(_JUNK)
            break
        place = place[key]
    said = ""
    try:
        ColumnMap.from_mapping(content, "map.yaml")
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    assert not said or said.startswith(("map.yaml", "bench"))


def test_constant_with_uncertainty_is_reported_and_exported(case: Case) -> None:
    case.map["columns"]["air_temperature"]["uncertainty"] = 0.5
    case.map["columns"]["air_pressure"] = {"value": 1010, "unit": "hPa", "uncertainty": 4}
    assert case.run().code == 0
    before = Recording.open(case.folder / "run")
    assert {name: own.uncertainty for name, own in before.origins.items()} == pytest.approx(
        {"air_temperature": 0.5, "air_pressure": 400.0}
    )
    export_recording(before, case.folder / "out.csv", map_file=case.folder / "out.yaml")
    (case.folder / "again").mkdir()
    import_table(case.folder / "out.csv", ColumnMap.load(case.folder / "out.yaml"), case.folder / "again")
    assert Recording.open(case.folder / "again").origins == before.origins


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"value": 21.5, "unit": "degC", "uncertainty": -1}, ("air_temperature.uncertainty: -1", "allowed")),
        (
            {"column": "Coil [degC]", "unit": "degC", "uncertainty": 1},
            ("air_temperature.uncertainty", "value"),
        ),
        ({"value": 21.5, "unit": "degC", "pulses": 1}, ("air_temperature", "belong to a column")),
        ({"column": "Coil [degC]", "unit": "degC", "pulses": 1}, ("air_temperature.pulses", "angle")),
    ],
)
def test_uncertainty_belongs_to_a_constant(case: Case, entry: dict[str, Any], words: tuple[str, ...]) -> None:
    case.map["columns"]["air_temperature"] = entry
    case.refused(*words)
