"""What the benchmarks print and write; nothing here is timed."""

from __future__ import annotations

import importlib
import io
import json
import math
import sys
import types
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

import benchmarks
from benchmarks.__main__ import main
from benchmarks.results import Bar, Figure, MeasurementError, Report, number, shown, to_json
from benchmarks.timing import Timing, by_turns

KEYS = ["name", "value", "unit", "peer", "peer_value", "ratio", "bar", "holds"]
REPORT = Report(
    "Open loop",
    [
        Figure("speed", 900.0, "s/s", bar=Bar(">=", 800.0)),
        Figure("speed", 900.0, "s/s", "MuJoCo RK4", 36.0, Bar(">=", 30.0, "ratio")),
        Figure("speed", 900.0, "s/s", "SciPy LSODA", 100.0),
        Figure("tilt error", 3e-6, "rad", bar=Bar("<=", 1e-6)),
    ],
    notes=["One core."],
)


def printed(report: Report, width: int = 80) -> str:
    stream = io.StringIO()
    console = Console(file=stream, width=width)
    for part in shown(report):
        console.print(part)
    return stream.getvalue()


def test_file_has_an_entry_a_figure():
    entries = json.loads(to_json([REPORT]))
    assert [list(entry) for entry in entries] == [KEYS] * 4
    assert entries[1] == {
        "name": "Open loop: speed", "value": 900.0, "unit": "s/s", "peer": "MuJoCo RK4", "peer_value": 36.0,
        "ratio": 25.0, "bar": "ratio >= 30", "holds": False,
    }  # fmt: skip
    assert [entry["holds"] for entry in entries] == [True, False, None, False]
    assert entries[0]["peer"] is entries[0]["peer_value"] is entries[0]["ratio"] is None


def test_numbers_that_are_none_become_null():
    report = Report("T", [Figure("speed", math.inf, "s/s", "other", 0.0, Bar(">", 1.0))])
    (entry,) = json.loads(to_json([report]))
    assert entry["value"] is entry["ratio"] is None
    assert entry["holds"] is False


@pytest.mark.parametrize(
    ("sense", "below", "at", "above"),
    [(">=", False, True, True), (">", False, False, True), ("<=", True, True, False), ("<", True, False, False)],
)  # fmt: skip
def test_bars(sense, below, at, above):
    bar = Bar(sense, 2.0)
    assert (bar.holds(1.0), bar.holds(2.0), bar.holds(3.0)) == (below, at, above)
    assert not bar.holds(math.nan)


def test_contradictory_figures_are_refused():
    with pytest.raises(ValueError, match="both a name and a figure"):
        Figure("speed", 1.0, "s/s", peer="MuJoCo")
    with pytest.raises(ValueError, match="needs a peer"):
        Figure("speed", 1.0, "s/s", bar=Bar(">=", 30.0, "ratio"))


def test_table_says_each_figure_once_and_each_verdict():
    text = printed(REPORT)
    assert text.count("900 s/s") == 1
    assert [line.split()[-1] for line in text.splitlines() if line.rstrip().endswith(("yes", "NO"))] == [
        "yes",
        "NO",
        "NO",
    ]
    assert "ratio >= 30" in text
    assert "3.00e-06 rad" in text
    assert "One core." in text
    assert all(len(line) <= 80 for line in text.splitlines())
    assert "peer" not in printed(Report("T", REPORT.figures[:1]))


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (9.996, "10.00"), (984.4, "984"), (30.0, "30.0"), (-0.0123, "-0.0123"), (1.89e-8, "1.89e-08"),
     (math.nan, "not known")],
)  # fmt: skip
def test_numbers(value, text):
    assert number(value) == text


def test_turns():
    calls: list[str] = []
    parts: list[float] = []
    work = {name: (lambda name=name: calls.append(name)) for name in "ab"}
    times = by_turns(work, 3, turn_s=0.0, progress=parts.append)
    assert calls == ["a", "b"] * 4  # one round more than is counted
    assert parts == [0.25, 0.5, 0.75, 1.0]
    for timing in times.values():
        assert len(timing.cpu) == len(timing.wall) == 3
    timing = Timing((3.0, 1.0, 2.0), (5.0, 6.0, 4.0))
    assert (timing.best, timing.median, timing.clock) == (1.0, 2.0, 4.0)


@pytest.mark.parametrize("name", benchmarks.SUBJECTS)
def test_subjects_can_be_measured(name):
    assert callable(importlib.import_module(f"benchmarks.{name}").measure)


@pytest.fixture
def subject(monkeypatch: pytest.MonkeyPatch) -> str:
    """Put a subject among the others that needs no time."""
    module = types.ModuleType("benchmarks.nothing")

    def measure(progress: Callable[[float], None]) -> list[Report]:
        progress(1.0)
        return [REPORT]

    module.measure = measure  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "benchmarks.nothing", module)
    monkeypatch.setitem(benchmarks.SUBJECTS, "nothing", "nothing")
    return "nothing"


def test_command_prints_and_writes(subject: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "bench.json"
    assert main([subject, "--json", str(file)]) == 0
    assert json.loads(file.read_text(encoding="utf-8")) == json.loads(to_json([REPORT]))
    assert "1 of 3 bars hold" in capsys.readouterr().out
    assert main([subject, "--json", str(file), "--fail"]) == 1


def test_what_cannot_be_measured_is_said(
    subject: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def measure(progress: Callable[[float], None]) -> list[Report]:
        raise MeasurementError("no luck")

    sys.modules["benchmarks.nothing"].measure = measure  # type: ignore[attr-defined]
    file = tmp_path / "bench.json"
    assert main([subject, "--json", str(file)]) == 1
    assert capsys.readouterr().err.strip() == "error: nothing: no luck"
    assert not file.exists()


def test_bad_input_is_one_line(subject: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["speeed"])
    assert end.value.code == 2
    assert "'speeed' is not known; allowed: simulation" in capsys.readouterr().err
    blocked = tmp_path / "file"
    blocked.write_text("", encoding="utf-8")
    assert main([subject, "--json", str(blocked / "bench.json")]) == 2
    output = capsys.readouterr()
    assert output.err.strip().splitlines()[-1].startswith("error: ")
    assert not output.out  # refused before anything was measured
