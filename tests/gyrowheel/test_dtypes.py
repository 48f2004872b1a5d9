"""Tables of pandas and of arrow whose columns are of other types than plain numbers: read right, or refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import gyrowheel as gw

N = 200
TIME = np.arange(N) * 5e-4
MAP: dict[str, Any] = {
    "schema": 1,
    "time": {"column": "t", "unit": "s"},
    "missing": "keep",
    "columns": {
        "tilt_x": {"column": "a", "unit": "mrad"},
        "tilt_y": {"column": "b", "unit": "mrad"},
        "spin_rate": {"column": "w", "unit": "rad/s"},
        "motor_current": {"column": "i", "unit": "mA"},
    },
}
WHOLE = np.arange(N) % 50
NS = np.round(TIME * 1e9).astype(np.int64)


def table(**changed: Any) -> Any:
    columns = {"t": TIME, "a": WHOLE * 1.0, "b": WHOLE * 0.5, "w": np.full(N, 200.0), "i": WHOLE * 1.0}
    return pa.table(columns | changed)


def twice(values: Any) -> Any:
    """Return a column in two chunks."""
    return pa.chunked_array([values[:70], values[70:]])


READ: dict[str, Callable[[], Any]] = {
    "decimals": lambda: pa.array(WHOLE.tolist()).cast(pa.decimal128(22, 3)),
    "categories": lambda: pa.array(WHOLE.astype(float)).dictionary_encode(),
    "chunks": lambda: twice(pa.array(WHOLE)),
    "categories in chunks": lambda: twice(pa.array(WHOLE)).dictionary_encode(),
    "half floats": lambda: pa.array(WHOLE.astype(np.float16)),
    "single floats": lambda: pa.array(WHOLE.astype(np.float32)),
    "bytes": lambda: pa.array(WHOLE.astype(np.uint8)),
}


@pytest.mark.parametrize("stored", [False, True], ids=["in memory", "stored"])
@pytest.mark.parametrize("name", READ)
def test_numbers_of_any_type_are_read(name: str, stored: bool, tmp_path: Path) -> None:
    given = table(i=READ[name]())
    if stored:
        pq.write_table(given, tmp_path / "t.parquet")
        given = tmp_path / "t.parquet"
    rows = gw.read_table(given, MAP).data.measurement
    assert rows["motor_current"] == pytest.approx(1e-3 * WHOLE, rel=1e-6)


@pytest.mark.parametrize("stored", [False, True], ids=["in memory", "stored"])
@pytest.mark.parametrize(
    ("kind", "unit"),
    [
        (pa.timestamp("ns"), "timestamp"),
        (pa.timestamp("us"), "timestamp"),
        (pa.timestamp("us", "Europe/Vienna"), "timestamp"),
        (pa.duration("us"), "s"),
        (pa.duration("ns"), "s"),
    ],
)
def test_times_of_any_type_are_read(kind: Any, unit: str, stored: bool, tmp_path: Path) -> None:
    stamps = pa.array(NS + (1_700_000_000_000_000_000 if unit == "timestamp" else 0))
    ns = pa.timestamp("ns") if unit == "timestamp" else pa.duration("ns")
    given = table(t=stamps.cast(ns).cast(kind))
    if stored:
        pq.write_table(given, tmp_path / "t.parquet")
        given = tmp_path / "t.parquet"
    rows = gw.read_table(given, MAP | {"time": {"column": "t", "unit": unit}}).data.measurement
    assert np.abs(rows["stamp_ns"] - NS).max() < 100


def test_missing_numbers_are_nan() -> None:
    holed = pa.array([None if k in (3, 90) else int(v) for k, v in enumerate(WHOLE)])
    for values in (holed, holed.cast(pa.decimal128(22, 3)), holed.dictionary_encode()):
        rows = gw.read_table(table(i=values), MAP).data.measurement
        assert np.flatnonzero(np.isnan(rows["motor_current"])).tolist() == [3, 90]


@pytest.mark.parametrize(
    "values", [pa.array(["x"] * N), pa.array([[1.0]] * N), pa.array([{"a": 1}] * N), pa.nulls(N)]
)
def test_values_that_are_not_numbers_are_refused(values: Any) -> None:
    with pytest.raises(gw.InputError, match=r"column 'i'"):
        gw.read_table(table(i=values), {k: v for k, v in MAP.items() if k != "missing"})


def test_tables_of_pandas() -> None:
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame(
        {
            "t": pd.to_timedelta(NS, unit="ns"),
            "a": pd.array(WHOLE, dtype="Float32"),
            "b": pd.Categorical(WHOLE * 0.5),
            "w": np.full(N, 200.0),
            "i": pd.array([None, *WHOLE[1:].tolist()], dtype="Int64"),
        }
    )
    rows = gw.read_table(frame, MAP).data.measurement
    assert np.abs(rows["stamp_ns"] - NS).max() < 100
    assert rows["tilt_y"] == pytest.approx(0.5e-3 * WHOLE)
    assert np.flatnonzero(np.isnan(rows["motor_current"])).tolist() == [0]
    assert rows["motor_current"][1:] == pytest.approx(1e-3 * WHOLE[1:])
