"""The map that is suggested for a table opens its file, and gives what the preview showed: tables of every writing."""

from __future__ import annotations

import datetime as dt
import gzip
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_core.errors import InputError

from .test_wrong_tables import Table

ROWS = 300
HEADS = (
    "Prüfstand 3",
    "Messung 12.11.2026 10:00",
    "gain … 2.5",
    "rig;B,3\tx",
    "form\x0cfeed",
    "",
    "a = 1.5 V",
)
WORDS = ("OVR", "n/a", "overload")


def times(kind: str, seconds: list[float]) -> dict[str, list[str]]:
    """Return the column, or the columns, of the times of a table, by their names."""
    begin = dt.datetime(2026, 11, 12, 10, 0, 58)
    dates = [begin + dt.timedelta(seconds=own) for own in seconds]
    return {
        "s": {"Time [s]": [f"{own:.4f}" for own in seconds]},
        "ms": {"t [ms]": [f"{1e3 * own:.1f}" for own in seconds]},
        "epoch": {"epoch [s]": [f"{1.784e9 + own:.4f}" for own in seconds]},
        "ticks": {"Ticks": [f"{134 * 10**15 + round(1e7 * own)}" for own in seconds]},
        "date": {"Date": [f"{own:%Y-%m-%dT%H:%M:%S.%f}" for own in dates]},
        "month": {"Date": [f"{own:%d-%b-%YT%H:%M:%S.%f}" for own in dates]},
        "two columns": {
            "sec": [f"{1784000000 + int(own)}" for own in seconds],
            "nanosec": [f"{round(1e9 * own) % 10**9}" for own in seconds],
        },
    }[kind]


