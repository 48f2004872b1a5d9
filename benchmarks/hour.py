"""An hour of the whole graph in real time, recorded, then diagnosed: no lost samples, no growing memory."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from benchmarks.diagnosis import diagnosed
from benchmarks.realtime import run
from benchmarks.results import Bar, Figure, Report
from gyrowheel_core.node import prepare_environment

MINUTES = 60.0
_RUN = 0.97  # fraction of the progress


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Measure an hour; takes five minutes more."""
    prepare_environment()
    folder = Path(tempfile.mkdtemp(prefix="gyrowheel-bench-"))
    recording, right = folder / "hour", True
    try:
        report = run(recording, MINUTES, lambda fraction: progress(_RUN * fraction))
        if not recording.exists():
            return [report]
        found = diagnosed(recording)
        right = found["verdict"] == "nothing_missing"
    finally:
        if right:
            shutil.rmtree(folder, ignore_errors=True)
    progress(1.0)
    figures = [
        # nothing is hidden in the machine of the graph
        Figure("effects named in it", float(len(found["named"])), "effects", bar=Bar("<=", 0.0)),
        Figure("diagnosis, processor", sum(found["stages"].values()), "s"),
        Figure("diagnosis, memory", found["memory"], "GB"),
    ]
    kept = "" if right else f" It is kept in {recording}: nothing is hidden in it."
    note = f"The recording diagnosed: {found['verdict']}, in {found['windows']} windows.{kept}"
    return [replace(report, figures=[*report.figures, *figures], notes=[*report.notes, note])]
