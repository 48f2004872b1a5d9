"""Studies: further cases of tests, run one by one.

They are part of the test files and marked ``study``; ``make test`` leaves them out.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from benchmarks.results import Bar, Figure, MeasurementError, Report

ROOT = Path(__file__).resolve().parents[1]


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Run all studies, on all cores, and count those that pass."""
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
        written = Path(name) / "studies.xml"
        command = [sys.executable, "-m", "pytest", "--studies", "-n", "auto", "-q", f"--junitxml={written}"]
        run = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert run.stdout is not None
        said = ""
        for line in run.stdout:
            said += line
            if line.rstrip().endswith("%]"):
                progress(float(line.rpartition("[")[2].rstrip().rstrip("%]")) / 100.0)
        if run.wait() > 1 or not written.exists():
            raise MeasurementError(f"the studies do not run: {' '.join(said.split())[-300:]}")
        return [report(written)]


def report(written: Path) -> Report:
    """Return the figures of the report of a pytest run."""
    cases: Counter[str] = Counter()
    failed: dict[str, list[str]] = {}
    for case in ET.parse(written).getroot().iter("testcase"):
        file = case.get("classname", "").rpartition(".")[2].removeprefix("test_")
        cases[file] += 1
        if case.find("failure") is not None or case.find("error") is not None:
            failed.setdefault(file, []).append(case.get("name", ""))
    return Report(
        "Studies",
        [
            Figure(
                file,
                float(count - len(failed.get(file, ()))),
                f"of {count} hold",
                bar=Bar(">=", float(count)),
            )
            for file, count in sorted(cases.items())
        ],
        notes=[
            "Each case is one more of what a test shows, with another effect, instrument or machine.",
            *(f"{file}: {', '.join(names)}." for file, names in failed.items()),
        ],
    )