class Written:
    """A table written in a way that a seed chooses."""

    def __init__(self, seed: int) -> None:
        rng = self.rng = np.random.default_rng(seed)
        self.delimiter = str(rng.choice([",", ";", "\t", "|", " "]))
        self.decimal = "," if self.delimiter != "," and rng.random() < 0.3 else "."
        self.end = str(rng.choice(["\n", "\r\n", "\r"]))
        self.encoding = str(rng.choice(["utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-16-le"]))
        self.packed = rng.random() < 0.1
        self.units = str(rng.choice(["names", "names", "line", "line", "cells"]))
        self.times = str(rng.choice(["s", "s", "ms", "epoch", "ticks", "date", "month", "two columns"]))
        self.index = str(rng.choice(["", "", "nameless", "R", "index"]))
        self.holes = rng.random() < 0.3
        self.notes: list[str] = []

    def cells(self) -> tuple[list[str], list[str], list[list[str]]]:
        """Return names, units and rows of cells."""
        rng, table = self.rng, Table()
        columns = {name: values[:ROWS] for name, values in table.columns.items()}
        columns = times(self.times, [float(text) for text in columns.pop("Time [s]")]) | columns
        if self.units == "cells" and self.delimiter != " ":
            columns = {
                name.partition(" [")[0]: [cell + unit for cell in values]
                for name, values in columns.items()
                for unit in [name.partition(" [")[2].replace("]", "")]
            }
        names, units, rows = (
            list(columns),
            [""] * len(columns),
            [*map(list, zip(*columns.values(), strict=True))],
        )
        if self.units == "line":
            names, units = (
                list(part)
                for part in zip(*([*name.rstrip("]").split(" ["), ""][:2] for name in names), strict=True)
            )
        if self.delimiter == " ":
            names = [name.replace(" ", "_") for name in names]
        if self.holes:
            for row in rng.integers(1, ROWS, 5):
                rows[row][rng.integers(2, len(names))] = str(rng.choice(["", "NaN", *WORDS[:2]]))
                if self.delimiter == " ":
                    rows[row] = [cell or "NaN" for cell in rows[row]]
        if rng.random() < 0.2:
            rows = [[*row[:2], row[2].replace("-", "\u2212"), *row[3:]] for row in rows]
        if self.decimal == ",":
            rows = [[cell.replace(".", ",") for cell in row] for row in rows]
        if self.index in ("nameless", "index"):
            names, units = ["" if self.index == "nameless" else "index", *names], ["", *units]
            rows = [[str(k), *row] for k, row in enumerate(rows)]
        if self.delimiter == " " and self.index == "nameless":
            names[0] = "row"
        return names, units, rows

    def text(self) -> str:
        """Return the text."""
        rng = self.rng
        names, units, rows = self.cells()
        if self.index == "R":
            rows = [[str(k), *row] for k, row in enumerate(rows, 1)]
        if self.delimiter != " " and rng.random() < 0.2:
            names = [f'"{name}"' for name in names]
            if self.units == "names" and rng.random() < 0.5:
                names = [name.replace(" [", "\n[") for name in names]
        lines = [str(rng.choice(HEADS)) for _ in range(rng.integers(0, 4))]
        lines.append(self.delimiter.join(names))
        if self.units == "line":
            lines.append(self.delimiter.join(unit or "-" for unit in units))
            if rng.random() < 0.2:  # how often each is written, as some loggers state
                lines.append(self.delimiter.join(["Smp"] * len(units)))
        apart = "   " if self.delimiter == " " and rng.random() < 0.5 else self.delimiter
        body = [apart.join(row) for row in rows]
        if self.delimiter != " " and self.index != "R" and rng.random() < 0.15:
            body = [line + self.delimiter for line in body]
        if rng.random() < 0.15:
            body.insert(len(body) // 2, "# paused, and went on")
        if rng.random() < 0.1:
            body.insert(len(body) // 2, "")
        if rng.random() < 0.1 and self.delimiter != " ":
            body += [self.delimiter * (body[0].count(self.delimiter))] * 3
        elif rng.random() < 0.1:
            body[-1] = body[-1][: len(body[-1]) // 2]
        return "\n".join([*lines, *body]) + "\n" * (rng.random() < 0.8)

    def write(self, folder: Path) -> Path:
        """Write it."""
        data = self.text().replace("\n", self.end).encode(self.encoding, "replace")
        file = folder / ("table.csv.gz" if self.packed else "table.csv")
        file.write_bytes(gzip.compress(data) if self.packed else data)
        return file


def opened(file: Path) -> str:
    """Return what is wrong with the suggested map of a file; empty where it opens the file as the preview showed."""
    found = gw.suggest_map(file)
    preview = found.suggestion.recording
    if not found.settled or preview is None:
        return f"not settled: {' '.join(found.questions)[:300]}"
    made = gw.read_table(file, found).data.measurement
    same = made.dtype == preview.measurement.dtype and made.tobytes() == preview.measurement.tobytes()
    file.with_name("map.yaml").write_text(found.suggestion.map_text(), encoding="utf-8")
    again = gw.read_table(file, file.with_name("map.yaml")).data.measurement
    if not same or again.tobytes() != made.tobytes():
        return "another recording than the preview"
    return "" if abs(len(made) - ROWS) <= 1 else f"{len(made)} samples of {ROWS}"


@pytest.mark.parametrize("seed", range(30))
def test_the_suggested_map_opens_its_file_and_gives_the_preview(tmp_path: Path, seed: int) -> None:
    assert opened(Written(seed).write(tmp_path)) == ""


@pytest.mark.study
@pytest.mark.slow
def test_two_thousand_suggested_maps_open_their_files(tmp_path: Path) -> None:
    wrong = {}
    for seed in range(1000, 3000):
        file = Written(seed).write(tmp_path)
        try:
            said = opened(file)
        except InputError as error:
            said = str(error)
        if said:
            wrong[seed] = said
        file.unlink()
    assert wrong == {}


DEVICES = {
    "LabJack": ("\t", [f"AIN{k}" for k in range(8)], ["time", *(f"v{k}" for k in range(8))]),
    "NI": (",", None, ["Time (s)", *(f"Dev1/ai{k} (V)" for k in range(8))]),
    "SignalExpress": (",", None, ["Time", *(f"Y[{k}]" for k in range(8))]),
    "FlexLogger": (",", None, ["Time (s)", *(f"Voltage_{k}" for k in range(8))]),
    "PicoScope": (",", None, ["Time (s)", *(f"Channel {letter}" for letter in "ABCDEFGH")]),
}


@pytest.mark.parametrize("device", DEVICES)
def test_inputs_of_a_device_are_asked_for_and_not_guessed(device: str, tmp_path: Path) -> None:
    delimiter, head, names = DEVICES[device]
    volts = np.random.default_rng(1).normal(1.0, 1.0, (400, 8)).round(4)
    lines = [delimiter.join(head)] if head else []
    lines += [delimiter.join(names)]
    lines += [delimiter.join([f"{5e-4 * k:.4f}", *map(str, row)]) for k, row in enumerate(volts.tolist())]
    file = tmp_path / "card.csv"
    file.write_text("\n".join(lines), encoding="utf-8")
    found = gw.suggest_map(file)
    assert found.content["columns"] == {}
    assert found.content["time"]["column"] == names[0]
    (asked,) = (question for question in found.questions if "inputs of a device" in question)
    assert f"'{names[1]}' .. '{names[-1]}'" in asked


def test_axes_with_numbers_are_no_inputs_of_a_device(tmp_path: Path) -> None:
    names = ["time", "tilt1", "tilt2", "rpm", "u1", "u2", "um", "im"]
    values = np.random.default_rng(1).normal(0.0, 0.01, (400, 8)).round(4)
    values[:, 0], values[:, 3] = 5e-4 * np.arange(400), 3000.0
    file = tmp_path / "rig.csv"
    np.savetxt(file, values, delimiter=",", header=",".join(names), comments="")
    found = gw.suggest_map(file)
    assert found.content["columns"]["coil_voltage_x"]["column"] == "u1"
    assert not [question for question in found.questions if "inputs of a device" in question]
