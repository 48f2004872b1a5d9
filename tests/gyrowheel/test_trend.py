"""The verb `trend` and `gw.trend`: page, JSON, columns and picture of a table of many recordings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import gyrowheel as gw
from gyrowheel.batches import api

from .helpers import Shell


@pytest.fixture(scope="module")
def rows() -> list[api.Row]:
    """Return a batch of forty machines, a recording a day each; the drag of the air rises after the twentieth."""
    found: list[api.Row] = []
    for k in range(40):
        row: dict[str, Any] = dict.fromkeys(api.COLUMNS) | {
            "recording": f"runs/{k}", "key": f"{k}", "machine": f"wheel {k}", "start": 1.7e9 + 86400.0 * k,
            "verdict": "effect", "effects": "windage", "error": "",
        }  # fmt: skip
        row |= {"windage.w": 1e-3 * (1.0 + 0.02 * (k % 5) + 0.5 * (k >= 20)), "windage.w.error": 2e-5}
        found.append(row | {"motor_resistance": 2.5 + 0.01 * (k % 3), "motor_resistance.error": 0.01})
    return found


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_the_day_of_a_step_is_named(
    rows: list[api.Row], ending: str, tmp_path: Path, gyrowheel: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    api.write_rows(Path(f"results.{ending}"), rows)
    shown = gyrowheel.good("trend", f"results.{ending}", "--json", "trend.json", "--picture", "trend.png").out
    assert "windage.w over the machines: a step" in shown
    assert "from 2023-12-04, machine wheel 20" in " ".join(shown.split())
    content = json.loads(Path("trend.json").read_text())
    courses = {course["name"]: course for course in content["courses"]}
    left = courses["windage.w"]["departure"]
    assert (left["kind"], left["machine"], left["recording"]) == ("step", "wheel 20", "runs/20")
    assert left["size"] == pytest.approx(5e-4, rel=0.1)
    assert courses["motor_resistance"]["departure"] is None
    assert len(courses["motor_resistance"]["values"]) == 40
    assert Path("trend.png").read_bytes().startswith(b"\x89PNG")
    found = gw.trend(f"results.{ending}")
    assert repr(found) == "<Trend: windage.w: a step, from 2023-12-04, machine wheel 20>"
    assert {len(column) for column in found.to_columns().values()} == {80}
    shared = {own["name"]: own for own in content["shared"]}
    assert shared["windage.w"]["mean"] == pytest.approx(1.29e-3)
    low, high = shared["windage.w"]["interval"]
    assert low < shared["windage.w"]["spread"] < high
    assert shared["windage.w"]["spread"] == pytest.approx(2.5e-4, rel=0.05)
    assert (shared["windage.w"]["machines"], shared["windage.w"]["recordings"]) == (40, 40)
    assert (shared["motor_resistance"]["spread"], shared["motor_resistance"]["interval"][0]) == (0.0, 0.0)
    assert [own.name for own in found.differing] == ["windage.w"]
    assert "Machines differ in the first 1 of 2 quantities" in " ".join(shown.split())


def test_nothing_is_named_where_nothing_changes(rows: list[api.Row]) -> None:
    quiet = [{**row, "windage.w": 1e-3 * (1.0 + 0.02 * (k % 5))} for k, row in enumerate(rows)]
    found = gw.trend(gw.Batch(tuple(quiet)))
    assert found.headline() == "2 quantities, all within their control limits"
    assert "No quantity left its control limits." in str(found)
    assert "versions" not in str(found)
    mixed = gw.trend(gw.Batch(tuple(row | {"version": str(k % 2)} for k, row in enumerate(quiet))))
    assert "The recordings were diagnosed by 2 versions" in " ".join(str(mixed).split())


def test_a_few_machines_without_dates_have_a_mean_and_a_spread(
    rows: list[api.Row], tmp_path: Path, gyrowheel: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    api.write_rows(Path("few.parquet"), [{**row, "start": None} for row in rows[:3]])
    shown = gyrowheel.good("trend", "few.parquet").out
    assert "Too few dated recordings for control limits." in shown
    assert "windage.w mN·m 1.020 ± 0.012" in " ".join(shown.split())
    assert "Machines differ in no quantity" in shown
    refused = gyrowheel("trend", "few.parquet", "--picture", "trend.png")
    assert (refused.code, refused.err) == (
        2, "error: picture: no control limits; they take 8 dated machines or recordings\n",
    )  # fmt: skip
    unsteady = [{**row, "machine": f"m{k % 3}"} for k, row in enumerate(rows[:3] + rows[-3:])]
    found = gw.trend(gw.Batch(tuple(unsteady)))
    assert found.headline() == "2 quantities, too few dated recordings for control limits"
    assert "Recordings of a machine differ by more than their errors in windage.w" in " ".join(
        str(found).split()
    )


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.parquet", None, "none.parquet: no such file"),
        ("table.txt", b"", "table.txt: must end in .parquet or .csv"),
        ("table.csv", b"a,b\n1,2\n", "table.csv: not a table of a batch: it has no column recording"),
        ("few.parquet", 2, "few.parquet: 2 recordings; allowed: a quantity of at least 3 machines, or of at least 8 "
         "recordings in addition to the first of each machine"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(
    name: str, content: bytes | int | None, message: str, rows: list[api.Row], tmp_path: Path, gyrowheel: Shell,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    if isinstance(content, bytes):
        Path(name).write_bytes(content)
    elif content is not None:
        api.write_rows(Path(name), rows[:content])
    refused = gyrowheel("trend", name, "--picture", "trend.png")
    assert (refused.code, refused.err) == (2, f"error: {message}\n")
    assert not Path("trend.png").exists()
