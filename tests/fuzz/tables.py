"""Tables of other programs, CSV and Parquet: refused, or imported with values that a bench can have."""

from __future__ import annotations

import functools
import random
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mapping import ColumnMap, import_table

from .damage import mutated, mutated_text
from .harness import Case, WrongAnswer
from .texts import MAP

_ROWS = 40
_CELLS = (
    "",
    "nan",
    "inf",
    "-inf",
    "1e400",
    "1e308",
    "-1e308",
    "1e-320",
    "x",
    "1,5",
    "0x1f",
    '"',
    '""',
    "\x00",
    "1 2",
    "٣",
    "1_0",
    "--1",
    "true",
)


def columns() -> dict[str, np.ndarray]:
    """Return the columns of a small table that is imported."""
    rng = np.random.default_rng(2)
    time = np.arange(_ROWS) * 0.5
    speed = np.full(_ROWS, 3000.0)
    return {
        "t_ms": time,
        "TiltX": rng.normal(scale=0.1, size=_ROWS),
        "TiltY": rng.normal(scale=0.1, size=_ROWS),
        "Angle": np.mod(speed * 6.0 * 1e-3 * time, 360.0),
        "Speed": speed,
        "Ux": rng.normal(size=_ROWS),
        "Uy": rng.normal(size=_ROWS),
        "Um": np.full(_ROWS, 6.0),
        "Im": np.full(_ROWS, 120.0),
    }


def text_table() -> str:
    """Return the table as CSV."""
    table = columns()
    rows = zip(*(column.tolist() for column in table.values()), strict=True)
    return "\n".join([",".join(table), *(",".join(map(repr, row)) for row in rows)]) + "\n"


@functools.cache
def _map(folder: Path) -> ColumnMap:
    return ColumnMap.load(folder / "map.yaml")


def _use(folder: Path, name: str, data: bytes) -> str:
    (folder / name).write_bytes(data)
    target = folder / "run"
    shutil.rmtree(target, ignore_errors=True)
    number = import_table(folder / name, _map(folder), target).samples
    recording = Recording.open(target)
    if len(recording.measurement) != number:
        raise WrongAnswer(f"{number} samples were imported, {len(recording.measurement)} are read")
    if not np.all(np.isfinite(recording.readings.array)):
        raise WrongAnswer("a value that is not finite was imported")
    return "imported"


def csv(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Damage a CSV file: bytes, lines, or single cells."""
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    text = text_table()
    if _use(folder, "table.csv", text.encode()) != "imported":
        raise AssertionError
    while True:
        kind = rng.randrange(3)
        if kind == 0:
            data = mutated(text.encode(), rng)
        elif kind == 1:
            data = mutated_text(text, rng).encode("utf-8", "surrogatepass")
        else:
            lines = text.split("\n")
            for _ in range(rng.choice((1, 2, 3))):
                k = rng.randrange(len(lines))
                cells = lines[k].split(",")
                cells[rng.randrange(len(cells))] = rng.choice(_CELLS)
                lines[k] = ",".join(
                    cells[: rng.choice((len(cells), len(cells), rng.randrange(len(cells) + 1)))]
                )
            data = "\n".join(lines).encode()
        yield Case("table.csv", data, lambda data: _use(folder, "table.csv", data))


def parquet(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Damage a Parquet file: its bytes, or the types and values of its columns."""
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    table = columns()
    whole = []
    for options in (
        {},
        {"compression": "zstd"},
        {"compression": "none", "use_dictionary": False},
        {"version": "1.0"},
    ):
        pq.write_table(pa.table(table), folder / "table.parquet", **options)
        whole.append((folder / "table.parquet").read_bytes())
    if _use(folder, "table.parquet", whole[0]) != "imported":
        raise AssertionError
    while True:
        data = mutated(rng.choice(whole), rng) if rng.random() < 0.8 else _odd(table, rng, folder)
        yield Case("table.parquet", data, lambda data: _use(folder, "table.parquet", data))


def _odd(table: dict[str, np.ndarray], rng: random.Random, folder: Path) -> bytes:
    """Return a valid Parquet file with a column of another type or with odd values."""
    odd: dict[str, object] = dict(table)
    name = rng.choice(list(table))
    values = table[name].tolist()
    place = rng.randrange(_ROWS)
    choices = (
        [str(value) for value in values],
        [
            *values[:place],
            rng.choice((float("nan"), float("inf"), 1e308, -1e308, 5e-324)),
            *values[place + 1 :],
        ],
        [*values[:place], None, *values[place + 1 :]],
        [value > 0 for value in values],
        [[value] for value in values],
        [b"x"] * _ROWS,
        [None] * _ROWS,
        pa.array([int(value) for value in values], pa.int8() if max(map(abs, values)) < 100 else pa.int64()),
        pa.array([int(1e6 * abs(value)) for value in values], pa.timestamp("us")),
        pa.array(values).dictionary_encode(),
        pa.array(values, pa.float32()),
        pa.array([int(abs(value)) for value in values]).cast(pa.decimal128(20, 0)),
    )
    odd[name] = rng.choice(choices)
    if rng.random() < 0.2:
        odd[rng.choice((name + " ", "\x00", "", "x" * 300))] = odd.pop(name)
    pq.write_table(pa.table(odd), folder / "odd.parquet")
    return (folder / "odd.parquet").read_bytes()
