"""From the command to the first step of the simulation: whole processes, with and without compiled code on the disk."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.results import Bar, Figure, MeasurementError, Report

WARM, COLD = 5, 2  # processes
PLAN = """
schema: 1
name: first_step
hold_s: 0.05
segments:
  - {spin_rpm: 3500, tilt_deg: [[0, 0]]}
"""


def first_step(folder: Path, cache: Path, number: int) -> float:
    """Return the time from the start of ``gyrowheel simulate`` to the message that its short plan is simulated [s].

    The plan is a tenth of a second long; writing the recording afterwards is not counted.

    Parameters
    ----------
    folder : Path
        Folder of plan and recording.
    cache : Path
        Folder of the compiled code.
    number : int
        Number of the process, for the name of its recording.

    Raises
    ------
    MeasurementError
        If the command fails.
    """
    plan = folder / "plan.yaml"
    plan.write_text(PLAN, encoding="utf-8")
    command = [sys.executable, "-c", "from gyrowheel.cli.app import main; main()", "simulate"]
    command += ["--plan", str(plan), "-o", str(folder / f"recording{number}")]
    environment = {**os.environ, "GYROWHEEL_CACHE": str(cache), "NO_COLOR": "1"}
    begin = time.perf_counter()
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        seconds, lines = None, []
        for line in process.stderr:
            lines.append(line)
            if seconds is None and "100 %" in line:
                seconds = time.perf_counter() - begin
    if process.returncode or seconds is None:
        raise MeasurementError(
            f"gyrowheel simulate failed: {' '.join(''.join(lines).split()) or process.returncode}"
        )
    return seconds


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Measure warm and cold starts."""
    warm, cold, busy = [], [], []
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
        folder = Path(name)
        for k in range(COLD + WARM):
            if k < COLD:
                cold.append(first_step(folder, folder / f"cache{k}", k))
            else:
                before = _children()
                warm.append(first_step(folder, folder / "cache0", k))
                busy.append(_children() - before)
            progress((k + 1) / (COLD + WARM))
    return [
        Report(
            "Start of gyrowheel simulate",
            [
                Figure("warm", min(warm), "s", bar=Bar("<", 3.0)),
                Figure("cold", min(cold), "s", "warm", min(warm)),
            ],
            notes=[
                "Whole processes, by the clock from their start until the first tenth of a second is simulated. "
                f"Cold: nothing compiled is on the disk, best of {COLD}. Warm: a later process, best of {WARM}, median "
                f"{statistics.median(warm):.2f} s; the whole process needs {min(busy):.2f} s of the processor. "
                "Python's own bytecode is there in both.",
            ],
        )
    ]


def _children() -> float:
    """Return the processor time of the child processes [s]."""
    times = os.times()
    return times.children_user + times.children_system
