"""An hour of the whole graph in real time, recorded, then diagnosed: nothing lost, no memory that grows."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from benchmarks.diagnosis import diagnosed
from benchmarks.realtime import run
from benchmarks.results import Bar, Figure, Report
from gyrowheel_core.node import prepare_environment

MINUTES = 60.0
_RUN = 0.97  # share of the progress


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Measure an hour; it takes five minutes more."""
    prepare_environment()
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as folder:
        recording = Path(folder) / "hour"
        report = run(recording, MINUTES, lambda fraction: progress(_RUN * fraction))
        if not recording.exists():
            return [report]
        found = diagnosed(recording)
    progress(1.0)
    figures = [
        # nothing is hidden in the machine of the graph
        Figure("effects named in it", float(len(found["named"])), "effects", bar=Bar("<=", 0.0)),
        Figure("diagnosis, processor", sum(found["stages"].values()), "s"),
        Figure("diagnosis, memory", found["memory"], "GB"),
    ]
    note = f"The recording diagnosed: {found['verdict']}, in {found['windows']} windows."
    return [replace(report, figures=[*report.figures, *figures], notes=[*report.notes, note])]
