"""Many recordings, a row of a table for each: found below folders, resumed, failures as rows."""

from __future__ import annotations

import shutil
import time
import warnings
from pathlib import Path
from typing import Any

import pyarrow
import pyarrow.csv
import pyarrow.parquet
import pytest

import gyrowheel as gw
from gyrowheel.batches import api, workers

from .conftest import Wheel
from .helpers import Shell


@pytest.fixture(scope="module")
def runs(wheel: Wheel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a recording in a subfolder, one file of it alone, and one that is damaged."""
    folder = tmp_path_factory.mktemp("batch")
    shutil.copytree(wheel.recording, folder / "monday" / "first")
    (file,) = Path(wheel.recording).glob("*.mcap")
    shutil.copy(file, folder / "alone.mcap")
    (folder / "bad").mkdir()
    (folder / "bad" / "metadata.yaml").write_text("nothing")
    (folder / "notes.txt").write_text("no recording")
    return folder


@pytest.mark.parametrize("ending", ["parquet", pytest.param("csv", marks=pytest.mark.study)])
@pytest.mark.slow
def test_every_recording_is_a_row_and_done_once(
    runs: Path, wheel: Wheel, ending: str, tmp_path: Path, gyrowheel: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / f"results.{ending}"
    options = ("batch", runs, "--model", wheel.model, "-o", table, "--jobs", "1")
    shown = gyrowheel.good(*options)
    assert "windage" in shown.out
    assert "failed " in shown.out
    rows = {row["recording"]: row for row in api.read_rows(table)}
    assert set(rows) == {str(runs / name) for name in ("monday/first", "alone.mcap", "bad")}
    good, bad = rows[str(runs / "monday/first")], rows[str(runs / "bad")]
    assert (good["verdict"], good["effects"], good["error"]) == ("effect", "windage", "")
    found = gw.diagnose(wheel.recording, gw.Model.load(wheel.model)).effects[0]
    assert good["windage.w"] == pytest.approx(found.coefficients["w"].value)
    assert good["windage.w.error"] > 0.0
    assert good["windage.w.data"] == good["windage.w"]  # it has no prior
    assert 0.0 < good["windage.w.data_scatter"] < good["windage.w.data_error"]
    assert good["motor_constant.data_error"] > good["motor_constant.error"]
    assert bad["verdict"] == "failed"
    assert "metadata.yaml" in bad["error"]
    assert "windage.w" not in bad

    def again(*_: object) -> dict[str, Any]:
        raise AssertionError("diagnosed again")

    monkeypatch.setattr(api, "diagnosed", again)
    assert "3 of 3 were in" in gyrowheel.good(*options).err
    assert {row["recording"]: row for row in api.read_rows(table)} == rows


@pytest.mark.slow
def test_a_recording_whose_name_is_no_text_is_a_row(wheel: Wheel, tmp_path: Path, gyrowheel: Shell) -> None:
    (file,) = Path(wheel.recording).glob("*.mcap")
    (tmp_path / "monday").mkdir()
    shutil.copy(file, tmp_path / "monday" / "a \udcff.mcap")
    table = tmp_path / "results.csv"
    gyrowheel.good("batch", tmp_path, "--model", wheel.model, "-o", table, "--jobs", "1")
    (row,) = api.read_rows(table)
    assert (row["recording"], row["verdict"]) == (f"{tmp_path / 'monday'}/a \\udcff.mcap", "effect")
    assert "1 of 1 were in" in gyrowheel.good("batch", tmp_path, "--model", wheel.model, "-o", table).err


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_rows_are_read_as_they_were_written(ending: str, tmp_path: Path) -> None:
    """Names and digests of digits stay texts."""
    rows = [
        dict.fromkeys(api.COLUMNS)
        | {
            "recording": "1e3",
            "key": "12e4567890123456",
            "machine": "0012",
            "verdict": "effect",
            "proven": False,
            "effects": "",
            "error": "",
        }
        | {"start": 0.1 + 0.2, "windage.w": 1.0e-3 / 3.0},
        dict.fromkeys(api.COLUMNS)
        | {"recording": "b, c", "key": "0", "verdict": "failed", "error": 'says "no"'},
    ]
    table = tmp_path / f"rows \udcff.{ending}"
    api.write_rows(table, rows)
    assert api.read_rows(table) == rows
    api.write_rows(table, [rows[0] | {"recording": "a \udcff"}])  # a path that is no text
    assert api.read_rows(table)[0]["recording"] == "a \\udcff"


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_a_table_without_the_columns_that_were_added_later_is_read(ending: str, tmp_path: Path) -> None:
    row = dict.fromkeys(api.COLUMNS) | {"recording": "a", "key": "0", "verdict": "effect", "error": ""}
    write = pyarrow.parquet.write_table if ending == "parquet" else pyarrow.csv.write_csv
    write(
        pyarrow.table({n: [v] for n, v in row.items() if n not in ("version", "proven")}),
        tmp_path / f"t.{ending}",
    )
    assert api.read_rows(tmp_path / f"t.{ending}") == [row]


def test_a_changed_recording_or_model_is_diagnosed_again_and_an_interruption_keeps_the_rows(
    runs: Path, wheel: Wheel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, table = gw.Model.load(wheel.model), tmp_path / "results.parquet"
    calls: list[str] = []

    def made_up(_: object, item: tuple[str, str], scratch: str | None = None) -> dict[str, Any]:
        if len(calls) == 2:
            raise KeyboardInterrupt
        calls.append(item[0])
        return dict.fromkeys(api.COLUMNS) | {
            "recording": item[0],
            "key": item[1],
            "verdict": "unknown",
            "error": "",
        }

    monkeypatch.setattr(api, "diagnosed", made_up)
    found = gw.batch(runs, model, table, jobs=1)
    assert found.interrupted
    assert len(api.read_rows(table)) == 2
    calls.clear()
    assert len(gw.batch(runs, model, table, jobs=1).rows) == 3
    assert len(calls) == 1
    (runs / "bad" / "metadata.yaml").write_text("something else")
    calls.clear()
    gw.batch(runs, model, table, jobs=1)
    assert calls == [str(runs / "bad")]
    calls.clear()
    other = gw.batch(
        runs / "monday", model.remove("windage") if model.effects else gw.Model("dtg"), table, jobs=1
    )
    assert calls == [str(runs / "monday/first")]
    # rows of recordings elsewhere stay
    assert len(other.rows) == 3


@pytest.mark.parametrize("versionless", [False, True])
def test_rows_of_another_version_are_diagnosed_again(
    runs: Path,
    wheel: Wheel,
    versionless: bool,
    tmp_path: Path,
    gyrowheel: Shell,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also those of the first tables, which had no version."""
    table, calls = tmp_path / "results.csv", []

    def made_up(_: object, item: tuple[str, str], scratch: str | None = None) -> dict[str, Any]:
        calls.append(item[0])
        own = {"recording": item[0], "key": item[1], "verdict": "unknown", "error": ""}
        return dict.fromkeys(api.COLUMNS) | own

    monkeypatch.setattr(api, "diagnosed", made_up)
    options = ("batch", runs, "--model", wheel.model, "-o", table, "--jobs", "1")
    assert "another version" not in gyrowheel.good(*options).err
    rows = api.read_rows(table)
    assert len(rows) == 3
    assert {row["version"] for row in rows} == {api._version()}
    elsewhere = rows[0] | {"recording": "elsewhere", "key": "0", "version": "0.0.1"}
    rows = [elsewhere, *(row | {"version": "0.0.1"} for row in rows[:2]), rows[2]]
    if versionless:
        columns = api.columns_of(rows)
        del columns["version"]
        pyarrow.csv.write_csv(pyarrow.table(columns), table)
    else:
        api.write_rows(table, rows)
    calls.clear()
    shown = gyrowheel.good(*options).err
    assert len(calls) == (3 if versionless else 2)
    assert f"{len(calls)} of {table} were of another version: diagnosed again" in shown
    found = {row["recording"]: row["version"] for row in api.read_rows(table)}
    assert len(found) == 4
    assert found.pop("elsewhere") == (None if versionless else "0.0.1")
    assert set(found.values()) == {api._version()}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nowhere", "-o", "r.parquet"), "nowhere: no such folder"),
        ((".", "-o", "r.txt"), "r.txt: must end in .parquet or .csv"),
        ((".", "-o", "r.parquet"), ".: no recording in it; allowed: folders with metadata.yaml, .mcap, .db3"),
        ((".", "-o", "r.parquet", "--jobs", "0"), "jobs: 0 is out of range; allowed: >= 1"),
    ],
)
def test_bad_input_is_one_line(
    words: tuple[str, ...],
    message: str,
    wheel: Wheel,
    gyrowheel: Shell,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    refused = gyrowheel("batch", *words, "--model", wheel.model)
    assert (refused.code, refused.err) == (2, f"error: {message}\n")
    assert not list(tmp_path.iterdir())


def test_work_that_ends_early_warns_of_nothing() -> None:
    """As after an error or Ctrl-C, with results that nobody takes."""

    def call(item: int, scratch: str | None) -> int:
        time.sleep(0.05)
        return item

    with (
        warnings.catch_warnings(record=True) as warned,
        workers.finished(call, range(40), jobs=2) as results,
    ):
        warnings.simplefilter("always")
        assert next(results) in range(4)
    assert [str(own.message) for own in warned] == []


def test_what_the_data_contradict_is_not_stated_as_missing() -> None:
    row = dict.fromkeys(api.COLUMNS, "") | {"verdict": "effect", "effects": "windage"}
    page = str(gw.Batch(tuple(row | {"proven": proven} for proven in (True, None, False))))
    lines = [line.split() for line in page.splitlines() if "windage" in line]
    assert [" ".join(line) for line in lines] == [
        "an effect is missing windage 2",
        "an effect may be missing, not proven windage 1",
    ]
