"""A lab's recording, written by other hands than the project's export: read, questioned, diagnosed as the original."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gyrowheel as gw
import gyrowheel_sim
from gyrowheel_analysis.fitting.preparation import prepare
from gyrowheel_recording.bags import Origin, Recording, described

from . import lab_tables as lab
from .helpers import Shell

pytestmark = pytest.mark.slow

Change = Callable[[dict[str, np.ndarray], dict[str, str]], None]
HIDDEN = "windage"
PAGE = Path(__file__).resolve().parents[2] / "docs" / "import.md"


@pytest.fixture(scope="module")
def original() -> gw.Recording:
    return gw.simulate("check", effects={HIDDEN: {}}, machine=6)


@pytest.fixture(scope="module")
def measurement(original: gw.Recording) -> Any:
    return original.data.measurement


def found(recording: gw.Recording) -> dict[str, tuple[float, float]]:
    """Return the coefficients of the hidden effect with their standard errors, if it alone is named."""
    diagnosis = gw.diagnose(recording, gw.Model("gyrowheel"))
    # nothing is left but noise, whatever the rate
    assert diagnosis.error is not None
    left = [row.chi2_per_n for row in diagnosis.error.after.channels.values()]
    assert max(left) < 2.2, diagnosis.error.after.channels
    said = diagnosis.to_dict()
    assert (said["verdict"], [own["name"] for own in said["effects"]]) == ("effect", [HIDDEN]), said["setup"]
    return {
        name: (own["value"], own["standard_error"])
        for name, own in said["effects"][0]["coefficients"].items()
    }


def apart(one: dict[str, tuple[float, float]], other: dict[str, tuple[float, float]]) -> float:
    """Return by how many standard errors coefficients differ, the most."""
    return max(abs(one[name][0] - other[name][0]) / max(one[name][1], other[name][1]) for name in one)


def written(folder: Path, columns: dict[str, np.ndarray], units: dict[str, str]) -> list[Path]:
    """Write the same columns in every format of a lab."""
    return [
        lab.write_text(folder / "lab.csv", columns, units),
        lab.write_text(
            folder / "lab.csv.gz",
            columns,
            units,
            delimiter=";",
            decimal=",",
            units_row=True,
            head=["# Prüfstand 3", "# zweite Zeile"],
        ),
        lab.write_text(folder / "lab.txt", columns, units, delimiter="\t"),
        lab.write_mat5(folder / "lab5.mat", columns, units),
        lab.write_hdf5(folder / "lab73.mat", columns, units, matlab=True),
        lab.write_hdf5(folder / "lab.h5", columns, units),
        lab.write_numpy(folder / "lab.npz", columns, units),
        lab.write_numpy(folder / "lab.npy", columns, units),
        lab.write_feather(folder / "lab.feather", columns, units),
        lab.write_tdms(folder / "lab.tdms", columns, units),
        lab.write_mdf(folder / "lab.mf4", columns, units),
    ]


def test_the_same_data_in_every_format_is_the_same_recording(measurement: Any, tmp_path: Path) -> None:
    """To the digits that a table holds: what is found in one is found in all."""
    columns, units = lab.lab_columns(measurement[:4000], every=4)
    files = written(tmp_path, columns, units)
    read = [gw.read_table(file) for file in files]
    rows = read[0].data.measurement
    for file, own in zip(files, read, strict=True):
        same = own.data.measurement
        assert np.array_equal(same["sequence"], rows["sequence"]), file
        assert np.abs(same["stamp_ns"] - rows["stamp_ns"]).max() <= 100, file
        for name in lab.LAB:
            assert same[name] == pytest.approx(rows[name], rel=1e-8, abs=1e-9), (file, name)


@pytest.mark.study
def test_hidden_effect_is_found_in_every_format(measurement: Any, tmp_path: Path) -> None:
    columns, units = lab.lab_columns(measurement)
    first, *others = [found(gw.read_table(file)) for file in written(tmp_path, columns, units)]
    for own in others:
        assert apart(own, first) < 0.1


def test_hidden_effect_is_found_at_1_khz_with_jitter_and_a_gap(
    original: gw.Recording, measurement: Any, tmp_path: Path
) -> None:
    columns, units = lab.lab_columns(measurement, every=2, jitter=8e-5, gap=(9000, 9400))
    suggested = gw.suggest_map(lab.write_text(tmp_path / "lab.csv", columns, units))
    assert suggested.settled, suggested.questions
    recording = gw.read_table(tmp_path / "lab.csv", suggested)
    # half as many samples, and half of the voltages that acted: the coefficients agree within that noise
    assert apart(found(recording), found(original)) < 3.0


@pytest.mark.study
def test_effect_of_averages_is_found_without_an_angle(measurement: Any, tmp_path: Path) -> None:
    columns, units = lab.lab_columns(measurement, every=2, without=["spin_angle", "coil_temperature"])
    recording = gw.read_table(lab.write_text(tmp_path / "lab.csv", columns, units))
    said = gw.diagnose(recording, gw.Model("gyrowheel")).to_dict()
    # drag without its phase may be that of the bearing, too; it is said, not hidden
    assert said["verdict"] in ("effect", "ambiguous")
    assert [own["name"] for own in said["effects"]] == [HIDDEN]


def test_assumed_air_widens_the_coefficients(original: gw.Recording) -> None:
    """Windage goes with density^(n - 1): what a pressure that was never measured may be off is part of its error."""
    rows = original.data.measurement.copy()
    rows["air_pressure"] = np.nan
    found = []
    for recording in (original.data, replace(original.data, measurement=rows)):
        problem = prepare([recording], gw.Model("gyrowheel").details).problem
        fit = problem.refined(problem.fit((problem.unknowns.term(HIDDEN),)))
        found.append((fit.coefficients[HIDDEN], fit.standard_error(HIDDEN, "w")))
    (stated, known), (values, assumed) = found
    assert values["w"] == pytest.approx(stated["w"], rel=0.01)
    own = values["w"] * (values["n"] - 1.0) * 3000.0 / 101325.0
    assert assumed**2 - known**2 == pytest.approx(own**2, rel=0.1)


def test_uncertainty_of_a_constant_widens_the_coefficients(original: gw.Recording) -> None:
    """As what is assumed for a pressure that was never measured, but as large as the map says."""
    sizes = {}
    for pressure in (0.0, 500.0, 2000.0):
        text = described(original.data.bench_text, {"air_pressure": Origin(pressure)} if pressure else {})
        recording = replace(original.data, bench_text=text)
        problem = prepare([recording], gw.Model("gyrowheel").details).problem
        fit = problem.refined(problem.fit((problem.unknowns.term(HIDDEN),)))
        values = fit.coefficients[HIDDEN]
        sizes[pressure] = fit.standard_error(HIDDEN, "w")
    own = values["w"] * (values["n"] - 1.0) / 101325.0
    for pressure in (500.0, 2000.0):
        assert sizes[pressure] ** 2 - sizes[0.0] ** 2 == pytest.approx((own * pressure) ** 2, rel=0.1)


def test_the_steps_of_the_page_work(
    measurement: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gyrowheel: Shell
) -> None:
    """The table of the page, its commands up to the recording, and its lines of Python."""
    columns, units = lab.lab_columns(
        measurement, every=2, jitter=8e-5, gap=(9000, 9400), without=["spin_angle", "coil_temperature"]
    )
    units["Tilt Y"] = "rad"
    head = ["# Pruefstand 3, 2026-11-12"]
    lab.write_text(
        tmp_path / "bench3.csv", columns, units, delimiter=";", decimal=",", units_row=True, head=head
    )
    monkeypatch.chdir(tmp_path)
    page = PAGE.read_text(encoding="utf-8")
    blocks = [own for _, own in re.findall(r"^```(\w*)\n(.*?)^```", page, re.MULTILINE | re.DOTALL)]
    starts = ("$ gyrowheel import --suggest bench3.csv", "$ gyrowheel import bench3.csv")
    suggesting, importing = (
        own.removeprefix("$ ").partition("\n") for own in blocks if own.startswith(starts)
    )
    said = gyrowheel.good(*shlex.split(suggesting[0])[1:])
    assert said.out.count("•") == suggesting[2].count("•"), said.out
    made = tmp_path / "bench3.map.yaml"
    text = made.read_text(encoding="utf-8")
    right = text.replace("{column: Tilt Y, unit: rad}", "{column: Tilt Y, unit: deg}")
    made.write_text(right, encoding="utf-8")
    said = gyrowheel.good(*shlex.split(importing[0])[1:])
    for line in importing[2].splitlines():
        assert line in said.out
    (python,) = (own for own in blocks if own.startswith("import gyrowheel as gw"))
    names: dict[str, Any] = {}
    exec(compile(python, "import.md", "exec"), names)  # the page's own code
    assert len(names["recording"]) == 26185
    assert len(names["found"].questions) == 1


def other_rig(folder: Path, period: float, **hidden: Any) -> gw.Recording:
    """Return what is read from the table of a rig whose loop has another period [s]."""
    text = (Path(gyrowheel_sim.__file__).parent / "config" / "bench.yaml").read_text(encoding="utf-8")
    found_there = re.findall(r"sample_period: \{value: [0-9.e-]+", text)
    assert len(found_there) == 1
    (folder / "other.yaml").write_text(
        text.replace(found_there[0], f"sample_period: {{value: {period}"), encoding="utf-8"
    )
    run = gw.simulate("check", effects=hidden, machine=6, bench=folder / "other.yaml")
    columns, units = lab.lab_columns(run.data.measurement)
    recording = gw.read_table(lab.write_text(folder / "other.csv", columns, units))
    assert np.median(np.diff(recording.data.measurement["stamp_ns"])) == pytest.approx(1e9 * period, abs=100)
    return recording


@pytest.mark.study  # 1 kHz and 2 kHz are above
def test_an_effect_is_found_at_5_khz(tmp_path: Path) -> None:
    """The loop of another rig runs at 5 kHz, and the one who reads its table has the usual bench."""
    found(other_rig(tmp_path, 2.0e-4, **{HIDDEN: {}}))


@pytest.mark.study
def test_rig_at_500_hz_has_no_false_finding(tmp_path: Path) -> None:
    """Moves are a large part of its samples; in them the setpoint too changes the voltages that tell its rate."""
    told = gw.diagnose(other_rig(tmp_path, 2.0e-3), gw.Model("gyrowheel"))
    assert told.verdict == "nothing_missing", str(told)


@pytest.mark.parametrize("ros1", [False, True], ids=["ROS 2", "ROS 1"])
def test_a_bag_with_foreign_messages_is_read(measurement: Any, tmp_path: Path, ros1: bool) -> None:
    some = measurement[::2] if ros1 else measurement
    some = some[:6000]
    place = lab.write_bag(tmp_path / ("wheel.bag" if ros1 else "wheel"), some, ros1=ros1)
    columns = {
        name: {"column": f"/wheel/{topic}.vector.{axis}", "unit": unit}
        for name, topic, axis, unit in [
            ("tilt_x", "tilt", "x", "rad"),
            ("tilt_y", "tilt", "y", "rad"),
            ("air_temperature", "tilt", "z", "K"),
            ("spin_angle", "spin", "x", "rad"),
            ("spin_rate", "spin", "y", "rad/s"),
            ("coil_temperature", "spin", "z", "K"),
            ("coil_voltage_x", "coil_volts", "x", "V"),
            ("coil_voltage_y", "coil_volts", "y", "V"),
            ("motor_voltage", "motor", "x", "V"),
            ("motor_current", "motor", "y", "A"),
            ("air_pressure", "motor", "z", "Pa"),
        ]
    }
    given = {"schema": 1, "time": {"column": "/wheel/tilt.stamp", "unit": "s"}, "columns": columns}
    rows = gw.read_bag(place, given).data.measurement
    kept = some[: len(rows)]
    for name in lab.LAB:
        assert rows[name] == pytest.approx(kept[name], rel=1e-12, abs=1e-9), name
    assert np.array_equal(rows["stamp_ns"] - rows["stamp_ns"][0], kept["stamp_ns"] - kept["stamp_ns"][0])


def test_tables_in_memory(measurement: Any) -> None:
    import pandas as pd
    import pyarrow as pa

    columns, units = lab.lab_columns(measurement[:8000])
    named = {f"{name} [{units[name]}]": values for name, values in columns.items()}
    one, other = gw.read_table(pd.DataFrame(named)), gw.read_table(pa.table(named))
    assert np.array_equal(one.data.measurement, other.data.measurement)
    assert one.data.measurement["tilt_x"] == pytest.approx(measurement["tilt_x"][:8000], rel=1e-9)


def test_two_rates_and_two_clocks_in_one_file(measurement: Any, tmp_path: Path) -> None:
    """Temperatures at 10 Hz; the motor by a logger whose clock is 0.25 s ahead."""
    import h5py

    columns, units = lab.lab_columns(measurement)
    with h5py.File(tmp_path / "two.h5", "w") as file:
        for name, values in columns.items():
            folder, step = "fast", 1
            if "temp" in name or "pressure" in name:
                folder, step = "slow", 200
            elif "Motor" in name:
                folder = "motor"
            file[f"{folder}/{name}"] = values[::step]
            file[f"{folder}/{name}"].attrs["unit"] = units[name]
        file["slow/Time"] = columns["Time"][::200]
        file["motor/Time"] = columns["Time"] + 0.25
        for folder in ("slow", "motor"):
            file[f"{folder}/Time"].attrs["unit"] = "s"
    suggested = gw.suggest_map(tmp_path / "two.h5")
    assert suggested.settled, suggested.questions
    content = suggested.content
    assert content["columns"]["air_temperature"]["clock"] == "slow/Time"
    assert content["columns"]["motor_current"]["clock"] == "motor/Time"
    assert content["clocks"] == {"motor/Time": pytest.approx(-0.25, abs=0.005)}
    assert any("250" in remark and "ahead" in remark for remark in suggested.remarks)
    assert any("10 samples a second, interpolated" in remark for remark in suggested.remarks)
    rows = gw.read_table(tmp_path / "two.h5", suggested).data.measurement
    lost = len(measurement) - len(rows)
    assert lost < 600
    # the rows that not all clocks cover are those at the beginning: the motor's clock begins later by what was found
    begin = next(
        k for k in range(lost + 1) if measurement["tilt_x"][k] == pytest.approx(rows["tilt_x"][0], rel=1e-9)
    )
    whole = measurement[begin : begin + len(rows)]
    assert np.percentile(np.abs(rows["motor_voltage"] - whole["motor_voltage"]), 95) < 0.05


def by_two_loggers(measurement: Any, file: Path, *names: str) -> Path:
    """Write a file in which some columns are of a second logger, called drive, whose clock is 0.25 s ahead."""
    import h5py

    columns, units = lab.lab_columns(measurement)
    columns["Time"] = columns["Time"] - columns["Time"][0]
    with h5py.File(file, "w") as out:
        for name, values in columns.items():
            place = f"{'drive' if name in names else 'wheel'}/{name}"
            out[place], out[place].attrs["unit"] = values, units[name]
        out["drive/Time"], out["drive/Time"].attrs["unit"] = columns["Time"] + 0.25, "s"
    return file


def test_last_part_of_a_path_decides_its_meaning(measurement: Any, tmp_path: Path) -> None:
    """The folder says drive, as of a motor; the columns in it are those of the coils."""
    suggested = gw.suggest_map(
        by_two_loggers(measurement, tmp_path / "coils.h5", "Coil X", "Coil Y", "Coil temp")
    )
    assert suggested.settled, suggested.questions
    columns = suggested.content["columns"]
    assert [columns[f"coil_voltage_{axis}"]["column"] for axis in "xy"] == ["drive/Coil X", "drive/Coil Y"]
    assert suggested.content["clocks"] == {"drive/Time": pytest.approx(-0.25, abs=0.005)}


def test_unknown_clock_offset_is_asked_for(measurement: Any, tmp_path: Path) -> None:
    still = measurement[3000:4600]  # of a hold
    file = by_two_loggers(still, tmp_path / "hold.h5", "Motor voltage", "Motor current")
    suggested = gw.suggest_map(file)
    assert not suggested.settled
    assert any("'drive/Time'" in question and "0 for none" in question for question in suggested.questions)


def exchanged(one: str, other: str) -> Change:
    def change(columns: dict[str, np.ndarray], units: dict[str, str]) -> None:
        columns[one], columns[other] = columns[other], columns[one]

    return change


def called(name: str, unit: str) -> Change:
    def change(columns: dict[str, np.ndarray], units: dict[str, str]) -> None:
        units[name] = unit

    return change


def times(name: str, factor: float, unit: str = "") -> Change:
    def change(columns: dict[str, np.ndarray], units: dict[str, str]) -> None:
        columns[name] = columns[name] * factor
        units[name] = unit or units[name]

    return change


#: What is wrong with a table, and the reading that the question must name.
MISLEADING: dict[str, tuple[Change, str]] = {
    "tilts exchanged": (exchanged("Tilt X", "Tilt Y"), "tilt"),
    "coils exchanged": (exchanged("Coil X", "Coil Y"), "coil_voltage"),
    "rpm called rad/s": (called("Speed", "rad/s"), "spin_rate"),
    "rad/s called rpm": (times("Speed", np.pi / 30.0), "spin_rate"),
    "mV called V": (called("Coil X", "V"), "coil_voltage_x"),
    "motor in mV called V": (times("Motor voltage", 1e3), "motor_voltage"),
    "mA called A": (called("Motor current", "A"), "motor_current"),
    "voltage and current exchanged": (exchanged("Motor voltage", "Motor current"), "motor"),
    "a tilt with the other sign": (times("Tilt X", -1.0), "tilt"),
    "degrees called radians": (called("Tilt Y", "rad"), "tilt_y"),
    "kelvin called Celsius": (
        lambda columns, units: columns.update({"Air temp": columns["Air temp"] + 273.15}),
        "air_temperature",
    ),
    "seconds called milliseconds": (called("Time", "ms"), "time"),
}


#: The others are of the same kinds, and a study.
ALIKE = (
    "coils exchanged",
    "rad/s called rpm",
    "motor in mV called V",
    "mA called A",
    "degrees called radians",
)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.study] if name in ALIKE else []) for name in MISLEADING],
)
def test_a_misleading_table_is_questioned(measurement: Any, tmp_path: Path, name: str) -> None:
    change, asked = MISLEADING[name]
    columns, units = lab.lab_columns(measurement, every=4)
    change(columns, units)
    file = lab.write_text(tmp_path / "lab.csv", columns, units)
    suggested = gw.suggest_map(file)
    assert not suggested.settled
    assert any(asked in question for question in suggested.questions), suggested.questions
    with pytest.raises(gw.InputError, match="questions about its columns"):
        gw.read_table(file)


def test_all_faults_are_reported_at_once(measurement: Any, tmp_path: Path) -> None:
    columns, units = lab.lab_columns(measurement, every=4, without=["motor_current", "air_pressure"])
    units["Tilt X"], units["Time"] = "rad", "ms"
    columns["Coil Y"] = columns["Coil Y"].copy()
    columns["Coil Y"][100:110] = np.nan
    suggested = gw.suggest_map(lab.write_text(tmp_path / "lab.csv", columns, units))
    told = "\n".join((*suggested.questions, *suggested.remarks))
    for word in (
        "tilt_x: 'Tilt X [rad]' reaches",
        "time: a row every",
        "coil_voltage_y: 10 of",
        "motor_current",
        "air_pressure",
    ):
        assert word in told
    assert suggested.content["missing"] == "keep"
    suggested.save(tmp_path / "map.yaml")
    assert "# ? time: a row every" in (tmp_path / "map.yaml").read_text(encoding="utf-8")


def test_a_recording_read_back_is_that_of_the_lab(measurement: Any, tmp_path: Path) -> None:
    columns, units = lab.lab_columns(measurement, every=2)
    gw.read_table(lab.write_text(tmp_path / "lab.csv", columns, units), None, tmp_path / "run")
    rows = Recording.open(tmp_path / "run").measurement
    assert rows["tilt_x"] == pytest.approx(measurement["tilt_x"][::2], rel=1e-8)
    assert np.abs(np.diff(rows["stamp_ns"]) - 1_000_000).max() <= 100
