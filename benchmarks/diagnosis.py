"""Processor time and memory of a diagnosis, stage by stage, for minutes and for an hour of samples.

Every diagnosis runs in a separate process, ``python -m benchmarks.diagnosis RECORDING``, which prints its costs as
JSON; so the peak memory is that of the diagnosis alone.
"""

from __future__ import annotations

import importlib
import io
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import wraps
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.results import Bar, Figure, MeasurementError, Report
from gyrowheel.show.layout import figures_table

#: Functions that are stages: module, function and name of the stage. The remaining time is the last stage.
STAGES = (
    ("gyrowheel_recording.bags.reader", "Recording.open", "reading"),
    ("gyrowheel_analysis.fitting.kept_windows", "reduce_and_account", "reduction"),
    ("gyrowheel_analysis.diagnosis.diagnose", "prepare", "balance"),
    ("gyrowheel_analysis.fitting.problem", "Problem.with_drift_estimated", "noise and drift"),
    ("gyrowheel_analysis.diagnosis.explanation", "select", "selection"),
    ("gyrowheel_analysis.diagnosis.events", "search_events", "events"),
    ("gyrowheel_analysis.diagnosis.events", "search", "free forms"),
    ("gyrowheel_analysis.diagnosis.diagnose", "errors_of", "error table"),
)
_REST, _REPORT = "ties, limits, next test", "report"
_HIDDEN = {"aero_cross": {"c": 0.0055, "n": 1.98}}
MINUTES = "4 minutes"
HOUR = "1 hour"
#: Holds [s] and repetitions of the survey for each length.
_LENGTHS = {MINUTES: (3.25, 1), HOUR: (2.2, 20)}
#: Time and time of the same diagnosis again [s], memory [GB].
_BARS = {MINUTES: (10.0, 1.0, 1.0), HOUR: (90.0, 10.0, 3.0)}
_RUNS = {MINUTES: 3, HOUR: 1}


def plan(name: str) -> str:
    """Return the text of the plan: the survey with longer holds, or repeated in other orders."""
    text = resources.files("gyrowheel_control").joinpath("plans/survey.yaml").read_text(encoding="utf-8")
    survey = yaml.safe_load(text)
    hold, times = _LENGTHS[name]
    segments = [
        {**segment, "shuffle_seed": segment["shuffle_seed"] + 100 * k}
        if "shuffle_seed" in segment
        else segment
        for k in range(times)
        for segment in survey["segments"]
    ]
    return yaml.safe_dump({**survey, "name": "measured", "hold_s": hold, "segments": segments})


def record(folder: Path, text: str, progress: Callable[[float], None]) -> int:
    """Record a machine with a hidden effect and return the number of samples."""
    from gyrowheel_control.loops.closed_loop import simulate
    from gyrowheel_control.plans.plan import Plan
    from gyrowheel_recording.bags import write_run
    from gyrowheel_sim.bench import Bench
    from gyrowheel_sim.blind import draw_machine
    from gyrowheel_sim.environment import to_json
    from gyrowheel_sim.plant.scenario import Scenario

    bench = Bench.load()
    machine = Scenario(draw_machine(bench, np.random.default_rng(6)), _HIDDEN, 6)
    run = simulate(bench, machine, Plan.load(text), progress=progress)
    write_run(
        folder, run.measurement, run.command, run.setpoints, to_json(run.environment), bench.describe(),
        sample_period=bench.sample_period,
    )  # fmt: skip
    return len(run.measurement)


