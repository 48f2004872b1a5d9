"""The graph in real time: ten recorded minutes, lost samples and late commands, and their causes."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.graph import PLAN
from benchmarks.results import Bar, Figure, Report
from benchmarks.timing import processor_time, stolen_time
from gyrowheel_bringup.graph import Graph, GraphError, Progress
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import prepare_environment
from gyrowheel_recording.bags import info

MINUTES = 10.0
WATCHDOG_S = 2.0  # longer than the default, for a busy computer
#: Allowed growth of the memory of a node in an hour [MiB].
GROWTH = 5.0
_SEGMENTS_S = 10.8  # duration of one repetition
_SETTLED_S = 60.0  # start of the evaluation of the memory
_DOMAIN = 62


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Measure ten minutes."""
    prepare_environment()
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as folder:
        return [run(Path(folder) / "realtime", MINUTES, progress)]


def run(directory: Path, minutes: float, progress: Callable[[float], None]) -> Report:
    """Run the whole graph in real time, recorded into `directory`, and return losses and costs."""
    marks: list[tuple[float, dict[str, float], dict[str, float]]] = []  # time, processor time, memory

    def note(p: Progress) -> None:
        if not marks or time.monotonic() - marks[-1][0] > 1.0:
            pids = graph.pids
            marks.append(
                (
                    time.monotonic(),
                    {name: processor_time(pid) for name, pid in pids.items()},
                    {name: _memory(pid) for name, pid in pids.items()},
                )
            )
        progress(min(p.elapsed / p.duration, 1.0))

    title = f"Graph in real time, {minutes:g} min"
    repeat = str(max(round(60.0 * minutes / _SEGMENTS_S), 1))
    parameters = {"plant": {"watchdog": WATCHDOG_S}}
    host = stolen_time()
    try:
        with Graph(
            PLAN.replace("REPEAT", repeat),
            record=directory,
            realtime=True,
            parameters=parameters,
            domain_id=int(os.environ.get("ROS_DOMAIN_ID") or _DOMAIN),
        ) as graph:
            result = graph.run(progress=note)
    except (GraphError, InputError) as error:
        # for example a guard that trips because the computer is too slow for the loop: that is also a result
        figure = Figure("lost samples", float("nan"), "samples", bar=Bar("<=", 0.0))
        return Report(title, [figure], notes=[f"The run ended early: {error}."])
    found = info(directory).integrity
    (begin, first, _), (end, last, _) = marks[0], marks[-1]
    samples, pace = result.samples, result.pace
    own = min(pace["displaced_samples"], pace["late_commands"])
    return Report(
        title,
        [
            Figure("lost samples", float(found.missing), "samples", bar=Bar("<=", 0.0)),
            Figure("late commands", 100.0 * pace["late_commands"] / samples, "%", bar=Bar("<", 1.0)),
            Figure("late: the plant itself was displaced", 100.0 * own / samples, "%"),
            Figure(
                "late: the answer took more than two periods",
                100.0 * (pace["late_commands"] - own) / samples,
                "%",
            ),
            Figure("missing commands", 100.0 * pace["missing_commands"] / samples, "%"),
            Figure("samples with the last command held", 100.0 * pace["held_samples"] / samples, "%"),
            Figure("samples more than a period late", 100.0 * pace["late_samples"] / samples, "%"),
            Figure("longest delay of a sample", pace["worst_delay_ms"], "ms"),
            Figure("time that the bench stood still", pace["behind_s"], "s"),
            # of a virtual machine: time that its host gives to others is lost for the loop, at any priority
            Figure("processor taken by the host", 100.0 * (stolen_time() - host) / (end - begin), "%"),
            *(
                Figure(f"processor: {name}", 100.0 * (last[name] - first[name]) / (end - begin), "%")
                for name in result.pids
            ),
            *(
                Figure(f"memory, growth: {name}", _growth(marks, name), "MiB/h", bar=Bar("<", GROWTH))
                for name in result.pids
            ),
        ],
        notes=[
            f"Five processes and the one that started them, a sample every 0.5 ms, everything recorded: {samples} "
            "samples. Late is a command that came after the next sample; the guard's watch-dog is set to "
            f"{WATCHDOG_S:g} s. Processor: share of one core. Memory: the slope of what is resident, after the first "
            f"{_SETTLED_S:g} s.",
        ],
    )


def _growth(marks: list[tuple[float, dict[str, float], dict[str, float]]], name: str) -> float:
    """Return the growth of the memory of a node [MiB/h]: the slope of a straight line."""
    begin = marks[0][0]
    points = [(t - begin, memory[name]) for t, _, memory in marks if t - begin > _SETTLED_S]
    if len(points) < 2:
        return float("nan")
    times, sizes = np.array(points).T
    return float(np.polyfit(times / 3600.0, sizes / 2**20, 1)[0])


def _memory(pid: int) -> float:
    """Return the private resident memory of a process [bytes]; NaN if the system does not report it.

    Pages of files, such as the recording and shared libraries, do not count.
    """
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return float("nan")
    return next((1024.0 * int(line.split()[1]) for line in lines if line.startswith("RssAnon")), float("nan"))
