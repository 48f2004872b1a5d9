"""Tables that are wrong in twenty ways: all that is wrong with one is told in one answer, each with its cure."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_sim.bench import Bench

N = 2000
RATE = 1000.0
BENCH = Bench.load()

Lines = list[str]
Change = Callable[["Table"], None]


class Table:
    """A table of a wheel at one speed and one tilt, to be spoilt before it is written."""

    def __init__(self) -> None:
        rng = np.random.default_rng(7)
        v, time = BENCH.value, np.arange(N) / RATE
        speed = np.full(N, 250.0) + rng.normal(0.0, 0.05, N)
        stiff = v("flexure_stiffness_x") - 0.5 * BENCH.tuning_inertia * 250.0**2
        current = 0.05 + rng.normal(0.0, 5e-3, N)
        tilt = {axis: size + rng.normal(0.0, 2e-5, N) for axis, size in (("x", 0.04), ("y", 0.03))}
        self.columns: dict[str, list[str]] = {
            "Time [s]": [f"{t:.4f}" for t in time],
            "Tilt X [deg]": self.written(np.degrees(tilt["x"])),
            "Tilt Y [deg]": self.written(np.degrees(tilt["y"])),
            "Encoder [deg]": self.written(np.degrees(np.mod(250.0 * time, 2.0 * math.pi))),
            "Speed [rpm]": self.written(speed * 30.0 / math.pi),
            "Coil X [V]": self.written(stiff * tilt["x"] / v("coil_constant") + rng.normal(0.0, 0.02, N)),
            "Coil Y [V]": self.written(stiff * tilt["y"] / v("coil_constant") + rng.normal(0.0, 0.02, N)),
            "Motor voltage [V]": self.written(v("motor_constant") * speed + v("motor_resistance") * current),
            "Motor current [A]": self.written(current),
            "Coil temp [degC]": self.written(np.full(N, 21.0) + rng.normal(0.0, 0.01, N)),
            "Air temp [degC]": self.written(np.full(N, 20.0) + rng.normal(0.0, 0.01, N)),
            "Air pressure [hPa]": self.written(np.full(N, 1013.0) + rng.normal(0.0, 0.05, N)),
        }
        self.delimiter = ";"
        self.spoil: Callable[[Lines], Lines] = lambda lines: lines

    @staticmethod
    def written(values: np.ndarray) -> list[str]:
        return [f"{value:.7g}" for value in values]

    def numbers(self, name: str) -> np.ndarray:
        return np.array([float(text) for text in self.columns[name]])

    def write(self, folder: Path) -> Path:
        lines = [self.delimiter.join(self.columns)]
        lines += [self.delimiter.join(row) for row in zip(*self.columns.values(), strict=True)]
        file = folder / "lab.csv"
        file.write_text("\n".join(self.spoil(lines)) + "\n", encoding="utf-8")
        return file


def cells(name: str, rows: slice, change: Callable[[str], str]) -> Change:
    """Return what writes some cells of a column otherwise."""

    def spoil(table: Table) -> None:
        table.columns[name][rows] = [change(text) for text in table.columns[name][rows]]

    return spoil


def lines(change: Callable[[Lines], Lines]) -> Change:
    """Return what changes the lines of a file."""

    def spoil(table: Table) -> None:
        table.spoil = change

    return spoil


def values(name: str, change: Callable[[np.ndarray], np.ndarray], form: str = "%.10g") -> Change:
    """Return what changes the numbers of a column."""

    def spoil(table: Table) -> None:
        table.columns[name] = [form % value for value in change(table.numbers(name))]

    return spoil


def renamed(old: str, new: str) -> Change:
    """Return what gives a column another name."""

    def spoil(table: Table) -> None:
        table.columns = {new if name == old else name: own for name, own in table.columns.items()}

    return spoil


def both(one: Change, other: Change) -> Change:
    """Return two changes, one after the other."""

    def spoil(table: Table) -> None:
        one(table)
        other(table)

    return spoil


def after(row: int, factor: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return what multiplies all values from a row on."""
    return lambda x: np.where(np.arange(len(x)) < row, x, factor * x)