def diagnosed(recording: Path, *, again: bool = False) -> dict[str, Any]:
    """Return the costs of a diagnosis in another process: the first one of a recording, or one that was made before.

    Raises
    ------
    MeasurementError
        If it fails.
    """
    command = [sys.executable, "-m", "benchmarks.diagnosis", str(recording), *["again"] * again]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise MeasurementError(f"the diagnosis failed: {' '.join(done.stderr.split())[-300:]}")
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Measure a recording of four minutes and one of an hour."""
    found: dict[str, dict[str, Any]] = {}
    samples, seconds_again = {}, {}
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
        for part, length in enumerate(_LENGTHS):
            recording = Path(name) / f"recording{part}"

            def advance(fraction: float, done: int = part) -> None:
                progress(0.5 * done + 0.2 * fraction)

            samples[length] = record(recording, plan(length), advance)
            runs = []
            for k in range(_RUNS[length]):
                runs.append(diagnosed(recording))
                progress(0.5 * part + 0.2 + 0.3 * (k + 1) / _RUNS[length])
            found[length] = min(runs, key=lambda run: sum(run["stages"].values()))
            seconds_again[length] = sum(diagnosed(recording, again=True)["stages"].values())
    figures = []
    for length, run in found.items():
        seconds, fewer, gigabytes = _BARS[length]
        figures.append(Figure(f"{length}, time", sum(run["stages"].values()), "s", bar=Bar("<", seconds)))
        figures.append(Figure(f"{length}, again", seconds_again[length], "s", bar=Bar("<", fewer)))
        figures.append(Figure(f"{length}, memory", run["memory"], "GB", bar=Bar("<", gigabytes)))
    table = figures_table("share of the time, %", *found)
    for stage in next(iter(found.values()))["stages"]:
        shares = (100.0 * run["stages"][stage] / sum(run["stages"].values()) for run in found.values())
        table.add_row(stage, *(f"{share:.1f}" for share in shares))
    counts = " and ".join(
        f"{samples[length] / 1e6:.2g} million samples in {run['windows']} windows"
        for length, run in found.items()
    )
    starts = ", ".join(f"{run['start']:.1f} s" for run in found.values())
    return [
        Report(
            "Diagnosis",
            figures,
            notes=[
                f"Survey plan with longer holds, and twenty surveys in a row: {counts}. Hidden: a cross torque of"
                f" the air; found: {'; '.join(', '.join(run['named']) or run['verdict'] for run in found.values())}.",
                "Time of the processor from the opening of the recording to the printed report, best of"
                f" {_RUNS[MINUTES]} and of {_RUNS[HOUR]}; the start of Python and its libraries takes {starts} more."
                " Again: the same diagnosis in another process. Memory: the most that the whole process had.",
            ],
            details=[table],
        )
    ]


def main(recording: str, again: str = "") -> None:
    """Diagnose a recording, for the first time or `again`, and print the costs as JSON."""
    from rich.console import Console

    begun = time.process_time()
    stages = dict.fromkeys([*(stage for _, _, stage in STAGES), _REST, _REPORT], 0.0)
    for module_name, path, stage in STAGES:
        _watch(module_name, path, stage, stages)
    from gyrowheel.diagnosis import page as render
    from gyrowheel_analysis.diagnosis import diagnose as verdict
    from gyrowheel_analysis.model import Model
    from gyrowheel_recording.bags import Recording
    from gyrowheel_sim.bench import Bench

    if not again:
        _forget_recordings()
    model = Model(Bench.load())
    start = time.process_time()
    result = verdict.diagnose([Recording.open(recording)], model)
    found = time.process_time()
    stages[_REST] = found - start - sum(stages.values())
    console = Console(file=io.StringIO(), width=100)
    for part in render.diagnosis_page(result):
        console.print(part)
    stages[_REPORT] = time.process_time() - found
    json.dump(
        {
            "stages": stages,
            "start": start - begun,
            "memory": _most_memory() / 1e9,
            "verdict": result.verdict,
            "named": [finding.name for finding in result.effects],
            "windows": sum(len(item.time) for item in result.residuals),
        },
        sys.stdout,
    )


def _forget_recordings() -> None:
    """Let this process find nothing of recordings in the cache: the first look at a recording is measured."""
    from gyrowheel_core import cache

    read = cache.read
    kept = ("windows_", "setups_", "explanation_", "diagnosis_")
    cache.read = lambda name: None if name.startswith(kept) else read(name)


def _most_memory() -> float:
    """Return the peak memory of this process [bytes].

    The value of `resource` would start with the memory of the parent process.
    """
    try:
        status = Path("/proc/self/status").read_text(encoding="utf-8")
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0
    return 1024.0 * float(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))


def _watch(module_name: str, path: str, stage: str, stages: dict[str, float]) -> None:
    """Add the processor time of a function to its stage, without that of nested stages."""
    owner: Any = importlib.import_module(module_name)
    *outer, name = path.split(".")
    for part in outer:
        owner = getattr(owner, part)
    found = getattr(owner, name, None)
    if found is None:
        raise SystemExit(f"{module_name} has no {path}: the stages of a diagnosis have changed")

    @wraps(found)
    def timed(*arguments: Any, **named: Any) -> Any:
        begin, before = time.process_time(), sum(stages.values())
        try:
            return found(*arguments, **named)
        finally:
            within = sum(stages.values()) - before
            stages[stage] += time.process_time() - begin - within

    setattr(owner, name, timed)


if __name__ == "__main__":
    main(*sys.argv[1:])
