"""Times as loggers write them: rounded, wrapped, set back, in days, in two columns; rows of several instruments."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_core.errors import InputError
from gyrowheel_recording.mapping.clock import ClockError, clock_of, rounded_to

from .test_wrong_tables import RATE, N, Table

TIME = np.arange(N) / RATE


def written(folder: Path, columns: dict[str, list[str]], *, without: tuple[str, ...] = ()) -> Path:
    """Write the table with other columns of times."""
    table = Table()
    del table.columns["Time [s]"]
    table.columns = columns | {name: own for name, own in table.columns.items() if name not in without}
    return table.write(folder)


def read(file: Path) -> np.ndarray:
    found = gw.suggest_map(file)
    assert found.settled, found.questions
    return gw.read_table(file, found).data.measurement


@pytest.mark.parametrize("rate", [1000.0, 1024.0, 1733.3, 2000.0])
@pytest.mark.parametrize("step", [0.001, 0.0015, 0.002, 0.003, 0.005, 0.010])
@pytest.mark.parametrize("lost", [(), ((500, 700),), ((50, 90), (900, 1000))])
def test_rounded_stamps_are_spread_evenly(
    rate: float, step: float, lost: tuple[tuple[int, int], ...]
) -> None:
    kept = np.delete(np.arange(4000), np.concatenate([np.arange(*own) for own in lost]) if lost else [])
    stamps = np.round(np.floor(kept / rate / step + 0.37) * step, 6)
    clock = clock_of(stamps)
    assert 1.0 / clock.period == pytest.approx(rate, rel=1e-3)
    assert clock.sequence[-1] + 1 == pytest.approx(4000, abs=3)
    assert np.abs(clock.stamps_ns - 1e9 * (kept - kept[0]) / rate).max() < 1.3e9 * step


def test_rows_that_are_there_twice_are_not_taken_for_rounded_ones() -> None:
    rng = np.random.default_rng(7)
    for count in (1, 5, 40, 200):
        assert rounded_to(np.sort(np.r_[TIME, rng.choice(TIME, count, replace=False)])) is None


def test_jitter_beyond_a_row_is_refused() -> None:
    rng = np.random.default_rng(7)
    clock_of(np.sort(TIME + rng.normal(0.0, 3e-4, N)))
    with pytest.raises(ClockError, match="rows; allowed: up to one row"):
        clock_of(np.sort(TIME + rng.normal(0.0, 0.067, N)))


DAY = 86400.0
STAMP = dt.datetime(2026, 5, 4, 11, 59, 59)
LATER = dt.datetime(2026, 5, 27, 11, 59, 59)
WRITTEN = {
    "datenum": {"t": [f"{739935.4 + x / DAY:.13f}" for x in TIME]},
    "julian day": {"JD": [f"{2461000.5 + x / DAY:.12f}" for x in TIME]},
    "spreadsheet": {"Time": [f"{46146.4 + x / DAY:.13f}" for x in TIME]},
    "epoch": {"epoch": [f"{1.784e9 + x:.4f}" for x in TIME]},
    "milliseconds": {"millis": [f"{round(1e3 * x) + 7}" for x in TIME]},
    "AM and PM": {
        "Date": [(STAMP + dt.timedelta(seconds=x)).strftime("%m/%d/%Y %I:%M:%S.%f %p") for x in TIME.tolist()]
    },
    "month by its name": {
        "Date": [(STAMP + dt.timedelta(seconds=x)).strftime("%d-%b-%Y %H:%M:%S.%f") for x in TIME.tolist()]
    },
    "month by a German name": {
        "Datum": [(STAMP + dt.timedelta(seconds=x)).strftime("%d. Mai %Y %H:%M:%S.%f") for x in TIME.tolist()]
    },
    "day after the month, beyond 12": {
        "Date": [(LATER + dt.timedelta(seconds=x)).strftime("%m/%d/%Y %H:%M:%S.%f") for x in TIME.tolist()]
    },
    "digits without signs": {
        "Date": [(STAMP + dt.timedelta(seconds=x)).strftime("%Y%m%dT%H%M%S.%f") for x in TIME.tolist()]
    },
    "milliseconds behind a colon": {
        "Time": [
            f"{STAMP + dt.timedelta(seconds=x):%H:%M:%S}:{round(1e3 * x) % 1000:03d}" for x in TIME.tolist()
        ]
    },
    "file times of Windows": {"Timestamp": [f"{134 * 10**15 + round(1e7 * x)}" for x in TIME]},
    "ticks of .NET": {"Ticks": [f"{639 * 10**15 + round(1e7 * x)}" for x in TIME]},
    "two columns": {
        "header.stamp.sec": [f"{1784000000 + int(x + 0.4)}" for x in TIME],
        "header.stamp.nanosec": [f"{round(1e9 * ((x + 0.4) % 1.0))}" for x in TIME],
    },
    "within a second": {
        "sec": ["12"] * N,
        "usec": [f"{round(1e6 * x) // 3}" for x in TIME],
    },
}


@pytest.mark.parametrize("name", [name for name in WRITTEN if name != "within a second"])
def test_times_of_every_writing_are_read(tmp_path: Path, name: str) -> None:
    rows = read(written(tmp_path, WRITTEN[name]))
    assert len(rows) == N
    assert np.diff(rows["stamp_ns"]) == pytest.approx(np.full(N - 1, 1e6), abs=1e5)


def test_numbers_of_rows_without_a_name_are_no_times(tmp_path: Path) -> None:
    found = gw.suggest_map(written(tmp_path, {"": [str(k) for k in range(N)]}))
    assert "time" not in found.content
    assert any("such as `rate: 1000`" in question for question in found.questions)


def test_a_clock_of_dates_that_was_set_back_is_told_in_seconds(tmp_path: Path) -> None:
    back = [STAMP + dt.timedelta(seconds=x - 3600.0 * (x >= 0.5)) for x in TIME.tolist()]
    found = gw.suggest_map(written(tmp_path, {"Date": [f"{own:%Y-%m-%d %H:%M:%S.%f}" for own in back]}))
    assert any("was set back by 3600 s in 1 place" in question for question in found.questions)


def test_a_second_of_rows_in_two_columns(tmp_path: Path) -> None:
    found = gw.suggest_map(written(tmp_path, WRITTEN["within a second"], without=("Encoder [deg]",)))
    assert found.content["time"] == {"column": "sec", "unit": "s", "plus": "usec", "plus_unit": "us"}


@pytest.mark.parametrize(
    ("begin", "whole", "least"), [(2**32, 2**32, 0), (2**31, 2**32, -(2**31)), (86_400_000_000, 86400e6, 0)]
)
def test_a_counter_that_begins_anew_is_counted_on(
    tmp_path: Path, begin: int, whole: float, least: int
) -> None:
    ticks = np.round(1e6 * TIME).astype(np.int64) + begin - 1_000_000 - least
    values = ticks % int(whole) + least
    file = written(tmp_path, {"t [us]": [str(value) for value in values]})
    found = gw.suggest_map(file)
    (question,) = found.questions
    assert f"restarts at {whole:.10g}, 1 place" in question
    given = found.content
    given["time"]["wraps"] = float(whole)
    rows = gw.read_table(file, given).data.measurement
    assert np.diff(rows["stamp_ns"]).tolist() == [1_000_000] * (N - 1)


def test_a_clock_that_was_set_back_is_told_from_rows_in_disorder(tmp_path: Path) -> None:
    back = np.where(np.arange(N) >= 1000, TIME - 0.2996, TIME)
    (question,) = gw.suggest_map(written(tmp_path, {"Time [s]": [f"{x:.4f}" for x in back]})).questions
    assert "was set back by 0.2996 in 1 place, first in row 1001" in question
    assert "Sort" not in question
    (question,) = gw.suggest_map(
        written(tmp_path, {"Time [s]": [f"{x:.4f}" for x in back]}, without=("Encoder [deg]",))
    ).questions
    assert "or another recording begins" in question
    assert "Sort" not in question


def test_rows_that_repeat_earlier_ones_are_reported(tmp_path: Path) -> None:
    """Where the shaft turns a whole number of times in them, the angle goes on as evenly as between other rows."""
    table = Table()
    table.columns["Encoder [deg]"] = [f"{x:.4f}" for x in np.mod(360.0 * 40.0 * TIME, 360.0)]
    table.columns["Speed [rpm]"] = ["2400"] * N
    table.spoil = lambda own: [*own[:1501], *own[1001:]]
    (question, *_) = gw.suggest_map(table.write(tmp_path)).questions
    assert (
        "goes back by 0.5 in 1 place, first in row 1501: the rows from there on repeat earlier ones"
        in question
    )
    assert "Take them out" in question


@pytest.mark.parametrize(("name", "a_turn"), [("Angle", 360.0), ("Angle", 1.0), ("revolutions", 1.0)])
@pytest.mark.parametrize("speed", [True, False])
def test_an_angle_that_runs_on_is_taken_in_the_unit_of_its_rate(
    tmp_path: Path, name: str, a_turn: float, speed: bool
) -> None:
    table = Table()
    turned = 250.0 / (2.0 * np.pi) * TIME * a_turn
    del table.columns["Encoder [deg]"]
    if not speed:
        del table.columns["Speed [rpm]"]
    table.columns[name] = [f"{x:.7f}" for x in turned]
    found = gw.suggest_map(table.write(tmp_path))
    assert found.content["columns"]["spin_angle"]["unit"] == {360.0: "deg", 1.0: "turn"}[a_turn]
    assert found.settled, found.questions


def of_day(seconds: np.ndarray) -> list[str]:
    micro = np.round(1e6 * seconds).astype(np.int64) % 86_400_000_000
    return [str((dt.datetime.min + dt.timedelta(microseconds=own)).time()) for own in micro.tolist()]


@pytest.mark.parametrize("begin", [40_000.25, 86_400.25 - 1e-3 * (N // 2)], ids=["at noon", "over midnight"])
def test_times_of_day_are_read_with_a_remark(begin: float, tmp_path: Path) -> None:
    file = written(tmp_path, {"Time": of_day(begin + 1e-3 * np.arange(N))})
    found = gw.suggest_map(file)
    assert found.questions == ()
    assert any("times of day without a date" in own for own in found.remarks)
    assert any("midnight before row" in own for own in found.remarks) == (begin > 80_000.0)
    rows = gw.read_table(file, found.content).data.measurement
    assert np.diff(rows["stamp_ns"]).tolist() == [1_000_000] * (N - 1)


def test_times_of_day_that_an_hour_is_taken_from_are_asked_about(tmp_path: Path) -> None:
    back = 40_000.25 + 1e-3 * np.arange(N) - np.where(np.arange(N) >= 1000, 3600.0, 0.0)
    (question,) = gw.suggest_map(written(tmp_path, {"Time": of_day(back)})).questions
    assert "was set back by 3600 in 1 place, first in row 1001" in question


def test_slow_readings_in_rows_of_their_own_are_interpolated(tmp_path: Path) -> None:
    table = Table()
    slow = ("Coil temp [degC]", "Air temp [degC]", "Air pressure [hPa]")
    rows: list[tuple[float, list[str]]] = []
    for k in range(N):
        cells = ["" if name in slow else values[k] for name, values in table.columns.items()]
        rows.append((TIME[k], [f"{TIME[k]:.4f}", *cells[1:]]))
        if k % 10 == 0:
            own = [values[k] if name in slow else "" for name, values in table.columns.items()]
            rows.append((TIME[k] + 4e-4, [f"{TIME[k] + 4e-4:.4f}", *own[1:]]))
    file = tmp_path / "union.csv"
    lines = [";".join(table.columns), *(";".join(cells) for _, cells in sorted(rows, key=lambda own: own[0]))]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    samples = read(file)
    assert len(samples) == N
    assert all(np.isfinite(samples[name]).all() for name in samples.dtype.names or ())
    assert samples["air_pressure"] == pytest.approx(np.full(N, 101300.0), abs=30.0)


def test_a_table_without_times_is_read_by_its_rate(tmp_path: Path) -> None:
    file = written(tmp_path, {})
    found = gw.suggest_map(file)
    assert any("rate: 1000" in text for text in found.questions)
    given = found.content | {"rate": RATE}
    rows = gw.read_table(file, given).data.measurement
    assert np.diff(rows["stamp_ns"]).tolist() == [1_000_000] * (N - 1)
    with pytest.raises(InputError, match="either time or rate"):
        gw.read_table(file, given | {"time": {"column": "Speed [rpm]", "unit": "s"}})


def test_a_map_that_gives_one_field_of_csv_has_the_others_seen(tmp_path: Path) -> None:
    table = Table()
    table.columns["Coil X [V]"][5] = "[OVR]"
    file = table.write(tmp_path)
    given = gw.suggest_map(file).content
    given["csv"] = {"missing": ["[OVR]"]}
    given["missing"] = "keep"
    rows = gw.read_table(file, given).data.measurement
    assert np.flatnonzero(np.isnan(rows["coil_voltage_x"])).tolist() == [5]