def clipped(volts: np.ndarray) -> np.ndarray:
    """Let a voltage rise for a while to where the range of the logger ends."""
    volts = volts.copy()
    volts[500:900] += 0.5
    return np.minimum(volts, float(np.median(volts)) + 0.2)


def noise_clipped(volts: np.ndarray) -> np.ndarray:
    """Let noise reach where the range of the logger ends, and come back from it."""
    return np.minimum(volts, float(np.percentile(volts, 80.0)))


def merged(table: Table) -> None:
    """Let two loggers fill every other row."""
    for name in list(table.columns)[1:]:
        own = table.columns[name]
        motor = "Motor" in name
        table.columns[name] = [text if (k % 2 == 0) == motor else "" for k, text in enumerate(own)]


#: What is wrong with a table, and words of what must be told of it and of its cure.
WRONG: dict[str, tuple[Change, tuple[str, ...]]] = {
    "comma and point mixed": (
        cells("Coil X [V]", slice(400, 430), lambda text: text.replace(".", ",")),
        ("coil_voltage_x: 30 cells", "another decimal sign", "row 401", "Write all numbers with one"),
    ),
    "signs between the thousands": (
        cells("Air pressure [hPa]", slice(0, 900), lambda text: "1'" + text[1:]),
        ("air_pressure: 900 cells", "between the thousands", "Write the numbers without"),
    ),
    "two units in the cells of a column": (
        both(
            cells("Motor voltage [V]", slice(None, 1000), lambda text: f"{text} V"),
            cells("Motor voltage [V]", slice(1000, None), lambda text: f"{float(text) * 1e3} mV"),
        ),
        ("motor_voltage: 2000 cells", "a unit behind the number", "Write the numbers alone"),
    ),
    "hours, minutes and seconds in one number": (
        values("Time [s]", lambda time: 100059.0 + time + np.where(time < 1.0, 0.0, 40.0), "%.3f"),
        ("100059.999 is followed by 100100 in row 1001", "Write seconds from the beginning"),
    ),
    "every 50th row twice": (
        lines(
            lambda own: [own[0], *(line for k, line in enumerate(own[1:]) for _ in range(1 + (k % 50 == 0)))]
        ),
        ("stands still in 40 places, first in row 2: rows are there twice", "Take the second ones out"),
    ),
    "two units in one column": (
        values("Coil Y [V]", after(1200, 1000.0)),
        ("coil_voltage_y: 'Coil Y [V]' goes on in another unit from row 1201", "Write all rows in one unit"),
    ),
    "overrange as a text": (
        cells("Coil X [V]", slice(100, 103), lambda _: "OVR"),
        ("coil_voltage_x: 3 cells", "'OVR'", "row 101", "`csv: missing:`"),
    ),
    "any text": (
        cells("Motor current [A]", slice(100, 101), lambda _: "stop pressed"),
        ("motor_current: 1 cell", "'stop pressed'", "takes it for no reading"),
    ),
    "a number for nothing": (
        cells("Motor current [A]", slice(200, 240), lambda _: "-9999"),
        ("motor_current: 40 of 200", "-9999", "row 201", "`missing: -9999`"),
    ),
    "names again in the middle": (
        lines(lambda own: [*own[:1500], own[0], *own[1500:]]),
        ("1 lines that repeat the names are left out",),
    ),
    "averages at the end": (
        lines(lambda own: [*own, "Mean" + ";1" * 11]),
        ("time: 1 cell", "'Mean'", "Take these rows out"),
    ),
    "minutes and seconds": (
        cells("Time [s]", slice(None), lambda text: f"34:{float(text):09.6f}"),
        ("time: 2000 cells", "a time of day", "Write seconds from the beginning", "no column of times"),
    ),
    "Excel's date stamps": (
        values("Time [s]", lambda x: 46000.5 + x / 86400.0, "%.11f"),
        ("time: a row every", "Is it in day?"),
    ),
    "time backward": (
        values("Time [s]", lambda x: x[::-1]),
        ("time: 'Time [s]' runs backward", "Turn the order"),
    ),
    "time that restarts": (
        values("Time [s]", lambda x: np.mod(x, 0.7)),
        ("time: 'Time [s]' restarts", "2 places, first in row 701", "Cut the file there, before row 701"),
    ),
    "a counter of 16 bit": (
        both(
            values("Time [s]", lambda x: np.mod(np.round(x * 1e3) + 65_000, 65_536)),
            renamed("Time [s]", "Time [ms]"),
        ),
        ("time: 'Time [ms]' is a counter that restarts at 65536, 1 place", "Add 65536 to it"),
    ),
    "rows twice": (
        lines(lambda own: [*own[:500], own[499], *own[500:]]),
        ("stands still in 1 place", "Take the second ones out"),
    ),
    "two loggers merged": (merged, ("the rows of two loggers are merged", "a table of its own")),
    "a column twice": (
        lines(lambda own: [own[0].replace("Coil Y", "Coil X"), *own[1:]]),
        ("2 columns are called 'Coil X [V]'", "Give each a name of its own"),
    ),
    "rows cut off": (
        lines(lambda own: [*own[:700], own[700].rpartition(";")[0], *own[701:]]),
        ("rows of another length", "See whether the file is whole"),
    ),
    "no names": (lines(lambda own: own[1:]), ("no line of names", "Write one above the numbers")),
    "a column that is empty": (
        cells("Coil Y [V]", slice(20, None), lambda _: ""),
        ("column 'Coil Y [V]' has values in 20 of 2000 rows", "coil_voltage_y: no such column"),
    ),
    "volts clipped": (
        values("Motor voltage [V]", clipped),
        ("motor_voltage: 'Motor voltage [V]' stays at", "clip", "wider range"),
    ),
    "noise clipped": (
        values("Coil X [V]", noise_clipped),
        ("coil_voltage_x: 'Coil X [V]' stays at", "clip", "wider range"),
    ),
    "a slow logger": (
        values("Time [s]", lambda x: 100.0 * x),
        ("time: a row every 0.1 s", "20 samples a second"),
    ),
    "what was asked for": (
        renamed("Speed [rpm]", "Speed setpoint [rpm]"),
        ("spin_rate: no such column",),
    ),
    "an unknown unit": (
        renamed("Speed [rpm]", "Speed [furlong]"),
        ("spin_rate: the unit 'furlong'", "Set `unit:`"),
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_faults_of_a_table_are_reported_with_their_cures(tmp_path: Path, name: str) -> None:
    change, words = WRONG[name]
    table = Table()
    change(table)
    found = gw.suggest_map(table.write(tmp_path))
    told = "\n".join((*found.questions, *found.remarks))
    for word in words:
        assert word in told, told


def test_a_correct_table_raises_no_question(tmp_path: Path) -> None:
    found = gw.suggest_map(Table().write(tmp_path))
    assert found.settled, found.questions
    assert not found.remarks or all("samples a second" in remark for remark in found.remarks), found.remarks


def test_all_faults_are_reported_in_one_message(tmp_path: Path) -> None:
    several = ("comma and point mixed", "two units in one column", "a number for nothing", "time that restarts",
               "averages at the end", "volts clipped")  # fmt: skip
    table = Table()
    for name in several:
        WRONG[name][0](table)
    found = gw.suggest_map(table.write(tmp_path))
    told = "\n".join((*found.questions, *found.remarks))
    for name in several:
        assert WRONG[name][1][0] in told, (name, told)


def test_sentinels_stay_missing(tmp_path: Path) -> None:
    """The suggested map itself reads texts and numbers that stand for nothing, and names again in the middle."""
    table = Table()
    for name in ("overrange as a text", "a number for nothing", "names again in the middle"):
        WRONG[name][0](table)
    found = gw.suggest_map(table.write(tmp_path))
    assert found.settled, found.questions
    rows = gw.read_table(tmp_path / "lab.csv", found).data.measurement
    assert len(rows) == N
    assert np.flatnonzero(np.isnan(rows["coil_voltage_x"])).tolist() == [100, 101, 102]
    assert np.flatnonzero(np.isnan(rows["motor_current"])).tolist() == list(range(200, 240))
